#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""./core.sh bench grounding [--profile core|paper] [--build native|portable] [--frames N]: cost and exactness.

Renders N frames of a walk in each of three worlds (once; kept in results/bench), builds the library free of ROS, and
runs all geometry of grounding (segmentation excluded) over them, with perfect labels and the tasks' predicates.
Beside it, on the same frames: OctoMap's insertPointCloud, a plain OpenCV pipeline in C++, a plain numpy pipeline.
Progress goes to stderr; the last line on stdout is one JSON object, times in process CPU ms unless they say wall:

    mean_ms p95_ms p99_ms max_ms      a whole SemanticMap::update; wall: the same in wall time; per frame the median of
                                      passes, so that other programs on the machine count little
    frames points                     frames in all; mean number of points in range
    stages map_ms                     mean per stage; map part = depth image to voxels + octree + columns
    insert_point_cloud_ms insert_discretized_ms opencv_ms numpy_ms, and map_vs_insert_point_cloud
    map_vs_insert_discretized whole_vs_opencv whole_vs_numpy: their means over ours, on the same frames
    decisions_different               of decisions_compared cells and frames, against a reference in double precision
                                      (profile paper, else null); observations_different: pixels in another voxel;
                                      leaf_counts_ok: the octree's leaves sum to the observations
    scenes                            times of each, and what the plain OpenCV pipeline takes: about 3 ms per AROUND
    notes bars                        what the ratios do not say; every bar with figure, bar and met

Exit code 1 when a bar is not met.
"""

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import yaml

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "src" / "core_bringup" / "src"))
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "src" / "core_perception" / "src"))

from core_bringup.evaluation.bars import finish, judge
from core_bringup.evaluation.frame_recorder import BENCH_SCENES, find_recording
from core_bringup.evaluation.frame_recording import FrameRecording
from core_bringup.evaluation.grounding_figures import (
    BUILDS,
    Measurement,
    build_programs,
    compare,
    format_params,
    summarise,
)
from core_bringup.evaluation.plain_grounding import PlainGrounding
from core_bringup.exceptions import BringupError

ROOT = Path(__file__).resolve().parents[2]
PROFILES = ("core", "paper")
INSERT_EVERY, NUMPY_EVERY = 4, 20
NOTES = (
    "the count-based update does not cast rays; insertPointCloud does, and updates free space on the way",
    "the map part begins at the depth image, insertPointCloud at a finished cloud of the same points",
    "both plain pipelines do the method of profile paper in two dimensions: no octree, no remembered objects",
    "the warehouse is recorded with the over-cautious predicates of its task beside those of the oracle",
)
# Bars of the build machine, per profile and build.
TIME_BARS = {
    ("paper", "native"): {"mean_ms": 1.0, "p99_ms": 2.5},
    ("paper", "portable"): {"mean_ms": 1.6},
    ("core", "native"): {"mean_ms": 3.0, "p99_ms": 6.0},
    ("core", "portable"): {},
}
RATIO_BARS = {"map_vs_insert_point_cloud": 50.0, "map_vs_insert_discretized": 12.0, "whole_vs_opencv": 8.0}


def say(text):
    print(f"grounding: {text}", file=sys.stderr, flush=True)


def run_program(program, params_file, recordings, passes, reference):
    """Measurement over all recordings, and per recording."""
    whole, scenes = Measurement(), {}
    for name, path in recordings.items():
        say(f"{name}: {passes} passes")
        command = [str(program), str(params_file), str(path), str(passes), str(INSERT_EVERY)]
        done = subprocess.run(command + ["reference"] * reference, stdout=subprocess.PIPE, check=False)
        if done.returncode != 0:
            raise BringupError(f"{program.name}: exit status {done.returncode}")
        scenes[name] = Measurement()
        for measurement in (whole, scenes[name]):
            measurement.add(done.stdout.decode())
    return whole, scenes


def time_numpy(params, recordings):
    """CPU time [ms] of a frame of the plain numpy pipeline, every NUMPY_EVERY-th frame."""
    times_ms = []
    for path in recordings.values():
        recording = FrameRecording.open(path)
        pipeline = PlainGrounding(recording.header, params)
        for k in range(0, len(recording.frames), NUMPY_EVERY):
            frame = recording.frames[k].copy()
            before_s = time.process_time()
            pipeline.update(frame)
            times_ms.append(1e3 * (time.process_time() - before_s))
    return np.array(times_ms)


def exactness(whole, profile):
    """Agreement with the reference, which exists for profile paper."""
    if profile != "paper":
        return {"decisions_different": None}
    names = ("decisions_different", "decisions_compared", "observations", "observations_different")
    return {
        **{n: whole.values[n] for n in names},
        "leaf_counts_ok": whole.values["leaf_counts"] == whole.values["observations"],
    }


def judge_results(results):
    """Every bar that holds for this profile and build."""
    profile, build = results["profile"], results["build"]
    bars = {name: (results[name], "<=", limit) for name, limit in TIME_BARS[profile, build].items()}
    if profile == "paper":
        bars["decisions_different"] = (results["decisions_different"], "==", 0)
        bars["leaf_counts_ok"] = (int(results["leaf_counts_ok"]), "==", 1)
        if build == "native":
            bars.update({name: (results[name], ">=", limit) for name, limit in RATIO_BARS.items()})
    return judge(bars)


def measure(options, folder):
    """All figures."""
    recordings = {}
    for scene in BENCH_SCENES:
        say(f"{scene.name}: {options.frames} frames (rendered when missing)")
        recordings[scene.name] = find_recording(scene, options.frames, folder)
    say(f"building for {options.build}")
    bench_dir = ROOT / "src" / "core_perception" / "bench"
    programs = build_programs(bench_dir, folder / f"build_{options.build}", options.build)
    config = ROOT / "src" / "core_perception" / "config" / f"{options.profile}.yaml"
    params = yaml.safe_load(config.read_text(encoding="utf-8"))["semantic_map"]
    with tempfile.TemporaryDirectory() as scratch:
        params_file = Path(scratch) / "params.txt"
        params_file.write_text(format_params(params), encoding="utf-8")
        whole, scenes = run_program(
            programs / "bench_grounding", params_file, recordings, options.passes, options.profile == "paper"
        )
    say("numpy pipeline")
    numpy_ms = time_numpy(params, recordings)
    times_ms = whole.per_frame("whole_cpu_ms")
    return {
        "bench": "grounding",
        "profile": options.profile,
        "build": options.build,
        **summarise(times_ms),
        "wall": summarise(whole.per_frame("whole_wall_ms")),
        "frames": len(times_ms),
        "passes": options.passes,
        "points": round(float(whole.per_frame("points").mean())),
        "stages": {name: round(float(whole.per_frame(f"stage_{name}_cpu_ms").mean()), 4) for name in whole.stages()},
        "map_ms": round(float(whole.map_part().mean()), 4),
        **compare(whole, numpy_ms, INSERT_EVERY, NUMPY_EVERY),
        **exactness(whole, options.profile),
        "scenes": {
            name: {
                **summarise(scene.per_frame("whole_cpu_ms")),
                "opencv_ms": round(scene.per_frame("opencv_cpu_ms").mean(), 3),
            }
            for name, scene in scenes.items()
        },
        "notes": list(NOTES),
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--profile", choices=PROFILES, default="core")
    parser.add_argument("--build", choices=BUILDS, default="native")
    parser.add_argument("--frames", type=int, default=200, help="of each scene")
    parser.add_argument("--passes", type=int, default=5)
    options = parser.parse_args()
    if options.frames < 1 or options.passes < 1:
        parser.error("--frames and --passes: allowed >= 1")
    try:
        results = measure(options, ROOT / "results" / "bench")
    except BringupError as error:
        say(error)
        return 1
    return finish(results, judge_results(results))


if __name__ == "__main__":
    sys.exit(main())

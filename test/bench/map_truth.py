#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""./core.sh bench map_truth [--profile core|paper|both] [--scene NAME ...]: is the map right?

Walks a camera through the three worlds with perfect segmentation, once with exact depth and once with the noise of the
camera, lets the real map ground the frames, and holds its safety grid against the oracle's predicates evaluated on the
true geometry, in metres: ON, NEAR, AROUND, BETWEEN, metric obstacles, and whatever is in no safe region. It counts
cells that were observed within range. The walks are rendered once and kept in results/bench/map_truth (1.2 GB), where
a picture of every map is drawn: look at these. Exactly what is measured, with formulas: evaluation/map_truth.py,
true_regions.py and sight.py in core_bringup.

Progress goes to stderr; the last line on stdout is one JSON object. Per profile, over all walks and for each
("exact", "noisy"):

    iou                    overlap of what is called and what is truly unsafe, in cells
    iou_strict             the same with the cells that a true border only touches; without them the alignment of the
                           world's walls with the cells decides
    optimistic_share       truly unsafe cells called safe; pessimistic_share: safe ones called unsafe
    pessimistic_beside_truth   share of the latter that lie beside a truly unsafe cell
    border_within_1_cell   share of the true border beyond which the map lets a point go at most one cell
    worst_depth_cells      farthest it does so anywhere, with worst_place_m and worst_rules, the rules that hold there
    worst_hole_cells       the same anywhere inside a true region, where a robot cannot get to
    worlds                 the shares for each world
    on_the_way             the worst of every 20th frame; the other figures are of the map at the end of the walk
    bars                   for profile core: every bar with figure, bar and met

Exit code 1 when a bar is not met.
"""

import argparse
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

from tqdm import tqdm

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "src" / "core_bringup" / "src"))
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "src" / "core_perception" / "src"))

from core_bringup.evaluation.bars import finish
from core_bringup.evaluation.frame_recorder import find_recording
from core_bringup.evaluation.frame_recording import FrameRecording
from core_bringup.evaluation.ground_program import add_noise, ground, read_profile
from core_bringup.evaluation.grounding_figures import build_programs
from core_bringup.evaluation.map_truth import GridCollage
from core_bringup.evaluation.map_truth_picture import draw_comparison
from core_bringup.evaluation.map_truth_run import SCENES, Truth, Walk, assess, judge, summarise
from core_bringup.exceptions import BringupError

ROOT = Path(__file__).resolve().parents[2]
PROFILES = {"core": ("core",), "paper": ("paper",), "both": ("core", "paper")}
KINDS = ("exact", "noisy")
EVERY = 20
NOISE_SEED = 1


class Bench:
    """Everything that stays the same from walk to walk."""

    def __init__(self, options, folder):
        """Build the program and read the profiles."""
        perception = ROOT / "src" / "core_perception"
        self.options, self.folder = options, folder
        self.profiles = PROFILES[options.profile]
        build = build_programs(perception / "bench", ROOT / "results" / "bench" / "build_native", "native")
        self.program = build / "ground_frames"
        self.params = {name: read_profile(perception / "config", name) for name in ("core", "paper")}

    def measure(self, scene, bar):
        """Profile and kind of depth -> figures of one walk."""
        recording = find_recording(scene, self.options.frames, self.folder)
        bar.update()
        walk = Walk.load(scene, FrameRecording.open(recording), self.params["core"])
        bar.update()
        results = {}
        with tempfile.TemporaryDirectory(dir=self.folder) as scratch:
            noisy = Path(scratch) / "noisy.frames"
            add_noise(recording, replace(walk.world.camera_noise, seed=NOISE_SEED), noisy)
            bar.update()
            truth = None
            for profile in self.profiles:
                for kind, path in zip(KINDS, (recording, noisy)):
                    grids = ground(self.program, self.params[profile], path, EVERY, Path(scratch))
                    collage = GridCollage(grids)
                    truth = truth or Truth(walk, *collage.rectangle)
                    results[profile, kind], final = assess(walk, truth, collage)
                    self.draw(scene, profile, kind, walk, final, results[profile, kind])
                    bar.update()
        return results

    def draw(self, scene, profile, kind, walk, final, result):
        """Picture of the map at the end of a walk."""
        title = (
            f"{scene.name}, {kind} depth, profile {profile}: IoU {result['iou']:.3f}, "
            f"{100.0 * result['border_within_1_cell']:.2f} % of the border within 1 cell, "
            f"worst {result['worst_depth_cells']:.2f} cells"
        )
        draw_comparison(self.folder / f"{scene.name}_{kind}_{profile}.png", final, walk.sight.path_m, title)


def measure(options, scenes):
    """All figures."""
    folder = ROOT / "results" / "bench" / "map_truth"
    folder.mkdir(parents=True, exist_ok=True)
    bench, results = Bench(options, folder), {}
    steps = len(scenes) * (3 + len(KINDS) * len(bench.profiles))
    with tqdm(total=steps, desc="map_truth", unit="step", file=sys.stderr) as bar:
        for scene in scenes:
            bar.set_postfix_str(scene.name)
            for (profile, kind), figures in bench.measure(scene, bar).items():
                results.setdefault(profile, {}).setdefault(scene.name, {})[kind] = figures
    return {
        "bench": "map_truth",
        "profile": options.profile,
        "frames": options.frames,
        "pictures": str(folder.relative_to(ROOT)),
        **{profile: {**summarise(walks), "scenes": walks} for profile, walks in results.items()},
    }


def print_table(results):
    """One line for every map."""
    columns = f"{'IoU':>7}{'strict':>8}{'optim.':>8}{'pess.':>8}{'<=1 cell':>10}{'worst':>7}"
    print(f"{'walk':34}{'depth':7}{'profile':8}{columns}", file=sys.stderr)
    for profile in PROFILES[results["profile"]]:
        rows = {"all walks": results[profile], **results[profile]["scenes"]}
        for name, row in rows.items():
            for kind in KINDS:
                r = row[kind]
                shares = (
                    f"{r['iou']:7.3f}{r['iou_strict']:8.3f}{r['optimistic_share']:8.3f}{r['pessimistic_share']:8.3f}"
                )
                depth = f"{100.0 * r['border_within_1_cell']:9.2f}%{r['worst_depth_cells']:7.2f}"
                print(f"{name:34}{kind:7}{profile:8}{shares}{depth}", file=sys.stderr)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--profile", choices=sorted(PROFILES), default="both")
    parser.add_argument("--frames", type=int, default=200, help="of each walk")
    names = [scene.name for scene in SCENES]
    parser.add_argument("--scene", choices=names, action="append", help="only this walk; may be repeated")
    options = parser.parse_args()
    if options.frames < EVERY:
        parser.error(f"--frames: allowed >= {EVERY}")
    try:
        results = measure(options, [s for s in SCENES if not options.scene or s.name in options.scene])
    except BringupError as error:
        print(f"map_truth: {error}", file=sys.stderr)
        return 1
    print_table(results)
    return finish(results, judge(results["core"]) if "core" in results else {})


if __name__ == "__main__":
    sys.exit(main())

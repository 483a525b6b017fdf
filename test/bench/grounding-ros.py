#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""./core.sh bench grounding-ros [--profile core|paper] [--rate HZ] [--frames N]: image in -> safety_grid out.

Plays recorded walks (rendered once, kept in results/bench) to the shipped semantic_map node through real topics, and in
the same run to a null relay: a roscpp node that takes the same two images through the same queues and answers at once
with an empty SafetyGrid of the same size. Each gets its frame at pinned times, the relay half a period after the map,
so that neither waits for the other. Latency: from right before the depth image is published (the labels follow at once)
until the bytes of the grid are back, both in this process by its monotonic clock; tf is there when the images come, and
segmentation takes no time. Progress goes to stderr; the last line on stdout is one JSON object:

    p50_ms p99_ms max_ms null          wall time of the map, and of the relay
    excess_p50_ms excess_p99_ms        map - relay
    frames dropped                     frames sent to each; those without a grid
    late_starts                        frames sent more than 1 ms after their time
    load_average                       of the machine, in the last minute, before and after
    nice                               priority of the graph and of this process: a raised one is asked for (--nice), so
                                       that other programs on the machine count less
    bars                               every bar with figure, bar and met

Exit code 1 when a bar is not met.
"""

import argparse
import contextlib
import gc
import os
import sys
import time
from pathlib import Path

import numpy as np
import rospy
import std_srvs.srv

from core_bringup.evaluation.bars import finish, judge
from core_bringup.evaluation.frame_recorder import BENCH_SCENES, find_recording
from core_bringup.evaluation.frame_recording import FrameRecording
from core_bringup.evaluation.launcher import RoslaunchProcess
from core_bringup.exceptions import BringupError
from core_bringup.ros.recording_player import RecordingPlayer, join_graph

ROOT = Path(__file__).resolve().parents[2]
EXCESS_P99_BAR_MS = 10.0
START_DEADLINE_S, LAST_GRID_DEADLINE_S = 30.0, 2.0
LATE_S = 0.001
SPIN_S = 0.0015  # the end of a wait is spun: sleeping may oversleep by as much


def say(text):
    print(f"grounding-ros: {text}", file=sys.stderr, flush=True)


def sleep_until(instant_s):
    """Until a time of the monotonic clock; returns by how much it was missed [s]."""
    pause_s = instant_s - time.monotonic() - SPIN_S
    if pause_s > 0.0:
        time.sleep(pause_s)
    while time.monotonic() < instant_s:
        pass
    return time.monotonic() - instant_s


class Run:
    """Latencies of both listeners, frame by frame."""

    def __init__(self, rate_hz):
        self._period_s = 1.0 / rate_hz
        self._players = {"map": RecordingPlayer("/map"), "null": RecordingPlayer("/null", images_only=True)}
        self._sent = {name: [] for name in self._players}  # (stamp [ns], time of the images [s])
        self.late_starts = 0

    def connect(self):
        for player in self._players.values():
            player.wait_connected(START_DEADLINE_S)

    def play(self, recording):
        """Send every frame of a recording to both, at pinned times; ends with the grids of the last one."""
        start_s = time.monotonic() + self._period_s
        for k, frame in enumerate(recording.frames):
            for offset, (name, player) in zip((0.0, 0.5), self._players.items()):
                stamp_ns = time.time_ns()
                send = player.prepare(recording.header, frame, stamp_ns)
                self.late_starts += sleep_until(start_s + (k + offset) * self._period_s) > LATE_S
                self._sent[name].append((stamp_ns, send()))
        for name, player in self._players.items():
            player.arrival_s(self._sent[name][-1][0], LAST_GRID_DEADLINE_S)

    def latencies_ms(self, name):
        """Of the frames that were answered [ms]."""
        player = self._players[name]
        arrivals = [(player.arrival_s(stamp_ns), sent_s) for stamp_ns, sent_s in self._sent[name]]
        return np.array([1e3 * (arrived_s - sent_s) for arrived_s, sent_s in arrivals if arrived_s is not None])

    def sent(self, name):
        return len(self._sent[name])


def rank(ordered, share):
    """A latency that was measured, never between two."""
    return float(ordered[int(np.ceil(share * len(ordered))) - 1])


def summarise(times_ms):
    ordered = np.sort(times_ms)
    figures = {"p50_ms": rank(ordered, 0.5), "p99_ms": rank(ordered, 0.99), "max_ms": float(ordered[-1])}
    return {name: round(value, 3) for name, value in figures.items()}


def measure(options):
    """All figures; needs the graph."""
    recordings = [
        FrameRecording.open(find_recording(scene, options.frames, ROOT / "results" / "bench")) for scene in BENCH_SCENES
    ]
    run, load_before = Run(options.rate), os.getloadavg()[0]
    run.connect()
    reset = rospy.ServiceProxy("/map/semantic_map/reset", std_srvs.srv.Empty)
    gc.disable()  # a collection would stand in the latency of the frame it meets
    for scene, recording in zip(BENCH_SCENES, recordings):
        say(f"{scene.name}: {len(recording.frames)} frames at {options.rate:g} Hz")
        reset()
        run.play(recording)
    latencies_ms = {name: run.latencies_ms(name) for name in ("map", "null")}
    if any(len(times_ms) == 0 for times_ms in latencies_ms.values()):
        raise BringupError("no grid came; see the log")
    own, null = summarise(latencies_ms["map"]), summarise(latencies_ms["null"])
    return {
        "bench": "grounding-ros",
        "profile": options.profile,
        "rate_hz": options.rate,
        **own,
        "null": null,
        "excess_p50_ms": round(own["p50_ms"] - null["p50_ms"], 3),
        "excess_p99_ms": round(own["p99_ms"] - null["p99_ms"], 3),
        "frames": run.sent("map"),
        "dropped": run.sent("map") - len(latencies_ms["map"]),
        "null_dropped": run.sent("null") - len(latencies_ms["null"]),
        "late_starts": run.late_starts,
        "nice": os.nice(0),
        "load_average": [round(load_before, 2), round(os.getloadavg()[0], 2)],
    }


def judge_results(results):
    bars = {"excess_p99_ms": EXCESS_P99_BAR_MS, "dropped": 0}
    return judge({name: (results[name], "<=", limit) for name, limit in bars.items()})


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--profile", choices=("core", "paper"), default="core")
    parser.add_argument("--rate", type=float, default=10.0, help="of the camera [Hz]")
    parser.add_argument("--frames", type=int, default=200, help="of each of the three walks")
    parser.add_argument("--nice", type=int, default=-10, help="priority asked for; below 0 only root gets it")
    options = parser.parse_args()
    if options.frames < 1 or not 0.1 <= options.rate <= 50.0:
        parser.error("--frames: allowed >= 1; --rate: allowed 0.1..50")
    if options.nice != 0:
        with contextlib.suppress(PermissionError):
            os.nice(options.nice)  # the graph inherits it
    log = ROOT / "results" / "bench" / "grounding_ros.log"
    launch = str(Path(__file__).with_name("grounding_ros.launch"))
    try:
        with RoslaunchProcess(("roslaunch", launch, f"profile:={options.profile}"), log) as graph:
            join_graph(graph, "bench_grounding_ros")
            results = measure(options)
    except BringupError as error:
        say(f"{error} ({log})")
        return 1
    return finish(results, judge_results(results))


if __name__ == "__main__":
    sys.exit(main())

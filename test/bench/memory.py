#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""./core.sh bench memory [--minutes M] [--keep-radius R]: an hour of walking, compressed; what the map's process holds.

Plays frames with stamps of an hour to three semantic_map nodes, as fast as they answer: one that keeps everything (as
shipped), one that drops what leaves a rolling window, one that keeps it on disk. Recorded walks (rendered once, kept in
results/bench) are set end to end, each moved to where the last one ended, so that new ground keeps coming for two
thirds of the time; for the last third the robot goes back over it, frame by frame. One frame every half second, at
0.5 m/s. Progress goes to stderr; the last line on stdout is one JSON object, of the shipped map unless it says more:

    rss_start_mb rss_end_mb          resident size after the first three minutes, and at the end
    rss_turn_mb again_mb             where the robot turns back; growth after it, on ground walked again
    bytes_per_m2                     growth up to there, by area seen meanwhile (columns with votes; resolution_m 0.2)
    first_half second_half           the same in each half of that way: it follows the new ground alone
    mapped_m2 frames
    drop disk                        with a window of keep_radius_m: rss_start_mb, rss_end_mb, growth_mb; tiles away at
                                     the end, tiles_lost; frame_ms, frame_p99_ms as below
    frame_ms                         median time from images to grid in the first, and in the last three minutes [ms]
    frame_p99_ms                     99th percentile of it over the hour: what moving tiles adds shows beside the others
    bars                             every bar with figure, bar and met; the margin of the windows is what malloc may
                                     keep of what was freed

Exit code 1 when a bar is not met.
"""

import argparse
import statistics
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import rospy
from diagnostic_msgs.msg import DiagnosticArray

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from graph import node_pid

from core_bringup.evaluation.bars import finish, judge
from core_bringup.evaluation.frame_recorder import BENCH_SCENES, find_recording
from core_bringup.evaluation.frame_recording import FrameRecording
from core_bringup.evaluation.launcher import RoslaunchProcess
from core_bringup.exceptions import BringupError
from core_bringup.ros.recording_player import RecordingPlayer, join_graph

ROOT = Path(__file__).resolve().parents[2]
NODES = ("whole", "drop", "disk")
SCENES = BENCH_SCENES[1:]  # the first one comes back to where it began
RECORDED_FRAMES, EVERY, PERIOD_S = 200, 5, 0.5
NEW_SHARE, WARM_UP_S = 2 / 3, 180.0
LOOK_EVERY = 10  # frames between two looks at the published window, for the area
CONNECT_DEADLINE_S, GRID_DEADLINE_S = 30.0, 30.0
MARGIN_MB, HALVES_BAR = 4.0, 0.25


def say(text):
    print(f"memory: {text}", file=sys.stderr, flush=True)


def resident_mb(pid):
    for line in Path(f"/proc/{pid}/status").read_text(encoding="ascii").splitlines():
        if line.startswith("VmRSS:"):
            return float(line.split()[1]) / 1024.0
    raise BringupError(f"process {pid} has ended")


class Walk:
    """Frame k of a walk that never ends: recordings end to end, each moved to the end of the one before."""

    def __init__(self):
        folder = ROOT / "results" / "bench"
        self._recordings = [FrameRecording.open(find_recording(scene, RECORDED_FRAMES, folder)) for scene in SCENES]
        self._length = RECORDED_FRAMES // EVERY
        ends = [np.array([r.frames[0]["p_map_base"], r.frames[-1]["p_map_base"]]) for r in self._recordings]
        self._starts = [pair[0] for pair in ends]
        self._ways = [pair[1] - pair[0] for pair in ends]

    def frame(self, k):
        """Header and frame, its pose moved."""
        lap, rest = divmod(k, self._length * len(SCENES))
        scene, at = divmod(rest, self._length)
        start = lap * sum(self._ways) + sum(self._ways[:scene], np.zeros(2))
        frame = self._recordings[scene].frames[at * EVERY].copy()
        moved = start - self._starts[scene]
        frame["p_map_base"] += moved
        frame["T_map_camera"][:2, 3] += moved
        return self._recordings[scene].header, frame


class Area:
    """Cells that had votes in any published window."""

    def __init__(self):
        self._cells = np.zeros(0, np.int64)
        self._cell_m2 = 0.0

    def look(self, grid):
        seen = np.flatnonzero((grid.n_safe + grid.n_unsafe) > 0)
        x = seen % grid.width + round(grid.origin_x_m / grid.resolution_m)
        y = seen // grid.width + round(grid.origin_y_m / grid.resolution_m)
        self._cells = np.union1d(self._cells, (x.astype(np.int64) << 32) + y)
        self._cell_m2 = grid.resolution_m**2

    def m2(self):
        return len(self._cells) * self._cell_m2


class Walker:
    """Plays the walk to every node and notes what each one holds."""

    def __init__(self):
        self._players = {name: RecordingPlayer(f"/{name}") for name in NODES}
        self._pids = {}
        self._walk, self._area = Walk(), Area()
        self.frame_ms = {name: [] for name in NODES}
        self._first_stamp_ns = 0

    def connect(self, n_frames):
        for name, player in self._players.items():
            player.wait_connected(CONNECT_DEADLINE_S)
            self._pids[name] = node_pid(f"/{name}/semantic_map")
        # In the past: constraints from the future are not in force.
        self._first_stamp_ns = time.time_ns() - round(1e9 * PERIOD_S * (n_frames + 10))

    def step(self, i, k):
        """Play frame k of the walk as the i-th of the hour."""
        header, frame = self._walk.frame(k)
        stamp_ns = self._first_stamp_ns + round(1e9 * PERIOD_S * i)
        for name, player in self._players.items():
            sent_s = player.prepare(header, frame, stamp_ns)()
            arrived_s = player.arrival_s(stamp_ns, GRID_DEADLINE_S)
            if arrived_s is None:
                raise BringupError(f"{name}: no grid of frame {i} within {GRID_DEADLINE_S:g} s")
            self.frame_ms[name].append(1e3 * (arrived_s - sent_s))
        if k % LOOK_EVERY == 0:
            self._area.look(self._players["whole"].newest_grid())

    def look(self):
        return {**{name: resident_mb(pid) for name, pid in self._pids.items()}, "m2": self._area.m2()}


def window_status(name):
    """Values of a node's diagnostics."""
    while True:
        message = rospy.wait_for_message(f"/{name}/diagnostics", DiagnosticArray, 10.0)
        values = {entry.key: entry.value for entry in message.status[0].values}
        if "tiles_away" in values:
            return {key: int(values[key]) for key in ("tiles_in_memory", "tiles_away", "tiles_unwritten", "tiles_lost")}


def play(walker, n_frames):
    """Resident sizes [MB] and area [m2] at the marks of the hour."""
    n_new, n_warm = round(n_frames * NEW_SHARE), min(round(WARM_UP_S / PERIOD_S), n_frames // 4)
    marks = {n_warm: "start", (n_warm + n_new) // 2: "half", n_new: "turn", n_frames: "end"}
    looks, began_s = {}, time.monotonic()
    for i in range(n_frames + 1):
        if i in marks:
            looks[marks[i]] = look = walker.look()
            sizes = "  ".join(f"{name} {look[name]:.1f} MB" for name in NODES)
            minutes = i * PERIOD_S / 60.0
            say(f"{minutes:5.1f} min  {look['m2']:8.0f} m2  {sizes}  ({time.monotonic() - began_s:.0f} s)")
        if i < n_frames:
            walker.step(i, i if i < n_new else 2 * n_new - 1 - i)
    return looks, n_warm


def bytes_per_m2(before, after):
    return round((after["whole"] - before["whole"]) * 2**20 / (after["m2"] - before["m2"]), 1)


def measure(options):
    n_frames = round(options.minutes * 60.0 / PERIOD_S)
    walker = Walker()
    walker.connect(n_frames)
    looks, n_warm = play(walker, n_frames)

    def frame_ms(name):
        times_ms = walker.frame_ms[name]
        return [round(statistics.median(part), 2) for part in (times_ms[:n_warm], times_ms[-n_warm:])]

    def frame_p99_ms(name):
        return round(float(np.percentile(walker.frame_ms[name], 99.0)), 2)

    def window(name):
        start, end = looks["start"][name], max(look[name] for look in looks.values())
        figures = {"rss_start_mb": start, "rss_end_mb": looks["end"][name], "growth_mb": end - start}
        return {
            **{key: round(value, 2) for key, value in figures.items()},
            "frame_ms": frame_ms(name),
            "frame_p99_ms": frame_p99_ms(name),
            **window_status(name),
        }

    return {
        "bench": "memory",
        "minutes": options.minutes,
        "frames": n_frames,
        "keep_radius_m": options.keep_radius,
        **{f"rss_{mark}_mb": round(looks[mark]["whole"], 2) for mark in ("start", "turn", "end")},
        "again_mb": round(looks["end"]["whole"] - looks["turn"]["whole"], 2),
        "bytes_per_m2": bytes_per_m2(looks["start"], looks["turn"]),
        "first_half": bytes_per_m2(looks["start"], looks["half"]),
        "second_half": bytes_per_m2(looks["half"], looks["turn"]),
        "mapped_m2": round(looks["turn"]["m2"]),
        "frame_ms": frame_ms("whole"),
        "frame_p99_ms": frame_p99_ms("whole"),
        "drop": window("drop"),
        "disk": window("disk"),
    }


def judge_results(results):
    """Nothing lost, no growth with a window, and without one only by new ground."""
    unlike = abs(results["second_half"] - results["first_half"]) / results["bytes_per_m2"]
    bars = {
        "drop_growth_mb": (results["drop"]["growth_mb"], MARGIN_MB),
        "disk_growth_mb": (results["disk"]["growth_mb"], MARGIN_MB),
        "again_mb": (results["again_mb"], MARGIN_MB),
        "halves_differ": (round(unlike, 3), HALVES_BAR),
        "tiles_lost": (results["disk"]["tiles_lost"], 0),
    }
    return judge({name: (figure, "<=", limit) for name, (figure, limit) in bars.items()})


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=60.0, help="of walking")
    parser.add_argument("--keep-radius", type=float, default=20.0, help="of the rolling windows [m]")
    options = parser.parse_args()
    if not 4.0 <= options.minutes <= 600.0 or not options.keep_radius >= 20.0:
        parser.error("--minutes: allowed 4..600; --keep-radius: allowed >= 20, the published window")
    log = ROOT / "results" / "bench" / "memory.log"
    launch = str(Path(__file__).with_name("memory.launch"))
    try:
        with tempfile.TemporaryDirectory() as folder:
            command = ("roslaunch", launch, f"keep_radius_m:={options.keep_radius}", f"map_dir:={folder}")
            with RoslaunchProcess(command, log) as graph:
                join_graph(graph, "bench_memory")
                results = measure(options)
    except BringupError as error:
        say(f"{error} ({log})")
        return 1
    return finish(results, judge_results(results))


if __name__ == "__main__":
    sys.exit(main())

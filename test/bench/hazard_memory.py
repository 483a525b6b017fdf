#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""./core.sh bench hazard_memory [--profile core|paper|both] [--rounds N] [--drift-seed N]: does the barrier stay?

A robot walks up to a line of cones that closes the main aisle of the warehouse, past a person, turns round until
everything is out of view, walks 10 m away, comes back, and does so N times, each time in another lane. Every frame is
rendered with the noise of the camera and perfect segmentation and goes through the real map; no picture is stored.
From the grid on that first closed a hazard, every later one is checked:

    open cell    a cell of the hazard's core (the hull of the line; the person's radius less one cell) that is not
                 unsafe or has h > 0, in the window of the grid
    passable     a disc as wide as the robot finds a way through the aisle at the line; threaded: a point does. What was
                 never seen counts as open here

Definitions: evaluation/hazard_memory.py and hazard_walk.py in core_bringup. Progress goes to stderr; the last line on
stdout is one JSON object. Per profile:

    openings      how often the barrier went from closed to open (an open cell, or passable)
    confirmed     rule -> frame that first closed it, or null
    first_opening frame, time, place of a cell, place of the robot; or null
    movers        the same of hazards of classes that move, which the map is to forget in time; no bar
    rounds        of each: frames checked, open_frames, open_cells (most in one grid), longest_gap_m, passable_frames,
                  threaded_frames
    drift         of the odometry at the end; 0 unless --drift-seed is given. With drift the hazards are looked for
                  where the odometry has them at that frame; such a run is reported and has no bar
    bars          for profile core: every bar with figure, bar and met

Exit code 1 when a bar is not met.
"""

import argparse
import contextlib
import sys
from pathlib import Path

from tqdm import tqdm

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "src" / "core_bringup" / "src"))
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "src" / "core_perception" / "src"))

from core_bringup.evaluation import hazard_walk
from core_bringup.evaluation.bars import finish, judge
from core_bringup.evaluation.frame_recorder import make_header, render_frames
from core_bringup.evaluation.ground_program import GroundStream, read_profile
from core_bringup.evaluation.grounding_figures import build_programs
from core_bringup.evaluation.hazard_memory import HazardWatch, count_openings, summarise_round
from core_bringup.evaluation.true_regions import TruthParams
from core_bringup.exceptions import BringupError
from core_bringup.params import find_robot_file
from core_bringup.robot import RobotConfig
from core_bringup.world import load_world

ROOT = Path(__file__).resolve().parents[2]
PROFILES = {"core": ("core",), "paper": ("paper",), "both": ("core", "paper")}
NOISE_SEED = 1


class Watched:
    """Some hazards, checked grid by grid."""

    def __init__(self, cores, passage, resolution_m, drifts):
        self.watch = HazardWatch(cores, passage, resolution_m)
        self._drifts, self.checks = drifts, []

    def take(self, grid):
        """Check the next grid."""
        self.checks.append(self.watch.check(grid, self._drifts[grid.frame]))

    def report_briefly(self, lap):
        """Figures of the whole walk, in short."""
        first = next((check for check in self.checks if check.is_open), None)
        return {
            "openings": count_openings(self.checks),
            "open_frames": sum(check.is_open for check in self.checks),
            "confirmed": {name: self.watch.confirmed.get(name) for name in self.watch.cores},
            "first_opening": None if first is None else describe(first, lap),
        }

    def report(self, lap):
        """Figures of the whole walk."""
        start = min(self.watch.confirmed.values(), default=len(self.checks))
        rounds = [
            summarise_round(n, [c for c, r in zip(self.checks, lap.round_of) if r == n and c.frame > start])
            for n in sorted(set(lap.round_of))
        ]
        return {
            **self.report_briefly(lap),
            "frames_checked": sum(row["frames"] for row in rounds),
            "longest_gap_m": max(row["longest_gap_m"] for row in rounds),
            "threaded_frames": sum(row["threaded_frames"] for row in rounds),
            "rounds": rounds,
        }


def describe(check, lap):
    """Where and when a barrier opened."""
    pose = lap.poses[check.frame]
    place_m = None if check.first_open_m is None else [round(float(v), 2) for v in check.first_open_m]
    robot = [round(v, 2) for v in (pose.x_m, pose.y_m, pose.yaw_rad)]
    return {"frame": check.frame, "time_s": round(pose.time_s, 1), "cell_m": place_m, "robot": robot}


def move(frame, drift):
    """A frame with the pose that a drifting odometry gives it."""
    stamp_s, T_map_camera, p_map_base, depth_mm, labels = frame
    return stamp_s, drift.matrix() @ T_map_camera, drift.apply(p_map_base[None])[0], depth_mm, labels


def both(watched):
    """Gives a grid to all of them."""

    def take(grid):
        for one in watched:
            one.take(grid)

    return take


def measure(options):
    """All figures."""
    perception = ROOT / "src" / "core_perception"
    program = build_programs(perception / "bench", ROOT / "results" / "bench" / "build_native", "native")
    params = {name: read_profile(perception / "config", name) for name in ("core", "paper")}
    robot = RobotConfig.load(find_robot_file())
    world = load_world(hazard_walk.WORLD).for_task(hazard_walk.TASK)
    lap = hazard_walk.plan(world, options.rounds, robot)
    header = make_header(lap.scene, world, robot)
    resolution_m = params["core"]["resolution_m"]
    cores = hazard_walk.make_cores(world, header.predicates, TruthParams.from_map(params["core"]), resolution_m)
    drifts = hazard_walk.drift_along(lap.poses, options.drift_seed)
    moves = {rule: rule.split("(")[1].rstrip(")") in params["core"]["mobile_classes"] for rule in cores}
    at_rest, movers = ({rule: core for rule, core in cores.items() if moves[rule] == m} for m in (False, True))
    passage = hazard_walk.make_passage(robot)
    watched = {
        profile: (Watched(at_rest, passage, resolution_m, drifts), Watched(movers, None, resolution_m, drifts))
        for profile in PROFILES[options.profile]
    }
    with contextlib.ExitStack() as stack:
        streams = [
            stack.enter_context(
                GroundStream(program / "ground_frames", params[profile], header, len(lap.poses), both(pair))
            )
            for profile, pair in watched.items()
        ]
        frames = render_frames(world, robot, NOISE_SEED, lap.poses)
        bar = tqdm(zip(frames, drifts), total=len(lap.poses), desc="hazard_memory", unit="frame", file=sys.stderr)
        for frame, drift in bar:
            for stream in streams:
                stream.add(*move(frame, drift))
    end = drifts[-1]
    return {
        "bench": "hazard_memory",
        "profile": options.profile,
        "frames": len(lap.poses),
        "drift": {
            "shift_m": round(end.offset_m((lap.poses[-1].x_m, lap.poses[-1].y_m)), 3),
            "yaw_rad": round(end.yaw_rad, 4),
        },
        **{p: {**rest.report(lap), "movers": moving.report_briefly(lap)} for p, (rest, moving) in watched.items()},
    }


def judge_results(results):
    """Bars of profile core, without drift."""
    row = results["core"]
    never = sum(frame is None for frame in row["confirmed"].values())
    return judge({"openings": (row["openings"], "==", 0), "never_confirmed": (never, "==", 0)})


def print_table(results):
    """One line for every round."""
    for profile in PROFILES[results["profile"]]:
        print(f"{profile}: confirmed {results[profile]['confirmed']}", file=sys.stderr)
        print(f"   movers {results[profile]['movers']}", file=sys.stderr)
        for r in results[profile]["rounds"]:
            print("   " + "  ".join(f"{name} {value}" for name, value in r.items()), file=sys.stderr)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--profile", choices=sorted(PROFILES), default="both")
    parser.add_argument("--rounds", type=int, default=10)
    parser.add_argument("--drift-seed", type=int, default=0, help="of the odometry's drift; 0: none")
    options = parser.parse_args()
    if options.rounds < 1 or options.drift_seed < 0:
        parser.error("--rounds: allowed >= 1; --drift-seed: allowed >= 0")
    try:
        results = measure(options)
    except BringupError as error:
        print(f"hazard_memory: {error}", file=sys.stderr)
        return 1
    print_table(results)
    has_bars = "core" in results and options.drift_seed == 0
    return finish(results, judge_results(results) if has_bars else {})


if __name__ == "__main__":
    sys.exit(main())

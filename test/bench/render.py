#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""./core.sh bench render [--worlds NAME ...] [--step S]: what a frame of the simulated camera costs, in every world.

Draws what the robot sees every S m along the straight way of every task and takes the CPU time of the renderer's
process. A table goes to stderr; the last line on stdout is one JSON object:

    worlds     per world: frames, cpu_ms_median, cpu_ms_p95, and the task and place of its slowest frame
    densest    the world with the largest median
    bars       cpu_ms_median of that world <= 40, with figure, bar and met

Every view is drawn twice and the lesser time counts, because other programs on the machine only add to it: they take
the caches, so run this on an idle machine. Exit code 1 when the bar is not met.
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np
from tqdm import tqdm

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "src" / "core_bringup" / "src"))

from core_bringup.evaluation.bars import finish, judge
from core_bringup.evaluation.gallery_views import TaskStage, standing_state
from core_bringup.exceptions import ConfigError
from core_bringup.params import find_robot_file
from core_bringup.robot import RobotConfig
from core_bringup.world import find_worlds_dir, load_world

BAR_MS = 40.0
DRAWS = 2


def view_poses(task, step_m):
    """x [m], y [m], yaw [rad] along the start pose and the way points."""
    places = [np.asarray(task.start_pose[:2]), *task.waypoints_m]
    poses = [tuple(task.start_pose)]
    for start, end in zip(places[:-1], places[1:]):
        way = end - start
        shares = np.arange(step_m, np.linalg.norm(way), step_m) / max(np.linalg.norm(way), 1e-9)
        poses += [(*(start + share * way), float(np.arctan2(way[1], way[0]))) for share in shares]
    return poses


def cpu_time_s(pid):
    """CPU time a process has used, by the kernel's clock of that process (clock_getcpuclockid(3))."""
    return time.clock_gettime((~pid << 3) | 2)


def draw_time_ms(stage, state, pid):
    """CPU time [ms] the renderer's process takes for one frame."""
    before_s = cpu_time_s(pid)
    stage.draw(state)
    return 1e3 * (cpu_time_s(pid) - before_s)


def measure(world, robot, step_m):
    """CPU time [ms] of every frame, and its task and pose."""
    times_ms, views = [], []
    with TaskStage(world, robot) as stage:
        pid = stage.renderer._process.pid
        for name, task in world.tasks.items():
            stage.show(name)
            for x_m, y_m, yaw_rad in view_poses(task, step_m):
                state = standing_state(robot, stage.ground((x_m, y_m)), yaw_rad)
                times_ms.append(min(draw_time_ms(stage, state, pid) for _ in range(DRAWS)))
                views.append((name, round(float(x_m), 2), round(float(y_m), 2), round(float(yaw_rad), 2)))
    slowest = int(np.argmax(times_ms))
    return {
        "frames": len(times_ms),
        "cpu_ms_median": round(float(np.median(times_ms)), 2),
        "cpu_ms_p95": round(float(np.percentile(times_ms, 95)), 2),
        "slowest": {"task": views[slowest][0], "pose": views[slowest][1:], "cpu_ms": round(times_ms[slowest], 2)},
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--worlds", nargs="+", metavar="NAME", help="only these (default: every shipped world)")
    parser.add_argument("--step", type=float, default=1.0, help="distance between two views [m]")
    options = parser.parse_args()
    if not options.step >= 0.05:
        parser.error("--step: allowed >= 0.05")
    shipped = sorted(path.stem for path in find_worlds_dir().glob("*.yaml"))
    try:
        worlds = [load_world(name) for name in options.worlds or shipped]
    except ConfigError as error:
        parser.error(str(error))
    robot = RobotConfig.load(find_robot_file())
    rows = {w.name: measure(w, robot, options.step) for w in tqdm(worlds, file=sys.stderr, desc="render", unit="world")}
    for name, row in rows.items():
        figures = f"median {row['cpu_ms_median']:6.1f} ms   p95 {row['cpu_ms_p95']:6.1f} ms"
        print(f"{name:14}{row['frames']:5} frames   {figures}   slowest {row['slowest']}", file=sys.stderr)
    densest = max(rows, key=lambda name: rows[name]["cpu_ms_median"])
    figure = rows[densest]["cpu_ms_median"]
    results = {"bench": "render", "worlds": rows, "densest": densest}
    return finish(results, judge({"cpu_ms_median": (figure, "<=", BAR_MS)}))


if __name__ == "__main__":
    sys.exit(main())

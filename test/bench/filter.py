#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""./core.sh bench filter [--ticks N] [--no-ros]: what a decision of the filter costs, and how exact it is.

Drives the shipped filter (profile core) through random worlds and measures, per tick in which it had to solve: the
program alone as the filter solves it, every check included; the whole tick without ROS; and, on the same programs,
cvxpy's own solve(), a problem built anew each time, and the closed form for the single-row programs of profile paper.
Then the node in a graph of its own: from the tick's start until cmd_vel is here, beside a node that takes the same
messages and answers zero. Progress goes to stderr; the last line on stdout is one JSON object:

    qp_p50_us qp_p99_us qp_max_us           thread CPU of VelocityQp.solve, compiled; qp_wall: the same by the wall
    tick_p50_ms tick_p99_ms tick_max_ms     thread CPU of CbfFilter.step, over all ticks
    field_p99_ms                            thread CPU of taking a new grid of 100 x 100 cells
    rows_mean rows_max                      rows of the programs that were solved
    cvxpy_solve_p50_us cvxpy_rebuilt_p50_us closed_form_p50_us
    speedup_vs_cvxpy_solve                  ratio of medians, same programs, same run
    max_error                               largest difference to the closed form
    ros_p50_ms ros_p99_ms                   wall, tick start -> cmd_vel received; null: of the node that does nothing
    ros_excess_p99_ms                       difference of the two
    bars                                    every bar with figure, bar and met

Exit code 1 when a bar is not met.
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np
from tqdm import tqdm

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "src" / "core_control" / "test"))

from control_support import (
    Driver,
    Plant,
    draw_safe_pose,
    make_grid,
    make_inputs,
    make_params,
    make_random_mask,
    start_anew,
)
from filter_graph import measure_through_ros
from soundness_cases import slew

from core_bringup.evaluation.bars import finish, judge
from core_bringup.evaluation.launcher import RoslaunchProcess
from core_bringup.exceptions import BringupError
from core_bringup.ros.recording_player import join_graph
from core_control.cbf_filter import CbfFilter
from core_control.qp import VelocityQp
from core_control.safety_field import SafetyField

ROOT = Path(__file__).resolve().parents[2]
EPISODE_TICKS = 200
PLAIN_PROGRAMS, REBUILT_PROGRAMS, SINGLE_ROWS = 500, 100, 2000
UPPER_BARS = {"qp_p99_us": 100.0, "tick_p99_ms": 2.0, "max_error": 1e-9, "ros_excess_p99_ms": 3.0}
SPEEDUP_BAR = 25.0


def say(text):
    print(f"filter: {text}", file=sys.stderr, flush=True)


class Watch:
    """Thread CPU and wall time of calls [s]."""

    def __init__(self):
        self.cpu_s, self.wall_s = [], []

    def time(self, call, *arguments):
        wall, cpu = time.perf_counter(), time.thread_time_ns()
        result = call(*arguments)
        self.cpu_s.append(1e-9 * (time.thread_time_ns() - cpu))
        self.wall_s.append(time.perf_counter() - wall)
        return result


def summarise(times_s, prefix, unit, factor):
    """p50, p99 and max in a unit."""
    values = factor * np.percentile(times_s, [50, 99, 100])
    return {f"{prefix}_{name}_{unit}": round(float(value), 3) for name, value in zip(("p50", "p99", "max"), values)}


def measure_clearance(filter_, field, pose):
    return filter_._profile._barrier.compute_clearance(field, pose).h_m


def drive(ticks):
    """Watches of tick and grid, and the programs (arguments of solve) that the filter met."""
    tick, grid, programs = Watch(), Watch(), []
    params, rng = make_params(), np.random.default_rng(0)
    filter_ = CbfFilter(params)
    qp = filter_._profile._qp
    inner = qp.solve
    qp.solve = lambda *arguments: programs.append(arguments) or inner(*arguments)
    with tqdm(total=ticks, desc="ticks", file=sys.stderr) as bar:
        while len(tick.cpu_s) < ticks:
            message = make_grid(make_random_mask(rng), resolution_m=0.2)
            field = grid.time(SafetyField, message)
            start_anew(filter_)
            pose = draw_safe_pose(rng, field, lambda p, f=field: measure_clearance(filter_, f, p))
            if pose is None:
                continue
            plant, driver, nominal = Plant(pose), Driver(rng, params.limits), np.zeros(3)
            for _ in range(EPISODE_TICKS):
                nominal = slew(nominal, driver.step(plant.pose, field), params)
                inputs = make_inputs(nominal, field, plant.pose, plant.twist)
                plant.step(tick.time(filter_.step, inputs).u_safe)
            bar.update(EPISODE_TICKS)
    return tick, grid, programs


def make_like(qp_rows, solver, boxed=True):
    return VelocityQp(qp_rows, make_params().weights, boxed, solver)


def time_programs(programs):
    """Watches of the three ways to solve the same programs."""
    most_rows = max(len(b) for _, _, b, _ in programs)
    compiled, plain = make_like(most_rows, "compiled"), make_like(most_rows, "cvxpy")
    watches = {"compiled": Watch(), "plain": Watch(), "rebuilt": Watch()}
    for program in tqdm(programs, desc="compiled", file=sys.stderr):
        watches["compiled"].time(compiled.solve, *program)
    for program in tqdm(programs[:PLAIN_PROGRAMS], desc="cvxpy", file=sys.stderr):
        watches["plain"].time(plain.solve, *program)
    for program in tqdm(programs[:REBUILT_PROGRAMS], desc="cvxpy, built anew", file=sys.stderr):
        watches["rebuilt"].time(lambda p=program: make_like(len(p[2]), "cvxpy"))
    return watches


def compare_with_closed_form():
    """Largest difference of single-row programs, and the watch of the closed form."""
    rng, qp, watch, largest = np.random.default_rng(1), VelocityQp(1, np.ones(3), False, "compiled"), Watch(), 0.0
    for _ in range(SINGLE_ROWS):
        u, a = rng.uniform(-1.0, 1.0, 3), rng.normal(size=3)
        b = rng.choice([rng.uniform(-0.5, 0.5), a @ u + 10.0 ** rng.uniform(-12, -5)])
        exact = watch.time(project, u, a, b)
        largest = max(largest, float(np.abs(qp.solve(u, a[None], np.array([b])) - exact).max()))
    return largest, watch


def project(u, a, b):
    """u + max(0, b - a . u) a / |a|^2."""
    return u + max(0.0, b - a @ u) * a / (a @ a)


def measure(options):
    """All figures but those of the graph."""
    tick, grid, programs = drive(options.ticks)
    if not programs:
        raise BringupError("no tick needed a program; allowed: more --ticks")
    say(f"{len(programs)} of {len(tick.cpu_s)} ticks needed a program")
    watches = time_programs(programs)
    max_error, closed = compare_with_closed_form()
    rows = [len(b) for _, _, b, _ in programs]
    median_us = {name: 1e6 * float(np.median(watch.cpu_s)) for name, watch in watches.items()}
    return {
        "bench": "filter",
        "ticks": len(tick.cpu_s),
        "programs": len(programs),
        **summarise(watches["compiled"].cpu_s, "qp", "us", 1e6),
        "qp_wall": summarise(watches["compiled"].wall_s, "qp", "us", 1e6),
        **summarise(tick.cpu_s, "tick", "ms", 1e3),
        "tick_wall": summarise(tick.wall_s, "tick", "ms", 1e3),
        "field_p99_ms": summarise(grid.cpu_s, "field", "ms", 1e3)["field_p99_ms"],
        "rows_mean": round(float(np.mean(rows)), 2),
        "rows_max": max(rows),
        "cvxpy_solve_p50_us": round(median_us["plain"], 1),
        "cvxpy_rebuilt_p50_us": round(median_us["rebuilt"], 1),
        "closed_form_p50_us": round(1e6 * float(np.median(closed.cpu_s)), 2),
        "speedup_vs_cvxpy_solve": round(median_us["plain"] / median_us["compiled"], 1),
        "max_error": max_error,
    }


def measure_graph(seconds):
    """Figures through ROS, in a graph of its own."""
    log = ROOT / "results" / "bench" / "filter.log"
    launch = str(ROOT / "src" / "core_control" / "test" / "filter_bench.launch")
    with RoslaunchProcess(("roslaunch", launch), log) as graph:
        join_graph(graph, "bench_filter")
        latencies_s = measure_through_ros(seconds)
    own, null = (summarise(latencies_s[name], "ros", "ms", 1e3) for name in ("filter", "null"))
    return {**own, "null": null, "ros_excess_p99_ms": round(own["ros_p99_ms"] - null["ros_p99_ms"], 3)}


def judge_results(results):
    bars = {name: (results[name], "<=", limit) for name, limit in UPPER_BARS.items() if name in results}
    bars["speedup_vs_cvxpy_solve"] = (results["speedup_vs_cvxpy_solve"], ">=", SPEEDUP_BAR)
    return judge(bars)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--ticks", type=int, default=20000)
    parser.add_argument("--seconds", type=float, default=30.0, help="in the graph")
    parser.add_argument("--no-ros", action="store_true", help="leave the graph out")
    options = parser.parse_args()
    if options.ticks < 1 or not options.seconds > 0.0:
        parser.error("--ticks: allowed >= 1; --seconds: allowed > 0")
    try:
        results = measure(options)
        if not options.no_ros:
            results.update(measure_graph(options.seconds))
    except BringupError as error:
        say(error)
        return 1
    return finish(results, judge_results(results))


if __name__ == "__main__":
    sys.exit(main())

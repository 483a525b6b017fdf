# SPDX-License-Identifier: BSD-3-Clause
"""Program check_bag: reads a bag, holds it against bag_invariant and prints a table. Takes nothing from the filter."""

from __future__ import annotations

import argparse
import math
import sys
from typing import Any, Dict, List

import numpy as np
import rosbag

from core_control.bag_invariant import RULES, Bounds, Command, Received, Recording, Report, Tick, check

EXIT_VIOLATED, EXIT_BAD_INPUT = 1, 2
SHOWN = 10
LARGEST_TRANSPORT_S, LARGEST_SKIP_S = 0.2, 10.0
STATES = (0, 1, 2)  # core_msgs/SafetyGrid: safe, unsafe, unknown
TOPICS = {
    "nominal": "cmd_vel_nominal",
    "nominal_stamped": "cmd_vel_nominal_stamped",
    "odometry": "odom",
    "grid": "safety_grid",
    "state": "cbf_filter/state",
    "command": "cmd_vel",
}


class BadInputError(Exception):
    """The bag or an option cannot be used; the text is the one line for the user."""


def read_recording(path: str, topics: Dict[str, str]) -> Recording:
    """The messages of a bag.

    Args:
        path: of the bag.
        topics: role (a key of TOPICS) -> absolute name.

    Raises:
        BadInputError: no such file, no bag, or no message on a topic that is needed.
    """
    heard: Dict[str, List[Any]] = {role: [] for role in TOPICS}
    roles = {name: role for role, name in topics.items()}
    try:
        with rosbag.Bag(path) as bag:
            known = sorted(bag.get_type_and_topic_info().topics)
            for name, message, receipt in bag.read_messages(topics=list(roles)):
                heard[roles[name]].append(READERS[roles[name]](message, receipt.to_sec()))
    except (OSError, rosbag.ROSBagException, AttributeError, ValueError) as error:
        raise BadInputError(f"{path}: {error}; allowed: an indexed bag of the topics of cbf_filter") from error
    heard["nominal"] += heard.pop("nominal_stamped")
    for role, messages in heard.items():
        if not messages:
            raise BadInputError(f"{path}: no message on {topics[role]}; in the bag: {' '.join(known)}")
    return Recording(heard["nominal"], heard["odometry"], heard["grid"], heard["command"], heard["state"])


def _six(twist: Any) -> tuple:
    linear, angular = twist.linear, twist.angular
    return (linear.x, linear.y, linear.z, angular.x, angular.y, angular.z)


def _to_stamp_s(stamp: Any) -> float:
    return math.nan if stamp.is_zero() else stamp.to_sec()


def _read_nominal(message: Any, receipt_s: float, stamp_s: float = math.nan) -> Received:
    six = _six(message)
    problem = "" if all(map(math.isfinite, six)) else f"not finite: {six}"
    return Received(receipt_s, stamp_s, problem or (f"outside the plane: {six}" if any(six[2:5]) else ""))


def _read_stamped(message: Any, receipt_s: float) -> Received:
    return _read_nominal(message.twist, receipt_s, _to_stamp_s(message.header.stamp))


def _read_odometry(message: Any, receipt_s: float) -> Received:
    pose, twist = message.pose.pose, message.twist.twist
    q = (pose.orientation.x, pose.orientation.y, pose.orientation.z, pose.orientation.w)
    used = (pose.position.x, pose.position.y, *q, twist.linear.x, twist.linear.y, twist.angular.z)
    problem = "" if all(map(math.isfinite, used)) and any(q) else f"no pose and twist: {used}"
    return Received(receipt_s, _to_stamp_s(message.header.stamp), problem, message.header.frame_id)


def _read_grid(message: Any, receipt_s: float) -> Received:
    stamps = _to_stamp_s(message.header.stamp), _to_stamp_s(message.constraints_stamp)
    return Received(receipt_s, stamps[0], _find_grid_problem(message), message.header.frame_id, stamps[1])


def _find_grid_problem(message: Any) -> str:
    cells = message.width * message.height
    sizes = [len(message.h_m), len(message.state), len(message.cause)]
    if not cells or sizes != [cells] * 3:
        return f"{message.width} x {message.height} cells, arrays of {sizes}"
    geometry = (message.resolution_m, message.origin_x_m, message.origin_y_m)
    if not all(map(math.isfinite, geometry)) or not message.resolution_m > 0.0:
        return f"cell size and origin are {geometry}"
    if np.isnan(message.h_m).any() or not set(bytearray(message.state)) <= set(STATES):
        return "h is no number, or a state is not known"
    return ""


def _read_command(message: Any, receipt_s: float) -> Command:
    return Command(receipt_s, _six(message))


def _read_state(message: Any, receipt_s: float) -> Tick:
    names = {getattr(message, name): name for name in dir(type(message)) if name.isupper()}
    mode = names.get(message.mode, str(message.mode))
    return Tick(receipt_s, message.header.stamp.to_sec(), message.tick, mode, tuple(message.u_safe))


READERS = {
    "nominal": _read_nominal,
    "nominal_stamped": _read_stamped,
    "odometry": _read_odometry,
    "grid": _read_grid,
    "state": _read_state,
    "command": _read_command,
}


def format_report(report: Report, bounds: Bounds, start_s: float) -> str:
    """Table of the rules, what the session was like, and the first violations with their time since start_s."""
    lines = [f"{'rule':20}{'checked':>10}{'violated':>10}"]
    lines += [f"{rule:20}{report.checked[rule]:10}{report.broken[rule]:10}" for rule in RULES]
    exempt = sum(report.modes[mode] for mode in bounds.exempt)
    modes = " ".join(f"{mode} {count}" for mode, count in sorted(report.modes.items()))
    lines.append(f"modes: {modes}; exempt ({', '.join(bounds.exempt)}): {exempt}")
    lines.append(" ".join(f"{name} {value:.6g}" for name, value in sorted(report.figures.items())))
    lines.append(
        f"allowed: {bounds.transport_s:g} s of transport; freshness from {bounds.skip_s:g} s after the start on"
    )
    for time_s, rule, problem in sorted(report.violations)[:SHOWN]:
        lines.append(f"VIOLATED at {time_s:.3f} ({time_s - start_s:+.3f} s): {rule}: {problem}")
    if len(report.violations) > SHOWN:
        lines.append(f"... and {len(report.violations) - SHOWN} more")
    return "\n".join(lines)


class OneLineParser(argparse.ArgumentParser):
    """Refuses with one line."""

    def error(self, message: str) -> None:
        """Raise instead of printing the usage."""
        raise BadInputError(message)


def make_parser() -> OneLineParser:
    """Options; the defaults are those of cbf_filter's parameters in profile core."""
    parser = OneLineParser(
        prog="check_bag",
        description="Hold a recorded session against the promise that no motion follows without fresh inputs. "
        "Exit status: 0 it holds, 1 it does not, 2 bad input.",
    )
    parser.add_argument("bag")
    parser.add_argument("--ns", default="/", help="namespace of the robot")
    for role, name in TOPICS.items():
        parser.add_argument(f"--{role.replace('_', '-')}", default=name, metavar="TOPIC", help=f"default: {name}")
    for name, meaning in (("nominal", "command"), ("odometry", ""), ("grid", ""), ("constraints", "0: none required")):
        default = getattr(Bounds, f"{name}_s")
        parser.add_argument(f"--{name}-timeout-s", type=float, default=default, help=f"{meaning} default: {default:g}")
    parser.add_argument("--limits", type=float, nargs=3, default=Bounds.limits, metavar=("VX", "VY", "YAW_RATE"))
    parser.add_argument("--period-s", type=float, default=Bounds.period_s, help="1 / output_rate_hz")
    parser.add_argument("--transport-s", type=float, default=Bounds.transport_s, help="<= 0.2")
    parser.add_argument("--skip-s", type=float, default=Bounds.skip_s, help="start of the bag without freshness, <= 10")
    return parser


def make_bounds(options: argparse.Namespace) -> Bounds:
    """Bounds of the options; BadInputError for a number that is not allowed."""
    names = ("nominal_timeout_s", "odometry_timeout_s", "grid_timeout_s", "period_s")
    for name, value in [*((name, getattr(options, name)) for name in names), *(("limits", v) for v in options.limits)]:
        if not (math.isfinite(value) and value > 0.0):
            raise BadInputError(f"--{name.replace('_', '-')}: got {value:g}, allowed > 0")
    if not 0.0 <= options.transport_s <= LARGEST_TRANSPORT_S:
        raise BadInputError(f"--transport-s: got {options.transport_s:g}, allowed 0 to {LARGEST_TRANSPORT_S:g}")
    if not 0.0 <= options.skip_s <= LARGEST_SKIP_S:
        raise BadInputError(f"--skip-s: got {options.skip_s:g}, allowed 0 to {LARGEST_SKIP_S:g}")
    if not options.constraints_timeout_s >= 0.0:
        raise BadInputError(f"--constraints-timeout-s: got {options.constraints_timeout_s:g}, allowed >= 0")
    ages = (options.nominal_timeout_s, options.odometry_timeout_s, options.grid_timeout_s)
    constraints_s = options.constraints_timeout_s or math.inf
    times_s = (options.period_s, options.transport_s, options.skip_s)
    return Bounds(*ages, constraints_s, tuple(options.limits), *times_s)


def resolve(namespace: str, name: str) -> str:
    """Absolute name of a topic."""
    return name if name.startswith("/") else f"/{namespace.strip('/')}/{name}".replace("//", "/")


def main(arguments: list) -> int:
    """Run; returns the exit status."""
    try:
        options = make_parser().parse_args(arguments)
        bounds = make_bounds(options)
        recording = read_recording(options.bag, {role: resolve(options.ns, getattr(options, role)) for role in TOPICS})
        report = check(recording, bounds)
    except (BadInputError, ValueError) as error:
        sys.stderr.write("check_bag: " + " ".join(str(error).split()) + "\n")
        return EXIT_BAD_INPUT
    start_s = min(recording.ticks[0].stamp_s, recording.commands[0].receipt_s)
    sys.stdout.write(format_report(report, bounds, start_s) + "\n")
    return 0 if report.holds else EXIT_VIOLATED

# SPDX-License-Identifier: BSD-3-Clause
"""What must hold of a recorded session, whatever the filter says: no motion without fresh inputs, and its neighbours.

Independent of the filter on purpose: nothing of it is imported, and its own ages are not looked at.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections import Counter
from dataclasses import dataclass, field
from typing import Dict, List, Optional, Sequence, Tuple

import numpy as np

# Rounding of times in the bag [s], and share of a limit that counts as rounding.
ROUNDING_S, ROUNDING = 1e-6, 1e-9
# A stamp further than this in the future [s] says nothing about an age.
FUTURE_S = 0.2
PERIOD_SHARE = 1.2
RULES = (
    "finite",
    "within_limits",
    "equals_state",
    "has_state",
    "stopped_is_zero",
    "fresh_nominal",
    "fresh_odometry",
    "fresh_grid",
    "fresh_constraints",
    "one_frame",
    "period",
)


@dataclass(frozen=True)
class Received:
    """One input message: receipt by the recorder and stamp [s] (NaN: none), and what is wrong in it, if anything.

    constraints_s is the image stamp of the constraints in a grid [s]; NaN: none.
    """

    receipt_s: float
    stamp_s: float = math.nan
    problem: str = ""
    frame: str = ""
    constraints_s: float = math.nan


@dataclass(frozen=True)
class Command:
    """One command sent to the robot: time of receipt [s] and its six entries [m/s, rad/s], linear first."""

    receipt_s: float
    six: Tuple[float, ...]

    @property
    def u(self) -> np.ndarray:
        """(3,) vx, vy [m/s], yaw rate [rad/s]."""
        return np.array([self.six[0], self.six[1], self.six[5]])

    @property
    def is_zero(self) -> bool:
        """Whether it asks for no motion at all."""
        return not any(self.six)


@dataclass(frozen=True)
class Tick:
    """One state of the filter: time of receipt, stamp [s], counter, mode by its name, command it says it sent."""

    receipt_s: float
    stamp_s: float
    number: int
    mode: str
    u_safe: Tuple[float, ...]


@dataclass(frozen=True)
class Recording:
    """Every message of a session that matters, each list by time of receipt."""

    nominal: List[Received]
    odometry: List[Received]
    grid: List[Received]
    commands: List[Command]
    ticks: List[Tick]


@dataclass(frozen=True)
class Bounds:
    """What the session is held against.

    Attributes:
        nominal_s, odometry_s, grid_s, constraints_s: largest ages [s]; constraints_s: infinite where none are required.
        limits: (3,) largest magnitudes [m/s, m/s, rad/s].
        period_s: control period; the 99th percentile of the periods may be PERIOD_SHARE times as long.
        transport_s: largest time between the receipt of one message by the filter and by the recorder.
        skip_s: start of the bag in which no freshness is asked for: the recorder connects to one topic after another.
        exempt: modes in which freshness and limits do not bind the filter.
    """

    nominal_s: float = 0.3
    odometry_s: float = 0.3
    grid_s: float = 0.5
    constraints_s: float = 15.0
    limits: Tuple[float, ...] = (0.5, 0.25, 0.8)
    period_s: float = 0.05
    transport_s: float = 0.05
    skip_s: float = 1.0
    exempt: Tuple[str, ...] = ("DISABLED", "OVERRIDE")


@dataclass
class Report:
    """How often each rule was applied, what broke it, and what the session was like."""

    checked: Counter = field(default_factory=Counter)
    broken: Counter = field(default_factory=Counter)
    violations: List[Tuple[float, str, str]] = field(default_factory=list)
    modes: Counter = field(default_factory=Counter)
    figures: Dict[str, float] = field(default_factory=dict)

    def judge(self, rule: str, time_s: float, problem: Optional[str]) -> None:
        """Count one application of a rule; a problem is a violation."""
        self.checked[rule] += 1
        if problem:
            self.broken[rule] += 1
            self.violations.append((time_s, rule, problem))

    @property
    def holds(self) -> bool:
        """Whether no rule is broken."""
        return not self.violations


class Stream:
    """The messages of one input, asked which of them the filter may have looked at."""

    def __init__(self, messages: Sequence[Received]):
        """Keep them by time of receipt."""
        self._messages = sorted(messages, key=lambda message: message.receipt_s)
        self._times_s = [message.receipt_s for message in self._messages]

    def find_candidates(self, from_s: float, until_s: float) -> List[Received]:
        """The newest message received before from_s, and every one until until_s."""
        first = max(0, bisect_left(self._times_s, from_s) - 1)
        return self._messages[first : bisect_right(self._times_s, until_s)]


def check(recording: Recording, bounds: Bounds) -> Report:
    """Hold a session against every rule.

    A tick stamped s whose command the recorder got at r may rest on the newest input received before s - transport, or
    on any until r + transport: one of these must be sound, with

        s - receipt <= limit + transport,   -FUTURE_S <= s - stamp <= limit

    Raises:
        ValueError: the stamps of one run of the filter go back: the clock was set, and ages mean nothing.
    """
    report = Report()
    pairs = pair(recording.ticks, recording.commands, bounds)
    streams = {name: Stream(getattr(recording, name)) for name in ("nominal", "odometry", "grid")}
    for command in recording.commands:
        finite = all(math.isfinite(value) for value in command.six)
        report.judge("finite", command.receipt_s, None if finite else f"command is {command.six}")
    from_s = min(recording.ticks[0].stamp_s, recording.commands[0].receipt_s) + bounds.skip_s
    for tick, command in pairs:
        report.modes[tick.mode] += 1
        if command is not None:
            _check_command(report, tick, command, bounds)
            if not command.is_zero and tick.mode not in bounds.exempt and tick.stamp_s >= from_s:
                _check_inputs(report, tick, command.receipt_s, streams, bounds)
    _check_alone(report, recording, pairs, bounds)
    _check_period(report, recording.ticks, bounds)
    report.figures["ticks"] = len(recording.ticks)
    report.figures["commands"] = len(recording.commands)
    report.figures["moving"] = sum(not command.is_zero for command in recording.commands)
    return report


def pair(ticks: Sequence[Tick], commands: Sequence[Command], bounds: Bounds) -> list:
    """(tick, command) for every tick, None where the recorder has no command of it.

    A tick sends its command after its stamp and before its state: it is the first that is left after the stamp. The
    recorder's simulated clock may be behind the filter's by a part of a period.
    """
    pairs, next_command, early_s = [], 0, 0.25 * bounds.period_s
    for tick in ticks:
        while next_command < len(commands) and commands[next_command].receipt_s < tick.stamp_s - early_s:
            next_command += 1
        command = commands[next_command] if next_command < len(commands) else None
        if command is not None and command.receipt_s > tick.receipt_s + bounds.transport_s:
            command = None
        next_command += command is not None
        pairs.append((tick, command))
    return pairs


def _check_command(report: Report, tick: Tick, command: Command, bounds: Bounds) -> None:
    same = np.array_equal(command.u, tick.u_safe, equal_nan=True)
    report.judge("equals_state", tick.stamp_s, None if same else f"state says {tick.u_safe}, sent was {command.u}")
    if tick.mode == "STOPPED":
        report.judge("stopped_is_zero", tick.stamp_s, None if command.is_zero else f"sent was {command.u}")
    if tick.mode not in bounds.exempt:
        inside = np.all(np.abs(command.u) <= np.array(bounds.limits) * (1.0 + ROUNDING)) and not any(command.six[2:5])
        report.judge("within_limits", tick.stamp_s, None if inside else f"{command.six}, limits {bounds.limits}")


def _check_inputs(report: Report, tick: Tick, sent_s: float, streams: Dict[str, Stream], bounds: Bounds) -> None:
    limits_s = {"nominal": bounds.nominal_s, "odometry": bounds.odometry_s, "grid": bounds.grid_s}
    sound = {}
    for name, limit_s in limits_s.items():
        candidates = streams[name].find_candidates(tick.stamp_s - bounds.transport_s, sent_s + bounds.transport_s)
        problems = [_find_problem(message, tick.stamp_s, limit_s, bounds.transport_s) for message in candidates]
        sound[name] = [message for message, problem in zip(candidates, problems) if not problem]
        why = None if sound[name] else (problems[-1] if problems else "none was received")
        report.judge(f"fresh_{name}", tick.stamp_s, why)
    if sound["grid"]:
        ages_s = [tick.stamp_s - message.constraints_s for message in sound["grid"]]
        good = math.isinf(bounds.constraints_s) or any(
            -FUTURE_S - ROUNDING_S <= age_s <= bounds.constraints_s + ROUNDING_S for age_s in ages_s
        )
        why = None if good else f"constraints are {ages_s[-1]:.3f} s old, limit {bounds.constraints_s:g} s"
        report.judge("fresh_constraints", tick.stamp_s, why)
    if sound["grid"] and sound["odometry"]:
        frames = [{message.frame for message in sound[name]} for name in ("odometry", "grid")]
        why = None if frames[0] & frames[1] else f"odometry in {sorted(frames[0])}, grid in {sorted(frames[1])}"
        report.judge("one_frame", tick.stamp_s, why)


def _find_problem(message: Received, now_s: float, limit_s: float, transport_s: float) -> Optional[str]:
    if message.problem:
        return message.problem
    since_receipt_s, since_stamp_s = now_s - message.receipt_s, now_s - message.stamp_s
    if since_receipt_s > limit_s + transport_s + ROUNDING_S:
        return f"received {since_receipt_s:.3f} s before, limit {limit_s:g} s and {transport_s:g} s of transport"
    if since_stamp_s > limit_s + ROUNDING_S:
        return f"stamped {since_stamp_s:.3f} s before, limit {limit_s:g} s"
    if since_stamp_s < -FUTURE_S - ROUNDING_S:
        return f"stamped {-since_stamp_s:.3f} s in the future, limit {FUTURE_S:g} s"
    return None


def _check_alone(report: Report, recording: Recording, pairs: list, bounds: Bounds) -> None:
    """No command but zero comes from anywhere but a tick; the last before the filter ended may lack its state."""
    paired = {id(command) for _, command in pairs if command is not None}
    ends_s = [run[-1].stamp_s for run in find_runs(recording.ticks)]
    alone = [command for command in recording.commands if id(command) not in paired]
    report.figures["commands_without_state"] = len(alone)
    report.figures["ticks_without_command"] = sum(command is None for _, command in pairs)
    slack_s = bounds.period_s + bounds.transport_s
    for command in recording.commands:
        at_an_edge = any(0.0 <= command.receipt_s - end_s <= slack_s for end_s in ends_s)
        at_an_edge = at_an_edge or command.receipt_s < recording.ticks[0].stamp_s
        lonely = id(command) not in paired and not command.is_zero and not at_an_edge
        why = f"{command.u} while no tick sent it: another publisher, or a state was lost" if lonely else None
        report.judge("has_state", command.receipt_s, why)


def find_runs(ticks: Sequence[Tick]) -> List[List[Tick]]:
    """Ticks of one process each: where the counter does not grow the filter was started again.

    Raises:
        ValueError: stamps go back while the counter grows.
    """
    runs: List[List[Tick]] = []
    for tick in ticks:
        if not runs or tick.number <= runs[-1][-1].number:
            runs.append([])
        elif tick.stamp_s < runs[-1][-1].stamp_s:
            raise ValueError(f"the clock goes back at tick {tick.number}, {tick.stamp_s:.3f} s; cut the bag there")
        runs[-1].append(tick)
    return runs


def _check_period(report: Report, ticks: Sequence[Tick], bounds: Bounds) -> None:
    runs = find_runs(ticks)
    neighbours = [(a, b) for run in runs for a, b in zip(run, run[1:])]
    periods_s = np.array([b.stamp_s - a.stamp_s for a, b in neighbours if b.number == a.number + 1])
    report.figures["restarts"] = len(runs) - 1
    report.figures["states_lost"] = sum(b.number - a.number - 1 for a, b in neighbours)
    if not len(periods_s):
        return
    p50_s, p99_s, longest_s = (float(value) for value in np.percentile(periods_s, [50, 99, 100]))
    report.figures.update(period_p50_s=p50_s, period_p99_s=p99_s, period_longest_s=longest_s)
    allowed_s = PERIOD_SHARE * bounds.period_s
    why = None if p99_s <= allowed_s else f"p99 of the periods is {p99_s:.4f} s, limit {allowed_s:g} s"
    report.judge("period", ticks[-1].stamp_s, why)

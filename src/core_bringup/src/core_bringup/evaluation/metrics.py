# SPDX-License-Identifier: BSD-3-Clause
"""Figures of a finished trial, each a pure function of its tick records."""

from __future__ import annotations

import hashlib
import itertools
import math
import struct
from collections import Counter
from typing import Dict, List, Optional, Sequence, Tuple

from core_bringup.evaluation.records import MODE_NAMES, TickRecord

# A command counts as changed from this on [m/s], measured at the end of the footprint, LEVER_ARM_M from its centre.
MIN_CHANGE_MPS = 0.02
LEVER_ARM_M = 0.55
# The nominal command pushes from this speed on [m/s]; the robot counts as stopped below MIN_CHANGE_MPS.
MIN_PUSH_MPS = 0.05
# Two interventions with a shorter pause between them [s] are one.
MERGE_GAP_S = 0.5
# A false stop lasts longer than this [s].
MIN_FALSE_STOP_S = 1.0

Episode = Tuple[float, float]


def find_episodes(times_s: Sequence[float], flags: Sequence[bool], merge_gap_s: float = MERGE_GAP_S) -> List[Episode]:
    """Spans of time in which flags hold; pauses up to merge_gap_s do not end a span.

    Args:
        times_s: (n,) increasing times [s].
        flags: (n,) whether the condition holds.
        merge_gap_s: longest pause inside one episode [s].

    Returns:
        (first, last) time of every episode [s]; both are equal for an episode of one tick.
    """
    episodes: List[Episode] = []
    for time_s, flag in zip(times_s, flags):
        if not flag:
            continue
        if episodes and time_s - episodes[-1][1] <= merge_gap_s:
            episodes[-1] = (episodes[-1][0], time_s)
        else:
            episodes.append((time_s, time_s))
    return episodes


def command_change_mps(record: TickRecord) -> float:
    """Speed the filter took from or added to the command at the end of the footprint [m/s].

    change = |(dx, dy)| + LEVER_ARM_M |dw|   with (dx, dy, dw) = u_safe - u_nominal

    NaN where there was no nominal command.
    """
    dx, dy, dw = (a - b for a, b in zip(record.filter.u_safe, record.filter.u_nominal))
    return math.hypot(dx, dy) + LEVER_ARM_M * abs(dw)


def nominal_pushes(record: TickRecord) -> bool:
    """The nominal command asks the robot to go somewhere; turning on the spot is not going."""
    return math.hypot(*record.filter.u_nominal[:2]) > MIN_PUSH_MPS


def filter_intervenes(record: TickRecord) -> bool:
    """The filter changed the command by more than MIN_CHANGE_MPS; where there is no command, nothing can be changed."""
    return command_change_mps(record) > MIN_CHANGE_MPS + 1e-9  # the difference of two decimals is not exact


def filter_stops(record: TickRecord) -> bool:
    """The nominal command pushes and the filter leaves less than MIN_CHANGE_MPS of it."""
    return nominal_pushes(record) and math.hypot(*record.filter.u_safe[:2]) < MIN_CHANGE_MPS


def count_interventions(records: Sequence[TickRecord]) -> int:
    """Number of episodes in which the filter changed the command or stopped it; waiting for the first input is none."""
    started = list(itertools.dropwhile(lambda record: record.filter.mode == "STOPPED", records))
    return len(find_episodes(_times(started), [filter_intervenes(r) for r in started]))


def count_false_stops(records: Sequence[TickRecord], task) -> int:
    """Number of stops longer than MIN_FALSE_STOP_S on a safe task; 0 on an unsafe one, where to stop is right."""
    if task.expectation != "safe":
        return 0
    episodes = find_episodes(_times(records), [filter_stops(r) for r in records])
    return sum(1 for first, last in episodes if last - first > MIN_FALSE_STOP_S)


def smallest_obstacle_clearance_m(records: Sequence[TickRecord]) -> Optional[float]:
    """Smallest distance from the footprint to any solid object [m]; None where there is none."""
    return finite_or_none(min((r.truth.obstacle_clearance_m for r in records), default=math.inf))


def stop_gap_m(records: Sequence[TickRecord]) -> Optional[float]:
    """Smallest distance from the footprint to the true unsafe region [m], 0 once entered; None without a region."""
    smallest = finite_or_none(min((r.truth.clearance_m for r in records), default=math.inf))
    return None if smallest is None else max(smallest, 0.0)


def penetration_m(records: Sequence[TickRecord]) -> float:
    """Largest depth of the footprint in the true unsafe region [m]; 0 when it never entered."""
    return max(0.0, -min((r.truth.clearance_m for r in records), default=0.0))


def goal_distance_m(record: TickRecord, task) -> float:
    """Distance from the base point to the goal [m]."""
    return math.hypot(record.position_m[0] - task.goal_m[0], record.position_m[1] - task.goal_m[1])


def path_length_m(records: Sequence[TickRecord]) -> float:
    """Length of the way of the base point on the ground [m]."""
    points = [r.position_m for r in records]
    return sum(math.hypot(b[0] - a[0], b[1] - a[1]) for a, b in zip(points, points[1:]))


def trajectory_row(record: TickRecord) -> Tuple[float, ...]:
    """(17,) stamp, pose (7), twist (6), applied command (3) of one tick: what the hash is taken over."""
    o = record.odometry
    return (
        (record.time_s,)
        + tuple(o.p_odom_base)
        + tuple(o.q_odom_base)
        + tuple(o.v_base)
        + tuple(o.w_base)
        + tuple(record.filter.u_safe)
    )


def trajectory_sha256(records: Sequence[TickRecord]) -> str:
    """Sha256 over the rows of all ticks as little-endian float64: equal hashes mean equal runs to the last bit."""
    digest = hashlib.sha256()
    for record in records:
        digest.update(struct.pack("<17d", *trajectory_row(record)))
    return digest.hexdigest()


def finite_or_none(value: float) -> Optional[float]:
    """JSON has no NaN and no infinity."""
    return float(value) if math.isfinite(value) else None


def compute_figures(records: Sequence[TickRecord], task) -> Dict[str, object]:
    """All figures of result.json that follow from the records alone.

    Args:
        records: every tick up to and including the end tick; may be empty.
        task: core_bringup.world.Task.

    Returns:
        Keys of result.json; None stands for a figure the task or an empty run does not have.
    """
    changes = [change for change in map(command_change_mps, records) if math.isfinite(change)]
    finite_h = [r.filter.h_m for r in records if math.isfinite(r.filter.h_m)]
    return {
        "min_clearance_m": smallest_obstacle_clearance_m(records),
        "stop_gap_m": stop_gap_m(records),
        "goal_distance_m": goal_distance_m(records[-1], task) if records else None,
        "interventions": count_interventions(records),
        "false_stops": count_false_stops(records, task),
        "sim_time_s": round(records[-1].time_s - records[0].time_s, 9) if records else 0.0,
        "trajectory_sha256": trajectory_sha256(records),
        "penetration_m": penetration_m(records),
        "base_entered": any(r.truth.base_inside for r in records),
        "fallen": any(r.truth.fallen for r in records),
        "min_h_m": min(finite_h, default=None),
        "intervention_mean_mps": sum(changes) / len(changes) if changes else None,
        "intervention_max_mps": max(changes, default=None),
        "path_length_m": path_length_m(records),
        **count_ticks(records),
    }


def count_ticks(records: Sequence[TickRecord]) -> Dict[str, object]:
    """Number of ticks in all, per mode, per reason of a stop, and per rule behind an intervention."""
    modes = Counter(r.filter.mode for r in records)
    reasons = Counter(r.filter.reason for r in records if r.filter.reason)
    rules = Counter(r.filter.binding_rule for r in records if r.filter.binding_rule and filter_intervenes(r))
    return {
        "ticks": len(records),
        "ticks_per_mode": {mode: modes[mode] for mode in MODE_NAMES if modes[mode]},
        "ticks_per_reason": dict(sorted(reasons.items())),
        "ticks_per_rule": dict(sorted(rules.items())),
    }


def _times(records: Sequence[TickRecord]) -> List[float]:
    return [r.time_s for r in records]

# SPDX-License-Identifier: BSD-3-Clause
"""Figures of a finished trial beyond metrics.py: how long, how smooth, how far, how old, how fast."""

from __future__ import annotations

import math
from typing import Dict, Iterable, List, Optional, Sequence

import numpy as np

from core_bringup.evaluation.metrics import command_change_mps, filter_stops
from core_bringup.evaluation.records import TickRecord
from core_bringup.rotations import yaw_of_quaternion

# Span of the quadratic fitted to the velocity at every tick [s]: two to three steps of a trot.
JERK_WINDOW_S = 0.5
# A nominal way shorter than this has no ratio [m].
MIN_WAY_M = 0.5
PERCENTILES = (50, 95, 99)


def tick_durations_s(records: Sequence[TickRecord]) -> np.ndarray:
    """(n,) time that every tick stands for [s]: to the next tick; the last one lasts as long as the median."""
    gaps_s = np.diff([r.time_s for r in records])
    if len(gaps_s) == 0:
        return np.zeros(len(records))
    return np.append(gaps_s, np.median(gaps_s))


def violation_time_s(records: Sequence[TickRecord]) -> float:
    """Time the footprint was inside a true unsafe region [s]: sum of dt over the ticks inside."""
    inside = np.array([r.truth.inside for r in records], dtype=bool)
    return float(tick_durations_s(records)[inside].sum())


def false_stop_share(records: Sequence[TickRecord], task) -> Optional[float]:
    """Share of all ticks at which the nominal command pushes and the filter stops it, in 0..1.

    None on an unsafe task, where to stop is right, and without ticks.
    """
    if task.expectation != "safe" or not records:
        return None
    return sum(map(filter_stops, records)) / len(records)


def intervention_integral_m(records: Sequence[TickRecord]) -> float:
    """What the filter took from or added to the command over the whole run [m].

    integral = sum over ticks of change dt   with change [m/s] as in metrics.command_change_mps
    """
    changes = np.array([command_change_mps(r) for r in records])
    return float(np.nansum(changes * tick_durations_s(records))) if len(changes) else 0.0


def nominal_way_m(points_m: np.ndarray, end_m: Sequence[float]) -> float:
    """Length of a polyline (n, 2) from its first point to the point of it nearest to end_m (2,) [m]."""
    best_m, way_m, walked_m = math.inf, 0.0, 0.0
    for a, b in zip(points_m, points_m[1:]):
        length_m = float(np.linalg.norm(b - a))
        if length_m == 0.0:
            continue
        share = float(np.clip(np.dot(np.asarray(end_m) - a, b - a) / length_m**2, 0.0, 1.0))
        distance_m = float(np.linalg.norm(a + share * (b - a) - end_m))
        if distance_m < best_m:
            best_m, way_m = distance_m, walked_m + share * length_m
        walked_m += length_m
    return way_m


def path_length_ratio(records: Sequence[TickRecord], task) -> Optional[float]:
    """Driven way over the straight nominal way from the start over the waypoints to where the run ended or the goal.

    None while the nominal way is shorter than MIN_WAY_M.
    """
    if not records:
        return None
    points_m = np.array([r.position_m for r in records], dtype=float)
    driven_m = float(np.linalg.norm(np.diff(points_m, axis=0), axis=1).sum())
    way_m = nominal_way_m(np.vstack([points_m[:1], np.reshape(task.waypoints_m, (-1, 2))]), points_m[-1])
    return driven_m / way_m if way_m >= MIN_WAY_M else None


def jerk_rms_mps3(records: Sequence[TickRecord]) -> Optional[float]:
    """Root mean square of the jerk of the base on the ground [m/s^3].

    At every tick a quadratic v(t) = a + b t + c t^2 is fitted to the velocity on the ground in odom over JERK_WINDOW_S;
    jerk = 2 c. A plain second difference at the tick rate would measure the steps of the gait and the noise. Windows
    with a gap in the ticks are left out; None when no window is whole.
    """
    if len(records) < 5:
        return None
    times_s = np.array([r.time_s for r in records])
    period_s = float(np.median(np.diff(times_s)))
    half = max(int(round(0.5 * JERK_WINDOW_S / period_s)), 2)
    if len(records) < 2 * half + 1:
        return None
    weights = np.linalg.pinv(np.vander(np.arange(-half, half + 1) * period_s, 3, increasing=True))[2]
    velocity_mps = np.array([_ground_velocity_mps(r) for r in records])
    windows = np.lib.stride_tricks.sliding_window_view(velocity_mps, 2 * half + 1, axis=0)
    jerk_mps3 = 2.0 * windows @ weights
    spans_s = times_s[2 * half :] - times_s[: -2 * half]
    whole = (spans_s < (2 * half + 0.5) * period_s) & np.isfinite(jerk_mps3).all(axis=1)
    if not whole.any():
        return None
    return float(np.sqrt(np.mean(np.sum(jerk_mps3[whole] ** 2, axis=1))))


def _ground_velocity_mps(record: TickRecord) -> tuple:
    yaw_rad = yaw_of_quaternion(record.odometry.q_odom_base)
    vx, vy = record.odometry.v_base[:2]
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    return c * vx - s * vy, s * vx + c * vy


def quantiles(values: Iterable[float], with_max: bool = False) -> Optional[Dict[str, float]]:
    """p50, p95, p99 (and max) of the finite values, linear between neighbours; None without any."""
    finite = [v for v in values if math.isfinite(v)]
    if not finite:
        return None
    result = {f"p{p}": float(v) for p, v in zip(PERCENTILES, np.percentile(finite, PERCENTILES))}
    if with_max:
        result["max"] = float(max(finite))
    return result


def compute_trial_figures(
    records: Sequence[TickRecord], task, reasoner_latencies_s: Sequence[float]
) -> Dict[str, object]:
    """The keys of result.json that this module defines.

    constraints_age_s: age of the constraints in force at every tick [s]. latency_s: reasoner, from image to answer,
    once an answer; qp, thread CPU time of the filter's solve; grid, age of the safety grid in force at every tick [s].
    """
    ages: List[float] = [r.filter.constraints_age_s for r in records]
    return {
        "violation_time_s": violation_time_s(records),
        "false_stop_share": false_stop_share(records, task),
        "intervention_integral_m": intervention_integral_m(records),
        "path_length_ratio": path_length_ratio(records, task),
        "jerk_rms_mps3": jerk_rms_mps3(records),
        "constraints_age_s": quantiles(ages, with_max=True),
        "latency_s": {
            "reasoner": quantiles(reasoner_latencies_s),
            "qp": quantiles(r.filter.solve_time_s for r in records if r.filter.solve_time_s > 0.0),
            "grid": quantiles(r.filter.grid_age_s for r in records),
        },
    }

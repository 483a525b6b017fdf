# SPDX-License-Identifier: BSD-3-Clause
"""Made-up trials for the tests of the evaluation: a robot on a straight line, a region in front of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Callable, List, Tuple

import numpy as np

from core_bringup.evaluation.grid_history import GridSnapshot
from core_bringup.evaluation.records import FilterSample, OdometrySample, TickRecord, TruthSample

PERIOD_S = 0.05
FRONT_M = 0.55
REGION_X_M = 4.0


@dataclass(frozen=True)
class FakeRegion:
    """A closed square from REGION_X_M on."""

    name: str = "closed_area"
    reason: str = "behind the cones"
    polygon_m: Tuple = ((4.0, -1.0), (6.0, -1.0), (6.0, 1.0), (4.0, 1.0))


@dataclass(frozen=True)
class FakeTask:
    """The fields of core_bringup.world.Task the evaluation reads."""

    name: str = "cone_line"
    expectation: str = "unsafe"
    goal_m: Tuple = (8.0, 0.0)
    goal_tolerance_m: float = 0.4
    time_limit_s: float = 40.0
    unsafe_regions: Tuple = (FakeRegion(),)
    waypoints_m: Tuple = ((8.0, 0.0),)


SAFE_TASK = FakeTask("open_aisle", "safe", unsafe_regions=())


def make_record(tick: int, x_m: float, **changes) -> TickRecord:
    """One tick of a robot at (x, 0) that is told to go forward and does; changes are fields of the three samples."""
    stamp_ns = tick * 50_000_000
    gap_m = REGION_X_M - (x_m + FRONT_M)
    base_inside = REGION_X_M <= x_m <= 6.0
    truth = {
        "inside": gap_m < 0 and x_m < 6.55,
        "base_inside": base_inside,
        "clearance_m": gap_m,
        "obstacle_clearance_m": 2.0,
    }
    state = {"mode": "NOMINAL", "u_nominal": (0.5, 0.0, 0.0), "u_safe": (0.5, 0.0, 0.0), "h_m": gap_m}
    for key, value in changes.items():
        (state if key in FilterSample.__dataclass_fields__ else truth)[key] = value
    odometry = OdometrySample(stamp_ns, (x_m, 0.0, 0.52), (0.0, 0.0, 0.0, 1.0), (0.5, 0.0, 0.0), (0.0, 0.0, 0.0))
    return TickRecord(odometry, FilterSample(stamp_ns, tick, **state), TruthSample(stamp_ns, **truth))


def held(tick: int, x_m: float, **changes) -> TickRecord:
    """A tick at which the filter takes the whole command away."""
    return make_record(
        tick, x_m, **{"mode": "FILTERED", "u_safe": (0.0, 0.0, 0.0), "binding_rule": "BETWEEN(traffic_cone)", **changes}
    )


def walk(seconds: float, x_of: Callable[[float], float], stop_x_m: float = np.inf, **changes) -> List[TickRecord]:
    """A walk along x_of(t) that the filter holds at stop_x_m."""
    records = []
    for tick in range(int(round(seconds / PERIOD_S)) + 1):
        x_m = x_of(tick * PERIOD_S)
        make = held if x_m >= stop_x_m else make_record
        records.append(make(tick, min(x_m, stop_x_m), **changes))
    return records


def make_grid(
    stamp_ns: int = 0, origin_m: Tuple[float, float] = (-2.0, -3.0), shape: Tuple[int, int] = (60, 110)
) -> GridSnapshot:
    """A grid of 0.1 m cells whose cells between x = 3.9 m and 4.3 m are unsafe by BETWEEN(traffic_cone)."""
    rows, columns = shape
    x_m = origin_m[0] + (np.arange(columns) + 0.5) * 0.1 + np.zeros((rows, 1))
    unsafe = (x_m > 3.9) & (x_m < 4.3)
    h_m = np.where(unsafe, -0.1, np.abs(x_m - 4.1) - 0.2)
    cause = np.where(unsafe, 0, 65535)
    return GridSnapshot(
        stamp_ns,
        0.1,
        origin_m,
        np.where(unsafe, 0, 5),
        np.where(unsafe, 5, 0),
        h_m,
        unsafe.astype(int),
        cause,
        ("BETWEEN(traffic_cone)",),
    )

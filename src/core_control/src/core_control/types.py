# SPDX-License-Identifier: BSD-3-Clause
"""Plain data that passes between the modules of this package. Arrays are float64 unless a shape says otherwise."""

from __future__ import annotations

import enum
from dataclasses import dataclass, field
from typing import Optional, Tuple

import numpy as np

NAN = float("nan")
NO_CELL = -1


class CellState(enum.IntEnum):
    """Decision of the map about one cell; the values are those of core_msgs/SafetyGrid."""

    SAFE = 0
    UNSAFE = 1
    UNKNOWN = 2


class Mode(enum.IntEnum):
    """What the filter did at a tick; the values are those of core_msgs/FilterState."""

    NOMINAL = 0
    FILTERED = 1
    HOLD = 2
    STOPPED = 3
    DISABLED = 4
    ESCAPE = 5
    OVERRIDE = 6


@dataclass(frozen=True)
class Cause:
    """Why a cell is unsafe: the rule, for example ``BETWEEN(traffic_cone)``, the class and instance it speaks of.

    instance_id is 0 for none; mobile says that what is there may move by itself.
    """

    rule: str = ""
    class_name: str = ""
    instance_id: int = 0
    mobile: bool = False

    def describe(self) -> str:
        """Rule and class in words; the class once only."""
        if self.class_name and self.class_name not in self.rule:
            return f"{self.rule} {self.class_name}".strip()
        return self.rule or "an unsafe cell"


@dataclass(frozen=True)
class SafetyGridData:
    """One safety grid as received.

    Attributes:
        frame_id: fixed frame the grid lies in.
        stamp_s: stamp of the depth image last added [s].
        constraints_stamp_s: image stamp of the constraints in force [s]; 0 while none exists.
        history_start_s: stamp of the first frame in the map's memory [s].
        resolution_m: edge of a cell, > 0.
        origin_m: (2,) lower left corner of cell (0, 0).
        state: (ny, nx) uint8, values of CellState; row iy, column ix.
        unknown_is_unsafe: whether UNKNOWN counts as unsafe.
        h_m: (ny, nx) signed distance at cell centres.
        cause: (ny, nx) uint16 index into causes; 65535 for none.
        causes: the causes.
        speed_cap_mps: (ny, nx) largest speed in a cell [m/s], NaN for none; None where no cell has one.
    """

    frame_id: str
    stamp_s: float
    constraints_stamp_s: float
    history_start_s: float
    resolution_m: float
    origin_m: np.ndarray
    state: np.ndarray
    unknown_is_unsafe: bool
    h_m: np.ndarray
    cause: np.ndarray
    causes: Tuple[Cause, ...] = ()
    speed_cap_mps: Optional[np.ndarray] = None


@dataclass(frozen=True)
class Binding:
    """The place that decides: cause, nearest point on its cell [m] in the grid's frame, flat index of the cell."""

    cause: Cause = Cause()
    point_m: Tuple[float, float] = (NAN, NAN)
    cell: int = NO_CELL


@dataclass(frozen=True)
class Clearance:
    """Barrier value at one pose.

    Attributes:
        h_m: smallest clearance [m]; negative while a part of the footprint covers an unsafe cell.
        gradient: (2,) direction on the ground in which h grows fastest; zero where it has none.
        cell: index of the deciding box in the field, NO_CELL for none.
        point_m: (2,) point of the boundary that decides.
    """

    h_m: float
    gradient: np.ndarray
    cell: int = NO_CELL
    point_m: np.ndarray = field(default_factory=lambda: np.full(2, NAN))


@dataclass(frozen=True)
class BarrierRows:
    """Linear conditions a_i . u >= b_i on a body velocity u = (vx, vy, yaw rate).

    Attributes:
        a: (n, 3) [-, -, m].
        b: (n,) [m/s].
        cell: (n,) index of the cell behind the row, NO_CELL for rows without one.
        point_m: (n, 2) point of the cell the row keeps away from; NaN for rows without one.
    """

    a: np.ndarray
    b: np.ndarray
    cell: np.ndarray
    point_m: np.ndarray

    def __len__(self) -> int:
        return len(self.b)

    @staticmethod
    def empty() -> BarrierRows:
        """No condition."""
        return BarrierRows(np.zeros((0, 3)), np.zeros(0), np.zeros(0, dtype=int), np.zeros((0, 2)))

    @staticmethod
    def concatenate(parts) -> BarrierRows:
        """Every condition of every part, in order."""
        parts = list(parts) or [BarrierRows.empty()]
        return BarrierRows(
            np.concatenate([p.a for p in parts]),
            np.concatenate([p.b for p in parts]),
            np.concatenate([p.cell for p in parts]),
            np.concatenate([p.point_m for p in parts]),
        )


@dataclass(frozen=True)
class FilterInputs:
    """Everything the filter may look at in one tick. None means never received; an age is NaN then.

    Attributes:
        u_nominal: (3,) wanted vx [m/s], vy [m/s], yaw rate [rad/s] in base_link; NaN marks a command that is no number.
        pose: (3,) x [m], y [m], yaw [rad] of base_link in odometry_frame_id.
        twist: (3,) vx, vy, yaw rate of base_link, expressed in it.
        odometry_frame_id: frame of the pose.
        field: the safety field of the newest grid.
        grid_problem: why the newest grid could not be used, as (reason, detail).
        nominal_planar: the command asked for no motion outside the plane.
        nominal_age_s, odometry_age_s, grid_age_s, constraints_age_s: ages at the tick.
        stop_request: (reason, detail) from outside the library for which this tick must be zero.
        latch_request: the same, and until reset() is called.
        override_mps: speed the operator drives at past the filter; None while he does not.
    """

    u_nominal: Optional[np.ndarray] = None
    pose: Optional[np.ndarray] = None
    twist: Optional[np.ndarray] = None
    odometry_frame_id: str = ""
    field: Optional[object] = None
    grid_problem: Optional[Tuple[str, str]] = None
    nominal_planar: bool = True
    nominal_age_s: float = NAN
    odometry_age_s: float = NAN
    grid_age_s: float = NAN
    constraints_age_s: float = NAN
    stop_request: Optional[Tuple[str, str]] = None
    latch_request: Optional[Tuple[str, str]] = None
    override_mps: Optional[float] = None


@dataclass(frozen=True)
class FilterResult:
    """What the filter decided in one tick, and why; the fields are those of core_msgs/FilterState.

    speed_cap_mps is infinite while no cap is in force and NaN while nothing is known of it. blocked_event is the
    blockage.Blockage to be sent at this tick, mostly None.
    """

    mode: Mode
    u_safe: np.ndarray
    u_nominal: np.ndarray
    reason: str = ""
    detail: str = ""
    h_m: float = NAN
    gradient: np.ndarray = field(default_factory=lambda: np.zeros(2))
    binding: Optional[Binding] = None
    solve_time_s: float = 0.0
    rows: int = 0
    scale: float = 1.0
    speed_cap_mps: float = NAN
    speed_cap_reason: str = ""
    blocked_s: float = 0.0
    blocked_event: Optional[object] = None
    latched: bool = False

# SPDX-License-Identifier: BSD-3-Clause
"""What a profile proposes for one tick, and the helpers both profiles share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Optional

import numpy as np

from core_control.modes import Stop
from core_control.safety_field import SafetyField
from core_control.speed_cap import NO_CAP, SpeedCap
from core_control.types import NO_CELL, BarrierRows, Binding, Clearance, Mode


@dataclass(frozen=True)
class Situation:
    """What a profile looks at in one tick.

    Attributes:
        field: safety field of the newest grid.
        pose: (3,) x [m], y [m], yaw [rad] of base_link in the field's frame.
        twist: (3,) measured body velocity [m/s, m/s, rad/s].
        u_nominal: (3,) wanted command within the cap, same units.
        u_previous: (3,) command sent in the last tick.
        pending: commands sent before that have not taken effect yet, as rollout.Pending.
        cap: speeds that the answer must not exceed either; in the filter the CommandCap of the tick.
    """

    field: SafetyField
    pose: np.ndarray
    twist: np.ndarray
    u_nominal: np.ndarray
    u_previous: np.ndarray
    pending: list
    cap: SpeedCap = NO_CAP


@dataclass(frozen=True)
class Proposal:
    """A command and what stands behind it.

    Attributes:
        u: (3,) command; equal to the nominal one, entry by entry, when nothing had to change.
        clearance: barrier value now.
        binding: the place behind the change; None while nothing binds.
        rows: number of barrier rows.
        scale: what the verifier left of the command, 0..1.
        solve_time_s: thread CPU time of the solve [s]; 0 when none was needed.
        note: what the program did, in words.
        mode: set where it is another than u and h tell.
        latch: why nothing may move from now on; None to go on.
    """

    u: np.ndarray
    clearance: Clearance
    binding: Optional[Binding] = None
    rows: int = 0
    scale: float = 1.0
    solve_time_s: float = 0.0
    note: str = ""
    mode: Optional[Mode] = None
    latch: Optional[Stop] = None


def scale_to_limits(u: np.ndarray, limits: np.ndarray) -> np.ndarray:
    """The command made smaller as a whole, so that no entry exceeds its limit and the path keeps its curvature.

    Args:
        u: (3,) command; zero where the limit is.
        limits: (3,) largest magnitudes, >= 0.
    """
    bounded = limits > 0.0
    factor = np.max(np.abs(u[bounded]) / limits[bounded])
    if factor <= 1.0:
        return u
    # An entry of 1e308 m/s overflows the quotient; the command is then beyond any use.
    return np.clip(u / factor, -limits, limits) if np.isfinite(factor) else np.zeros(3)


def find_binding(field: SafetyField, rows: BarrierRows, u_wanted: np.ndarray) -> Optional[Binding]:
    """Cause and place of the row that the wanted command breaks most; None when it breaks none."""
    if not len(rows):
        return None
    i = int(np.argmin(rows.a @ u_wanted - rows.b))
    if rows.a[i] @ u_wanted >= rows.b[i]:
        return None
    return make_binding(field, int(rows.cell[i]), rows.point_m[i])


def make_binding(field: SafetyField, cell: int, point_m: np.ndarray) -> Binding:
    """Cause and place of one cell of the field; a row from inside the unsafe set takes the cell under the point."""
    if cell == NO_CELL:
        under = field.find_cell(point_m) if np.isfinite(point_m).all() else None
        cell = NO_CELL if under is None else under[0] * field.unsafe.shape[1] + under[1]
    return Binding(field.get_cause(cell), (float(point_m[0]), float(point_m[1])), cell)

# SPDX-License-Identifier: BSD-3-Clause
"""Speed caps of the cells that the footprint lies in, or is about to enter."""

from __future__ import annotations

from typing import Optional, Tuple

import numpy as np

from core_control.dynamics import place_discs
from core_control.params import FilterParams
from core_control.rollout import SAMPLE_S, Pending, RollOut
from core_control.safety_field import Boxes, SafetyField
from core_control.types import Cause

# Time constants of the lag that slowing down is given before the footprint enters: 5 % of the change is left then.
SETTLE_LAGS = 3.0
# Every so many samples of a roll-out are looked at; discs are grown by half the way between two of them.
STRIDE = 4


class SlowRegions:
    """Finds the smallest speed cap of the cells that a command leads through.

    Looked at are the footprint now and where it would be on the way to rest, after a command of zero and after the
    candidate held for one period and SETTLE_LAGS of the lag. A robot that was free to go at one tick is then at least
    SETTLE_LAGS of the lag away from every slow cell at the next, as long as its course is the same: it has slowed
    down to cap + 0.05 (speed - cap) when its footprint enters.

    Args:
        params: parameters of the filter.

    Source: DESIGN row 16, severity `slow`. [CORE] knows safe and unsafe only.
    """

    def __init__(self, params: FilterParams):
        """Prepare the roll-out."""
        self._discs, self._lag_s = params.disc_array, params.lag_s
        self._hold_s = params.control_period_s + SETTLE_LAGS * params.lag_s
        self._roll_out = RollOut(self._discs, params.lag_s, self._hold_s, 0.0, params.limits)
        lever_m = np.hypot(self._discs[:, 0], self._discs[:, 1])
        self._speed_mps = float(np.hypot(params.max_vx_mps, params.max_vy_mps))
        disc_speed_mps = self._speed_mps + params.max_yaw_rate_radps * float(lever_m.max())
        self._grown_radii_m = self._discs[:, 2] + 0.5 * STRIDE * SAMPLE_S * disc_speed_mps
        self._extent_m = float(np.max(lever_m + self._grown_radii_m))

    def find(
        self, field: SafetyField, start: Tuple[np.ndarray, np.ndarray, Pending], u: np.ndarray
    ) -> Optional[Tuple[float, Cause]]:
        """Smallest cap [m/s] and the cause of its cell; None where there is none.

        Args:
            field: safety field.
            start: pose (3,), twist (3,) and pending commands now.
            u: (3,) candidate within the limits [m/s, m/s, rad/s].
        """
        if not len(field.slow_boxes):
            return None
        near = self._find_near(field, *start)
        # Far from every border the cap is everywhere that of the cell underneath.
        poses = self._predict(start, u) if len(near) else start[0][None]
        cells = self._find_cells(field, near, place_discs(poses, self._discs))
        if not len(cells):
            return None
        caps_mps = field.grid.speed_cap_mps.ravel()[cells]
        i = int(np.argmin(caps_mps))
        return float(caps_mps[i]), field.get_cause(cells[i])

    def _find_near(self, field: SafetyField, pose: np.ndarray, twist: np.ndarray, pending: Pending) -> Boxes:
        """Slow cells that the footprint may reach.

        The way of base_link is at most lag |v| + speed (hold + pending): behind a first-order lag every command adds
        its own speed times its duration in the end.
        """
        held_s = self._hold_s + sum(duration_s for _, duration_s in pending)
        reach_m = self._extent_m + self._lag_s * float(np.hypot(twist[0], twist[1])) + self._speed_mps * held_s
        return field.slow_boxes.take(field.slow_boxes.compute_distance(pose[None, :2])[0] <= reach_m)

    def _predict(self, start: Tuple[np.ndarray, np.ndarray, Pending], u: np.ndarray) -> np.ndarray:
        """Poses (n, 3) now and on the two ways to rest."""
        tracks = [self._roll_out.predict(*start, command) for command in (np.zeros(3), u)]
        sampled = [np.concatenate([track[STRIDE - 1 :: STRIDE], track[-1:]]) for track in tracks]
        return np.concatenate([start[0][None], *sampled])

    def _find_cells(self, field: SafetyField, near: Boxes, centres: np.ndarray) -> np.ndarray:
        """Flat indices of cells with a cap: those under a disc's centre (n, k, 2), and the near ones it overlaps."""
        points = centres.reshape(-1, 2)
        radii_m = np.tile(self._grown_radii_m, len(centres))
        overlapped = near.cell[(near.compute_distance(points) < radii_m[:, None]).any(axis=0)]
        index = np.floor((points - field.lo_m) / field.grid.resolution_m)
        ny, nx = field.unsafe.shape
        ix, iy = index[((index >= 0.0) & (index < (nx, ny))).all(axis=1)].astype(int).T
        under = np.unique(iy * nx + ix)
        has_cap = ~np.isnan(field.grid.speed_cap_mps.ravel()[under])
        return np.concatenate([overlapped, under[has_cap]])

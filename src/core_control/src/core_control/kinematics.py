# SPDX-License-Identifier: BSD-3-Clause
"""What the base can follow: any velocity, none sideways, or none sideways and no turn tighter than a radius."""

from __future__ import annotations

import math
from typing import Tuple

import numpy as np

from core_control.params import FilterParams
from core_control.types import NO_CELL, BarrierRows

# Sideways speed [m/s] and turning beyond the radius [m/s] that count as rounding.
ROUNDING_MPS = 1e-9
# Largest distance between two discs ahead of the axle [m].
AHEAD_STEP_M = 0.2


class Kinematics:
    """The commands a base can follow, and how it gets a lever on its own turning.

        holonomic      every (vx, vy, w)
        differential   vy = 0
        ackermann      vy = 0,  R_min |w| <= |vx|

    base_link must lie on the axle whose wheels do not steer. All three sets hold 0, and with u every s u, 0 <= s <= 1.

    Args:
        params: parameters of the filter: kinematics, look_ahead_m, min_turning_radius_m, footprint and limits.

    Differs from [CORE], whose robots walk sideways.
    """

    def __init__(self, params: FilterParams):
        """Keep the figures."""
        self.is_holonomic = params.kinematics == "holonomic"
        self._radius_m = params.min_turning_radius_m if params.kinematics == "ackermann" else 0.0
        self._max_vx_mps = params.max_vx_mps
        self._look_ahead_s = params.look_ahead_m / params.max_vx_mps
        self._discs = params.disc_array

    @property
    def row_count(self) -> int:
        """Largest number of rows compute_rows can return."""
        return 2 if self._radius_m > 0.0 else 0

    @property
    def disc_count(self) -> int:
        """Largest number of discs that rows are computed for."""
        if self.is_holonomic:
            return len(self._discs)
        return max(len(self.place_discs(sigma * self._max_vx_mps)[0]) for sigma in (1.0, -1.0))

    def adapt(self, u: np.ndarray) -> np.ndarray:
        """The part of a command that the base can follow; u itself where it can follow all of it.

            vy -> 0,   w -> w clipped to +-|vx| / R_min

        Args:
            u: (3,) vx, vy [m/s], w [rad/s], finite.
        """
        if self.is_holonomic:
            return u
        most_radps = abs(u[0]) / self._radius_m if self._radius_m > 0.0 else np.inf
        if u[1] == 0.0 and abs(u[2]) <= most_radps:
            return u
        return np.array([u[0], 0.0, np.clip(u[2], -most_radps, most_radps)])

    def allows(self, u: np.ndarray) -> bool:
        """Whether the base can follow the command (3,) [m/s, m/s, rad/s]."""
        if self.is_holonomic:
            return True
        return bool(abs(u[1]) <= ROUNDING_MPS and self._radius_m * abs(u[2]) <= abs(u[0]) + ROUNDING_MPS)

    def describe(self, u: np.ndarray) -> str:
        """What of a command (3,) [m/s, m/s, rad/s] is left out, in words; empty when nothing is."""
        parts = []
        if not self.is_holonomic and u[1] != 0.0:
            parts.append("sideways motion left out")
        if self._radius_m * abs(u[2]) > abs(u[0]):
            parts.append(f"turn limited to a radius of {self._radius_m:g} m")
        return ", ".join(parts)

    def compute_rows(self, u_wanted: np.ndarray) -> BarrierRows:
        """Rows that keep the turning radius, on the side of the wanted direction of travel; sideways is the box's task.

            sigma vx - R_min w >= 0,   sigma vx + R_min w >= 0,   sigma = sign of the wanted vx

        Their sum is sigma vx >= 0. u = 0 satisfies them, and so does u_wanted.

        Args:
            u_wanted: (3,) command that allows() accepts [m/s, m/s, rad/s].
        """
        if self._radius_m == 0.0:
            return BarrierRows.empty()
        sigma = 1.0 if u_wanted[0] >= 0.0 else -1.0
        a = np.array([[sigma, 0.0, -self._radius_m], [sigma, 0.0, self._radius_m]])
        return BarrierRows(a, np.zeros(2), np.full(2, NO_CELL), np.full((2, 2), np.nan))

    def place_discs(self, vx_mps: float) -> Tuple[np.ndarray, np.ndarray]:
        """Discs that the rows of a wheeled base keep out: those of the footprint, and some ahead of the axle.

            x = sigma L k / n, k = 1 .. n,   L = max(foremost disc of the footprint, look_ahead_m |vx| / max_vx)
            n = ceil(L / AHEAD_STEP_M),  sigma = sign of vx

        A disc on the axle has no lever on turning: its rows can only brake. The discs ahead have one, so that the base
        steers early instead, and the disc on the axle follows them: dc/dt = |vx| (ahead - c) / L, which leaves no
        half-plane that holds both. Where it cuts a corner that the discs ahead have passed it would come to rest beside
        it; with a smaller margin for the discs on the axle it passes. To turn on the spot no disc is needed ahead.

        Args:
            vx_mps: wanted speed along x [m/s].

        Returns:
            (n, 3) x [m], y [m], radius [m] in base_link, at most disc_count; and (n,) bool, which of them are those of
            the footprint on the axle, |x| < AHEAD_STEP_M / 2, while vx != 0.

        Source: point ahead of the axle in the input-output linearisation of the unicycle, [Oriolo].
        """
        if vx_mps == 0.0:
            return self._discs, np.zeros(len(self._discs), dtype=bool)
        sigma = 1.0 if vx_mps > 0.0 else -1.0
        ahead = [self._place_ahead(sigma, track, abs(vx_mps)) for track in np.unique(self._discs[:, 1:], axis=0)]
        discs = np.concatenate([self._discs, *ahead])
        on_axle = np.abs(discs[:, 0]) < AHEAD_STEP_M / 2.0
        on_axle[len(self._discs) :] = False
        return discs, on_axle

    def _place_ahead(self, sigma: float, track: np.ndarray, speed_mps: float) -> np.ndarray:
        """Discs ahead in one row of discs along x, given by their y and radius (2,)."""
        in_track = np.all(self._discs[:, 1:] == track, axis=1)
        foremost_m = float(np.max(sigma * self._discs[in_track, 0]))
        lead_m = max(foremost_m, speed_mps * self._look_ahead_s)
        count = math.ceil(lead_m / AHEAD_STEP_M - 1e-9)
        # The foremost disc itself is there already.
        steps = np.arange(1, count if lead_m == foremost_m else count + 1)
        ahead = np.empty((len(steps), 3))
        ahead[:, 0], ahead[:, 1:] = sigma * lead_m * steps / count, track
        return ahead

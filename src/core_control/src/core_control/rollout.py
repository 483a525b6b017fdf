# SPDX-License-Identifier: BSD-3-Clause
"""The verifier: roll a command out, then a stop, and scale it back until the footprint keeps its clearance."""

from __future__ import annotations

import math
from typing import List, Tuple

import numpy as np

from core_control.dynamics import integrate_lag, place_discs
from core_control.safety_field import SafetyField

# Largest time between two samples of a roll-out [s].
SAMPLE_S = 0.01
# Distance left to go at which a stopping robot counts as standing [m].
REST_M = 0.001
SCALES = tuple(i / 10.0 for i in range(10, -1, -1))
# Clearance lost to rounding [m].
ROUNDING_M = 1e-9

# A command (3,) and how long it still acts [s].
Pending = List[Tuple[np.ndarray, float]]


class RollOut:
    """Predicts where a command leads and says how much of it may be sent.

    Args:
        discs: (k, 3) x [m], y [m] in base_link, radius [m].
        lag_s: first-order lag of the body velocity behind the command, >= 0.
        hold_s: how long a command is held before the next can replace it.
        margin_m: clearance every sample must keep.
        limits: (3,) largest magnitudes of the command.
    """

    def __init__(self, discs: np.ndarray, lag_s: float, hold_s: float, margin_m: float, limits: np.ndarray):
        """Find the length of a stop and the distance between two samples."""
        self._discs, self._lag_s, self._hold_s = discs, lag_s, hold_s
        lever_m = float(np.max(np.hypot(discs[:, 0], discs[:, 1])))
        self._speed_mps = float(np.hypot(limits[0], limits[1]) + limits[2] * lever_m)
        # Between two samples a disc is at most half their distance from the nearer one.
        self._needed_m = margin_m + 0.5 * self._speed_mps * SAMPLE_S
        self._stop_s = lag_s * math.log(max(1.0, self._speed_mps * lag_s / REST_M))

    def predict(self, pose: np.ndarray, twist: np.ndarray, pending: Pending, u: np.ndarray) -> np.ndarray:
        """Sampled poses under the commands still on their way, then u for one period, then zero until standing.

        Args:
            pose: (3,) x [m], y [m], yaw [rad] now.
            twist: (3,) measured body velocity [m/s, m/s, rad/s].
            pending: commands sent before that have not taken effect yet.
            u: (3,) candidate; zero predicts a stop.

        Returns:
            (n, 3) poses; the last is where the robot comes to rest.
        """
        plan = [*pending, (u, self._hold_s), (np.zeros(3), self._stop_s)]
        parts = []
        for command, duration_s in plan:
            if duration_s <= 0.0:
                continue
            count = max(1, math.ceil(duration_s / SAMPLE_S - 1e-9))
            times_s = duration_s * np.arange(1, count + 1) / count
            poses, twist = integrate_lag(pose, twist, command, times_s, self._lag_s)
            pose = poses[-1]
            parts.append(poses)
        return np.concatenate(parts)

    def find_scale(self, field: SafetyField, start: Tuple[np.ndarray, np.ndarray, Pending], u: np.ndarray) -> float:
        """Largest scale s of 1, .9, ... 0 for which s u, followed by a stop, keeps its clearance.

            min over samples of (d(c_i) - r_i)  >=  min(margin, the same minimum for s = 0)

        s = 0 always passes: whatever the map says, stopping at once is allowed, and with less clearance than the margin
        a command must not lead closer than stopping does (non-decreasing clearance for a standing robot).

        Args:
            field: safety field.
            start: pose (3,), twist (3,) and pending commands now.
            u: (3,) candidate.
        """
        if not np.any(u):
            return 1.0
        now = start[0][None]
        stop_m = None
        for scale in SCALES[:-1]:
            poses = np.concatenate([now, self.predict(*start, scale * u)])
            clearance_m = self._compute_clearance(field, poses)
            if clearance_m >= self._needed_m:
                return scale
            if stop_m is None:
                stop_poses = np.concatenate([now, self.predict(*start, np.zeros(3))])
                stop_m = self._compute_clearance(field, stop_poses)
            if clearance_m >= min(self._needed_m, stop_m) - ROUNDING_M:
                return scale
        return 0.0

    def _compute_clearance(self, field: SafetyField, poses: np.ndarray) -> float:
        centres = place_discs(poses, self._discs)
        # Disc by disc: the points of one track lie close together, which keeps the search local.
        tracks = [field.compute_signed_distance(centres[:, i]) - disc[2] for i, disc in enumerate(self._discs)]
        return float(np.min(tracks))

# SPDX-License-Identifier: BSD-3-Clause
"""The verifier: roll a command out, then a stop, and scale it back until the footprint keeps its clearance."""

from __future__ import annotations

import math
from typing import List, Tuple

import numpy as np

from core_control.dynamics import place_discs
from core_control.prediction import make_schedule
from core_control.safety_field import SafetyField

# Largest time between two samples of a roll-out at full speed [s].
SAMPLE_S = 0.01
# Distance left to go at which a stopping robot counts as standing [m].
REST_M = 0.001
SCALES = tuple(i / 10.0 for i in range(10, -1, -1))
# Clearance lost to rounding [m].
ROUNDING_M = 1e-9

# A command (3,) and how long it still acts [s].
Pending = List[Tuple[np.ndarray, float]]
# Pose (3,), twist (3,) and pending commands now.
Start = Tuple[np.ndarray, np.ndarray, Pending]


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
        lever_m = np.hypot(discs[:, 0], discs[:, 1])
        self._extent_m = float(np.max(lever_m + discs[:, 2]))
        self._speed_mps = float(np.hypot(limits[0], limits[1]) + limits[2] * np.max(lever_m))
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
        plan = [(command, held_s) for command, held_s in (*pending, (u, self._hold_s)) if held_s > 0.0]
        durations_s = tuple(held_s for _, held_s in plan)
        schedule = make_schedule(durations_s, self._stop_s, self._lag_s, SAMPLE_S)
        return schedule.predict(pose, twist, np.array([command for command, _ in plan]))

    def find_scale(self, field: SafetyField, start: Start, u: np.ndarray) -> float:
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
        for scale in SCALES[:-1]:
            if self._keeps_clear(field, start, scale * u):
                return scale
        return 0.0

    def _keeps_clear(self, field: SafetyField, start: Start, u: np.ndarray) -> bool:
        clearance_m = self.compute_clearance(field, start, u)
        if clearance_m >= self._needed_m:
            return True
        stop_m = self.compute_clearance(field, start, np.zeros(3))
        return clearance_m >= min(self._needed_m, stop_m) - ROUNDING_M

    def compute_clearance(self, field: SafetyField, start: Start, u: np.ndarray) -> float:
        """Smallest clearance of the samples of a command and a stop [m]; +inf where nothing unsafe is near."""
        pose = start[0]
        poses = np.concatenate([pose[None], self.predict(*start, u)])
        way_m = float(np.max(np.hypot(poses[:, 0] - pose[0], poses[:, 1] - pose[1])))
        boxes = field.find_boxes_near(pose[:2], self._needed_m + self._extent_m + way_m)
        points, radius_m = place_discs(poses, self._discs).reshape(-1, 2), np.tile(self._discs[:, 2], len(poses))
        smallest_m = np.min(boxes.compute_distance(points) - radius_m[:, None], initial=np.inf)
        inside = field.is_inside(points)
        if inside.any():
            depth_m = field.safe_boxes.compute_smallest_distance(points[inside])
            smallest_m = min(smallest_m, np.min(-depth_m - radius_m[inside]))
        return float(smallest_m)

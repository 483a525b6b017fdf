# SPDX-License-Identifier: BSD-3-Clause
"""ESCAPE: out of a region that has grown over the robot, back along ground it has already walked.

The only motion the filter makes by itself, so everything about it is bounded, and it is off unless it is asked for:

- It needs what every command needs: fresh odometry, grid and constraints, no request to stop, and a fresh nominal
  command that asks for motion. A controller that is silent, or asks to stand, means that nobody drives: then the robot
  stands as well, and a nominal command of zero ends an escape at the next tick.
- It begins after the robot has stood for escape_after_s with h < 0, let by no command. Exempt cells (underfoot.py) do
  not count in h here.
- It leads along a trail of poses at which h was >= 0, none of them older than escape_trail_s, no point of the footprint
  faster than escape_speed_mps, and the verifier passes each command, so that h does not fall.
- It lasts escape_s at most, counted until h has reached the margin, however often it is interrupted.

Where it fails (time over, no trail left, refused by the verifier for 1 s) the filter latches.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Deque, Optional, Tuple

import numpy as np

from core_control.dynamics import compute_rotation, wrap_angle
from core_control.params import FilterParams

# Poses of the trail are so far apart, and reached when nearer than that [m, rad].
STEP_M, STEP_RAD = 0.03, 0.06
# Time for which the verifier may refuse [s].
REFUSED_S = 1.0
# A pose farther from the last one than a robot walks in three ticks and this [m] is a jump of the odometry.
JUMP_M = 0.2


@dataclass(frozen=True)
class Trail:
    """One pose (3,) the robot was at with h >= 0, and its tick."""

    tick: int
    pose: np.ndarray


class Escape:
    """Decides when to walk back, and where to.

    Args:
        params: parameters of the filter.
        reach_m: largest distance of a point of the footprint from base_link.
    """

    def __init__(self, params: FilterParams, reach_m: float):
        """Start without a trail."""
        self._params = params
        self._yaw_rate_radps = params.escape_speed_mps / reach_m
        self._jump_m = JUMP_M + 3.0 * params.control_period_s * math.hypot(*params.limits[:2])
        self._trail: Deque[Trail] = deque()
        self._tick, self._pose = 0, None
        self._held, self._walked, self._refused = 0, 0, 0
        self._spent = False

    def tighten(self, params: FilterParams) -> None:
        """Go on with parameters that allow less."""
        self._params = params

    def pause(self, moved: bool) -> None:
        """The filter stopped for another reason: the robot must rest anew before it walks back.

        Args:
            moved: somebody else may have driven: the trail no longer leads from where the robot is.
        """
        self._held, self._refused = 0, 0
        if moved:
            self._trail.clear()

    def give_up(self) -> None:
        """Do not try again before the robot has been out once: an operator saw to it."""
        self._spent = True

    @property
    def is_walking(self) -> bool:
        """Whether the robot has stood for long enough and has not come out yet."""
        return self._held > self._count(self._params.escape_after_s)

    @property
    def walked_s(self) -> float:
        """How long it has walked back [s]."""
        return self._walked * self._params.control_period_s

    def _count(self, duration_s: float) -> int:
        return round(duration_s / self._params.control_period_s)

    def watch(self, pose: np.ndarray) -> None:
        """Count a tick and look at the pose (3,); a jump of the odometry makes the trail worthless."""
        if self._pose is not None and np.linalg.norm(pose[:2] - self._pose[:2]) > self._jump_m:
            self._trail.clear()
        self._tick, self._pose = self._tick + 1, pose
        oldest = self._tick - self._count(self._params.escape_trail_s)
        while self._trail and self._trail[0].tick < oldest:
            self._trail.popleft()

    def update(self, h_m: float, rests: bool) -> None:
        """Take one tick.

        Args:
            h_m: clearance, exempt cells left out.
            rests: the nominal command asks for motion, and none is let.
        """
        if h_m >= self._params.margin_m or (h_m >= 0.0 and not (self.is_walking and self._trail)):
            self._held, self._walked, self._refused, self._spent = 0, 0, 0, False
        elif not rests:
            self._held, self._refused = 0, 0
        elif not self._spent:
            self._held += 1
        if h_m >= 0.0 and not self.is_walking and (not self._trail or not self._is_at(self._trail[-1].pose)):
            self._trail.append(Trail(self._tick, self._pose))

    def _is_at(self, pose: np.ndarray) -> bool:
        gap = self._pose - pose
        return bool(np.hypot(gap[0], gap[1]) < STEP_M and abs(wrap_angle(gap[2])) < STEP_RAD)

    def find_command(self) -> Tuple[Optional[np.ndarray], str]:
        """The command (3,) back along the trail, or None and why there is none."""
        if self._walked >= self._count(self._params.escape_s):
            return None, f"h has not reached the margin after {self.walked_s:.1f} s of walking back"
        if self._refused >= self._count(REFUSED_S):
            return None, f"the verifier has refused every step back for {REFUSED_S:g} s"
        while self._trail and self._is_at(self._trail[-1].pose):
            self._trail.pop()
        if not self._trail:
            return None, f"no pose with h >= 0 is left of the last {self._params.escape_trail_s:g} s"
        gap = self._trail[-1].pose - self._pose
        body = np.append(compute_rotation(self._pose[2]).T @ gap[:2], wrap_angle(gap[2]))
        # speed + |yaw rate| reach <= escape_speed, and the pose is not overshot within the tick.
        duration_s = np.hypot(body[0], body[1]) / self._params.escape_speed_mps + abs(body[2]) / self._yaw_rate_radps
        return body / max(duration_s, self._params.control_period_s), ""

    def count(self, walks: bool) -> None:
        """Take what the verifier made of the command of this tick."""
        self._walked += 1
        self._refused = 0 if walks else self._refused + 1

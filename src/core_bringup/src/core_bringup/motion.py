# SPDX-License-Identifier: BSD-3-Clause
"""Where the moving objects of a world are, as a function of time and of where the robot has been."""

from __future__ import annotations

import math
from typing import Dict, Iterable, Mapping, Optional, Sequence, Tuple

import numpy as np

from core_bringup.world_types import WorldObject

Pose = Tuple[np.ndarray, float]
Poses = Mapping[int, Pose]  # object id -> position (3,) [m], yaw [rad]


class WorldMotion:
    """The moving objects of a world.

    A pure function of the times and robot places it is told: bridge and monitor, told the same, get the same poses.
    A time that goes back begins anew, as the world does at a reset.
    """

    def __init__(self, objects: Iterable[WorldObject]):
        """Take the moving ones of objects; all stand at their start."""
        self._paths = {item.id: _Path(item) for item in objects if item.motion is not None}
        self.reset()

    def reset(self) -> None:
        """Back to the start: nothing has been set off by the robot."""
        self._time_s = -math.inf
        self._started_s = {label: path.start_at_s for label, path in self._paths.items()}

    def advance(self, time_s: float, robot_xy: Sequence[float]) -> Dict[int, Pose]:
        """Tell one tick, and get the poses at its time.

        What the robot sets off at a tick leaves its place at that time: a pose never depends on the robot's place of
        the same tick.

        Args:
            time_s: sim time of the tick, growing from call to call.
            robot_xy: (2,) base point of the robot at time_s [m], world frame.
        """
        if time_s < self._time_s:
            self.reset()
        self._time_s = time_s
        for label, path in self._paths.items():
            if self._started_s[label] is None and path.is_near(robot_xy):
                self._started_s[label] = time_s
        return self.poses_at(time_s)

    def poses_at(self, time_s: float) -> Dict[int, Pose]:
        """Poses at a time [s], by what has been set off so far."""
        return {label: path.pose_after(self._elapsed_s(label, time_s)) for label, path in self._paths.items()}

    def _elapsed_s(self, label: int, time_s: float) -> float:
        started_s = self._started_s[label]
        return -1.0 if started_s is None else time_s - started_s


class _Path:
    """The way of one object: stretches between places, each walked at one speed, with a pause at every place.

    A loop goes there and back; its pauses are those of every place reached, the start's at the end of the way back.
    """

    def __init__(self, item: WorldObject):
        motion = item.motion
        there = np.vstack([item.position_m[:2], motion.path_m])
        places = np.vstack([there, there[-2::-1]]) if motion.loop else there
        self._item, self._places = item, places
        steps = np.diff(places, axis=0)
        walk_s = np.hypot(steps[:, 0], steps[:, 1]) / motion.speed_mps
        self._arrive_s = np.cumsum(walk_s + motion.pause_s) - motion.pause_s
        self._leave_s = self._arrive_s - walk_s
        self._period_s = float(self._arrive_s[-1] + motion.pause_s) if motion.loop else math.inf
        self._yaws_rad = self._compute_yaws(steps)
        self.start_at_s: Optional[float] = motion.start_at_s

    def is_near(self, robot_xy: Sequence[float]) -> bool:
        """Whether the robot sets the object off."""
        within_m, place = self._item.motion.start_within_m, self._item.position_m
        return within_m is not None and math.hypot(robot_xy[0] - place[0], robot_xy[1] - place[1]) <= within_m

    def pose_after(self, elapsed_s: float) -> Pose:
        """Pose a time after the start; before it, the one that is written."""
        item = self._item
        if elapsed_s <= 0.0:
            return item.position_m, item.yaw_rad
        if math.isfinite(self._period_s):
            elapsed_s = math.fmod(elapsed_s, self._period_s)
        leg = min(int(np.searchsorted(self._leave_s, elapsed_s, side="right")) - 1, len(self._leave_s) - 1)
        leg = max(leg, 0)
        whole_s = self._arrive_s[leg] - self._leave_s[leg]
        share = min(max((elapsed_s - self._leave_s[leg]) / whole_s, 0.0), 1.0) if whole_s > 0.0 else 1.0
        xy = self._places[leg] + share * (self._places[leg + 1] - self._places[leg])
        return np.array([xy[0], xy[1], item.position_m[2]]), float(self._yaws_rad[leg])

    def _compute_yaws(self, steps: np.ndarray) -> np.ndarray:
        if not self._item.motion.face_motion:
            return np.full(len(steps), self._item.yaw_rad)
        return np.arctan2(steps[:, 1], steps[:, 0])

# SPDX-License-Identifier: BSD-3-Clause
"""A robot that moves exactly as commanded: no physics, no contact, the same interface as pybullet_backend."""

from __future__ import annotations

import math
from typing import Optional

import numpy as np

from core_bringup.backend import Backend, RobotState
from core_bringup.quadruped.kinematics import JOINT_NAMES, LEGS
from core_bringup.quadruped.model import compute_stand_joints
from core_bringup.robot import RobotConfig
from core_bringup.world_types import World

TIME_STEP_NS = 1000  # durations are whole microseconds, so that time never drifts


def integrate_twist(pose: np.ndarray, twist: np.ndarray, duration_s: float) -> np.ndarray:
    """Move a planar pose under a held body twist, in closed form.

        theta' = theta + w T,   p' = p + T sinc(w T / 2) R(theta + w T / 2) (vx, vy),   sinc(x) = sin(x) / x

    The chord of an arc of angle w T turns by half of it and is shorter by the sinc; for w = 0 it is the straight line.

    Args:
        pose: (3,) x [m], y [m], theta [rad] in the world.
        twist: (3,) vx, vy [m/s], w [rad/s], expressed in the moving frame.
        duration_s: T.

    Returns:
        (3,) pose after T; theta is not wrapped.
    """
    (x, y, theta), (vx, vy, w) = (map(float, pose)), (map(float, twist))
    half = 0.5 * w * duration_s
    chord_s = duration_s * (math.sin(half) / half if half != 0.0 else 1.0)
    c, s = math.cos(theta + half), math.sin(theta + half)
    return np.array([x + chord_s * (c * vx - s * vy), y + chord_s * (s * vx + c * vy), theta + w * duration_s])


class KinematicBackend(Backend):
    """base_link glides level, at the height of the stand above the surface under it; a step in height is taken at once.

    Feet always touch, it never falls and passes through objects.
    A command is held for the whole step and clipped to the robot's limits; there is no lag. The same commands give the
    same bits.
    """

    def __init__(self, robot: RobotConfig, world: Optional[World] = None):
        """Stand at the origin until reset; without a world the ground is level at 0."""
        self._world = world
        limits, params = robot.limits, robot.quadruped
        self._limits = np.array([limits.forward_mps, limits.sideways_mps, limits.yaw_radps])
        self._height_m = params.gait.body_height_m
        self._joint_names = JOINT_NAMES
        self._joints_rad = np.array(compute_stand_joints(params), dtype=float).reshape(-1)
        self.reset(np.zeros(3))

    def reset(self, start_pose: np.ndarray) -> RobotState:
        """See Backend."""
        start_pose = np.array(start_pose, dtype=float)
        if start_pose.shape != (3,) or not np.all(np.isfinite(start_pose)):
            raise ValueError(f"start_pose must be three finite numbers, got {start_pose}")
        self._pose, self._twist, self._time_ns = start_pose, np.zeros(3), 0
        return self.state

    def step(self, command: np.ndarray, duration_s: float) -> RobotState:
        """See Backend; duration_s is a whole number of microseconds."""
        command = np.array(command, dtype=float)
        if command.shape != (3,) or not np.all(np.isfinite(command)):
            raise ValueError(f"command must be three finite numbers, got {command}")
        duration_ns = round(duration_s / (TIME_STEP_NS * 1e-9)) * TIME_STEP_NS
        if duration_ns <= 0 or abs(duration_ns * 1e-9 - duration_s) > 1e-12:
            raise ValueError(f"duration_s must be a whole number > 0 of microseconds, got {duration_s}")
        self._twist = np.clip(command, -self._limits, self._limits)
        self._pose = integrate_twist(self._pose, self._twist, duration_ns * 1e-9)
        self._time_ns += duration_ns
        return self.state

    @property
    def state(self) -> RobotState:
        """See Backend."""
        x, y, yaw = self._pose
        ground_m = 0.0 if self._world is None else self._world.surface_height_m(x, y)
        return RobotState(
            time_s=self._time_ns * 1e-9,
            p_world_base=np.array([x, y, ground_m + self._height_m]),
            q_world_base=np.array([0.0, 0.0, math.sin(0.5 * yaw), math.cos(0.5 * yaw)]),
            v_base=np.array([self._twist[0], self._twist[1], 0.0]),
            w_base=np.array([0.0, 0.0, self._twist[2]]),
            joint_names=self._joint_names,
            joint_positions_rad=self._joints_rad.copy(),
            joint_velocities_radps=np.zeros(len(self._joints_rad)),
            foot_contacts=(True,) * len(LEGS),
        )

    def close(self) -> None:
        """Nothing to free."""

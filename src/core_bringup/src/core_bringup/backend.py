# SPDX-License-Identifier: BSD-3-Clause
"""The interface of a simulated robot in a world; pybullet_backend is the real one, kinematic_backend the exact one."""

from __future__ import annotations

import abc
from dataclasses import dataclass, field
from typing import Mapping, Tuple

import numpy as np


@dataclass(frozen=True)
class RobotState:
    """What the bridge publishes about the robot at one instant.

    Attributes:
        time_s: sim time [s].
        p_world_base: (3,) position of base_link [m], world frame.
        q_world_base: (4,) orientation x, y, z, w of base_link in world.
        v_base: (3,) linear velocity of base_link [m/s], expressed in base_link.
        w_base: (3,) angular velocity [rad/s], expressed in base_link.
        joint_names: names of the moving joints, in the order of the two arrays below.
        joint_positions_rad: (n,) joint angles.
        joint_velocities_radps: (n,) joint speeds.
        foot_contacts: per leg FR, FL, RR, RL: the foot touches something.
        fallen: the trunk lies on a surface or is tilted beyond what a walk needs; bumping into an object is no fall.
        object_poses: where the moving objects are at this instant: object id -> bottom centre (3,) [m], yaw [rad].
    """

    time_s: float
    p_world_base: np.ndarray
    q_world_base: np.ndarray
    v_base: np.ndarray
    w_base: np.ndarray
    joint_names: Tuple[str, ...] = ()
    joint_positions_rad: np.ndarray = field(default_factory=lambda: np.zeros(0))
    joint_velocities_radps: np.ndarray = field(default_factory=lambda: np.zeros(0))
    foot_contacts: Tuple[bool, ...] = ()
    fallen: bool = False
    object_poses: Mapping[int, Tuple[np.ndarray, float]] = field(default_factory=dict)


class Backend(abc.ABC):
    """A world with one robot in it, advanced in steps of sim time."""

    @abc.abstractmethod
    def reset(self, start_pose: np.ndarray) -> RobotState:
        """Put the robot at rest at start_pose (3,) x [m], y [m], yaw [rad] of the world and time to zero."""

    @abc.abstractmethod
    def step(self, command: np.ndarray, duration_s: float) -> RobotState:
        """Advance by duration_s under a held body velocity command.

        Args:
            command: (3,) vx [m/s], vy [m/s], yaw rate [rad/s], expressed in base_link; must be finite.
            duration_s: > 0 and a whole number of physics steps.

        Returns:
            State at the end of the step.

        Raises:
            ValueError: wrong shape, non-finite command, or a duration that is no multiple of the physics step.
        """

    @property
    @abc.abstractmethod
    def state(self) -> RobotState:
        """State now."""

    @abc.abstractmethod
    def close(self) -> None:
        """Free what the backend holds; calling it twice is allowed."""

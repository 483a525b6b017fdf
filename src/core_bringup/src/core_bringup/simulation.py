# SPDX-License-Identifier: BSD-3-Clause
"""A task in a world, put together: back end, camera and ground truth, from the parameters of the bridge."""

from __future__ import annotations

from dataclasses import replace
from typing import Optional

import numpy as np

from core_bringup.backend import Backend, RobotState
from core_bringup.camera import Frame
from core_bringup.ground_truth import GroundTruth, GroundTruthState
from core_bringup.kinematic_backend import KinematicBackend
from core_bringup.lockstep import Schedule
from core_bringup.motion import WorldMotion
from core_bringup.params import BridgeParams, find_robot_file
from core_bringup.robot import RobotConfig
from core_bringup.rotations import yaw_of_quaternion
from core_bringup.world import load_world, vary_world


class Simulation:
    """One robot doing one task in one variation of a world.

    Attributes:
        world, task, robot: what was loaded; world and task are the variation of the seed.
        start_pose: (3,) x [m], y [m], yaw [rad].
        schedule: stamps of ticks and frames.

    Raises:
        ConfigError: a wrong world, task, robot or rate. BringupError: PyBullet or its renderer does not start.
    """

    def __init__(self, params: BridgeParams):
        """Load and build everything; the robot stands at its start and no time has passed."""
        self.robot = RobotConfig.load(params.robot or find_robot_file())
        self.world, self.start_pose = vary_world(load_world(params.world), params.task, params.seed)
        self.task = self.world.task(params.task)
        self.schedule = Schedule(params.period_ns, params.frame_every(self.robot.camera.rate_hz))
        self.camera = self.robot.camera.model
        footprint = self.robot.footprint
        self._truth = GroundTruth(self.task.unsafe_regions, self.world.objects, footprint.length_m, footprint.width_m)
        self._classes = self.world.class_of_label()
        self._aliases = {item.id: item.aliases for item in self.world.objects}
        self._motion = WorldMotion(self.world.objects)
        self._renderer = self._start_renderer(params) if self.schedule.frame_every else None
        self._backend = self._start_backend(params)
        self.reset()

    @property
    def state(self) -> RobotState:
        """State of the robot and of the moving objects now."""
        return self._state

    def reset(self) -> RobotState:
        """Put the robot and the moving objects back to their start and time to zero."""
        self._time_ns = 0
        self._motion.reset()
        return self._with_objects(self._backend.reset(self.start_pose))

    def step(self, command: np.ndarray, duration_ns: int) -> RobotState:
        """Advance under a held command (3,); see Backend.step. What the robot sets off starts at a tick."""
        state = self._backend.step(command, duration_ns * 1e-9)
        self._time_ns += duration_ns
        if self._time_ns % self.schedule.period_ns == 0:
            self._motion.advance(self._time_ns * 1e-9, state.p_world_base[:2])
        return self._with_objects(state)

    def _with_objects(self, state: RobotState) -> RobotState:
        self._state = replace(state, object_poses=self._motion.poses_at(self._time_ns * 1e-9))
        return self._state

    def measure_truth(self, state: RobotState) -> GroundTruthState:
        """Ground truth of the footprint at a state."""
        x_m, y_m, _ = state.p_world_base
        yaw_rad = yaw_of_quaternion(state.q_world_base)
        return self._truth.evaluate(float(x_m), float(y_m), yaw_rad, state.object_poses)

    def render(self, state: RobotState) -> Frame:
        """What the camera sees at a state; BringupError when the renderer's process has died."""
        return self._renderer.render(state)

    def names_in(self, frame: Frame) -> dict:
        """Label id -> class name of what a frame shows, then its aliases."""
        present = map(int, np.flatnonzero(np.bincount(frame.labels.ravel(), minlength=1)))
        shown = (label for label in present if label in self._classes)
        return {label: (self._classes[label], *self._aliases.get(label, ())) for label in shown}

    @property
    def class_names(self) -> tuple:
        """Every class of the world, sorted."""
        return tuple(sorted(set(self._classes.values())))

    def close(self) -> None:
        """Free back end and renderer; calling it twice is allowed."""
        self._backend.close()
        if self._renderer is not None:
            self._renderer.close()

    def _start_renderer(self, params: BridgeParams):
        from core_bringup.pybullet_renderer import PybulletRenderer  # only where a camera is wanted

        return PybulletRenderer(self.world, self.robot, self.camera, params.renderer)

    def _start_backend(self, params: BridgeParams) -> Optional[Backend]:
        if params.backend == "kinematic":
            return KinematicBackend(self.robot, self.world)
        from core_bringup.pybullet_backend import PybulletBackend  # the kinematic world does without pybullet

        return PybulletBackend(self.world, self.robot, params.gui, params.seed, self._motion)

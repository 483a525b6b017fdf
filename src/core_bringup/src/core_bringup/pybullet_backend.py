# SPDX-License-Identifier: BSD-3-Clause
"""The walking robot in a PyBullet world: physics and joint control at 240 Hz in one process."""

from __future__ import annotations

import os
import sys
from dataclasses import replace
from typing import Optional, Sequence, Tuple

import numpy as np
import pybullet

from core_bringup.backend import Backend, RobotState
from core_bringup.exceptions import BringupError
from core_bringup.motion import WorldMotion
from core_bringup.params import PYBULLET_RATE_HZ
from core_bringup.pybullet_scene import PybulletScene, write_urdf
from core_bringup.quadruped.controller import GRAVITY_MPS2, TrotController
from core_bringup.quadruped.kinematics import JOINT_NAMES, LEGS, LegKinematics
from core_bringup.quadruped.model import compute_mass_properties, compute_stand_joints
from core_bringup.quadruped.types import QuadrupedState
from core_bringup.robot import RobotConfig
from core_bringup.world_types import World, WorldObject

FALLEN_TILT_RAD = 0.7
_SOLVER_ITERATIONS = 50
_WINDOW = "--width=1280 --height=800"


class PybulletBackend(Backend):
    """A quadruped that walks by force control through a world of solid objects, some of which move.

    A moving object is put a little further at every physics step, whatever it meets: it pushes, and is not pushed.

    The same seed in a fresh process gives the same states bit for bit.
    """

    def __init__(
        self,
        world: World,
        robot: RobotConfig,
        gui: bool = False,
        seed: int = 0,
        motion: Optional[WorldMotion] = None,
    ):
        """Open a PyBullet client and put the robot to the origin.

        Args:
            world: World.
            robot: RobotConfig.
            gui: open PyBullet's own window.
            seed: even: legs FL and RR make the first step; odd: FR and RL.
            motion: where the moving objects are; None: they stand.

        Raises:
            BringupError: PyBullet refuses to start or to load something.
        """
        self._world, self._robot, self._motion = world, robot, motion
        self._limits = np.array([robot.limits.forward_mps, robot.limits.sideways_mps, robot.limits.yaw_radps])
        self._client = _connect(gui)
        self._gui = gui
        self._urdf_path, self._scene = write_urdf(robot), None
        self._stand_rad = compute_stand_joints(robot.quadruped)
        mass = compute_mass_properties(robot.quadruped, robot.camera_mount, self._stand_rad)
        self._controller = TrotController(robot.quadruped, mass, 1.0 / PYBULLET_RATE_HZ, seed % 2)
        self.reset(np.zeros(3))

    def reset(self, start_pose: np.ndarray) -> RobotState:
        """Rebuild the scene and put the robot at rest at start_pose; see Backend.reset.

        Objects stay where they are now, those added since the start included.
        """
        start_pose = _check_vector("start_pose", start_pose)
        if self._scene is not None:
            self._world = replace(self._world, objects=self._scene.objects)
        pybullet.resetSimulation(physicsClientId=self._client)
        pybullet.setGravity(0.0, 0.0, -GRAVITY_MPS2, physicsClientId=self._client)
        pybullet.setPhysicsEngineParameter(
            fixedTimeStep=1.0 / PYBULLET_RATE_HZ,
            numSolverIterations=_SOLVER_ITERATIONS,
            numSubSteps=0,
            physicsClientId=self._client,
        )
        self._show(False)
        self._scene = PybulletScene(self._client, self._world, self._urdf_path, visual=self._gui)
        self._show(True)
        self._foot_ids = [self._scene.link_ids[f"{leg}_foot"] for leg in LEGS]
        self._free_joints()
        x, y, yaw = start_pose
        height = self._ground_under_m(start_pose) + self._robot.quadruped.gait.body_height_m
        self._scene.set_robot((x, y, height), (0.0, 0.0, np.sin(0.5 * yaw), np.cos(0.5 * yaw)), self._stand_rad.ravel())
        self._ticks = 0
        self._controller.reset(self._read_robot(np.ones(4, dtype=bool)))
        self._contacts, self._trunk_down = np.ones(4, dtype=bool), False
        self._state = self._read_state()
        self._follow(self._state.p_world_base)
        return self._state

    def step(self, command: np.ndarray, duration_s: float) -> RobotState:
        """Advance by duration_s under a held command, clipped to the robot's limits; see Backend.step."""
        command = np.clip(_check_vector("command", command), -self._limits, self._limits)
        ticks = round(duration_s * PYBULLET_RATE_HZ) if np.isfinite(duration_s) else 0
        if ticks < 1 or abs(duration_s * PYBULLET_RATE_HZ - ticks) > 1e-6:
            raise ValueError(f"duration_s: got {duration_s}, allowed a multiple of 1/{PYBULLET_RATE_HZ} s above 0")
        for _ in range(ticks):
            torques = self._controller.compute_torques(self._read_robot(self._contacts), command)
            pybullet.setJointMotorControlArray(
                self._scene.robot,
                self._scene.joint_ids,
                pybullet.TORQUE_CONTROL,
                forces=torques.ravel().tolist(),
                physicsClientId=self._client,
            )
            pybullet.stepSimulation(physicsClientId=self._client)
            self._ticks += 1
            self._move_objects()
            self._read_contacts()
        self._state = self._read_state()
        self._follow(self._state.p_world_base)
        return self._state

    @property
    def state(self) -> RobotState:
        """State now."""
        return self._state

    @property
    def objects(self) -> Tuple[WorldObject, ...]:
        """WorldObjects as they stand now."""
        return self._scene.objects

    def add_object(self, item: WorldObject) -> None:
        """Put a WorldObject into the world; BringupError when its id is taken."""
        self._scene.add_object(item)

    def move_object(self, label_id: int, position_m: Sequence[float], yaw_rad: float) -> None:
        """Put the bottom centre of an object to position_m (3,), heading yaw_rad; BringupError for an unknown id."""
        self._scene.move_object(label_id, position_m, yaw_rad)

    def remove_object(self, label_id: int) -> None:
        """Take an object out of the world; BringupError for an unknown id."""
        self._scene.remove_object(label_id)

    def close(self) -> None:
        """Close the client; calling it twice is allowed."""
        if self._client >= 0:
            pybullet.disconnect(physicsClientId=self._client)
            self._urdf_path.unlink()
            self._client = -1

    def _move_objects(self) -> None:
        """Put the moving objects to where they are now; what they touch is felt in the next physics step."""
        if self._motion is not None:
            for label_id, pose in self._motion.poses_at(self._ticks / PYBULLET_RATE_HZ).items():
                self._scene.place_object(label_id, *pose)

    def _ground_under_m(self, pose: np.ndarray) -> float:
        """Height of the highest surface under base_link and the four hips at a pose (3,)."""
        hips = LegKinematics(self._robot.quadruped.leg).p_base_thigh[:, :2]
        c, s = np.cos(pose[2]), np.sin(pose[2])
        places = pose[:2] + np.vstack([np.zeros(2), hips @ np.array([[c, s], [-s, c]])])
        return max(self._world.surface_height_m(x, y) for x, y in places)

    def _free_joints(self) -> None:
        """Turn off PyBullet's own joint motors and damping, and set the friction of the feet."""
        robot, client = self._scene.robot, self._client
        friction = self._robot.quadruped.leg.foot_friction
        for joint in self._scene.joint_ids:
            pybullet.setJointMotorControl2(robot, joint, pybullet.VELOCITY_CONTROL, force=0.0, physicsClientId=client)
        for link in range(-1, pybullet.getNumJoints(robot, physicsClientId=client)):
            pybullet.changeDynamics(
                robot, link, linearDamping=0.0, angularDamping=0.0, jointDamping=0.0, physicsClientId=client
            )
        for foot in self._foot_ids:
            pybullet.changeDynamics(robot, foot, lateralFriction=friction, physicsClientId=client)

    def _read_robot(self, contacts: np.ndarray) -> QuadrupedState:
        p, q, v, w = self._scene.get_base()
        joints = pybullet.getJointStates(self._scene.robot, self._scene.joint_ids, physicsClientId=self._client)
        angles = np.array([joint[0] for joint in joints]).reshape(4, 3)
        speeds = np.array([joint[1] for joint in joints]).reshape(4, 3)
        return QuadrupedState(p, _rotation_of(q), v, w, angles, speeds, contacts)

    def _read_contacts(self) -> None:
        """Which feet touch anything, and whether the trunk lies on a surface."""
        touching = set()
        self._trunk_down = False
        for contact in pybullet.getContactPoints(bodyA=self._scene.robot, physicsClientId=self._client):
            touching.add(contact[3])
            self._trunk_down |= contact[3] == -1 and contact[2] in self._scene.floor_bodies
        self._contacts = np.array([foot in touching for foot in self._foot_ids])

    def _read_state(self) -> RobotState:
        body = self._read_robot(self._contacts)
        rotation = body.R_world_base
        tilt_rad = np.arccos(np.clip(rotation[2, 2], -1.0, 1.0))
        q_world_base = self._scene.get_base()[1]
        return RobotState(
            time_s=self._ticks / PYBULLET_RATE_HZ,
            p_world_base=body.p_world_base,
            q_world_base=q_world_base,
            v_base=rotation.T @ body.v_world_base,
            w_base=rotation.T @ body.w_world_base,
            joint_names=JOINT_NAMES,
            joint_positions_rad=body.q_rad.ravel(),
            joint_velocities_radps=body.dq_radps.ravel(),
            foot_contacts=tuple(bool(contact) for contact in self._contacts),
            fallen=bool(self._trunk_down or tilt_rad > FALLEN_TILT_RAD),
        )

    def _show(self, visible: bool) -> None:
        """Draw in the window or not: drawing every body as it is loaded takes minutes."""
        if self._gui:
            client = self._client
            pybullet.configureDebugVisualizer(pybullet.COV_ENABLE_RENDERING, int(visible), physicsClientId=client)

    def _follow(self, p_world_base: np.ndarray) -> None:
        """Point the window's camera at the robot, from behind and above."""
        if self._gui:
            pybullet.resetDebugVisualizerCamera(4.0, -60.0, -25.0, p_world_base.tolist(), physicsClientId=self._client)


def _connect(gui: bool) -> int:
    if gui and sys.platform.startswith("linux") and not os.environ.get("DISPLAY"):  # PyBullet would end the process
        raise BringupError("gui: there is no display (DISPLAY is not set); allowed here: gui false")
    client = pybullet.connect(pybullet.GUI, options=_WINDOW) if gui else pybullet.connect(pybullet.DIRECT)
    if client < 0:
        raise BringupError("PyBullet did not start")
    if gui:
        pybullet.configureDebugVisualizer(pybullet.COV_ENABLE_GUI, 0, physicsClientId=client)
        pybullet.configureDebugVisualizer(pybullet.COV_ENABLE_SHADOWS, 0, physicsClientId=client)
    return client


def _check_vector(name: str, values: Sequence[float]) -> np.ndarray:
    vector = np.asarray(values, dtype=float)
    if vector.shape != (3,) or not np.all(np.isfinite(vector)):
        raise ValueError(f"{name}: got {values}, allowed (3,) finite numbers")
    return vector


def _rotation_of(q: np.ndarray) -> np.ndarray:
    return np.array(pybullet.getMatrixFromQuaternion(q)).reshape(3, 3)

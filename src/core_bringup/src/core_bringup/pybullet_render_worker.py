# SPDX-License-Identifier: BSD-3-Clause
"""The child process of PybulletRenderer: draws frames with a PyBullet client of its own."""

from __future__ import annotations

import importlib.util
import pickle
import signal
from multiprocessing.connection import Connection
from typing import List, Tuple

import numpy as np
import pybullet

from core_bringup.backend import RobotState
from core_bringup.camera import CameraModel
from core_bringup.camera_noise import add_camera_noise
from core_bringup.exceptions import BringupError
from core_bringup.face_painter import FacePainter
from core_bringup.pybullet_scene import PybulletScene, write_urdf
from core_bringup.quadruped.kinematics import JOINT_NAMES
from core_bringup.quadruped.model import compute_stand_joints
from core_bringup.robot import RobotConfig
from core_bringup.world_types import World

SKY_RGB = (188, 208, 228)
_SKY_PIXEL = np.array([*SKY_RGB, 255], dtype=np.uint8).view(np.uint32)[0]
# Where a renderer samples pixel (u, v), in its own image coordinates, less (u, v). Measured against rayTest.
_SAMPLE_OFFSET_PX = {"tiny": (0.0, 1.0), "egl": (0.5, 0.5)}
_LIGHT_DISTANCE_M = 20.0
_BODY_MASK = (1 << 24) - 1
_OPTICAL_TO_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


def build_projection_matrix(camera: CameraModel, offset_px: Tuple[float, float] = (0.0, 0.0)) -> Tuple[float, ...]:
    """OpenGL projection of a pinhole camera with fx != fy.

        left, right  = -cx n / fx, (w - cx) n / fx
        bottom, top  = -(h - cy) n / fy, cy n / fy          with (cx, cy) shifted by offset_px

    Args:
        camera: CameraModel.
        offset_px: where the renderer samples a pixel, from its integer coordinate.

    Returns:
        16 numbers, column by column.
    """
    n, fx, fy = camera.near_m, camera.fx_px, camera.fy_px
    cx, cy = camera.cx_px + offset_px[0], camera.cy_px + offset_px[1]
    return pybullet.computeProjectionMatrix(
        -cx * n / fx, (camera.width_px - cx) * n / fx, -(camera.height_px - cy) * n / fy, cy * n / fy, n, camera.far_m
    )


class FramePainter:
    """A PyBullet client that holds the drawn world and the camera on the robot."""

    def __init__(self, world: World, robot: RobotConfig, camera: CameraModel, renderer: str):
        """Build the world; arguments as those of PybulletRenderer."""
        self._camera, self._light, self._noise = camera, world.lighting, world.camera_noise
        self._stand_rad = compute_stand_joints(robot.quadruped).ravel()
        self._client = pybullet.connect(pybullet.DIRECT)
        self._engine = pybullet.ER_TINY_RENDERER if renderer == "tiny" else _load_egl(self._client)
        own_faces = renderer == "tiny" and not world.lighting.shadow  # no shadow falls on painted faces
        self._faces = FacePainter(camera, world.lighting) if own_faces else None
        urdf_path = write_urdf(robot)
        try:
            self.scene = PybulletScene(self._client, world, urdf_path, faces=self._faces)
        finally:
            urdf_path.unlink()
        self._R_base_optical, self._p_base_optical = robot.camera_mount.compute_optical_pose()
        self._projection = build_projection_matrix(camera, _SAMPLE_OFFSET_PX[renderer])

    def paint(self, state: RobotState) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Draw a frame at a state; joints default to the stand. Returns color, depth_m, labels as in camera.Frame."""
        p_world_base, q_world_base = state.p_world_base, state.q_world_base
        joint_names, joint_positions_rad = state.joint_names, state.joint_positions_rad
        if not joint_names:
            joint_names, joint_positions_rad = JOINT_NAMES, self._stand_rad
        self.scene.set_robot(p_world_base, q_world_base, joint_positions_rad, joint_names)
        for label_id, pose in state.object_poses.items():
            self.scene.place_object(label_id, *pose)
        camera, light = self._camera, self._light
        R_world_optical, p_world_camera = self._compute_camera_pose(p_world_base, q_world_base)
        _, _, rgba, buffer, segments = pybullet.getCameraImage(
            camera.width_px,
            camera.height_px,
            _compute_view_matrix(R_world_optical, p_world_camera),
            self._projection,
            lightDirection=[float(x) for x in light.direction],
            lightColor=[float(x) for x in light.color_rgb],
            lightDistance=_LIGHT_DISTANCE_M,
            shadow=int(light.shadow),
            lightAmbientCoeff=light.ambient,
            lightDiffuseCoeff=light.diffuse,
            lightSpecularCoeff=light.specular,
            renderer=self._engine,
            flags=pybullet.ER_SEGMENTATION_MASK_OBJECT_AND_LINKINDEX,
            physicsClientId=self._client,
        )
        shape = (camera.height_px, camera.width_px)
        segments = np.asarray(segments, dtype=np.int32).reshape(shape)
        labels = self._compute_labels(segments)
        nearness = compute_nearness(np.asarray(buffer).reshape(shape), camera.near_m, camera.far_m)
        pixels = np.ascontiguousarray(rgba, dtype=np.uint8).view(np.uint32).reshape(shape)
        pixels = np.where(segments < 0, _SKY_PIXEL, pixels)
        if self._faces is not None:
            self._faces.paint((pixels, nearness, labels), R_world_optical, p_world_camera)
        depth = np.divide(1.0, nearness, out=np.empty(shape, dtype=np.float32), casting="same_kind")
        np.copyto(depth, np.nan, where=labels == 0)
        color = pixels.view(np.uint8).reshape(*shape, 4)[:, :, :3].copy()
        return (*add_camera_noise(color, depth, self._noise, round(state.time_s * 1e9)), labels)

    def _compute_labels(self, segments: np.ndarray) -> np.ndarray:
        """World labels (h, w) uint16; the robot and the sky (-1, which the mask makes the largest body id) are 0."""
        bodies = self.scene.label_of_body
        table = np.zeros(max(bodies, default=0) + 2, dtype=np.uint16)
        for body, label in bodies.items():
            table[body] = label
        return np.take(table, segments & _BODY_MASK, mode="clip")

    def _compute_camera_pose(self, p_world_base: np.ndarray, q_world_base: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
        """Axes of the camera (3, 3), right, down and ahead, and its place (3,) [m], in the world frame."""
        R_world_base = np.array(pybullet.getMatrixFromQuaternion([float(x) for x in q_world_base])).reshape(3, 3)
        return R_world_base @ self._R_base_optical, p_world_base + R_world_base @ self._p_base_optical


def _compute_view_matrix(R_world_optical: np.ndarray, p_world_camera: np.ndarray) -> List[float]:
    """Inverse pose of a camera in OpenGL's axes (y up, looking along -z), 16 numbers column by column."""
    view = np.eye(4)
    view[:3, :3], view[:3, 3] = R_world_optical.T, -R_world_optical.T @ p_world_camera
    return (_OPTICAL_TO_OPENGL @ view).T.ravel().tolist()


def compute_nearness(buffer: np.ndarray, near_m: float, far_m: float) -> np.ndarray:
    """1 / z = 1 / n - (1 / n - 1 / f) d [1/m], float64, of OpenGL's depth buffer d in [0, 1]; z is the depth."""
    nearness = np.multiply(buffer, 1.0 / far_m - 1.0 / near_m, dtype=np.float64)
    nearness += 1.0 / near_m
    return nearness


def _load_egl(client: int) -> int:
    spec = importlib.util.find_spec("eglRenderer")
    if spec is None or spec.origin is None:
        raise BringupError("renderer egl: PyBullet's eglRenderer plugin is not installed; allowed here: tiny")
    if pybullet.loadPlugin(spec.origin, "_eglRendererPlugin", physicsClientId=client) < 0:
        raise BringupError("renderer egl: EGL did not start (no driver or no display device); allowed here: tiny")
    return pybullet.ER_BULLET_HARDWARE_OPENGL


def _answer(painter: FramePainter, name: str, arguments: Tuple) -> bytes:
    """Bytes of the answer to one request: 8 bytes of head, then the images if it was 'render'."""
    if name == "render":
        images = (np.ascontiguousarray(image).tobytes() for image in painter.paint(*arguments))
        return b"".join([b"F" + bytes(7), *images])
    getattr(painter.scene, name)(*arguments)
    return b"D" + bytes(7)


def serve(descriptor: int) -> None:
    """Answer requests on a socket until the other end closes it, be it on purpose or by its death."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    connection = Connection(descriptor)
    try:
        try:
            painter = FramePainter(*connection.recv())
        except BringupError as error:
            connection.send_bytes(b"E" + pickle.dumps(str(error)))
            return
        connection.send_bytes(b"D" + bytes(7))
        while True:
            name, arguments = connection.recv()
            try:
                answer = _answer(painter, name, arguments)
            except BringupError as error:
                answer = b"E" + pickle.dumps(str(error))
            connection.send_bytes(answer)
    except (EOFError, ConnectionError):
        return

# SPDX-License-Identifier: BSD-3-Clause
"""A first-person key frame with the safe / unsafe overlay and a caption that says when and why it was kept."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Sequence

import cv2
import numpy as np

from core_bringup.evaluation.key_frames import KeyFrame
from core_bringup.evaluation.records import OdometrySample
from core_bringup.evaluation.results import atomic_path
from core_bringup.robot import CameraConfig
from core_perception.overlay import GridView, draw_overlay

SCALE = 2
CAPTION_PX = 66
FONT = cv2.FONT_HERSHEY_SIMPLEX
PANEL_RGB, TITLE_RGB, TEXT_RGB = (22, 24, 28), (255, 255, 255), (190, 194, 200)


def draw_key_frame(path: Path, frame: KeyFrame, camera: CameraConfig) -> None:
    """Write one key frame as PNG, (2 h + caption, 2 w) pixels.

    Without depth, pose or grid the plain image is shown: there is nothing yet to lay over it.

    Raises:
        OSError: the file cannot be written.
    """
    picture = _draw_view(frame, camera)
    caption = _draw_caption(picture.shape[1], frame)
    with atomic_path(path) as temporary:
        whole = np.vstack([picture, caption])
        if not cv2.imwrite(str(temporary), cv2.cvtColor(whole, cv2.COLOR_RGB2BGR)):
            raise OSError(f"{path}: the picture cannot be written")


def camera_pose(odometry: OdometrySample, camera: CameraConfig) -> np.ndarray:
    """(4, 4) pose of the optical frame in odom: T_odom_camera = T_odom_base T_base_camera."""
    R_base_camera, p_base_camera = camera.mount.compute_optical_pose()
    R_odom_base = rotation_of(odometry.q_odom_base)
    T_odom_camera = np.eye(4)
    T_odom_camera[:3, :3] = R_odom_base @ R_base_camera
    T_odom_camera[:3, 3] = R_odom_base @ p_base_camera + np.array(odometry.p_odom_base)
    return T_odom_camera


def rotation_of(quaternion: Sequence[float]) -> np.ndarray:
    """(3, 3) rotation of a unit quaternion x, y, z, w."""
    x, y, z, w = quaternion
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip


def camera_matrix(camera: CameraConfig) -> np.ndarray:
    """(3, 3) pinhole matrix [px]."""
    model = camera.model
    return np.array([[model.fx_px, 0.0, model.cx_px], [0.0, model.fy_px, model.cy_px], [0.0, 0.0, 1.0]])


def _draw_view(frame: KeyFrame, camera: CameraConfig) -> np.ndarray:
    rgb = np.ascontiguousarray(frame.image.rgb)
    if frame.depth_m is None or frame.odometry is None or frame.grid is None:
        return cv2.resize(rgb, None, fx=SCALE, fy=SCALE, interpolation=cv2.INTER_CUBIC)
    grid = frame.grid
    view = GridView(grid.state, grid.resolution_m, grid.origin_m[0], grid.origin_m[1], grid.unknown_is_unsafe)
    pose = camera_pose(frame.odometry, camera)
    return draw_overlay(rgb, frame.depth_m, camera_matrix(camera), pose, view, frame.predicates)


def _draw_caption(width_px: int, frame: KeyFrame) -> np.ndarray:
    caption = np.full((CAPTION_PX, width_px, 3), PANEL_RGB, np.uint8)
    cv2.putText(caption, frame.title, (16, 27), FONT, 0.66, TITLE_RGB, 1, cv2.LINE_AA)
    cv2.putText(caption, _figures(frame), (16, 52), FONT, 0.48, TEXT_RGB, 1, cv2.LINE_AA)
    return caption


def _figures(frame: KeyFrame) -> str:
    """Time, filter and truth at the moment the frame was kept; cv2 draws ASCII only."""
    parts = [f"t = {frame.image.stamp_ns * 1e-9:.2f} s"]
    if frame.record is not None:
        state, truth = frame.record.filter, frame.record.truth
        parts.append(state.mode)
        if math.isfinite(state.h_m):
            parts.append(f"h = {state.h_m:.2f} m")
        wanted, sent = (math.hypot(u[0], u[1]) for u in (state.u_nominal, state.u_safe))
        parts.append(f"wanted {wanted:.2f}, sent {sent:.2f} m/s")
        if math.isfinite(truth.clearance_m):
            parts.append(f"{truth.clearance_m:.2f} m from the true region")
    return "  |  ".join(parts)

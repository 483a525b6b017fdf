# SPDX-License-Identifier: BSD-3-Clause
"""Draws the safety map into the camera image: safe ground green, unsafe red, unknown amber; predicates in force."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Sequence, Tuple

import cv2
import numpy as np

from core_perception.exceptions import EvidenceError
from core_perception.predicates import Predicate, Verdict

SAFE, UNSAFE, UNKNOWN, UNTOUCHED = 0, 1, 2, 3
SAFE_RGB = (46, 190, 90)
UNSAFE_RGB = (225, 45, 45)
UNKNOWN_RGB = (240, 175, 40)
PANEL_RGB = (22, 24, 28)
BORDER_RGB = (245, 255, 245)
TEXT_RGB = (238, 238, 238)
FONT = cv2.FONT_HERSHEY_SIMPLEX


@dataclass(frozen=True)
class GridView:
    """The part of a safety grid that is drawn.

    Attributes:
        state: (height, width) uint8 of 0 safe, 1 unsafe, 2 unknown, as in core_msgs/SafetyGrid; row iy, column ix.
        resolution_m: edge of a cell [m].
        origin_x_m: x of the lower left corner of cell (0, 0) [m] in odom.
        origin_y_m: y of it.
        unknown_is_unsafe: the filter keeps out of unknown cells too.
    """

    state: np.ndarray
    resolution_m: float
    origin_x_m: float
    origin_y_m: float
    unknown_is_unsafe: bool = True


@dataclass(frozen=True)
class OverlayStyle:
    """How the overlay is drawn.

    Attributes:
        scale: size of the picture over that of the image, a whole number >= 1.
        opacity: weight of the tint, 0..1.
        floor_z_m: height of the floor in the grid's frame [m].
        obstacle_height_m: points higher than this above the floor are obstacles [m].
        max_range_m: farthest distance along the optical axis that is tinted [m].
    """

    scale: int = 2
    opacity: float = 0.45
    floor_z_m: float = 0.0
    obstacle_height_m: float = 0.10
    max_range_m: float = 7.0


def pixel_states(
    depth_m: np.ndarray,
    K: np.ndarray,
    T_odom_camera: np.ndarray,
    grid_view: GridView,
    style: OverlayStyle = OverlayStyle(),
) -> np.ndarray:
    """Give every pixel the state of the ground under it.

        p_odom = T_odom_camera [z (u - cx) / fx, z (v - cy) / fy, z, 1]
        cell = floor((p_odom_xy - origin) / resolution)

    Args:
        depth_m: (h, w) distance along the optical axis [m]; NaN, inf or <= 0 where nothing was hit.
        K: (3, 3) camera matrix [px].
        T_odom_camera: (4, 4) pose of the optical frame in the grid's frame.
        grid_view: the grid.
        style: obstacle height and range.

    Returns:
        (h, w) uint8: SAFE, UNSAFE (also every obstacle), UNKNOWN (also outside the grid), or UNTOUCHED (no depth, or
        beyond the range).

    Raises:
        EvidenceError: a shape other than the above.
    """
    if depth_m.ndim != 2 or np.shape(K) != (3, 3) or np.shape(T_odom_camera) != (4, 4):
        raise EvidenceError(f"overlay: got depth {depth_m.shape}, K {np.shape(K)}, pose {np.shape(T_odom_camera)}")
    with np.errstate(invalid="ignore"):
        hit = np.isfinite(depth_m) & (depth_m > 0.0) & (depth_m <= style.max_range_m)
    z = np.where(hit, depth_m, 1.0).astype(float)
    v, u = np.mgrid[: depth_m.shape[0], : depth_m.shape[1]]
    p_camera = np.stack([z * (u - K[0, 2]) / K[0, 0], z * (v - K[1, 2]) / K[1, 1], z], axis=-1)
    p_odom = p_camera @ np.asarray(T_odom_camera)[:3, :3].T + np.asarray(T_odom_camera)[:3, 3]
    states = _cell_states(p_odom[..., 0], p_odom[..., 1], grid_view)
    states[p_odom[..., 2] > style.floor_z_m + style.obstacle_height_m] = UNSAFE
    states[~hit] = UNTOUCHED
    return states


def _cell_states(x_m, y_m, grid_view):
    ix = np.floor((x_m - grid_view.origin_x_m) / grid_view.resolution_m).astype(int)
    iy = np.floor((y_m - grid_view.origin_y_m) / grid_view.resolution_m).astype(int)
    height, width = grid_view.state.shape
    inside = (ix >= 0) & (ix < width) & (iy >= 0) & (iy < height)
    states = np.full(x_m.shape, UNKNOWN, np.uint8)
    states[inside] = grid_view.state[iy[inside], ix[inside]]
    return states


def draw_overlay(
    color: np.ndarray,
    depth_m: np.ndarray,
    K: np.ndarray,
    T_odom_camera: np.ndarray,
    grid_view: GridView,
    predicates: Sequence[Predicate] = (),
    style: OverlayStyle = OverlayStyle(),
) -> np.ndarray:
    """Tint an image by pixel_states and add a legend and the predicates.

    Args:
        color: (h, w, 3) uint8 rgb, registered to the depth image.
        depth_m: see pixel_states, as are K, T_odom_camera and grid_view.
        K: camera matrix.
        T_odom_camera: pose of the camera.
        grid_view: the grid.
        predicates: what is in force; may be empty.
        style: see OverlayStyle.

    Returns:
        (scale h, scale w, 3) uint8 rgb; the input is not changed.

    Raises:
        EvidenceError: shapes that do not fit each other.
    """
    if color.ndim != 3 or color.shape[:2] != depth_m.shape or color.shape[2] != 3 or color.dtype != np.uint8:
        raise EvidenceError(
            f"overlay: got colour {color.dtype} {color.shape}, depth {depth_m.shape}, allowed uint8 (h, w, 3), (h, w)"
        )
    states = pixel_states(depth_m, K, T_odom_camera, grid_view, style)
    size = (color.shape[1] * style.scale, color.shape[0] * style.scale)
    picture = cv2.resize(color, size, interpolation=cv2.INTER_CUBIC) if style.scale > 1 else color.copy()
    states = cv2.resize(states, size, interpolation=cv2.INTER_NEAREST)
    picture = _tint(picture, states, style.opacity)
    _draw_border(picture, states)
    _draw_legend(picture, grid_view.unknown_is_unsafe)
    _draw_predicates(picture, predicates)
    return picture


def _tint(picture, states, opacity):
    colors = np.array([SAFE_RGB, UNSAFE_RGB, UNKNOWN_RGB, (0, 0, 0)], np.float32)
    weights = np.array([opacity, opacity, 0.6 * opacity, 0.0], np.float32)[states][..., None]
    return np.clip(np.rint(picture * (1.0 - weights) + colors[states] * weights), 0, 255).astype(np.uint8)


def _draw_border(picture, states):
    """A bright line where safe ground ends; single pixels are smoothed away first."""
    safe = cv2.medianBlur((states == SAFE).astype(np.uint8), 5)
    edge = cv2.morphologyEx(safe, cv2.MORPH_GRADIENT, np.ones((2, 2), np.uint8)) > 0
    picture[edge] = BORDER_RGB


def _draw_legend(picture, unknown_is_unsafe):
    rows = [
        (SAFE_RGB, "safe"),
        (UNSAFE_RGB, "unsafe"),
        (UNKNOWN_RGB, "unknown, kept out" if unknown_is_unsafe else "unknown"),
    ]
    _draw_rows(picture, rows, at_right=True)


def _draw_predicates(picture, predicates):
    if predicates:
        ordered = sorted(predicates, key=lambda p: (p.verdict == Verdict.SAFE, -p.operator, p.class_name))
        _draw_rows(
            picture,
            [(SAFE_RGB if p.verdict == Verdict.SAFE else UNSAFE_RGB, p.expression) for p in ordered],
            at_right=False,
        )


def _draw_rows(picture, rows: Sequence[Tuple[Tuple[int, int, int], str]], at_right: bool):
    """A panel of coloured squares with text in an upper corner; rows that do not fit are counted in the last one."""
    font_scale = max(0.35, 0.45 * picture.shape[1] / 1000.0)
    line_px = round(44 * font_scale)
    room = max(1, (picture.shape[0] - line_px) // line_px)
    if len(rows) > room:
        rows = [*rows[: room - 1], (PANEL_RGB, f"and {len(rows) - room + 1} more")]
    text_px = max(cv2.getTextSize(text, FONT, font_scale, 1)[0][0] for _, text in rows)
    width_px, margin_px = text_px + 2 * line_px, line_px // 2
    left = picture.shape[1] - width_px - margin_px if at_right else margin_px
    left = max(left, 0)
    panel = picture[margin_px : margin_px + line_px * len(rows) + margin_px, left : left + width_px]
    panel[:] = np.rint(0.3 * panel + 0.7 * np.array(PANEL_RGB)).astype(np.uint8)
    for k, (color, text) in enumerate(rows):
        middle = margin_px + line_px // 4 + line_px * k + line_px // 2
        corner = (left + line_px // 2, middle - line_px // 4)
        cv2.rectangle(picture, corner, (corner[0] + line_px // 2, corner[1] + line_px // 2), color, -1)
        at = (left + line_px // 2 + round(0.8 * line_px), middle + line_px // 4)
        cv2.putText(picture, text, at, FONT, font_scale, TEXT_RGB, 1, cv2.LINE_AA)

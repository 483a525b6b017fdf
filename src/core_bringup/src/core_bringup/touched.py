# SPDX-License-Identifier: BSD-3-Clause
"""What is touched of an object, seen from above: a rectangle, a circle, or the rectangles of its parts."""

from __future__ import annotations

import math
from typing import List, Tuple

import numpy as np

from core_bringup.motion import Poses
from core_bringup.polygons import convex_hull, rectangle
from core_bringup.world_types import WorldObject

ROBOT_HEIGHT_M = 0.8  # what hangs higher is no obstacle
CIRCLE_CORNERS = 24
NO_POSES: Poses = {}


def object_place(item: WorldObject, poses: Poses = NO_POSES) -> Tuple[np.ndarray, float]:
    """Ground place (2,) [m] and heading [rad] of an object, among poses where it moves."""
    position_m, yaw_rad = poses.get(item.id, (item.position_m, item.yaw_rad))
    return np.asarray(position_m, dtype=float)[:2], yaw_rad


def touched_boxes_m(item: WorldObject) -> np.ndarray:
    """(k, 6) boxes x0, y0, z0, x1, y1, z1 in the object's own axes; that around a cylinder for one."""
    if item.collision == "parts":
        return item.collision_parts_m
    x_m, y_m, z_m = (float(value) for value in item.collision_size_m)
    return np.array([[-0.5 * x_m, -0.5 * y_m, 0.0, 0.5 * x_m, 0.5 * y_m, z_m]])


def boxes_between_m(item: WorldObject, low_m: float, high_m: float) -> np.ndarray:
    """(k, 6) those of touched_boxes_m that reach into the heights low_m < z < high_m of the world."""
    boxes_m, base_m = touched_boxes_m(item), float(item.position_m[2])
    return boxes_m[(base_m + boxes_m[:, 2] < high_m) & (base_m + boxes_m[:, 5] > low_m)]


def is_obstacle(item: WorldObject) -> bool:
    """Whether an object is solid and some of it hangs lower than ROBOT_HEIGHT_M."""
    return item.solid and len(boxes_between_m(item, -math.inf, ROBOT_HEIGHT_M)) > 0


def object_outlines_m(
    item: WorldObject, poses: Poses = NO_POSES, low_m: float = -math.inf, high_m: float = ROBOT_HEIGHT_M
) -> List[np.ndarray]:
    """Convex outlines (n, 2) on the ground, counter-clockwise, whose union is what is touched between two heights.

    One for a box or a cylinder (CIRCLE_CORNERS corners); a part that does not reach into the heights has none.
    """
    center_m, yaw_rad = object_place(item, poses)
    boxes_m = boxes_between_m(item, low_m, high_m)
    if item.collision == "cylinder":
        angles = np.arange(CIRCLE_CORNERS) * 2.0 * np.pi / CIRCLE_CORNERS
        circle_m = 0.5 * item.collision_size_m[0] * np.column_stack([np.cos(angles), np.sin(angles)])
        return [center_m + circle_m for _ in boxes_m]
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    outlines_m = []
    for box_m in boxes_m:
        middle_m, size_m = 0.5 * (box_m[:2] + box_m[3:5]), box_m[3:5] - box_m[:2]
        place_m = center_m + middle_m @ np.array([[c, s], [-s, c]])
        outlines_m.append(rectangle(place_m, yaw_rad, size_m[0], size_m[1]))
    return outlines_m


def object_hull_m(item: WorldObject, poses: Poses = NO_POSES) -> np.ndarray:
    """(n, 2) convex hull of the outlines below ROBOT_HEIGHT_M, counter-clockwise; of all where none is."""
    outlines_m = object_outlines_m(item, poses) or object_outlines_m(item, poses, high_m=math.inf)
    return outlines_m[0] if len(outlines_m) == 1 else convex_hull(np.concatenate(outlines_m))

# SPDX-License-Identifier: BSD-3-Clause
"""The three kinds of true unsafe regions: how far a footprint is from one, and its outline for pictures and maps."""

from __future__ import annotations

import numpy as np

from core_bringup.motion import Poses
from core_bringup.polygons import (
    contains_point,
    grow_convex,
    is_convex_ccw,
    point_distance_m,
    polygon_area_m2,
    signed_clearance_m,
)  # fmt: skip
from core_bringup.touched import NO_POSES, object_hull_m, object_outlines_m, object_place
from core_bringup.world_types import UnsafeRegion, WorldObject

_ARC_STEPS = 64  # corners of a drawn circle


def region_clearance_m(region: UnsafeRegion, footprint_m: np.ndarray, poses: Poses = NO_POSES) -> float:
    """Signed clearance between a convex footprint (n, 2) and a region; negative is the depth of penetration."""
    if region.polygon_m is not None:
        return signed_clearance_m(footprint_m, _counter_clockwise(region.polygon_m))
    if region.center_m is not None:
        return point_clearance_m(footprint_m, region.center_m) - region.radius_m
    # Growing a convex outline by r moves its border outwards by r everywhere, seen from inside as from outside.
    if region.item.collision == "cylinder":
        return object_clearance_m(footprint_m, region.item, poses) - region.radius_m
    return signed_clearance_m(footprint_m, object_hull_m(region.item, poses)) - region.radius_m


def region_contains(region: UnsafeRegion, point_m: np.ndarray, poses: Poses = NO_POSES) -> bool:
    """Whether a point (2,) lies in a region, border included."""
    point_m = np.asarray(point_m, dtype=float)
    if region.polygon_m is not None:
        return contains_point(_counter_clockwise(region.polygon_m), point_m)
    if region.center_m is not None:
        return bool(np.linalg.norm(point_m - region.center_m) <= region.radius_m)
    if region.item.collision == "cylinder":
        center_m, _ = object_place(region.item, poses)
        return bool(np.linalg.norm(point_m - center_m) <= _round_radius_m(region))
    outline = object_hull_m(region.item, poses)
    return contains_point(outline, point_m) or point_distance_m(outline, point_m) <= region.radius_m


def region_outline_m(region: UnsafeRegion, poses: Poses = NO_POSES) -> np.ndarray:
    """Outline (n, 2) of a region, counter-clockwise, for pictures and maps; circles become inscribed polygons.

    Args:
        region: UnsafeRegion of the task of a world made by World.for_task or vary_world.
        poses: of the moving objects, as RobotState.object_poses has them.
    """
    if region.polygon_m is not None:
        return _counter_clockwise(np.asarray(region.polygon_m, dtype=float))
    if region.center_m is not None:
        return _circle(region.center_m, region.radius_m)
    if region.item.collision == "cylinder":
        return _circle(object_place(region.item, poses)[0], _round_radius_m(region))
    return grow_convex(object_hull_m(region.item, poses), region.radius_m, _ARC_STEPS)


def object_clearance_m(footprint_m: np.ndarray, item: WorldObject, poses: Poses = NO_POSES) -> float:
    """Signed clearance between a convex footprint (n, 2) and what is touched of an object below ROBOT_HEIGHT_M.

    Of one made of parts: the least of theirs, so where they overlap the depth in the deepest of them. +inf without any.
    """
    if item.collision == "cylinder":
        center_m, _ = object_place(item, poses)
        return point_clearance_m(footprint_m, center_m) - 0.5 * float(item.collision_size_m[0])
    outlines_m = object_outlines_m(item, poses)
    return min((signed_clearance_m(footprint_m, outline_m) for outline_m in outlines_m), default=np.inf)


def point_clearance_m(footprint_m: np.ndarray, point_m: np.ndarray) -> float:
    """Distance of a point (2,) from a convex footprint (n, 2); minus its distance to the border where it is inside."""
    distance_m = point_distance_m(footprint_m, point_m)
    return -distance_m if contains_point(footprint_m, point_m) else distance_m


def _circle(center_m: np.ndarray, radius_m: float) -> np.ndarray:
    angles = 2.0 * np.pi * np.arange(_ARC_STEPS) / _ARC_STEPS
    return np.asarray(center_m, dtype=float) + radius_m * np.stack([np.cos(angles), np.sin(angles)], axis=1)


def _round_radius_m(region: UnsafeRegion) -> float:
    return 0.5 * float(region.item.collision_size_m[0]) + region.radius_m


def _counter_clockwise(polygon_m: np.ndarray) -> np.ndarray:
    is_ccw = is_convex_ccw(polygon_m) or polygon_area_m2(polygon_m) > 0.0
    return polygon_m if is_ccw else polygon_m[::-1]

# SPDX-License-Identifier: BSD-3-Clause
"""Where the robot's footprint stands against the true unsafe regions and the solid objects of a task."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Sequence

import numpy as np

from core_bringup.polygons import (
    contains_point,
    is_convex_ccw,
    point_distance_m,
    polygon_area_m2,
    rectangle,
    signed_clearance_m,
)  # fmt: skip
from core_bringup.world_types import UnsafeRegion, WorldObject

ROBOT_HEIGHT_M = 0.8  # what hangs higher is no obstacle


@dataclass(frozen=True)
class GroundTruthState:
    """The truth at one instant; field by field core_msgs/Violation."""

    inside: bool
    base_inside: bool
    clearance_m: float
    region: str
    reason: str
    obstacle_clearance_m: float


class GroundTruth:
    """Measures a rectangular footprint against fixed regions and objects, all on the ground plane.

    Args:
        regions: true unsafe regions of the task, simple polygons.
        objects: objects of the world; those that are not solid or hang above ROBOT_HEIGHT_M are left out.
        length_m, width_m: footprint, centred on base_link, length along its x axis.

    Raises:
        ValueError: a footprint that is not positive.
    """

    def __init__(
        self, regions: Sequence[UnsafeRegion], objects: Sequence[WorldObject], length_m: float, width_m: float
    ):
        """Prepare the outlines."""
        if not (length_m > 0.0 and width_m > 0.0):
            raise ValueError(f"footprint {length_m} x {width_m} m must be positive")
        self._regions = [(region, _counter_clockwise(region.polygon_m)) for region in regions]
        self._obstacles = [item for item in objects if item.solid and item.position_m[2] < ROBOT_HEIGHT_M]
        self._centers_m = np.array([item.position_m[:2] for item in self._obstacles]).reshape(-1, 2)
        self._radii_m = np.array([0.5 * np.hypot(*item.size_m[:2]) for item in self._obstacles])
        self._length_m, self._width_m = length_m, width_m

    def evaluate(self, x_m: float, y_m: float, yaw_rad: float) -> GroundTruthState:
        """Measure the footprint at a pose of base_link in the world frame.

        clearance_m is +inf without regions, and minus the depth of penetration where footprint and region overlap.
        """
        base = np.array([x_m, y_m])
        footprint = rectangle(base, yaw_rad, self._length_m, self._width_m)
        clearance_m, name, reason = math.inf, "", ""
        for region, outline in self._regions:
            value_m = signed_clearance_m(footprint, outline)
            if value_m < clearance_m:
                clearance_m, name, reason = value_m, region.name, region.reason
        return GroundTruthState(
            inside=clearance_m < 0.0,
            base_inside=any(contains_point(outline, base) for _, outline in self._regions),
            clearance_m=clearance_m,
            region=name,
            reason=reason,
            obstacle_clearance_m=self._obstacle_clearance_m(base, footprint),
        )

    def _obstacle_clearance_m(self, base: np.ndarray, footprint: np.ndarray) -> float:
        """Smallest clearance to an obstacle; those whose circumscribed circle is farther than the best are skipped."""
        best_m = math.inf
        if not self._obstacles:
            return best_m
        reach_m = 0.5 * math.hypot(self._length_m, self._width_m)
        bounds_m = np.linalg.norm(self._centers_m - base, axis=1) - self._radii_m - reach_m
        for i in np.argsort(bounds_m):
            if bounds_m[i] > best_m:
                break
            best_m = min(best_m, object_clearance_m(footprint, self._obstacles[i]))
        return best_m


def object_clearance_m(footprint_m: np.ndarray, item: WorldObject) -> float:
    """Signed clearance between a convex footprint (n, 2) and the collision outline of an object."""
    center = item.position_m[:2]
    if item.collision == "cylinder":
        distance_m = point_distance_m(footprint_m, center)
        return (-distance_m if contains_point(footprint_m, center) else distance_m) - 0.5 * float(item.size_m[0])
    return signed_clearance_m(footprint_m, rectangle(center, item.yaw_rad, item.size_m[0], item.size_m[1]))


def _counter_clockwise(polygon_m: np.ndarray) -> np.ndarray:
    is_ccw = is_convex_ccw(polygon_m) or polygon_area_m2(polygon_m) > 0.0
    return polygon_m if is_ccw else polygon_m[::-1]

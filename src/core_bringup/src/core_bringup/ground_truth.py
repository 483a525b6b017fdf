# SPDX-License-Identifier: BSD-3-Clause
"""Where the robot's footprint stands against the true unsafe regions and the solid objects of a task."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Sequence

import numpy as np

from core_bringup.motion import Poses
from core_bringup.polygons import rectangle
from core_bringup.regions import object_clearance_m, region_clearance_m, region_contains
from core_bringup.touched import NO_POSES, ROBOT_HEIGHT_M, is_obstacle, object_place
from core_bringup.world_types import UnsafeRegion, WorldObject

__all__ = ["ROBOT_HEIGHT_M", "GroundTruth", "GroundTruthState", "object_clearance_m"]


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
    """Measures a rectangular footprint against regions and objects, standing or moving, all on the ground plane.

    Args:
        regions: true unsafe regions of the task, of a world made by World.for_task or vary_world.
        objects: objects of the world; those that are not solid or hang above ROBOT_HEIGHT_M are left out, as are
            such parts of them.
        length_m, width_m: footprint, centred on base_link, length along its x axis.

    Raises:
        ValueError: a footprint that is not positive, or a region whose object is not known.
    """

    def __init__(
        self, regions: Sequence[UnsafeRegion], objects: Sequence[WorldObject], length_m: float, width_m: float
    ):
        """Keep what counts."""
        if not (length_m > 0.0 and width_m > 0.0):
            raise ValueError(f"footprint {length_m} x {width_m} m must be positive")
        for region in regions:
            if region.object_name is not None and region.item is None:
                raise ValueError(f"region {region.name}: its object {region.object_name} is not resolved (for_task)")
        self._regions = tuple(regions)
        self._obstacles = [item for item in objects if is_obstacle(item)]
        self._centers_m = np.array([item.position_m[:2] for item in self._obstacles]).reshape(-1, 2)
        self._radii_m = np.array([0.5 * np.hypot(*item.collision_size_m[:2]) for item in self._obstacles])
        self._index = {item.id: i for i, item in enumerate(self._obstacles)}
        self._length_m, self._width_m = length_m, width_m

    def evaluate(self, x_m: float, y_m: float, yaw_rad: float, poses: Poses = NO_POSES) -> GroundTruthState:
        """Measure the footprint at a pose of base_link in the world frame.

        clearance_m is +inf without regions, and minus the depth of penetration where footprint and region overlap.
        poses are those of the moving objects at the same instant (RobotState.object_poses); the others stand.
        """
        base = np.array([x_m, y_m])
        footprint = rectangle(base, yaw_rad, self._length_m, self._width_m)
        clearance_m, name, reason = math.inf, "", ""
        for region in self._regions:
            value_m = region_clearance_m(region, footprint, poses)
            if value_m < clearance_m:
                clearance_m, name, reason = value_m, region.name, region.reason
        return GroundTruthState(
            inside=clearance_m < 0.0,
            base_inside=any(region_contains(region, base, poses) for region in self._regions),
            clearance_m=clearance_m,
            region=name,
            reason=reason,
            obstacle_clearance_m=self._obstacle_clearance_m(base, footprint, poses),
        )

    def _obstacle_clearance_m(self, base: np.ndarray, footprint: np.ndarray, poses: Poses) -> float:
        """Smallest clearance to an obstacle; those whose circumscribed circle is farther than the best are skipped."""
        best_m = math.inf
        if not self._obstacles:
            return best_m
        reach_m = 0.5 * math.hypot(self._length_m, self._width_m)
        bounds_m = np.linalg.norm(self._places_m(poses) - base, axis=1) - self._radii_m - reach_m
        for i in np.argsort(bounds_m):
            if bounds_m[i] > best_m:
                break
            best_m = min(best_m, object_clearance_m(footprint, self._obstacles[i], poses))
        return best_m

    def _places_m(self, poses: Poses) -> np.ndarray:
        moved = [label for label in poses if label in self._index]
        if not moved:
            return self._centers_m
        places_m = self._centers_m.copy()
        for label in moved:
            places_m[self._index[label]] = object_place(self._obstacles[self._index[label]], poses)[0]
        return places_m

# SPDX-License-Identifier: BSD-3-Clause
"""What a world file says, as plain frozen data. Arrays are read-only."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Dict, Mapping, Optional, Tuple

import numpy as np

from core_bringup.exceptions import ConfigError


@dataclass(frozen=True, eq=False)
class WorldObject:
    """One rigid thing standing in the world.

    Attributes:
        id: label of its pixels, 1..65535, unique among objects and surfaces.
        name: unique name.
        class_name: canonical class.
        aliases: other names an open-vocabulary segmenter may know it by.
        shape: 'box', 'cylinder' or 'mesh': what is drawn.
        size_m: (3,) extent along the object's own x, y, z; a cylinder has diameter size_m[0] = size_m[1].
        mesh: OBJ file, origin at the bottom centre, z up, metres; None unless shape is 'mesh'.
        mesh_scale: (3,) factors applied to the mesh.
        position_m: (3,) bottom centre in the world frame.
        yaw_rad: turn about world z.
        color_rgba: (4,) in 0..1; drawn for box and cylinder, meshes carry their own.
        solid: whether it collides.
        collision: 'box' or 'cylinder' of size_m: what is touched, whatever is drawn.
        jitter_m, jitter_yaw_rad: largest shift (x and y each) and turn that vary_world applies.
    """

    id: int
    name: str
    class_name: str
    aliases: Tuple[str, ...]
    shape: str
    size_m: np.ndarray
    mesh: Optional[Path]
    mesh_scale: np.ndarray
    position_m: np.ndarray
    yaw_rad: float
    color_rgba: np.ndarray
    solid: bool
    collision: str = "box"
    jitter_m: float = 0.0
    jitter_yaw_rad: float = 0.0


@dataclass(frozen=True, eq=False)
class Surface:
    """A flat walkable patch; the first of a world is its floor.

    Attributes:
        id: label of its pixels, shared number space with the objects.
        polygon_m: (n, 2) convex, counter-clockwise, world frame.
        z_m: height.
        texture: PNG file, repeated every texture_tile_m along x and y; None for plain color_rgba.
    """

    id: int
    name: str
    class_name: str
    polygon_m: np.ndarray
    z_m: float
    color_rgba: np.ndarray
    texture: Optional[Path]
    texture_tile_m: float = 2.0


@dataclass(frozen=True, eq=False)
class Lighting:
    """One directional light. direction (3,) points from the scene to the light; the coefficients are in 0..1."""

    direction: np.ndarray
    color_rgb: np.ndarray
    ambient: float = 0.6
    diffuse: float = 0.5
    specular: float = 0.05
    shadow: bool = False


@dataclass(frozen=True, eq=False)
class UnsafeRegion:
    """Ground truth of a place the robot must not enter: polygon_m (n, 2) simple, counter-clockwise, world frame."""

    name: str
    reason: str
    polygon_m: np.ndarray


@dataclass(frozen=True, eq=False)
class Task:
    """What the nominal controller is asked to do, and where it must not go.

    Attributes:
        start_pose: (3,) x [m], y [m], yaw [rad] of base_link, world frame.
        start_variation: (3,) largest deviation of each, used by vary_world.
        waypoints_m: (n, 2) walked in order; the last one is goal_m.
        expectation: 'unsafe' (going to the goal enters an unsafe region) or 'safe'.
        oracle_predicates: what a perfect reasoner would say, for example ``BETWEEN(traffic_cone)=unsafe``.
    """

    name: str
    description: str
    start_pose: np.ndarray
    start_variation: np.ndarray
    waypoints_m: np.ndarray
    goal_m: np.ndarray
    goal_tolerance_m: float
    time_limit_s: float
    expectation: str
    unsafe_regions: Tuple[UnsafeRegion, ...]
    oracle_predicates: Tuple[str, ...]


@dataclass(frozen=True, eq=False)
class World:
    """Everything a world file says."""

    path: Path
    name: str
    objects: Tuple[WorldObject, ...]
    surfaces: Tuple[Surface, ...]
    lighting: Lighting
    tasks: Mapping[str, Task]

    def task(self, name: str) -> Task:
        """Look a task up by name; ConfigError lists the known ones."""
        if name not in self.tasks:
            raise ConfigError(str(self.path), "tasks", f"no task {name!r}", ", ".join(sorted(self.tasks)))
        return self.tasks[name]

    def class_of_label(self) -> Dict[int, str]:
        """Map label id to class name for objects and surfaces."""
        return {item.id: item.class_name for item in (*self.surfaces, *self.objects)}

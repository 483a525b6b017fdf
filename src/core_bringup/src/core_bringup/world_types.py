# SPDX-License-Identifier: BSD-3-Clause
"""What a world file says, as plain frozen data. Arrays are read-only."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Dict, Iterable, Mapping, Optional, Tuple

import numpy as np

from core_bringup.exceptions import ConfigError
from core_bringup.polygons import contains_point
from core_bringup.task_types import OperatorEvent, Task, UnsafeRegion

__all__ = ["CameraNoise", "Lighting", "Motion", "OperatorEvent", "Surface", "Task", "UnsafeRegion", "Variation",
           "World", "WorldObject"]  # fmt: skip


@dataclass(frozen=True, eq=False)
class Motion:
    """How an object moves: along straight lines, at one speed.

    Attributes:
        path_m: (n, 2) places walked to in order, from the object's position_m; the height stays.
        speed_mps: on every line.
        start_at_s: sim time at which it starts; None: start_within_m counts.
        start_within_m: it starts when the base point of the robot is within this distance of the object's start.
        loop: back and forth for ever, the object's start being one end; else it rests at the last place.
        pause_s: time it stands at each place of the path before it goes on.
        face_motion: its x axis follows the way it goes; else it keeps its heading.
    """

    path_m: np.ndarray
    speed_mps: float
    start_at_s: Optional[float] = 0.0
    start_within_m: Optional[float] = None
    loop: bool = False
    pause_s: float = 0.0
    face_motion: bool = True


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
        collision: 'box' or 'cylinder' of collision_size_m, or 'parts': what is touched, whatever is drawn.
        jitter_m, jitter_yaw_rad: largest shift (x and y each) and turn that vary_world applies.
        collision_size_m: (3,) extent of what is touched, bottom centred; size_m when not given.
        collision_parts_m: (k, 6) boxes x0, y0, z0, x1, y1, z1 in the object's own axes, for 'parts'; else (0, 6).
        presence: probability that a seed > 0 has it.
        motion: how it moves; None: it stands.
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
    collision_size_m: Optional[np.ndarray] = None
    collision_parts_m: np.ndarray = field(default_factory=lambda: np.zeros((0, 6)))
    presence: float = 1.0
    motion: Optional[Motion] = None

    def __post_init__(self):
        """Touch what is drawn unless told otherwise."""
        if self.collision_size_m is None:
            object.__setattr__(self, "collision_size_m", self.size_m)


@dataclass(frozen=True, eq=False)
class Surface:
    """A walkable patch, level or sloped; the first of a world is its floor.

    Attributes:
        id: label of its pixels, shared number space with the objects.
        polygon_m: (n, 2) convex, counter-clockwise, world frame.
        z_m: height; of a sloped patch that of its lowest corner.
        texture: PNG file, repeated every texture_tile_m along x and y; None for plain color_rgba.
        textures: the files a seed may take instead; empty: always texture.
        corner_z_m: (n,) height of every corner of a sloped patch, in one plane; None for a level one.
    """

    id: int
    name: str
    class_name: str
    polygon_m: np.ndarray
    z_m: float
    color_rgba: np.ndarray
    texture: Optional[Path]
    texture_tile_m: float = 2.0
    textures: Tuple[Path, ...] = ()
    corner_z_m: Optional[np.ndarray] = None

    @property
    def corners_m(self) -> np.ndarray:
        """Corners (n, 3) of the patch."""
        z_m = np.full(len(self.polygon_m), self.z_m) if self.corner_z_m is None else self.corner_z_m
        return np.column_stack([self.polygon_m, z_m])

    def height_m(self, point_m: np.ndarray) -> float:
        """Height of its plane at a point (2,): z = a x + b y + c through the corners."""
        if self.corner_z_m is None:
            return self.z_m
        a, b, c = fit_plane(self.corners_m)
        return float(a * point_m[0] + b * point_m[1] + c)


def fit_plane(corners_m: np.ndarray) -> np.ndarray:
    """(3,) a, b, c of the plane z = a x + b y + c nearest to corners (n, 3), by least squares."""
    matrix = np.column_stack([corners_m[:, :2], np.ones(len(corners_m))])
    return np.linalg.lstsq(matrix, corners_m[:, 2], rcond=None)[0]


@dataclass(frozen=True, eq=False)
class Lighting:
    """One directional light. direction (3,) points from the scene to the light; the coefficients are in 0..1."""

    direction: np.ndarray
    color_rgb: np.ndarray
    ambient: float = 0.6
    diffuse: float = 0.5
    specular: float = 0.05
    shadow: bool = False


@dataclass(frozen=True)
class CameraNoise:
    """Noise of the camera, on colour and depth, never on labels.

    Attributes:
        color_sigma: standard deviation of every colour value, in 0..1.
        depth_sigma_per_m2: k of sigma_z = k z^2 [1/m].
        depth_dropout: share of the pixels whose depth reads 0.
        seed: of the variation; 0: no noise at all.
    """

    color_sigma: float = 0.0
    depth_sigma_per_m2: float = 0.0
    depth_dropout: float = 0.0
    seed: int = 0

    @property
    def is_on(self) -> bool:
        """Whether any image is changed."""
        return self.seed > 0 and max(self.color_sigma, self.depth_sigma_per_m2, self.depth_dropout) > 0.0


@dataclass(frozen=True)
class Variation:
    """Largest deviations that a seed may draw for the whole world: of the light's azimuth and of two coefficients."""

    light_azimuth_rad: float = 0.0
    light_ambient: float = 0.0
    light_diffuse: float = 0.0
    camera_noise: CameraNoise = field(default_factory=CameraNoise)


@dataclass(frozen=True, eq=False)
class World:
    """Everything a world file says; after for_task or vary_world: what one run meets."""

    path: Path
    name: str
    objects: Tuple[WorldObject, ...]
    surfaces: Tuple[Surface, ...]
    lighting: Lighting
    tasks: Mapping[str, Task]
    variation: Variation = field(default_factory=Variation)

    @property
    def camera_noise(self) -> CameraNoise:
        """Noise of the camera in this variation."""
        return self.variation.camera_noise

    def task(self, name: str) -> Task:
        """Look a task up by name; ConfigError lists the known ones."""
        if name not in self.tasks:
            raise ConfigError(str(self.path), "tasks", f"no task {name!r}", ", ".join(sorted(self.tasks)))
        return self.tasks[name]

    def for_task(self, name: str) -> World:
        """Return the world of one task: its own objects added, those it hides left out; ConfigError if unknown."""
        task = self.task(name)
        if not task.objects and not task.hides and all(r.object_name is None or r.item for r in task.unsafe_regions):
            return self
        return self.with_objects([o for o in self.objects if o.name not in task.hides] + list(task.objects), name)

    def with_objects(self, objects: Iterable[WorldObject], task_name: str) -> World:
        """Return the same world with other objects, which are all that the task has.

        Regions of the task stand around these, and are gone with an object that is not there.
        """
        objects, task = tuple(objects), self.task(task_name)
        named = {item.name: item for item in objects}
        regions = tuple(
            replace(region, item=named.get(region.object_name)) for region in task.unsafe_regions
            if region.object_name is None or region.object_name in named
        )  # fmt: skip
        task = replace(task, unsafe_regions=regions, objects=(), hides=())
        return replace(self, objects=objects, tasks={**self.tasks, task_name: task})

    def surface_height_m(self, x_m: float, y_m: float) -> float:
        """Height of the highest surface at a place; the floor's, which is endless, where there is none."""
        point = np.array([x_m, y_m])
        heights = [s.height_m(point) for s in self.surfaces if contains_point(s.polygon_m, point)]
        return max(heights, default=self.surfaces[0].z_m)

    def class_of_label(self) -> Dict[int, str]:
        """Map label id to class name for objects and surfaces."""
        return {item.id: item.class_name for item in (*self.surfaces, *self.objects)}

# SPDX-License-Identifier: BSD-3-Clause
"""Checks of a world's meaning that a schema cannot express; every complaint names its key."""

from __future__ import annotations

from pathlib import Path
from typing import Dict

import numpy as np

from core_bringup.polygons import contains_point, is_convex_ccw, is_simple, polygon_area_m2
from core_bringup.world_types import Task, World
from core_bringup.yaml_source import KeyPath, YamlSource

MIN_AREA_M2 = 1e-4


def check_meaning(source: YamlSource, world: World) -> None:
    """Check unique ids and names, files, shapes, polygons and the tasks of a world that fits the schema.

    Raises:
        ConfigError: the first thing wrong, as one line.
    """
    if not np.any(world.lighting.direction):
        raise source.error(("lighting", "direction"), "got a zero vector", "a direction towards the light")
    _check_identity(source)
    _check_objects(source, world)
    _check_surfaces(source, world)
    for task in world.tasks.values():
        _check_task(source, world, task)


def _check_identity(source: YamlSource) -> None:
    ids: Dict[int, str] = {}
    names: Dict[str, str] = {}
    for group in ("surfaces", "objects"):
        for i, entry in enumerate(source.data[group]):
            for key, seen in (("id", ids), ("name", names)):
                if entry[key] in seen:
                    problem = f"{entry[key]!r} is already used by {seen[entry[key]]}"
                    raise source.error((group, i, key), problem, "a value of its own among surfaces and objects")
                seen[entry[key]] = f"{group}[{i}]"


def _check_objects(source: YamlSource, world: World) -> None:
    for i, item in enumerate(world.objects):
        model = source.data["objects"][i].get("model")

        def path_of(key: str, i: int = i, model: str = model) -> KeyPath:
            return ("objects", i, key) if key in source.data["objects"][i] or model is None else ("models", model, key)

        if item.mesh is not None and not item.mesh.is_file():
            raise source.error(path_of("mesh"), f"no file {item.mesh}", "an OBJ file, relative to the world file")
        if item.mesh is not None and not has_faces(item.mesh):
            raise source.error(path_of("mesh"), f"{item.mesh} holds no face", "an OBJ file with vertices and faces")
        written = {**source.data.get("models", {}).get(model, {}), **source.data["objects"][i]}
        if item.mesh is None and "mesh" in written:
            raise source.error(path_of("mesh"), f"given for shape {item.shape!r}", "mesh only with shape: mesh")
        is_round = "cylinder" in (item.shape, item.collision)
        if is_round and item.size_m[0] != item.size_m[1]:
            problem = f"a cylinder with x {item.size_m[0]} and y {item.size_m[1]}"
            raise source.error(path_of("size_m"), problem, "equal x and y (the diameter)")


def has_faces(path: Path) -> bool:
    """Whether a file has the vertices and faces of an OBJ; PyBullet takes any other file for an invisible object."""
    words = [line.split()[:4] for line in path.read_bytes().splitlines()]
    vertices = sum(len(line) == 4 and line[0] == b"v" for line in words)
    return vertices >= 3 and any(len(line) == 4 and line[0] == b"f" for line in words)


def _check_surfaces(source: YamlSource, world: World) -> None:
    for i, surface in enumerate(world.surfaces):
        if not is_convex_ccw(surface.polygon_m):
            raise source.error(("surfaces", i, "polygon_m"), "not convex counter-clockwise", "a convex, ccw polygon")
        if surface.texture is not None and not surface.texture.is_file():
            raise source.error(("surfaces", i, "texture"), f"no file {surface.texture}", "a PNG, relative to the world")


def _check_task(source: YamlSource, world: World, task: Task) -> None:
    base: KeyPath = ("tasks", task.name)
    floor = world.surfaces[0].polygon_m
    places = {("start_pose",): task.start_pose[:2], ("goal_m",): task.goal_m}
    places.update({("waypoints_m", i): point for i, point in enumerate(task.waypoints_m)})
    for key, point in places.items():
        if not contains_point(floor, point):
            raise source.error(base + key, f"({point[0]:g}, {point[1]:g}) is off the floor", "a place on surfaces[0]")
    if np.any(task.waypoints_m[-1] != task.goal_m):
        problem = "the last waypoint is not the goal"
        raise source.error(base + ("waypoints_m",), problem, f"a last waypoint equal to goal_m {task.goal_m.tolist()}")
    for i, region in enumerate(task.unsafe_regions):
        if polygon_area_m2(region.polygon_m) < MIN_AREA_M2 or not is_simple(region.polygon_m):
            key = base + ("unsafe_regions", i, "polygon_m")
            raise source.error(key, "crosses itself, is clockwise or has no area", "a simple ccw polygon")
    if task.expectation == "unsafe" and not task.unsafe_regions:
        raise source.error(base + ("unsafe_regions",), "none in an unsafe task", "at least one region")
    known = set(world.class_of_label().values())
    for i, text in enumerate(task.oracle_predicates):
        class_name = text.split("(", 1)[1].split(")", 1)[0]
        if class_name not in known:
            problem = f"class {class_name!r} is not in this world"
            raise source.error(base + ("oracle_predicates", i), problem, ", ".join(sorted(known)))

# SPDX-License-Identifier: BSD-3-Clause
"""Checks of a world's meaning that a schema cannot express; every complaint names its key."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Dict, Mapping, Sequence

import numpy as np

from core_bringup.polygons import contains_point, is_convex_ccw
from core_bringup.task_checks import check_tasks
from core_bringup.world_models import ModelShelf
from core_bringup.world_types import World, WorldObject, fit_plane
from core_bringup.yaml_source import KeyPath, YamlSource

_FLATNESS_M = 1e-3
_STEEPEST = 0.5  # rise over run of a sloped surface


def check_meaning(source: YamlSource, world: World, shelf: ModelShelf) -> None:
    """Check unique ids and names, files, shapes, polygons and the tasks of a world that fits the schema.

    Args:
        source: the world file.
        world: what was built of it.
        shelf: where its models were found.

    Raises:
        ConfigError: the first thing wrong, as one line.
    """
    if not np.any(world.lighting.direction):
        raise source.error(("lighting", "direction"), "got a zero vector", "a direction towards the light")
    _check_identity(source)
    _check_surfaces(source, world)
    check_objects = _ObjectChecks(source, world, shelf)
    check_objects.run(world.objects, ("objects",), source.data["objects"])
    for name, task in world.tasks.items():
        check_objects.run(task.objects, ("tasks", name, "objects"), source.data["tasks"][name].get("objects", ()))
    check_tasks(source, world)


def _check_identity(source: YamlSource) -> None:
    """Ids and names are unique among surfaces, objects and the objects of one task."""
    ids: Dict[Any, str] = {}
    names: Dict[Any, str] = {}
    for group in ("surfaces", "objects"):
        _check_unique(source, (group,), source.data[group], ids, names)
    for name, task in source.data["tasks"].items():
        _check_unique(source, ("tasks", name, "objects"), task.get("objects", ()), dict(ids), dict(names))


def _check_unique(
    source: YamlSource, path: KeyPath, entries: Sequence[Any], ids: Dict[Any, str], names: Dict[Any, str]
) -> None:
    for i, entry in enumerate(entries):
        for key, seen in (("id", ids), ("name", names)):
            if entry[key] in seen:
                problem = f"{entry[key]!r} is already used by {seen[entry[key]]}"
                raise source.error(path + (i, key), problem, "a value of its own among surfaces and objects")
            seen[entry[key]] = f"{path[-1]}[{i}]"


class _ObjectChecks:
    """Checks of objects, of the world and of tasks alike."""

    def __init__(self, source: YamlSource, world: World, shelf: ModelShelf):
        self._source, self._floor, self._shelf = source, world.surfaces[0].polygon_m, shelf
        self._known_meshes: set = set()

    def run(self, objects: Sequence[WorldObject], path: KeyPath, entries: Sequence[Mapping[str, Any]]) -> None:
        for i, (item, entry) in enumerate(zip(objects, entries)):
            self._check_mesh(item, entry, path + (i,))
            for shape, key, size_m in (
                (item.shape, "size_m", item.size_m),
                (item.collision, "collision_size_m", item.collision_size_m),
            ):
                if shape == "cylinder" and size_m[0] != size_m[1]:
                    key = key if not np.array_equal(size_m, item.size_m) else "size_m"
                    problem = f"a cylinder with x {size_m[0]} and y {size_m[1]}"
                    raise self._shelf.error(entry, path + (i,), key, problem, "equal x and y (the diameter)")
            self._check_parts(item, entry, path + (i,))
            if item.motion is not None:
                self._check_motion(item, entry["motion"], path + (i, "motion"))

    def _check_mesh(self, item: WorldObject, entry: Mapping[str, Any], path: KeyPath) -> None:
        mesh = item.mesh
        if mesh is None:
            if "mesh" in self._shelf.merge(entry, path):
                problem = f"given for shape {item.shape!r}"
                raise self._shelf.error(entry, path, "mesh", problem, "mesh only with shape: mesh")
            return
        if mesh in self._known_meshes:
            return
        if not mesh.is_file():
            allowed = "an OBJ file, relative to the file that names it"
            raise self._shelf.error(entry, path, "mesh", f"no file {mesh}", allowed)
        if not has_faces(mesh):
            allowed = "an OBJ file with vertices and faces"
            raise self._shelf.error(entry, path, "mesh", f"{mesh} holds no face", allowed)
        self._known_meshes.add(mesh)

    def _check_parts(self, item: WorldObject, entry: Mapping[str, Any], path: KeyPath) -> None:
        merged, key = self._shelf.merge(entry, path), "collision_parts_m"
        if (key in merged) != (item.collision == "parts"):
            if key in merged:
                raise self._shelf.error(entry, path, key, f"given for collision {item.collision!r}", "collision: parts")
            raise self._shelf.error(entry, path, "collision", f"parts without {key}", f"parts together with {key}")
        if key not in merged:
            return
        if "collision_size_m" in merged:
            problem = "given for collision 'parts'"
            raise self._shelf.error(entry, path, "collision_size_m", problem, "only with collision: box or cylinder")
        low_m, high_m = item.collision_parts_m[:, :3], item.collision_parts_m[:, 3:]
        half_m = 0.5 * item.size_m[:2]
        least_m, most_m = np.array([*-half_m, 0.0]) - _FLATNESS_M, np.array([*half_m, item.size_m[2]]) + _FLATNESS_M
        for k, (low, high) in enumerate(zip(low_m, high_m)):
            if np.any(low >= high):
                problem, allowed = "empty", "x0 < x1, y0 < y1, z0 < z1 of [x0, y0, z0, x1, y1, z1]"
                raise self._shelf.error(entry, path, key, f"box {k} is {problem}", allowed)
            if np.any(low < least_m) or np.any(high > most_m):
                problem = f"box {k} reaches out of size_m {item.size_m.tolist()}"
                raise self._shelf.error(entry, path, key, problem, "boxes within size_m, bottom centred")

    def _check_motion(self, item: WorldObject, entry: Mapping[str, Any], path: KeyPath) -> None:
        if len(entry.get("start", {"at_s": 0.0})) != 1:
            problem = f"got {len(entry['start'])} keys"
            raise self._source.error(path + ("start",), problem, "exactly one of at_s, robot_within_m")
        here = item.position_m[:2]
        for i, place in enumerate(item.motion.path_m):
            where = f"({place[0]:g}, {place[1]:g})"
            if not contains_point(self._floor, place):
                raise self._source.error(path + ("path_m", i), f"{where} is off the floor", "a place on surfaces[0]")
            if np.array_equal(place, here):
                problem = f"{where} is where it comes from"
                raise self._source.error(path + ("path_m", i), problem, "a place that differs from the one before")
            here = place


def is_png(path: Path) -> bool:
    """Whether a file begins as a PNG does; PyBullet draws what it cannot read white and says so nowhere."""
    with path.open("rb") as stream:
        return stream.read(8) == b"\x89PNG\r\n\x1a\n"


def has_faces(path: Path) -> bool:
    """Whether a file has the vertices and faces of an OBJ; PyBullet takes any other file for an invisible object."""
    words = [line.split()[:4] for line in path.read_bytes().splitlines()]
    vertices = sum(len(line) == 4 and line[0] == b"v" for line in words)
    return vertices >= 3 and any(len(line) == 4 and line[0] == b"f" for line in words)


def _check_surfaces(source: YamlSource, world: World) -> None:
    for i, surface in enumerate(world.surfaces):
        path, entry = ("surfaces", i), source.data["surfaces"][i]
        if not is_convex_ccw(surface.polygon_m):
            raise source.error(path + ("polygon_m",), "not convex counter-clockwise", "a convex, ccw polygon")
        for pair in (("texture", "textures"), ("z_m", "corner_z_m")):
            if all(key in entry for key in pair):
                allowed = f"{' or '.join(pair)}, not both"
                raise source.error(path + (pair[1],), f"given together with {pair[0]}", allowed)
        for key in ("texture", "textures"):
            names = entry.get(key, []) if key == "textures" else [entry[key]] if key in entry else []
            for k, name in enumerate(names):
                place = path + ((key, k) if key == "textures" else (key,))
                if not (source.path.parent / name).is_file():
                    problem = f"no file {source.path.parent / name}"
                    raise source.error(place, problem, "a PNG, relative to the world file")
                if not is_png(source.path.parent / name):
                    problem = f"{source.path.parent / name} is no PNG"
                    raise source.error(place, problem, "a PNG, relative to the world file")
        _check_heights(source, world, i)


def _check_heights(source: YamlSource, world: World, i: int) -> None:
    surface, floor_m = world.surfaces[i], world.surfaces[0].z_m
    path = ("surfaces", i, "z_m" if surface.corner_z_m is None else "corner_z_m")
    if surface.z_m < floor_m:
        allowed = f">= {floor_m:g}: nothing is seen or felt below surfaces[0]"
        raise source.error(path, f"got {surface.z_m:g}, lower than the floor", allowed)
    if surface.corner_z_m is None:
        return
    count = len(surface.polygon_m)
    if i == 0:
        raise source.error(path, "given for the floor", "a level surfaces[0], with z_m")
    if len(surface.corner_z_m) != count:
        raise source.error(path, f"got {len(surface.corner_z_m)} heights", f"{count}, one for each corner of polygon_m")
    a, b, c = fit_plane(surface.corners_m)
    off_m = np.abs(surface.polygon_m @ [a, b] + c - surface.corner_z_m).max()
    if off_m > _FLATNESS_M:
        raise source.error(path, f"not planar: a corner is {off_m:.3f} m off", f"one plane within {_FLATNESS_M} m")
    if np.hypot(a, b) > _STEEPEST:
        raise source.error(path, f"a slope of {np.hypot(a, b):.2f}", f"<= {_STEEPEST} (rise over run)")

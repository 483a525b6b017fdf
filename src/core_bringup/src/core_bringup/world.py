# SPDX-License-Identifier: BSD-3-Clause
"""Load a world file and vary it by a seed. The format is described in worlds/README.md."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any, Dict, List, Mapping, Optional, Tuple, Union

import numpy as np

from core_bringup.exceptions import ConfigError
from core_bringup.world_checks import check_meaning
from core_bringup.world_schema import check_schema
from core_bringup.world_types import Lighting, Surface, Task, UnsafeRegion, World, WorldObject
from core_bringup.yaml_source import YamlSource

__all__ = ["Lighting", "Surface", "Task", "UnsafeRegion", "World", "WorldObject", "find_worlds_dir", "load_world",
           "resolve_world_path", "vary_world"]  # fmt: skip


def find_worlds_dir() -> Path:
    """Find the folder of the shipped worlds from this file's own place, without asking ROS.

    Works in source and devel space (package link or top-level folder) and in install space (share/core_bringup).

    Raises:
        ConfigError: none of the candidates exists.
    """
    here = Path(__file__).resolve()
    package_dir = here.parents[2]
    prefixes = [here.parents[3], *here.parents[4:6]]
    prefixes += [Path(p) for p in os.environ.get("CMAKE_PREFIX_PATH", "").split(os.pathsep) if p]
    candidates = [package_dir / "worlds", here.parents[4] / "worlds"]
    candidates += [prefix / "share" / "core_bringup" / "worlds" for prefix in prefixes]
    for candidate in candidates:
        if any(candidate.glob("*.yaml")):
            return candidate
    raise ConfigError("core_bringup", "worlds", "shipped worlds not found", "an installed core_bringup")


def resolve_world_path(name_or_path: Union[str, Path], worlds_dir: Optional[Path] = None) -> Path:
    """Turn 'warehouse' or a path to a .yaml file into a path.

    Raises:
        ConfigError: neither a shipped world nor a file; the message lists the shipped ones.
    """
    path = Path(name_or_path)
    if path.suffix in (".yaml", ".yml") or path.parent != Path():
        if path.is_file():
            return path
        raise ConfigError(str(path), "world", "no such file", "a world name or the path of a world file")
    folder = find_worlds_dir() if worlds_dir is None else Path(worlds_dir)
    shipped = sorted(p.stem for p in folder.glob("*.yaml"))
    if str(name_or_path) not in shipped:
        allowed = f"{', '.join(shipped)}, or the path of a world file"
        raise ConfigError(str(folder), "world", f"no world {str(name_or_path)!r}", allowed)
    return folder / f"{name_or_path}.yaml"


def load_world(name_or_path: Union[str, Path], worlds_dir: Optional[Path] = None) -> World:
    """Read and check a world.

    Args:
        name_or_path: a shipped world's name, or the path of a world file.
        worlds_dir: folder of the shipped worlds; found by find_worlds_dir when None.

    Raises:
        ConfigError: anything wrong, as one line with file, line, key, value and what is allowed.
    """
    source = YamlSource(resolve_world_path(name_or_path, worlds_dir))
    check_schema(source)
    world = _build_world(source)
    check_meaning(source, world)
    return world


def vary_world(world: World, task_name: str, seed: int) -> Tuple[World, np.ndarray]:
    """Draw one bounded variation of a world and of a task's start.

        start_pose = nominal + u * start_variation,  u uniform in [-1, 1]^3

    Objects that declare jitter are shifted along x and y and turned the same way. Seed 0 is the world as written.

    Returns:
        World, start_pose (3,) x [m], y [m], yaw [rad].

    Raises:
        ConfigError: unknown task. ValueError: negative seed.
    """
    task = world.task(task_name)
    if seed < 0:
        raise ValueError(f"seed must be >= 0, got {seed}")
    if seed == 0:
        return world, task.start_pose.copy()
    rng = np.random.Generator(np.random.PCG64(seed))
    start_pose = task.start_pose + rng.uniform(-1.0, 1.0, 3) * task.start_variation
    objects = tuple(_jitter(item, rng.uniform(-1.0, 1.0, 3)) for item in world.objects)
    return replace(world, objects=objects), start_pose


def _jitter(item: WorldObject, u: np.ndarray) -> WorldObject:
    if item.jitter_m == 0.0 and item.jitter_yaw_rad == 0.0:
        return item
    shift_m = np.array([u[0] * item.jitter_m, u[1] * item.jitter_m, 0.0])
    yaw_rad = item.yaw_rad + float(u[2]) * item.jitter_yaw_rad
    return replace(item, position_m=_array(item.position_m + shift_m), yaw_rad=yaw_rad)


def _array(values: Any) -> np.ndarray:
    array = np.array(values, dtype=float)
    array.setflags(write=False)
    return array


def _build_world(source: YamlSource) -> World:
    data = source.data
    light: Dict[str, Any] = {"direction": (0.3, 0.2, 1.0), "color_rgb": (1.0, 1.0, 1.0), **data.get("lighting", {})}
    light.update(direction=_array(light["direction"]), color_rgb=_array(light["color_rgb"]))
    return World(
        path=source.path,
        name=data["name"],
        objects=tuple(_build_objects(source)),
        surfaces=tuple(_build_surface(source.path.parent, entry) for entry in data["surfaces"]),
        lighting=Lighting(**light),
        tasks={name: _build_task(name, entry) for name, entry in data["tasks"].items()},
    )


def _build_objects(source: YamlSource) -> List[WorldObject]:
    models = source.data.get("models", {})
    objects = []
    for i, entry in enumerate(source.data["objects"]):
        model_name = entry.get("model")
        if model_name is not None and model_name not in models:
            allowed = ", ".join(sorted(models)) or "no model is declared"
            raise source.error(("objects", i, "model"), f"unknown model {model_name!r}", allowed)
        merged = {**models.get(model_name, {}), **entry}
        for key in ("class", "shape", "size_m") + (("mesh",) if merged.get("shape") == "mesh" else ()):
            if key not in merged:
                raise source.error(("objects", i, key), "missing", "this key is required, here or in the model")
        objects.append(_build_object(source.path.parent, merged))
    return objects


def _build_object(folder: Path, entry: Mapping[str, Any]) -> WorldObject:
    shape, jitter = entry["shape"], entry.get("jitter", {})
    return WorldObject(
        id=entry["id"],
        name=entry["name"],
        class_name=entry["class"],
        aliases=tuple(entry.get("aliases", ())),
        shape=shape,
        size_m=_array(entry["size_m"]),
        mesh=folder / entry["mesh"] if shape == "mesh" else None,
        mesh_scale=_array(entry.get("mesh_scale", (1.0, 1.0, 1.0))),
        position_m=_array(entry["position_m"]),
        yaw_rad=float(entry.get("yaw_rad", 0.0)),
        color_rgba=_array(entry.get("color_rgba", (0.7, 0.7, 0.7, 1.0))),
        solid=entry.get("solid", True),
        collision=entry.get("collision", "cylinder" if shape == "cylinder" else "box"),
        jitter_m=float(jitter.get("position_m", 0.0)),
        jitter_yaw_rad=float(jitter.get("yaw_rad", 0.0)),
    )


def _build_surface(folder: Path, entry: Mapping[str, Any]) -> Surface:
    texture = entry.get("texture")
    return Surface(
        id=entry["id"],
        name=entry["name"],
        class_name=entry["class"],
        polygon_m=_array(entry["polygon_m"]),
        z_m=float(entry.get("z_m", 0.0)),
        color_rgba=_array(entry.get("color_rgba", (0.6, 0.6, 0.6, 1.0))),
        texture=None if texture is None else folder / texture,
        texture_tile_m=float(entry.get("texture_tile_m", 2.0)),
    )


def _build_task(name: str, entry: Mapping[str, Any]) -> Task:
    regions = [UnsafeRegion(r["name"], r["reason"], _array(r["polygon_m"])) for r in entry.get("unsafe_regions", ())]
    return Task(
        name=name,
        description=entry["description"],
        start_pose=_array(entry["start_pose"]),
        start_variation=_array(entry.get("start_variation", (0.0, 0.0, 0.0))),
        waypoints_m=_array(entry["waypoints_m"]),
        goal_m=_array(entry["goal_m"]),
        goal_tolerance_m=float(entry.get("goal_tolerance_m", 0.4)),
        time_limit_s=float(entry["time_limit_s"]),
        expectation=entry["expectation"],
        unsafe_regions=tuple(regions),
        oracle_predicates=tuple(entry.get("oracle_predicates", ())),
    )

# SPDX-License-Identifier: BSD-3-Clause
"""Find and load a world file. The format is described in worlds/README.md."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Optional, Union

from core_bringup.exceptions import ConfigError
from core_bringup.world_build import build_world
from core_bringup.world_checks import check_meaning
from core_bringup.world_models import CATALOGUE, ModelShelf
from core_bringup.world_schema import check_schema
from core_bringup.world_types import Lighting, Surface, Task, UnsafeRegion, World, WorldObject
from core_bringup.world_variation import vary_world
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
    prefixes = list(here.parents)[3:6]  # Path.parents itself has slices from Python 3.10 on
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
        worlds_dir: folder of the shipped worlds and of the catalogue of models; found by find_worlds_dir when None.

    Raises:
        ConfigError: anything wrong, as one line with file, line, key, value and what is allowed.
    """
    source = YamlSource(resolve_world_path(name_or_path, worlds_dir))
    check_schema(source)
    folder = find_worlds_dir() if worlds_dir is None else Path(worlds_dir)
    shelf = ModelShelf(source, folder / CATALOGUE)
    world = build_world(source, shelf)
    check_meaning(source, world, shelf)
    return world

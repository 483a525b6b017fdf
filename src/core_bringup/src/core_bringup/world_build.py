# SPDX-License-Identifier: BSD-3-Clause
"""Turns the data of a world file that fits the schema into the types of world_types."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Dict, Mapping, Optional, Sequence, Tuple

import numpy as np

from core_bringup.task_types import OperatorEvent, Task, UnsafeRegion
from core_bringup.world_models import ModelShelf
from core_bringup.world_types import CameraNoise, Lighting, Motion, Surface, Variation, World, WorldObject
from core_bringup.yaml_source import KeyPath, YamlSource


def freeze(values: Any) -> np.ndarray:
    """Copy numbers to a read-only array."""
    array = np.array(values, dtype=float)
    array.setflags(write=False)
    return array


def build_world(source: YamlSource, shelf: ModelShelf) -> World:
    """World of a file; ConfigError for an unknown model or a key that object and model both lack."""
    data = source.data
    light: Dict[str, Any] = {"direction": (0.3, 0.2, 1.0), "color_rgb": (1.0, 1.0, 1.0), **data.get("lighting", {})}
    light.update(direction=freeze(light["direction"]), color_rgb=freeze(light["color_rgb"]))
    return World(
        path=source.path,
        name=data["name"],
        objects=_build_objects(data["objects"], ("objects",), shelf),
        surfaces=tuple(_build_surface(source.path.parent, entry) for entry in data["surfaces"]),
        lighting=Lighting(**light),
        tasks={name: _build_task(name, entry, shelf) for name, entry in data["tasks"].items()},
        variation=_build_variation(data.get("variation", {})),
    )


def _build_variation(entry: Mapping[str, Any]) -> Variation:
    largest = {key: float(value) for key, value in entry.items() if key != "camera_noise"}
    noise = {key: float(value) for key, value in entry.get("camera_noise", {}).items()}
    return Variation(camera_noise=CameraNoise(**noise), **largest)


def _build_objects(entries: Sequence[Any], path: KeyPath, shelf: ModelShelf) -> Tuple[WorldObject, ...]:
    return tuple(_build_object(shelf.merge(entry, path + (i,))) for i, entry in enumerate(entries))


def _build_object(entry: Mapping[str, Any]) -> WorldObject:
    shape, jitter = entry["shape"], entry.get("jitter", {})
    scale = np.array(entry.get("mesh_scale", (1.0, 1.0, 1.0)), dtype=float)
    parts_m = np.array(entry.get("collision_parts_m", ()), dtype=float).reshape(-1, 6)
    return WorldObject(
        id=entry["id"],
        name=entry["name"],
        class_name=entry["class"],
        aliases=tuple(entry.get("aliases", ())),
        shape=shape,
        size_m=freeze(entry["size_m"]),
        mesh=entry["mesh"] if shape == "mesh" else None,
        mesh_scale=freeze(scale),
        position_m=freeze(entry["position_m"]),
        yaw_rad=float(entry.get("yaw_rad", 0.0)),
        color_rgba=freeze(entry.get("color_rgba", (0.7, 0.7, 0.7, 1.0))),
        solid=entry.get("solid", True),
        collision=entry.get("collision", "cylinder" if shape == "cylinder" else "box"),
        jitter_m=float(jitter.get("position_m", 0.0)),
        jitter_yaw_rad=float(jitter.get("yaw_rad", 0.0)),
        collision_size_m=freeze(entry.get("collision_size_m", entry["size_m"])),
        collision_parts_m=freeze(parts_m * np.tile(scale, 2)),
        presence=float(entry.get("presence", 1.0)),
        motion=_build_motion(entry.get("motion")),
    )


def _build_motion(entry: Optional[Mapping[str, Any]]) -> Optional[Motion]:
    if entry is None:
        return None
    start = entry.get("start", {"at_s": 0.0})
    return Motion(
        path_m=freeze(entry["path_m"]),
        speed_mps=float(entry["speed_mps"]),
        start_at_s=float(start["at_s"]) if "at_s" in start else None,
        start_within_m=float(start["robot_within_m"]) if "robot_within_m" in start else None,
        loop=entry.get("loop", False),
        pause_s=float(entry.get("pause_s", 0.0)),
        face_motion=entry.get("face_motion", True),
    )


def _build_surface(folder: Path, entry: Mapping[str, Any]) -> Surface:
    textures = tuple(folder / name for name in entry.get("textures", ()))
    texture = folder / entry["texture"] if "texture" in entry else None
    corner_z_m = freeze(entry["corner_z_m"]) if "corner_z_m" in entry else None
    return Surface(
        id=entry["id"],
        name=entry["name"],
        class_name=entry["class"],
        polygon_m=freeze(entry["polygon_m"]),
        z_m=float(entry.get("z_m", 0.0)) if corner_z_m is None else float(corner_z_m.min()),
        color_rgba=freeze(entry.get("color_rgba", (0.6, 0.6, 0.6, 1.0))),
        texture=textures[0] if textures else texture,
        texture_tile_m=float(entry.get("texture_tile_m", 2.0)),
        textures=textures,
        corner_z_m=corner_z_m,
    )


def _build_region(entry: Mapping[str, Any]) -> UnsafeRegion:
    disc, around = entry.get("disc", {}), entry.get("around", {})
    return UnsafeRegion(
        name=entry["name"],
        reason=entry["reason"],
        because=tuple(entry.get("because", ())),
        polygon_m=freeze(entry["polygon_m"]) if "polygon_m" in entry else None,
        center_m=freeze(disc["center_m"]) if disc else None,
        radius_m=float({**disc, **around}.get("radius_m", 0.0)),
        object_name=around.get("object"),
    )


def _build_event(entry: Mapping[str, Any]) -> OperatorEvent:
    rule = entry["add_rule"]
    kind = "predicate" if "predicate" in rule else "guideline"
    return OperatorEvent(float(entry["at_s"]), rule.get(kind, ""), kind, float(rule.get("lifetime_s", 0.0)))


def _build_task(name: str, entry: Mapping[str, Any], shelf: ModelShelf) -> Task:
    return Task(
        name=name,
        description=entry["description"],
        start_pose=freeze(entry["start_pose"]),
        start_variation=freeze(entry.get("start_variation", (0.0, 0.0, 0.0))),
        waypoints_m=freeze(entry["waypoints_m"]),
        goal_m=freeze(entry["goal_m"]),
        goal_tolerance_m=float(entry.get("goal_tolerance_m", 0.4)),
        time_limit_s=float(entry["time_limit_s"]),
        expectation=entry["expectation"],
        unsafe_regions=tuple(_build_region(region) for region in entry.get("unsafe_regions", ())),
        oracle_predicates=tuple(entry.get("oracle_predicates", ())),
        number=entry.get("number"),
        category=entry.get("category", ""),
        split=entry.get("split", "main"),
        variant_of=entry.get("variant_of"),
        objects=_build_objects(entry.get("objects", ()), ("tasks", name, "objects"), shelf),
        hides=tuple(entry.get("hides", ())),
        over_cautious=tuple(entry.get("over_cautious", ())),
        wrong_answer=tuple(entry.get("wrong_answer", ())),
        events=tuple(_build_event(event) for event in entry.get("events", ())),
    )

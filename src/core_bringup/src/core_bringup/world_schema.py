# SPDX-License-Identifier: BSD-3-Clause
"""The schema of a world file (JSON Schema draft 7) and the reading of its complaints in one line."""

from __future__ import annotations

from typing import Any, Dict, Tuple

import jsonschema

from core_bringup.exceptions import ConfigError
from core_bringup.yaml_source import YamlSource

SCHEMA_NAME = "core_world/1"

# Canonical class names a world may use. Source: [CORE] experiments (warehouse, hospital, residential).
SURFACE_CLASSES = ("floor", "carpet", "sidewalk", "road", "crosswalk", "grass", "gravel", "dirt", "ramp", "water")
OBJECT_CLASSES = (
    "barrier", "barrier_tape", "bed", "bench", "bicycle", "bollard", "building", "bush", "car", "cardboard_box",
    "cart", "chair", "counter", "crate", "curb", "curtain", "desk", "door", "fence", "fire_extinguisher",
    "fire_hydrant", "forklift", "gurney", "hand_truck", "iv_stand", "lamp_post", "machine", "mailbox",
    "medical_equipment", "pallet", "pallet_jack", "person", "pillar", "plant", "potted_plant", "shelf", "sign",
    "sofa", "stairs", "storage_rack", "table", "traffic_cone", "trash_can", "tree", "truck", "vending_machine",
    "wall", "warning_sign", "wet_floor_sign", "wheelchair",
)  # fmt: skip


def _numbers(count: int, **limits: float) -> Dict[str, Any]:
    return {"type": "array", "items": {"type": "number", **limits}, "minItems": count, "maxItems": count}


def _mapping(required: Tuple[str, ...], properties: Dict[str, Any]) -> Dict[str, Any]:
    return {"type": "object", "additionalProperties": False, "required": list(required), "properties": properties}


_NAME = {"type": "string", "pattern": "^[a-z][a-z0-9_]*$"}
_LABEL_ID = {"type": "integer", "minimum": 1, "maximum": 65535}
_LENGTH_M = {"type": "number", "exclusiveMinimum": 0, "maximum": 1000}
_COORDINATE = {"minimum": -1000, "maximum": 1000}
_ANGLE_RAD = {"type": "number", "minimum": -6.3, "maximum": 6.3}
_FRACTION = {"type": "number", "minimum": 0, "maximum": 1}
_POINT_XY = _numbers(2, **_COORDINATE)
_POLYGON = {"type": "array", "items": _POINT_XY, "minItems": 3, "maxItems": 64}
_COLOR_RGBA = _numbers(4, minimum=0, maximum=1)
_PREDICATE = {"type": "string", "pattern": r"^(ON|NEAR|AROUND|BETWEEN)\([a-z][a-z0-9_]*\)=(safe|unsafe)$"}

_SHAPE_KEYS = {
    "class": {"enum": list(OBJECT_CLASSES)},
    "aliases": {"type": "array", "items": _NAME, "uniqueItems": True},
    "shape": {"enum": ["box", "cylinder", "mesh"]},
    "collision": {"enum": ["box", "cylinder"]},
    "size_m": _numbers(3, exclusiveMinimum=0, maximum=1000),
    "mesh": {"type": "string", "pattern": r"^[^/].*\.obj$"},
    "mesh_scale": _numbers(3, exclusiveMinimum=0, maximum=1000),
    "color_rgba": _COLOR_RGBA,
    "solid": {"type": "boolean"},
}
_JITTER = _mapping((), {"position_m": {"type": "number", "minimum": 0, "maximum": 1}, "yaw_rad": _ANGLE_RAD})

_OBJECT = _mapping(
    ("id", "name", "position_m"),
    {
        "id": _LABEL_ID,
        "name": _NAME,
        "model": _NAME,
        "position_m": _numbers(3, **_COORDINATE),
        "yaw_rad": _ANGLE_RAD,
        "jitter": _JITTER,
        **_SHAPE_KEYS,
    },
)
_SURFACE = _mapping(
    ("id", "name", "class", "polygon_m"),
    {
        "id": _LABEL_ID,
        "name": _NAME,
        "class": {"enum": list(SURFACE_CLASSES)},
        "polygon_m": _POLYGON,
        "z_m": {"type": "number", "minimum": -10, "maximum": 10},
        "color_rgba": _COLOR_RGBA,
        "texture": {"type": "string", "pattern": r"^[^/].*\.png$"},
        "texture_tile_m": _LENGTH_M,
    },
)
_LIGHTING = _mapping(
    (),
    {
        "direction": _numbers(3, minimum=-1000, maximum=1000),
        "color_rgb": _numbers(3, minimum=0, maximum=1),
        "ambient": _FRACTION,
        "diffuse": _FRACTION,
        "specular": _FRACTION,
        "shadow": {"type": "boolean"},
    },
)
_REGION = _mapping(
    ("name", "reason", "polygon_m"),
    {"name": _NAME, "reason": {"type": "string", "minLength": 1, "maxLength": 200}, "polygon_m": _POLYGON},
)
_TASK = _mapping(
    ("description", "expectation", "start_pose", "waypoints_m", "goal_m", "time_limit_s"),
    {
        "description": {"type": "string", "minLength": 1, "maxLength": 400},
        "expectation": {"enum": ["unsafe", "safe"]},
        "start_pose": _numbers(3, **_COORDINATE),
        "start_variation": _numbers(3, minimum=0, maximum=5),
        "waypoints_m": {"type": "array", "items": _POINT_XY, "minItems": 1, "maxItems": 200},
        "goal_m": _POINT_XY,
        "goal_tolerance_m": _LENGTH_M,
        "time_limit_s": {"type": "number", "exclusiveMinimum": 0, "maximum": 3600},
        "unsafe_regions": {"type": "array", "items": _REGION},
        "oracle_predicates": {"type": "array", "items": _PREDICATE},
    },
)
WORLD_SCHEMA = {
    "$schema": "http://json-schema.org/draft-07/schema#",
    **_mapping(
        ("schema", "name", "surfaces", "objects", "tasks"),
        {
            "schema": {"enum": [SCHEMA_NAME]},
            "name": _NAME,
            "description": {"type": "string", "maxLength": 2000},
            "lighting": _LIGHTING,
            "surfaces": {"type": "array", "items": _SURFACE, "minItems": 1},
            "models": {"type": "object", "propertyNames": _NAME, "additionalProperties": _mapping((), _SHAPE_KEYS)},
            "objects": {"type": "array", "items": _OBJECT},
            "tasks": {"type": "object", "propertyNames": _NAME, "minProperties": 1, "additionalProperties": _TASK},
        },
    ),
}

_ALLOWED = {
    "type": lambda limit: f"a value of type {limit}",
    "enum": lambda limit: ", ".join(str(v) for v in limit),
    "minimum": lambda limit: f">= {limit}",
    "maximum": lambda limit: f"<= {limit}",
    "exclusiveMinimum": lambda limit: f"> {limit}",
    "minItems": lambda limit: f"at least {limit} entries",
    "maxItems": lambda limit: f"at most {limit} entries",
    "minLength": lambda limit: f"text of at least {limit} characters",
    "maxLength": lambda limit: f"text of at most {limit} characters",
    "minProperties": lambda limit: f"at least {limit} entries",
    "uniqueItems": lambda _limit: "entries that differ",
    "pattern": lambda limit: f"text like {limit}",
}


def _shorten(value: Any) -> str:
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else text[:57] + "..."


def _explain(error: jsonschema.ValidationError) -> Tuple[Tuple, str, str]:
    """Turn one complaint into (key path, problem, allowed)."""
    path = tuple(error.absolute_path)
    if error.validator == "additionalProperties":
        known = error.schema["properties"]
        unknown = sorted(set(error.instance) - set(known))[0]
        return path + (unknown,), "unknown key", ", ".join(sorted(known))
    if error.validator == "required":
        missing = [key for key in error.validator_value if key not in error.instance][0]
        return path + (missing,), "missing", "this key is required"
    if "propertyNames" in error.absolute_schema_path:  # the instance is the offending name itself
        path = path + (error.instance,)
    allowed = _ALLOWED.get(error.validator, lambda limit: f"{error.validator} {limit}")(error.validator_value)
    return path, f"got {_shorten(error.instance)}", allowed


def check_schema(source: YamlSource) -> None:
    """Check a world file against WORLD_SCHEMA.

    Raises:
        ConfigError: the first complaint, in the order of the file, as one line.
    """
    errors = list(jsonschema.Draft7Validator(WORLD_SCHEMA).iter_errors(source.data))
    complaints = [source.error(*_explain(error)) for error in errors]
    if complaints:
        raise min(complaints, key=_line_of)


def _line_of(error: ConfigError) -> Tuple[int, str]:
    return int(error.source.rsplit(":", 1)[1]), error.key

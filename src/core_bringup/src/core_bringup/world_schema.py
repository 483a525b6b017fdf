# SPDX-License-Identifier: BSD-3-Clause
"""The schema of a world file (JSON Schema draft 7) and the reading of its complaints in one line."""

from __future__ import annotations

from typing import Any, Dict, Tuple

import jsonschema

from core_bringup.exceptions import ConfigError
from core_bringup.task_types import CATEGORIES, SPLITS
from core_bringup.yaml_source import YamlSource

SCHEMA_NAME = "core_world/1"

# Canonical class names a world may use, as core_perception/config/ontology.yaml knows them, some by an alias.
# Source: [CORE] experiments (warehouse, hospital, residential).
SURFACE_CLASSES = (
    "floor", "carpet", "sidewalk", "road", "crosswalk", "grass", "gravel", "dirt", "ramp", "water", "sidewalk_ramp",
    "parking_lot", "hallway", "driveway", "path", "patio", "curb",
)  # fmt: skip
OBJECT_CLASSES = (
    "barrel", "barrier", "barrier_tape", "bed", "bench", "bicycle", "bollard", "building", "bush", "car",
    "cardboard_box", "cart", "chair", "counter", "crate", "curb", "curtain", "desk", "door", "fence",
    "fire_extinguisher", "fire_hydrant", "forklift", "gurney", "hand_truck", "iv_stand", "ladder", "lamp_post",
    "machine", "mailbox", "medical_equipment", "pallet", "pallet_jack", "person", "pillar", "plant", "potted_plant",
    "shelf", "sign", "sofa", "stairs", "storage_rack", "table", "traffic_cone", "trash_can", "tree", "truck",
    "vending_machine", "wall", "warning_sign", "wet_floor_sign", "wheelchair", "window",
)  # fmt: skip
MAX_TIME_S = 3600


def _number(**limits: float) -> Dict[str, Any]:
    return {"type": "number", **limits}


def _numbers(count: int, **limits: float) -> Dict[str, Any]:
    return _list({"type": "number", **limits}, count, count)


def _list(items: Dict[str, Any], least: int = 0, most: int = 10_000, **more: Any) -> Dict[str, Any]:
    return {"type": "array", "items": items, "minItems": least, "maxItems": most, **more}


def _mapping(required: Tuple[str, ...], properties: Dict[str, Any]) -> Dict[str, Any]:
    return {"type": "object", "additionalProperties": False, "required": list(required), "properties": properties}


_NAME = {"type": "string", "pattern": r"^[a-z][a-z0-9_]*\Z"}
_NAMES = _list(_NAME, uniqueItems=True)
_LABEL_ID = {"type": "integer", "minimum": 1, "maximum": 65535}
_LENGTH_M = _number(exclusiveMinimum=0, maximum=1000)
_TIME_S = _number(minimum=0, maximum=MAX_TIME_S)
_COORDINATE = {"minimum": -1000, "maximum": 1000}
_HEIGHT = {"minimum": -10, "maximum": 10}
_ANGLE_RAD = _number(minimum=-6.3, maximum=6.3)
_FRACTION = _number(minimum=0, maximum=1)
_POINT_XY = _numbers(2, **_COORDINATE)
_POLYGON = _list(_POINT_XY, 3, 64)
_COLOR_RGBA = _numbers(4, minimum=0, maximum=1)
_PREDICATE = {
    "type": "string",
    "pattern": r"^(ON|NEAR|AROUND|BETWEEN)\([a-z][a-z0-9_]*(, ?[0-9.]+)?(, ?(stop|slow))?\)=(safe|unsafe)\Z",
    "examples": ["ON(floor)=safe", "AROUND(forklift, 1.5)=unsafe"],
}
_PREDICATES = _list(_PREDICATE)
_TEXTURE = {"type": "string", "pattern": r"^[^/].*\.png$"}
_SENTENCE = {"type": "string", "minLength": 1, "maxLength": 300}

_SHAPE_KEYS = {
    "class": {"enum": list(OBJECT_CLASSES)},
    "aliases": _NAMES,
    "shape": {"enum": ["box", "cylinder", "mesh"]},
    "collision": {"enum": ["box", "cylinder", "parts"]},
    "size_m": _numbers(3, exclusiveMinimum=0, maximum=1000),
    "collision_size_m": _numbers(3, exclusiveMinimum=0, maximum=1000),
    "collision_parts_m": _list(_numbers(6, **_COORDINATE), 1, 64),
    "mesh": {"type": "string", "pattern": r"^[^/].*\.obj$"},
    "mesh_scale": _numbers(3, exclusiveMinimum=0, maximum=1000),
    "color_rgba": _COLOR_RGBA,
    "solid": {"type": "boolean"},
}
_MOTION = _mapping(
    ("path_m", "speed_mps"),
    {
        "path_m": _list(_POINT_XY, 1, 64),
        "speed_mps": _number(exclusiveMinimum=0, maximum=10),
        "start": _mapping((), {"at_s": _TIME_S, "robot_within_m": _LENGTH_M}),
        "loop": {"type": "boolean"},
        "pause_s": _TIME_S,
        "face_motion": {"type": "boolean"},
    },
)
_OBJECT = _mapping(
    ("id", "name", "position_m"),
    {
        "id": _LABEL_ID,
        "name": _NAME,
        "model": _NAME,
        "position_m": _numbers(3, **_COORDINATE),
        "yaw_rad": _ANGLE_RAD,
        "jitter": _mapping((), {"position_m": _number(minimum=0, maximum=1), "yaw_rad": _ANGLE_RAD}),
        "presence": _FRACTION,
        "motion": _MOTION,
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
        "z_m": _number(**_HEIGHT),
        "corner_z_m": _list(_number(**_HEIGHT), 3, 64),
        "color_rgba": _COLOR_RGBA,
        "texture": _TEXTURE,
        "textures": _list(_TEXTURE, 1, 16, uniqueItems=True),
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
_CAMERA_NOISE = _mapping(
    (),
    {
        "color_sigma": _number(minimum=0, maximum=0.2),
        "depth_sigma_per_m2": _number(minimum=0, maximum=0.1),
        "depth_dropout": _FRACTION,
    },
)
_VARIATION = _mapping(
    (),
    {
        "light_azimuth_rad": _number(minimum=0, maximum=6.3),
        "light_ambient": _FRACTION,
        "light_diffuse": _FRACTION,
        "camera_noise": _CAMERA_NOISE,
    },
)
_REGION = _mapping(
    ("name", "reason", "because"),
    {
        "name": _NAME,
        "reason": {"type": "string", "minLength": 1, "maxLength": 200},
        "because": _list(_PREDICATE, 1, 16, uniqueItems=True),
        "polygon_m": _POLYGON,
        "disc": _mapping(("center_m", "radius_m"), {"center_m": _POINT_XY, "radius_m": _LENGTH_M}),
        "around": _mapping(("object", "radius_m"), {"object": _NAME, "radius_m": _LENGTH_M}),
    },
)
_RULE = _mapping((), {"predicate": _PREDICATE, "guideline": _SENTENCE, "lifetime_s": _TIME_S})
_TASK = _mapping(
    ("description", "category", "expectation", "start_pose", "waypoints_m", "goal_m", "time_limit_s"),
    {
        "description": {"type": "string", "minLength": 1, "maxLength": 400},
        "number": {"type": "integer", "minimum": 1, "maximum": 12},
        "category": {"enum": list(CATEGORIES)},
        "split": {"enum": list(SPLITS)},
        "variant_of": _NAME,
        "expectation": {"enum": ["unsafe", "safe"]},
        "start_pose": _numbers(3, **_COORDINATE),
        "start_variation": _numbers(3, minimum=0, maximum=5),
        "waypoints_m": _list(_POINT_XY, 1, 200),
        "goal_m": _POINT_XY,
        "goal_tolerance_m": _LENGTH_M,
        "time_limit_s": _number(exclusiveMinimum=0, maximum=MAX_TIME_S),
        "objects": _list(_OBJECT),
        "hides": _NAMES,
        "unsafe_regions": _list(_REGION),
        "oracle_predicates": _PREDICATES,
        "over_cautious": _PREDICATES,
        "wrong_answer": _PREDICATES,
        "events": _list(_mapping(("at_s", "add_rule"), {"at_s": _TIME_S, "add_rule": _RULE})),
    },
)
_MODELS = {"type": "object", "propertyNames": _NAME, "additionalProperties": _mapping((), _SHAPE_KEYS)}
CATALOGUE_SCHEMA = {"$schema": "http://json-schema.org/draft-07/schema#", **_MODELS}
WORLD_SCHEMA = {
    "$schema": "http://json-schema.org/draft-07/schema#",
    **_mapping(
        ("schema", "name", "surfaces", "objects", "tasks"),
        {
            "schema": {"enum": [SCHEMA_NAME]},
            "name": _NAME,
            "description": {"type": "string", "maxLength": 2000},
            "lighting": _LIGHTING,
            "variation": _VARIATION,
            "surfaces": _list(_SURFACE, 1),
            "models": _MODELS,
            "objects": _list(_OBJECT),
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
        choices = error.schema["properties"][missing].get("enum")
        return path + (missing,), "missing", "this key is required" + (f": {', '.join(choices)}" if choices else "")
    if "propertyNames" in error.absolute_schema_path:  # the instance is the offending name itself
        path = path + (error.instance,)
    allowed = _ALLOWED.get(error.validator, lambda limit: f"{error.validator} {limit}")(error.validator_value)
    if "examples" in error.schema:
        allowed = "text like " + " or ".join(error.schema["examples"])
    return path, f"got {_shorten(error.instance)}", allowed


# JSON takes 3.0 for a whole number; a label or a seed must be one.
_TYPES = jsonschema.Draft7Validator.TYPE_CHECKER.redefine(
    "integer", lambda _checker, value: isinstance(value, int) and not isinstance(value, bool)
)
_VALIDATOR = jsonschema.validators.extend(jsonschema.Draft7Validator, type_checker=_TYPES)


def check_schema(source: YamlSource) -> None:
    """Check a world file against WORLD_SCHEMA; ConfigError is the first complaint, in the order of the file."""
    _check(source, WORLD_SCHEMA)


def check_catalogue(source: YamlSource) -> None:
    """Check a catalogue of models against CATALOGUE_SCHEMA; ConfigError as of check_schema."""
    _check(source, CATALOGUE_SCHEMA)


def _check(source: YamlSource, schema: Dict[str, Any]) -> None:
    errors = list(_VALIDATOR(schema).iter_errors(source.data))
    complaints = [source.error(*_explain(error)) for error in errors]
    if complaints:
        raise min(complaints, key=_line_of)


def _line_of(error: ConfigError) -> Tuple[int, str]:
    return int(error.source.rsplit(":", 1)[1]), error.key

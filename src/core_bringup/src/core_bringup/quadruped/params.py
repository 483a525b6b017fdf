# SPDX-License-Identifier: BSD-3-Clause
"""Parameters of the quadruped and of its controller, and the reader that checks every one of them.

A field is a number > 0 unless its metadata says otherwise; a wrong or missing or unknown key raises ConfigError.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field
from typing import Any, Tuple, Type, TypeVar

from core_bringup.exceptions import ConfigError

T = TypeVar("T")


def finite() -> Any:
    """A field that takes any finite number."""
    return field(metadata={"sign": "any"})


def vector(length: int, sign: str = "positive") -> Any:
    """A field that takes a list of numbers, all > 0 unless sign is 'any' (finite) or 'fraction' (0 < x < 1)."""
    return field(metadata={"length": length, "sign": sign})


def fraction() -> Any:
    """A field that takes a number between 0 and 1, both excluded."""
    return field(metadata={"sign": "fraction"})


def section(cls: type) -> Any:
    """A field that takes a mapping, read as the dataclass cls."""
    return field(metadata={"section": cls})


@dataclass(frozen=True)
class TrunkParams:
    """The body: a box whose centre is base_link, and a head box in front of it (no mass of its own)."""

    mass_kg: float
    size_m: Tuple[float, float, float] = vector(3)
    head_size_m: Tuple[float, float, float] = vector(3)


@dataclass(frozen=True)
class LegParams:
    """One leg; the other three are its mirror images. Joint order: hip x, hip y, knee.

    hip_x_m, hip_y_m: place of the hip x axis from base_link; hip_to_thigh_m: from there sideways to the hip y axis.
    link_mass_kg: hip, thigh, shank, foot. joint_*_rad and max_torque_nm: per joint, for a left leg.
    """

    hip_x_m: float
    hip_y_m: float
    hip_to_thigh_m: float
    thigh_m: float
    shank_m: float
    foot_radius_m: float
    foot_friction: float
    link_mass_kg: Tuple[float, ...] = vector(4)
    joint_lower_rad: Tuple[float, ...] = vector(3, "any")
    joint_upper_rad: Tuple[float, ...] = vector(3, "any")
    max_torque_nm: Tuple[float, ...] = vector(3)
    max_joint_speed_radps: float = 20.0


@dataclass(frozen=True)
class GaitParams:
    """The trot, the swing of a leg and the way a command is taken up.

    duty: share of the cycle a foot is on the ground, 0.5 < duty < 1. press_m: depth below the ground a swing aims at.
    speed_gain_s: foothold correction per velocity error. Below both dead-bands a command counts as zero.
    """

    cycle_s: float
    duty: float = fraction()
    clearance_m: float = field(default=0.10)
    press_m: float = field(default=0.015)
    speed_gain_s: float = field(default=0.15)
    body_height_m: float = field(default=0.52)
    max_acceleration_mps2: float = field(default=4.0)
    max_yaw_acceleration_radps2: float = field(default=8.0)
    dead_band_mps: float = field(default=0.02)
    dead_band_radps: float = field(default=0.02)
    swing_stiffness_nmprad: float = field(default=100.0)
    swing_damping_nmsprad: float = field(default=2.5)
    swing_mass_kg: float = field(default=0.8)


@dataclass(frozen=True)
class StanceParams:
    """Feedback of the body pose and the quadratic program that shares the wrench among the feet.

    Gains: x, y, z in 1/s^2 and 1/s; roll, pitch, yaw likewise. wrench_weights: force x, y, z, then torque x, y, z.
    """

    max_position_error_m: float
    max_yaw_error_rad: float
    max_linear_acceleration_mps2: float
    max_angular_acceleration_radps2: float
    friction: float
    min_normal_force_n: float
    force_weight: float
    position_gains_per_s2: Tuple[float, ...] = vector(3)
    velocity_gains_per_s: Tuple[float, ...] = vector(3)
    attitude_gains_per_s2: Tuple[float, ...] = vector(3)
    rate_gains_per_s: Tuple[float, ...] = vector(3)
    wrench_weights: Tuple[float, ...] = vector(6)


@dataclass(frozen=True)
class QuadrupedParams:
    """All a quadruped is built from and walks with."""

    trunk: TrunkParams = section(TrunkParams)
    leg: LegParams = section(LegParams)
    gait: GaitParams = section(GaitParams)
    stance: StanceParams = section(StanceParams)


_ALLOWED = {"any": "a finite number", "positive": "a finite number > 0", "fraction": "a number between 0 and 1"}


def read_section(cls: Type[T], data: Any, source: str, key: str = "") -> T:
    """Read a mapping as the dataclass cls, field by field.

    Args:
        cls: a dataclass of this module's kind of fields.
        data: the mapping, as the YAML reader gives it.
        source: file named in errors.
        key: path of the mapping inside the file, empty at the top.

    Returns:
        An instance of cls.

    Raises:
        ConfigError: not a mapping, an unknown or a missing key, or a value of wrong type or sign.
    """
    fields = {f.name: f for f in dataclasses.fields(cls)}
    if not isinstance(data, dict):
        raise ConfigError(source, key or "(file)", f"got {data!r}", "a mapping with " + ", ".join(fields))
    prefix = f"{key}." if key else ""
    for name in data:
        if name not in fields:
            raise ConfigError(source, f"{prefix}{name}", "unknown key", ", ".join(fields))
    values = {}
    for name, item in fields.items():
        if name in data:
            values[name] = _read_field(item, data[name], source, prefix + name)
        elif item.default is dataclasses.MISSING:
            raise ConfigError(source, prefix + name, "missing", _allowed(item))
    return cls(**values)


def _read_field(item: dataclasses.Field, value: Any, source: str, key: str) -> Any:
    if "section" in item.metadata:
        return read_section(item.metadata["section"], value, source, key)
    if item.type == "str":
        if isinstance(value, str) and value:
            return value
        raise ConfigError(source, key, f"got {value!r}", _allowed(item))
    length = item.metadata.get("length")
    if length is None:
        return _read_number(item, value, source, key)
    if not isinstance(value, (list, tuple)) or len(value) != length:
        raise ConfigError(source, key, f"got {value!r}", _allowed(item))
    return tuple(_read_number(item, entry, source, f"{key}[{i}]") for i, entry in enumerate(value))


def _read_number(item: dataclasses.Field, value: Any, source: str, key: str) -> float:
    kinds = (int,) if item.type == "int" else (int, float)
    good = isinstance(value, kinds) and not isinstance(value, bool) and math.isfinite(value)
    sign = item.metadata.get("sign", "positive")
    if not good or (sign != "any" and value <= 0.0) or (sign == "fraction" and value >= 1.0):
        raise ConfigError(source, key, f"got {value!r}", _allowed(item))
    return value if item.type == "int" else float(value)


def _allowed(item: dataclasses.Field) -> str:
    if "section" in item.metadata:
        return "a mapping with " + ", ".join(f.name for f in dataclasses.fields(item.metadata["section"]))
    if item.type == "str":
        return "a text"
    if item.type == "int":
        return "a whole number > 0"
    words = _ALLOWED[item.metadata.get("sign", "positive")]
    length = item.metadata.get("length")
    return words if length is None else f"a list of {length}, each {words}"

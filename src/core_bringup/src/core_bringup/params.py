# SPDX-License-Identifier: BSD-3-Clause
"""Parameters of world_bridge, checked before anything is started."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Mapping

from core_bringup.exceptions import ConfigError

BACKENDS = ("pybullet", "kinematic")
RENDERERS = ("tiny", "egl", "none")
PYBULLET_RATE_HZ = 240  # of the physics steps
_NS_PER_S = 1_000_000_000


def find_robot_file(name: str = "spot_like") -> Path:
    """Path of a shipped robot file, in source, devel and install space."""
    here = Path(__file__).resolve()
    candidates = [
        here.parents[2] / "config",
        *(p / "share" / "core_bringup" / "config" for p in list(here.parents)[3:6]),
    ]
    folder = next((c for c in candidates if (c / "robots").is_dir()), candidates[0])
    return folder / "robots" / f"{name}.yaml"


@dataclass(frozen=True)
class BridgeParams:
    """What world_bridge reads from its private parameters.

    Attributes:
        world: name of a shipped world or path of a world file. task: one of its tasks. seed: 0 is the world as written.
        robot: path of a robot file; empty: the shipped spot_like.
        backend: pybullet or kinematic. gui: PyBullet's own window. renderer: tiny, egl or none (no camera).
        lockstep: wait for the chain at every tick. rtf: sim seconds per wall second, 0 as fast as possible.
        tick_rate_hz: control periods per sim second. camera_rate_hz: frames per sim second, 0 the robot file's.
        clock_rate_hz: /clock messages per sim second without lock-step.
        stall_timeout_s: wall time a lock-step tick may take. cmd_vel_timeout_s: age of cmd_vel that brings a stand.
        frame_prefix: put before odom, base_link and the camera frames. start_paused: wait for unpause or step.
        publish_clock: false when another bridge of the same master publishes /clock.
    """

    world: str = "warehouse"
    task: str = "cone_line"
    robot: str = ""
    backend: str = "pybullet"
    renderer: str = "tiny"
    seed: int = 0
    lockstep: bool = False
    gui: bool = False
    start_paused: bool = False
    publish_clock: bool = True
    rtf: float = 1.0
    tick_rate_hz: float = 20.0
    camera_rate_hz: float = 0.0
    clock_rate_hz: float = 80.0
    stall_timeout_s: float = 30.0
    cmd_vel_timeout_s: float = 0.5
    frame_prefix: str = ""

    @classmethod
    def from_dict(cls, values: Mapping[str, Any], source: str = "world_bridge") -> BridgeParams:
        """Check a mapping of parameters; missing keys take the defaults.

        Raises:
            ConfigError: unknown key, wrong type, or a value outside what the message allows.
        """
        fields = {f.name: f for f in dataclasses.fields(cls)}
        for key in values:
            if key not in fields:
                raise ConfigError(source, f"~{key}", "unknown parameter", ", ".join(sorted(fields)))
        checked = {key: _convert(source, key, fields[key].type, value) for key, value in values.items()}
        params = cls(**checked)
        params._check(source)
        return params

    @property
    def period_ns(self) -> int:
        """Control period."""
        return round(_NS_PER_S / self.tick_rate_hz)

    @property
    def clock_steps_per_tick(self) -> int:
        """Parts into which a period is divided without lock-step."""
        return round(self.clock_rate_hz / self.tick_rate_hz)

    def frame_every(self, robot_camera_rate_hz: float, source: str = "world_bridge") -> int:
        """Ticks per camera frame, 0 without a camera; ConfigError when the tick rate is no multiple of the camera's."""
        if self.renderer == "none":
            return 0
        rate_hz = self.camera_rate_hz or robot_camera_rate_hz
        every = round(self.tick_rate_hz / rate_hz)
        if every < 1 or abs(every * rate_hz - self.tick_rate_hz) > 1e-9:
            allowed = f"a whole fraction of tick_rate_hz {self.tick_rate_hz:g}"
            raise ConfigError(source, "~camera_rate_hz", f"got {rate_hz:g}", allowed)
        return every

    def _check(self, source: str) -> None:
        fits = _is_whole_us if self.backend == "kinematic" else _is_whole_steps
        ranges = {
            "backend": (self.backend in BACKENDS, ", ".join(BACKENDS)),
            "renderer": (self.renderer in RENDERERS, ", ".join(RENDERERS)),
            "seed": (self.seed >= 0, "a whole number >= 0"),
            "rtf": (self.rtf >= 0.0, "a number >= 0, 0 is as fast as possible"),
            "tick_rate_hz": (fits(self.tick_rate_hz), _ALLOWED_RATE),
            "camera_rate_hz": (self.camera_rate_hz >= 0.0, "a number >= 0, 0 is the robot file's"),
            "clock_rate_hz": (
                self.clock_steps_per_tick >= 1
                and fits(self.clock_rate_hz)
                and abs(self.clock_steps_per_tick * self.tick_rate_hz - self.clock_rate_hz) < 1e-9,
                f"a multiple of tick_rate_hz, {_ALLOWED_RATE}",
            ) if fits(self.tick_rate_hz) and not self.lockstep else (True, ""),
            "stall_timeout_s": (self.stall_timeout_s > 0.0, "a number > 0"),
            "cmd_vel_timeout_s": (self.cmd_vel_timeout_s > 0.0, "a number > 0"),
            "gui": (not (self.gui and self.backend == "kinematic"), "false with backend kinematic"),
            "frame_prefix": (not self.frame_prefix.startswith("/") and " " not in self.frame_prefix,
                             "text without spaces and without a leading slash"),
            "world": (bool(self.world), "a world name or the path of a world file"),
            "task": (bool(self.task), "a task of the world"),
        }  # fmt: skip
        for key, (is_good, allowed) in ranges.items():
            if not is_good:
                raise ConfigError(source, f"~{key}", f"got {getattr(self, key)!r}", allowed)


_ALLOWED_RATE = f"1..1000 with a period of whole microseconds, and of whole 1/{PYBULLET_RATE_HZ} s in pybullet"


def _is_whole_steps(rate_hz: float) -> bool:
    return _is_whole_us(rate_hz) and abs(PYBULLET_RATE_HZ / rate_hz - round(PYBULLET_RATE_HZ / rate_hz)) < 1e-9


def _is_whole_us(rate_hz: float) -> bool:
    if not 1.0 <= rate_hz <= 1000.0:
        return False
    period_us = 1e6 / rate_hz
    return abs(period_us - round(period_us)) < 1e-6


def _convert(source: str, key: str, kind: str, value: Any) -> Any:
    """Check the type of one value; kind is the field's annotation as text."""
    good, allowed = {
        "bool": (isinstance(value, bool), "true or false"),
        "str": (isinstance(value, str), "text"),
        "int": (isinstance(value, int) and not isinstance(value, bool), "a whole number"),
        "float": (_is_number(value), "a finite number"),
    }[kind]
    if not good:
        raise ConfigError(source, f"~{key}", f"got {value!r}", allowed)
    return float(value) if kind == "float" else value


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)

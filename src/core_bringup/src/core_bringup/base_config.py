# SPDX-License-Identifier: BSD-3-Clause
"""What the velocity filter must know of a robot: footprint, limits and kinematics; a part of the robot file.

Launch files ask for it value by value, so this module imports no numpy.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Dict, Optional, Union

from core_bringup.exceptions import ConfigError
from core_bringup.quadruped.params import read_section, section
from core_bringup.yaml_source import YamlSource

KINDS = ("holonomic", "differential", "ackermann")
# Sections of a robot file that only the simulator reads.
SIMULATED = ("camera", "quadruped")


@dataclass(frozen=True)
class Footprint:
    """Rectangle around the robot that nothing of a normal walk leaves; its centre is center_x_m ahead of base_link."""

    length_m: float
    width_m: float
    center_x_m: float = field(default=0.0, metadata={"sign": "any"})


@dataclass(frozen=True)
class CommandLimits:
    """Largest magnitudes of a body velocity command; sideways_mps for holonomic robots only."""

    forward_mps: float
    yaw_radps: float
    sideways_mps: Optional[float] = None


@dataclass(frozen=True)
class KinematicsConfig:
    """What the base can follow: kind is one of KINDS; the figures are those of core_control's cbf_filter."""

    kind: str
    look_ahead_m: Optional[float] = None
    min_turning_radius_m: Optional[float] = None


@dataclass(frozen=True)
class BaseConfig:
    """A robot file that passed every check, camera and legs apart; a file for the filter alone has neither."""

    name: str
    footprint: Footprint = section(Footprint)
    limits: CommandLimits = section(CommandLimits)
    kinematics: KinematicsConfig = section(KinematicsConfig)

    @classmethod
    def load(cls, path: Union[str, Path]):
        """Read and check a robot file.

        Args:
            path: YAML file, see config/robots/ for every key with its unit.

        Returns:
            An instance of cls; BaseConfig itself leaves camera and legs aside.

        Raises:
            ConfigError: no such file, no YAML, or a wrong, missing, repeated or unknown key.
        """
        data = YamlSource(path).data
        if cls is BaseConfig:
            data = {key: value for key, value in data.items() if key not in SIMULATED}
        return cls.from_dict(data, str(path))

    @classmethod
    def from_dict(cls, data: Any, source: str = "robot"):
        """Check a mapping; source names it in errors."""
        robot = read_section(cls, data, source)
        robot.check_relations(source)
        return robot

    def check_relations(self, source: str) -> None:
        """Refuse values that are right one by one but impossible together; ConfigError."""
        kind, kinematics = self.kinematics.kind, self.kinematics
        if kind not in KINDS:
            raise ConfigError(source, "kinematics.kind", f"got {kind!r}", ", ".join(KINDS))
        rules = (
            ("limits.sideways_mps", self.limits.sideways_mps, ("holonomic",)),
            ("kinematics.look_ahead_m", kinematics.look_ahead_m, ("differential", "ackermann")),
            ("kinematics.min_turning_radius_m", kinematics.min_turning_radius_m, ("ackermann",)),
        )
        for key, value, kinds in rules:
            if value is not None and kind not in kinds:
                raise ConfigError(source, key, f"got {value}", f"nothing for kind {kind}")
            if value is None and kind in kinds:
                raise ConfigError(source, key, "missing", f"a finite number > 0 for kind {kind}")

    def make_filter_parameters(self) -> Dict[str, object]:
        """Parameters of core_control's cbf_filter that follow from the robot; 0 stands for what it does not have."""
        limits, kinematics = self.limits, self.kinematics
        return {
            "footprint": dict(vars(self.footprint)),
            "kinematics": kinematics.kind,
            "look_ahead_m": kinematics.look_ahead_m or 0.0,
            "min_turning_radius_m": kinematics.min_turning_radius_m or 0.0,
            "max_vx_mps": limits.forward_mps,
            "max_vy_mps": limits.sideways_mps or 0.0,
            "max_yaw_rate_radps": limits.yaw_radps,
        }

# SPDX-License-Identifier: BSD-3-Clause
"""The robot file: footprint, command limits, camera and legs of one kind of robot."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Union

from core_bringup.camera import CameraModel
from core_bringup.camera_mount import CameraMount
from core_bringup.exceptions import ConfigError
from core_bringup.quadruped.model import build_urdf
from core_bringup.quadruped.params import QuadrupedParams, read_section, section
from core_bringup.yaml_source import YamlSource


@dataclass(frozen=True)
class Footprint:
    """Rectangle around the robot, centred on base_link, that nothing of a normal walk leaves."""

    length_m: float
    width_m: float


@dataclass(frozen=True)
class CommandLimits:
    """Largest magnitudes of a body velocity command; larger ones are clipped by the controller."""

    forward_mps: float
    sideways_mps: float
    yaw_radps: float


@dataclass(frozen=True)
class CameraConfig:
    """The camera of a robot: rate, place and pinhole model."""

    rate_hz: float
    mount: CameraMount = section(CameraMount)
    model: CameraModel = section(CameraModel)


@dataclass(frozen=True)
class RobotConfig:
    """A robot file that passed every check."""

    name: str
    footprint: Footprint = section(Footprint)
    limits: CommandLimits = section(CommandLimits)
    camera: CameraConfig = section(CameraConfig)
    quadruped: QuadrupedParams = section(QuadrupedParams)

    @classmethod
    def load(cls, path: Union[str, Path]) -> RobotConfig:
        """Read and check a robot file.

        Args:
            path: YAML file, see config/robots/spot_like.yaml for every key with its unit.

        Returns:
            RobotConfig.

        Raises:
            ConfigError: no such file, no YAML, or a wrong, missing, repeated or unknown key.
        """
        return cls.from_dict(YamlSource(path).data, str(path))

    @classmethod
    def from_dict(cls, data: Any, source: str = "robot") -> RobotConfig:
        """Check a mapping; source names it in errors."""
        robot = read_section(cls, data, source)
        _check_relations(robot, source)
        return robot

    @property
    def camera_mount(self) -> CameraMount:
        """Pose of camera_link in base_link."""
        return self.camera.mount

    def urdf_text(self) -> str:
        """URDF for robot_description: base_link is an empty root, the trunk is fixed to it."""
        return build_urdf(self.name, self.quadruped, self.camera.mount, separate_trunk=True)

    def physics_urdf_text(self) -> str:
        """URDF for the physics engine: the same robot, base_link is the trunk itself."""
        return build_urdf(self.name, self.quadruped, self.camera.mount)


def _check_relations(robot: RobotConfig, source: str) -> None:
    """Refuse values that are right one by one but impossible together."""
    leg, gait = robot.quadruped.leg, robot.quadruped.gait
    reach_m = leg.thigh_m + leg.shank_m + leg.foot_radius_m
    if gait.body_height_m >= 0.97 * reach_m:
        raise ConfigError(
            source,
            "quadruped.gait.body_height_m",
            f"got {gait.body_height_m}",
            f"less than 0.97 of the leg's reach, {0.97 * reach_m:.3f}",
        )
    if gait.duty <= 0.5:
        raise ConfigError(source, "quadruped.gait.duty", f"got {gait.duty}", "more than 0.5 and less than 1 for a trot")
    for i, (lower, upper) in enumerate(zip(leg.joint_lower_rad, leg.joint_upper_rad)):
        if lower >= upper:
            raise ConfigError(source, f"quadruped.leg.joint_lower_rad[{i}]", f"got {lower}", f"less than {upper}")
    if robot.camera.model.near_m >= robot.camera.model.far_m:
        raise ConfigError(
            source,
            "camera.model.near_m",
            f"got {robot.camera.model.near_m}",
            f"less than far_m, {robot.camera.model.far_m}",
        )

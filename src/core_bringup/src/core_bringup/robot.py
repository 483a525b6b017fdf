# SPDX-License-Identifier: BSD-3-Clause
"""The robot file: footprint, command limits, kinematics, camera and legs of one kind of robot."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Dict

from core_bringup.base_config import BaseConfig
from core_bringup.camera import CameraModel
from core_bringup.camera_mount import CameraMount
from core_bringup.exceptions import ConfigError
from core_bringup.quadruped.model import build_urdf
from core_bringup.quadruped.params import QuadrupedParams, section


@dataclass(frozen=True)
class CameraConfig:
    """The camera of a robot: rate, place and pinhole model."""

    rate_hz: float
    mount: CameraMount = section(CameraMount)
    model: CameraModel = section(CameraModel)

    def make_filter_parameters(self) -> Dict[str, float]:
        """Parameters of core_control's cbf_filter that say where the camera looks."""
        return {"camera_fov_rad": self.model.compute_horizontal_fov(), "camera_yaw_rad": self.mount.yaw_rad}


@dataclass(frozen=True)
class RobotConfig(BaseConfig):
    """A robot file that passed every check, for the simulator: with a camera and four legs."""

    camera: CameraConfig = section(CameraConfig)
    quadruped: QuadrupedParams = section(QuadrupedParams)

    def check_relations(self, source: str) -> None:
        """See BaseConfig."""
        super().check_relations(source)
        if self.kinematics.kind != "holonomic":
            raise ConfigError(source, "kinematics.kind", f"got {self.kinematics.kind!r}", "holonomic with legs")
        if self.footprint.center_x_m != 0.0:
            raise ConfigError(source, "footprint.center_x_m", f"got {self.footprint.center_x_m}", "0 with legs")
        _check_legs_and_camera(self, source)

    def make_filter_parameters(self) -> Dict[str, object]:
        """See BaseConfig; and where the camera looks."""
        return {**super().make_filter_parameters(), **self.camera.make_filter_parameters()}

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


def _check_legs_and_camera(robot: RobotConfig, source: str) -> None:
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

# SPDX-License-Identifier: BSD-3-Clause
"""Parameters of the nodes: one frozen dataclass each; the fields are the table of keys, defaults and allowed values."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Tuple

import numpy as np

from core_control.exceptions import ParameterError
from core_control.parameter_reader import Choice, Flag, Number, Rows, parameter, read_parameters

POSITIVE = Number(0.0, open_low=True)
NOT_NEGATIVE = Number(0.0)
# Opening of a view that has no end; 2 pi, rounded up to what a file can say.
ALL_AROUND_RAD = 6.2832


@dataclass(frozen=True)
class Footprint:
    """Rectangle that discs must cover; its centre lies center_x_m ahead of base_link."""

    length_m: float = parameter(1.1, Number(0.0, 20.0, open_low=True))
    width_m: float = parameter(0.5, Number(0.0, 20.0, open_low=True))
    disc_count: int = parameter(3, Number(1, 16, whole=True))
    center_x_m: float = parameter(0.0, Number(-20.0, 20.0))

    def compute_discs(self) -> np.ndarray:
        """Discs that cover the rectangle, in a row along its longer axis.

            r = hypot(l / (2 n), w / 2),  x_i = (i + 1/2) l / n - l / 2 + center_x     (l >= w)

        Returns:
            (n, 3) x [m], y [m], radius [m] in base_link.
        """
        long_m, short_m = max(self.length_m, self.width_m), min(self.length_m, self.width_m)
        n = self.disc_count
        along = (np.arange(n) + 0.5) * long_m / n - long_m / 2.0
        radius_m = math.hypot(long_m / (2.0 * n), short_m / 2.0)
        discs = np.zeros((n, 3))
        discs[:, 0 if self.length_m >= self.width_m else 1] = along
        discs[:, 0] += self.center_x_m
        discs[:, 2] = radius_m
        return discs


@dataclass(frozen=True)
class FilterParams:
    """Parameters of cbf_filter; the meaning of each is in README.md and in config/core.yaml."""

    profile: str = parameter("core", Choice(("core", "paper")))
    enforce: bool = parameter(True, Flag())
    lockstep: bool = parameter(False, Flag())
    solver: str = parameter("compiled", Choice(("compiled", "cvxpy")))
    output_rate_hz: float = parameter(20.0, Number(1.0, 200.0))
    nominal_timeout_s: float = parameter(0.3, POSITIVE)
    grid_timeout_s: float = parameter(0.5, POSITIVE)
    odometry_timeout_s: float = parameter(0.3, POSITIVE)
    constraints_fresh_s: float = parameter(7.5, NOT_NEGATIVE)
    constraints_ttl_s: float = parameter(15.0, POSITIVE)
    require_constraints: bool = parameter(True, Flag())
    alpha_per_s: float = parameter(2.5, POSITIVE)
    margin_m: float = parameter(0.15, NOT_NEGATIVE)
    verifier_margin_m: float = parameter(0.03, NOT_NEGATIVE)
    lag_s: float = parameter(0.08, Number(0.0, 2.0))
    delay_s: float = parameter(0.0, Number(0.0, 1.0))
    rows_per_disc: int = parameter(8, Number(1, 64, whole=True))
    slide_ratio: float = parameter(0.5, NOT_NEGATIVE)
    yaw_weight_m: float = parameter(0.5, POSITIVE)
    kinematics: str = parameter("holonomic", Choice(("holonomic", "differential", "ackermann")))
    look_ahead_m: float = parameter(0.3, NOT_NEGATIVE)
    min_turning_radius_m: float = parameter(0.0, NOT_NEGATIVE)
    max_vx_mps: float = parameter(0.5, POSITIVE)
    max_vy_mps: float = parameter(0.25, NOT_NEGATIVE)
    max_yaw_rate_radps: float = parameter(0.8, POSITIVE)
    max_acceleration_mps2: float = parameter(2.0, POSITIVE)
    max_yaw_acceleration_radps2: float = parameter(4.0, POSITIVE)
    dead_band_mps: float = parameter(0.02, NOT_NEGATIVE)
    dead_band_radps: float = parameter(0.02, NOT_NEGATIVE)
    dead_band_per_axis: bool = parameter(False, Flag())
    dead_band_release: float = parameter(4.0, Number(1.0))
    e_stop_required: bool = parameter(False, Flag())
    e_stop_timeout_s: float = parameter(1.0, POSITIVE)
    override_enabled: bool = parameter(True, Flag())
    override_max_speed_mps: float = parameter(0.2, POSITIVE)
    override_max_s: float = parameter(10.0, POSITIVE)
    allow_multiple_nominal: bool = parameter(False, Flag())
    allow_foreign_output: bool = parameter(False, Flag())
    mobile_speed_mps: float = parameter(1.0, NOT_NEGATIVE)
    camera_fov_rad: float = parameter(ALL_AROUND_RAD, Number(0.0, ALL_AROUND_RAD, open_low=True))
    camera_yaw_rad: float = parameter(0.0, Number(-ALL_AROUND_RAD, ALL_AROUND_RAD))
    unseen_after_s: float = parameter(5.0, POSITIVE)
    unseen_range_m: float = parameter(1.0, POSITIVE)
    unseen_speed_mps: float = parameter(0.15, NOT_NEGATIVE)
    underfoot_grids: int = parameter(3, Number(0, 100, whole=True))
    latch_depth_m: float = parameter(1.0, POSITIVE)
    escape: bool = parameter(False, Flag())
    escape_after_s: float = parameter(2.0, POSITIVE)
    escape_trail_s: float = parameter(10.0, Number(0.0, 60.0, open_low=True))
    escape_speed_mps: float = parameter(0.15, POSITIVE)
    escape_s: float = parameter(5.0, Number(0.0, 60.0, open_low=True))
    blocked_after_s: float = parameter(2.0, Number(0.0, 60.0, open_low=True))
    paper_outside_gradient: str = parameter("flipped", Choice(("flipped", "printed")))
    footprint: Footprint = Footprint()
    discs: Tuple[Tuple[float, ...], ...] = parameter((), Rows((Number(), Number(), POSITIVE), "x_m, y_m, radius_m > 0"))

    @staticmethod
    def from_dict(values: dict) -> FilterParams:
        """Read and check.

        Raises:
            ParameterError: unknown key, value not allowed, or two values that contradict each other.
        """
        params = read_parameters(FilterParams, values)
        if params.alpha_per_s * params.control_period_s > 1.0:
            # gamma = alpha dt <= 1: the clearance may at most be used up in one tick.
            allowed = f"> 0 and <= output_rate_hz ({params.output_rate_hz:g})"
            raise ParameterError("alpha_per_s", params.alpha_per_s, allowed)
        if params.profile == "core" and params.verifier_margin_m > params.margin_m:
            allowed = f">= 0 and <= margin_m ({params.margin_m:g})"
            raise ParameterError("verifier_margin_m", params.verifier_margin_m, allowed)
        if params.constraints_fresh_s > params.constraints_ttl_s:
            allowed = f">= 0 and <= constraints_ttl_s ({params.constraints_ttl_s:g})"
            raise ParameterError("constraints_fresh_s", params.constraints_fresh_s, allowed)
        params._check_kinematics()
        return params

    def _check_kinematics(self) -> None:
        if self.profile == "paper" and self.kinematics != "holonomic":
            # The paper's row asks for sideways motion; leaving that out would break the row without a word.
            raise ParameterError("kinematics", self.kinematics, "holonomic in profile paper")
        if self.kinematics == "holonomic" and self.max_vy_mps == 0.0:
            raise ParameterError("max_vy_mps", self.max_vy_mps, "> 0 with kinematics holonomic")
        if self.kinematics == "ackermann" and self.min_turning_radius_m == 0.0:
            raise ParameterError("min_turning_radius_m", self.min_turning_radius_m, "> 0 with kinematics ackermann")

    @property
    def control_period_s(self) -> float:
        """One over the output rate [s]."""
        return 1.0 / self.output_rate_hz

    @property
    def limits(self) -> np.ndarray:
        """(3,) largest magnitudes of vx, vy [m/s] and yaw rate [rad/s]; 0 for vy where the base cannot go sideways."""
        vy_mps, yaw_rate_radps = self.max_vy_mps, self.max_yaw_rate_radps
        if self.kinematics != "holonomic":
            vy_mps = 0.0
        if self.kinematics == "ackermann":
            yaw_rate_radps = min(yaw_rate_radps, self.max_vx_mps / self.min_turning_radius_m)
        return np.array([self.max_vx_mps, vy_mps, yaw_rate_radps])

    @property
    def accelerations(self) -> np.ndarray:
        """(3,) largest growth of vx, vy [m/s^2] and yaw rate [rad/s^2] away from zero."""
        return np.array([self.max_acceleration_mps2, self.max_acceleration_mps2, self.max_yaw_acceleration_radps2])

    @property
    def weights(self) -> np.ndarray:
        """(3,) diagonal of W: 1, 1 and yaw_weight_m, which turns rad/s into m/s."""
        return np.array([1.0, 1.0, self.yaw_weight_m])

    @property
    def disc_array(self) -> np.ndarray:
        """(n, 3) x [m], y [m], radius [m] of the footprint's discs in base_link; discs wins over footprint."""
        return np.array(self.discs, dtype=float) if self.discs else self.footprint.compute_discs()


@dataclass(frozen=True)
class WaypointParams:
    """Parameters of waypoint_controller; the meaning of each is in README.md and in config/core.yaml."""

    lockstep: bool = parameter(False, Flag())
    waypoints: Tuple[Tuple[float, ...], ...] = parameter((), Rows((Number(), Number()), "x_m, y_m"))
    max_speed_mps: float = parameter(0.5, POSITIVE)
    max_yaw_rate_radps: float = parameter(0.6, POSITIVE)
    max_acceleration_mps2: float = parameter(1.0, POSITIVE)
    max_yaw_acceleration_radps2: float = parameter(2.0, POSITIVE)
    distance_kp_per_s: float = parameter(1.0, POSITIVE)
    distance_ki_per_s2: float = parameter(0.0, NOT_NEGATIVE)
    distance_kd: float = parameter(0.0, NOT_NEGATIVE)
    heading_kp_per_s: float = parameter(1.5, POSITIVE)
    heading_ki_per_s2: float = parameter(0.0, NOT_NEGATIVE)
    heading_kd: float = parameter(0.05, NOT_NEGATIVE)
    turn_in_place_rad: float = parameter(0.6, Number(0.0, math.pi, open_low=True))
    min_turning_radius_m: float = parameter(0.0, NOT_NEGATIVE)
    waypoint_tolerance_m: float = parameter(0.3, POSITIVE)
    goal_tolerance_m: float = parameter(0.2, POSITIVE)

    @staticmethod
    def from_dict(values: dict) -> WaypointParams:
        """Read and check; raises ParameterError for an unknown key or a value that is not allowed."""
        return read_parameters(WaypointParams, values)


@dataclass(frozen=True)
class MarkerParams:
    """Parameters of filter_markers."""

    arrow_m_per_mps: float = parameter(1.5, POSITIVE)
    height_m: float = parameter(0.05, Number())
    footprint: Footprint = Footprint()
    discs: Tuple[Tuple[float, ...], ...] = parameter((), Rows((Number(), Number(), POSITIVE), "x_m, y_m, radius_m > 0"))

    @staticmethod
    def from_dict(values: dict) -> MarkerParams:
        """Read and check; raises ParameterError for an unknown key or a value that is not allowed."""
        return read_parameters(MarkerParams, values)

    @property
    def disc_array(self) -> np.ndarray:
        """(n, 3) x [m], y [m], radius [m] of the discs in base_link; discs wins over footprint."""
        return np.array(self.discs, dtype=float) if self.discs else self.footprint.compute_discs()

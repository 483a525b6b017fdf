# SPDX-License-Identifier: BSD-3-Clause
"""When the filter must stop, and the stable codes that say why."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Optional

import numpy as np

from core_control.params import FilterParams
from core_control.types import FilterInputs

# A stamp further than this in the future [s] belongs to another clock: it says nothing about an age.
FUTURE_SLACK_S = 0.2


class Reason:
    """Codes of core_msgs/FilterState.reason; they never change their meaning."""

    WAITING_FOR_NOMINAL = "waiting_for_nominal"
    NOMINAL_STALE = "nominal_stale"
    NOMINAL_NOT_FINITE = "nominal_not_finite"
    NOMINAL_NOT_PLANAR = "nominal_not_planar"
    GRID_MISSING = "grid_missing"
    GRID_STALE = "grid_stale"
    GRID_NOT_FINITE = "grid_not_finite"
    GRID_MALFORMED = "grid_malformed"
    ODOMETRY_MISSING = "odometry_missing"
    ODOMETRY_STALE = "odometry_stale"
    ODOMETRY_NOT_FINITE = "odometry_not_finite"
    FRAME_MISMATCH = "frame_mismatch"
    MAP_LOST = "map_lost"
    CONSTRAINTS_MISSING = "constraints_missing"
    CONSTRAINTS_STALE = "constraints_stale"
    SOLVER_FAILED = "solver_failed"
    INTERNAL_ERROR = "internal_error"
    E_STOP = "e_stop"
    NOMINAL_PUBLISHERS = "nominal_publishers"
    FOREIGN_PUBLISHER = "foreign_publisher"
    DEEP_INSIDE = "deep_inside"
    ESCAPE_FAILED = "escape_failed"
    LOOP_OVERRUN = "loop_overrun"


ALL_REASONS = tuple(value for name, value in vars(Reason).items() if name.isupper())


@dataclass(frozen=True)
class Stop:
    """A reason to command zero: its code and the same in words, with figures."""

    reason: str
    detail: str


def rank_latch(reason: str) -> int:
    """Which of two latched reasons is shown: the one of the higher rank, of equal ones the first."""
    return {Reason.E_STOP: 2, Reason.FOREIGN_PUBLISHER: 1, Reason.INTERNAL_ERROR: 1}.get(reason, 0)


def find_nominal_stop(inputs: FilterInputs, params: FilterParams) -> Optional[Stop]:
    """Why the nominal command cannot be used, or None."""
    if inputs.u_nominal is None:
        return Stop(Reason.WAITING_FOR_NOMINAL, "no nominal command has been received")
    if not is_vector(inputs.u_nominal):
        return Stop(Reason.NOMINAL_NOT_FINITE, f"nominal command is {_show(inputs.u_nominal)}")
    if not inputs.nominal_planar:
        return Stop(Reason.NOMINAL_NOT_PLANAR, "nominal command asks for linear.z, angular.x or angular.y")
    return _find_age("nominal command", Reason.NOMINAL_STALE, inputs.nominal_age_s, params.nominal_timeout_s)


def find_odometry_stop(inputs: FilterInputs, params: FilterParams) -> Optional[Stop]:
    """Why the odometry cannot be used, or None."""
    if inputs.pose is None or inputs.twist is None:
        return Stop(Reason.ODOMETRY_MISSING, "no odometry has been received")
    if not (is_vector(inputs.pose) and is_vector(inputs.twist)):
        detail = f"odometry is {_show(inputs.pose)}, twist {_show(inputs.twist)}"
        return Stop(Reason.ODOMETRY_NOT_FINITE, detail)
    return _find_age("odometry", Reason.ODOMETRY_STALE, inputs.odometry_age_s, params.odometry_timeout_s)


def find_grid_stop(inputs: FilterInputs, params: FilterParams) -> Optional[Stop]:
    """Why the safety grid or the constraints in it cannot be used, or None."""
    if inputs.grid_problem is not None:
        return Stop(*inputs.grid_problem)
    if inputs.field is None:
        return Stop(Reason.GRID_MISSING, "no safety grid has been received")
    if not inputs.field.is_finite:
        return Stop(Reason.GRID_NOT_FINITE, "safety grid holds an h that is not a number")
    stale = _find_age("safety grid", Reason.GRID_STALE, inputs.grid_age_s, params.grid_timeout_s)
    if stale is not None:
        return stale
    grid_frame = inputs.field.grid.frame_id
    if inputs.pose is not None and grid_frame != inputs.odometry_frame_id:
        detail = f"safety grid is in frame '{grid_frame}', odometry in '{inputs.odometry_frame_id}'"
        return Stop(Reason.FRAME_MISMATCH, detail)
    return _find_constraints_stop(inputs, params)


def _find_constraints_stop(inputs: FilterInputs, params: FilterParams) -> Optional[Stop]:
    if not params.require_constraints:
        return None
    if math.isnan(inputs.constraints_age_s):
        return Stop(Reason.CONSTRAINTS_MISSING, "the safety grid was made without any constraints")
    return _find_age("constraints", Reason.CONSTRAINTS_STALE, inputs.constraints_age_s, params.constraints_ttl_s)


def find_command_stop(inputs: FilterInputs, params: FilterParams) -> Optional[Stop]:
    """Why nobody can drive, not even past the filter: a request from outside or the nominal command; None to go on."""
    return Stop(*inputs.stop_request) if inputs.stop_request else find_nominal_stop(inputs, params)


def find_stop(inputs: FilterInputs, params: FilterParams) -> Optional[Stop]:
    """The first reason to stop: request, nominal command, odometry, safety grid, constraints in this order, or None.

    With enforcement switched off only the request and the nominal command can stop the robot.
    """
    stop = find_command_stop(inputs, params)
    if stop is not None or not params.enforce:
        return stop
    return find_odometry_stop(inputs, params) or find_grid_stop(inputs, params)


def _find_age(name: str, reason: str, age_s: float, limit_s: float) -> Optional[Stop]:
    # Written so that an age of NaN counts as too old.
    if -FUTURE_SLACK_S <= age_s <= limit_s:
        return None
    if age_s < 0.0:
        return Stop(reason, f"{name} is stamped {-age_s:.2f} s in the future, limit {FUTURE_SLACK_S:g} s")
    return Stop(reason, f"{name} is {age_s:.2f} s old, limit {limit_s:g} s")


def is_vector(vector: np.ndarray) -> bool:
    """Whether an array holds three finite numbers, as a command, a pose and a twist do."""
    # An array of another size would be broadcast, an empty one counts as finite.
    return vector.shape == (3,) and bool(np.isfinite(vector).all())


def _show(vector: np.ndarray) -> str:
    return "(" + ", ".join(f"{value:.3g}" for value in vector.ravel()) + ")"

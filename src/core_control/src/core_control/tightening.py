# SPDX-License-Identifier: BSD-3-Clause
"""Parameters that may change while the filter runs, and only towards less: never beyond what it was started with."""

from __future__ import annotations

from dataclasses import asdict, fields
from typing import Dict

from core_control.exceptions import ParameterError
from core_control.params import FilterParams

# Parameters for which less means less motion, and those for which more does.
ONLY_DOWN = (
    "max_vx_mps",
    "max_vy_mps",
    "max_yaw_rate_radps",
    "nominal_timeout_s",
    "grid_timeout_s",
    "odometry_timeout_s",
    "constraints_ttl_s",
    "constraints_fresh_s",
    "alpha_per_s",
    "override_max_speed_mps",
)
ONLY_UP = ("margin_m",)
TIGHTENED = ONLY_DOWN + ONLY_UP


def tighten(start: FilterParams, current: FilterParams, wanted: Dict[str, float]) -> FilterParams:
    """The current parameters with those wanted in their place; all of them or none.

    Args:
        start: what the filter was started with; no value may allow more than this one.
        current: what is in force.
        wanted: name -> value; names of TIGHTENED.

    Raises:
        ParameterError: another name, a value that is not allowed, that allows more than at start, or that contradicts
            another parameter; the message names the value in force.
    """
    rules = {field.name: field.metadata.get("rule") for field in fields(FilterParams)}
    for key, value in wanted.items():
        if key not in TIGHTENED:
            raise ParameterError(key, value, "to change only at start; while running: " + ", ".join(TIGHTENED))
        rules[key].check(key, value)
        limit, down = getattr(start, key), key in ONLY_DOWN
        if (value > limit) if down else (value < limit):
            allowed = f"{'<=' if down else '>='} {limit:g}, its value at start; {getattr(current, key):g} stays"
            raise ParameterError(key, value, allowed)
    return FilterParams.from_dict({**asdict(current), **wanted})

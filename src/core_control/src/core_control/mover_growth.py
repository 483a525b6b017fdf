# SPDX-License-Identifier: BSD-3-Clause
"""How far what moves may have come since the grid was made."""

from __future__ import annotations

from core_control.params import FilterParams
from core_control.safety_field import SafetyField

# How fast the age that counts falls back when a new grid comes [s per s].
RELEASE = 0.1


class MoverGrowth:
    """Lets h fall with the age of the grid for the cells of what moves, h - v age, and rise again slowly.

        held = max(age, held - RELEASE dt),   growth = mobile_speed held

    The age of a 10 Hz grid goes up and down between 0.05 and 0.15 s. A clearance that did the same would let the robot
    stutter before a person: 0.1 m/s at one tick, none at the next. What moves may do while the robot stops is left out:
    the next tick sees it.

    Args:
        params: parameters of the filter.

    Source: research note A2.2, map age. [CORE] takes the map as it is, and so does profile `paper`.
    """

    def __init__(self, params: FilterParams):
        """Start with a new grid."""
        self._speed_mps = params.mobile_speed_mps
        self._fall_s, self._most_s = RELEASE * params.control_period_s, params.grid_timeout_s
        self.reset()

    def reset(self) -> None:
        """Forget the ages seen."""
        self._held_s = 0.0

    def update(self, age_s: float) -> None:
        """Take the age of the grid [s] at a new tick; NaN, as without a grid, and negative ages count as zero.

        A grid older than its timeout stops the robot: its age counts no further.
        """
        # max() in this order takes 0 for NaN.
        self._held_s = max(min(max(0.0, age_s), self._most_s), self._held_s - self._fall_s)

    def apply(self, field: SafetyField) -> SafetyField:
        """The field as it may be by now; itself where nothing in it moves."""
        return field.grow(self._speed_mps * self._held_s)

# SPDX-License-Identifier: BSD-3-Clause
"""Remembers the headings that the camera has looked along, so that the robot does not run where it has not looked."""

from __future__ import annotations

import math

import numpy as np

from core_control.dynamics import wrap_angle
from core_control.modes import is_vector
from core_control.params import ALL_AROUND_RAD, FilterParams
from core_control.types import FilterInputs

SECTORS = 36
SECTOR_RAD = 2.0 * math.pi / SECTORS


class SeenHeadings:
    """Sectors of heading in the grid's frame, each with when and where the camera last covered it with a new grid.

    A sector is covered while its middle lies in the camera's field of view, or while the camera's axis points into it.
    It counts as seen for unseen_after_s, and only within unseen_range_m of the place it was seen from: a view of
    opening 1.475 rad shows the ground 1.4 m ahead and beyond over a width of 1.3 m to either side, so that a parallel
    track up to about one metre beside it was in view.

    Args:
        params: parameters of the filter; a field of view of ALL_AROUND_RAD sees every heading.

    Source: DESIGN row 8. [CORE] drives in any direction at any speed.
    """

    def __init__(self, params: FilterParams):
        """Start with nothing seen."""
        self._params = params
        self._most_periods = params.unseen_after_s / params.control_period_s
        self.reset()

    def reset(self) -> None:
        """Forget what was seen."""
        self._periods = np.full(SECTORS, np.inf)
        self._places_m = np.zeros((SECTORS, 2))
        self._here_m = np.zeros(2)
        self._grid_stamp_s = math.nan

    def update(self, inputs: FilterInputs) -> None:
        """Let one control period pass, and look along the camera where the grid is a new one."""
        self._periods += 1.0
        if inputs.pose is None or inputs.twist is None:
            return
        if not (is_vector(inputs.pose) and is_vector(inputs.twist)):
            return
        self._here_m = inputs.pose[:2]
        if inputs.field is None or inputs.field.grid.stamp_s == self._grid_stamp_s:
            return
        self._grid_stamp_s = inputs.field.grid.stamp_s
        if 0.0 <= inputs.grid_age_s <= self._params.grid_timeout_s:
            self._look(inputs)

    def _look(self, inputs: FilterInputs) -> None:
        # The grid shows what the camera saw at its stamp; until now the robot went on turning.
        yaw_rad = inputs.pose[2] - inputs.twist[2] * inputs.grid_age_s + self._params.camera_yaw_rad
        offsets_rad = (np.arange(SECTORS) + 0.5) * SECTOR_RAD - yaw_rad
        away_rad = np.abs(np.remainder(offsets_rad + math.pi, 2.0 * math.pi) - math.pi)
        seen = away_rad <= max(0.5 * self._params.camera_fov_rad, 0.5 * SECTOR_RAD)
        self._periods[seen] = 0.0
        self._places_m[seen] = self._here_m

    def is_seen(self, heading_rad: float) -> bool:
        """Whether the camera covered the sector of a heading [rad], not long ago and not far from here."""
        if self._params.camera_fov_rad >= ALL_AROUND_RAD:
            return True
        sector = int((wrap_angle(heading_rad) % (2.0 * math.pi)) / SECTOR_RAD) % SECTORS
        far_m = float(np.hypot(*(self._here_m - self._places_m[sector])))
        return bool(self._periods[sector] <= self._most_periods and far_m <= self._params.unseen_range_m)

# SPDX-License-Identifier: BSD-3-Clause
"""Barrier of profile `paper`: one row from the signed distance of the nearest cell, for a point robot."""

from __future__ import annotations

from typing import Optional, Tuple

import numpy as np

from core_control.dynamics import compute_g
from core_control.safety_field import SafetyField
from core_control.types import NO_CELL, BarrierRows, Clearance


class SdfGradientBarrier:
    """The paper's barrier, to the letter: h of the closest cell and the direction to the closest border cell.

        h(x) = h_m of the cell of x;   grad h = (x - y*) / |x - y*|,   y* = centre of the nearest cell of the other kind

    The printed gradient is that of h for x in S only: outside S, h = -|x - y*| and the sign flips. As printed it would
    drive a robot that stands outside S deeper into the unsafe region.

    Args:
        alpha_per_s: alpha(h) = alpha_per_s * h.
        outside_gradient: ``flipped`` takes the true gradient outside S, ``printed`` the formula as it stands.

    Source: [CORE] equations of the barrier and of its gradient. The row is unsound on a grid (79 % of random episodes
    enter an unsafe cell, see docs/conventions.md); it is here for comparison.
    """

    def __init__(self, alpha_per_s: float, outside_gradient: str = "flipped"):
        """Keep gain and convention."""
        self._alpha_per_s = alpha_per_s
        self._flip = outside_gradient == "flipped"

    def compute_clearance(self, field: SafetyField, pose: np.ndarray) -> Clearance:
        """h, gradient and y* of the base point.

        Args:
            field: safety field.
            pose: (3,) x [m], y [m], yaw [rad] of base_link.

        Returns:
            Clearance; outside the grid, which counts as unsafe, h = -|x - y*| with y* the nearest cell of the grid.
        """
        position = np.asarray(pose[:2], dtype=float)
        cell = field.find_cell(position)
        if cell is None:
            y_star = self._clamp(field, position)
            return self._make(position, y_star, -float(np.linalg.norm(position - y_star)), NO_CELL)
        h_m = float(field.grid.h_m[cell])
        y_star, index = self._find_y_star(field, cell)
        if y_star is None:
            return Clearance(h_m, np.zeros(2))
        return self._make(position, y_star, h_m, index)

    def compute_rows(self, field: SafetyField, pose: np.ndarray, clearance: Clearance) -> BarrierRows:
        """The single row  grad h . (f + g u) >= -alpha h  with f = 0:  a = g' grad h,  b = -alpha h.

        Without a border there is no gradient: no row where every cell is safe, and one that no command satisfies,
        0 . u >= -alpha h > 0, where every cell is unsafe.
        """
        if clearance.h_m > 0.0 and not (clearance.gradient.any() and np.isfinite(clearance.h_m)):
            return BarrierRows.empty()
        a = compute_g(pose[2]).T @ np.append(clearance.gradient, 0.0)
        b = -self._alpha_per_s * clearance.h_m
        return BarrierRows(a[None], np.array([b]), np.array([clearance.cell]), clearance.point_m[None])

    def _make(self, position: np.ndarray, y_star: np.ndarray, h_m: float, cell: int) -> Clearance:
        gap = position - y_star
        length_m = float(np.linalg.norm(gap))
        gradient = gap / length_m if length_m > 0.0 else np.zeros(2)
        if h_m < 0.0 and self._flip:
            gradient = -gradient
        return Clearance(h_m, gradient, cell, y_star)

    @staticmethod
    def _clamp(field: SafetyField, position: np.ndarray) -> np.ndarray:
        half = 0.5 * field.grid.resolution_m
        return np.clip(position, field.lo_m + half, field.hi_m - half)

    @staticmethod
    def _find_y_star(field: SafetyField, cell: Tuple[int, int]) -> Tuple[Optional[np.ndarray], int]:
        """Centre of the nearest cell of the other kind, and the unsafe cell that explains it."""
        unsafe_here = bool(field.unsafe[cell])
        iy, ix = np.nonzero(field.unsafe != unsafe_here)
        if not len(iy):
            return None, NO_CELL
        j = int(np.argmin((iy - cell[0]) ** 2 + (ix - cell[1]) ** 2))
        width = field.unsafe.shape[1]
        index = cell[0] * width + cell[1] if unsafe_here else int(iy[j]) * width + int(ix[j])
        return field.compute_centre(iy[j : j + 1], ix[j : j + 1])[0], index

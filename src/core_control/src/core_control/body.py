# SPDX-License-Identifier: BSD-3-Clause
"""The robot's outline on the ground against the squares of grid cells: what lies under it, what it touches."""

from __future__ import annotations

import math
from typing import Tuple

import numpy as np

from core_control.dynamics import place_discs
from core_control.params import FilterParams
from core_control.safety_field import SafetyField

# Touching is not overlapping: lengths less than this [m] are rounding.
ROUNDING_M = 1e-9


class Body:
    """The rectangle of the footprint, or the discs where they are given instead.

    Args:
        params: footprint and discs are used.
    """

    def __init__(self, params: FilterParams):
        """Find how far the outline reaches from base_link."""
        discs = np.array(params.discs, dtype=float)
        self._discs = discs.reshape(-1, 3)
        self._half_m = 0.5 * np.array([params.footprint.length_m, params.footprint.width_m])
        self._center_x_m = params.footprint.center_x_m
        reaches = np.hypot(self._discs[:, 0], self._discs[:, 1]) + self._discs[:, 2]
        foremost_m = self._half_m[0] + abs(self._center_x_m)
        self.reach_m = float(np.max(reaches)) if len(discs) else math.hypot(foremost_m, self._half_m[1])

    def covers(self, pose: np.ndarray, centres: np.ndarray, cell_m: float) -> np.ndarray:
        """Which squares lie wholly under the body.

            rectangle: |R'(c - p) - (center_x, 0)| + cell/2 (|cos| + |sin|) <= half length and half width
            discs:     every corner of the square at most half a radius from the centre of one disc

        Half a radius, because discs reach beyond the body they stand for.

        Args:
            pose: (3,) x [m], y [m], yaw [rad] of base_link.
            centres: (m, 2) of the squares [m], in the frame of the pose.
            cell_m: their edge.

        Returns:
            (m,) bool.
        """
        if len(self._discs):
            gap = np.abs(centres[:, None] - place_discs(pose[None], self._discs)[0]) + cell_m / 2.0
            return (np.hypot(gap[..., 0], gap[..., 1]) <= 0.5 * self._discs[:, 2]).any(axis=1)
        c, s = math.cos(pose[2]), math.sin(pose[2])
        local = np.abs((centres - pose[:2]) @ np.array([[c, -s], [s, c]]) - [self._center_x_m, 0.0])
        return (local + 0.5 * cell_m * (abs(c) + abs(s)) <= self._half_m + ROUNDING_M).all(axis=1)

    def overlaps(self, poses: np.ndarray, centres: np.ndarray, cell_m: float, grow_m: float = 0.0) -> np.ndarray:
        """Which squares the body overlaps at any of the poses; exact, by separating axes.

        Args:
            poses: (n, 3).
            centres: (m, 2) of the squares [m].
            cell_m: their edge.
            grow_m: by how much the body is made larger on every side.

        Returns:
            (m,) bool.
        """
        if len(self._discs):
            gap = np.abs(centres[:, None, None] - place_discs(poses, self._discs)) - cell_m / 2.0
            distance = np.hypot(*np.moveaxis(np.maximum(gap, 0.0), -1, 0))
            return (distance < self._discs[:, 2] + grow_m - ROUNDING_M).any(axis=(1, 2))
        c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        R = np.moveaxis(np.array([[c, -s], [s, c]]), -1, 0)
        half = self._half_m + grow_m - ROUNDING_M
        extent = np.abs(R) @ half
        middle = poses[:, :2] + self._center_x_m * np.stack([c, s], axis=-1)
        gap = centres[None] - middle[:, None]
        turned = np.abs(R).sum(axis=1)
        apart = (np.abs(gap) >= extent[:, None] + cell_m / 2.0).any(axis=2)
        apart |= (np.abs(gap @ R) >= (half + cell_m / 2.0 * turned)[:, None]).any(axis=2)
        return (~apart).any(axis=0)


def find_unsafe_near(field: SafetyField, poses: np.ndarray, reach_m: float) -> Tuple[np.ndarray, np.ndarray]:
    """Unsafe cells within a square around poses.

    Args:
        field: safety field.
        poses: (n, 2 or 3) x [m], y [m] first.
        reach_m: how far around them.

    Returns:
        Rows and columns, (m,) each.
    """
    size = np.array(field.unsafe.shape[::-1])
    cell_m = field.grid.resolution_m
    # Clipped before they become integers: a pose may lie farther away than an integer can say.
    low = np.clip(np.floor((poses[:, :2].min(axis=0) - reach_m - field.lo_m) / cell_m), 0, size).astype(int)
    high = np.clip(np.ceil((poses[:, :2].max(axis=0) + reach_m - field.lo_m) / cell_m), 0, size).astype(int)
    iy, ix = np.nonzero(field.unsafe[low[1] : high[1], low[0] : high[0]])
    return iy + low[1], ix + low[0]

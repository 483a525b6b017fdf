# SPDX-License-Identifier: BSD-3-Clause
"""Shares a wanted wrench on the body among the feet that stand."""

from __future__ import annotations

from typing import Tuple

import daqp
import numpy as np

from core_bringup.quadruped.params import StanceParams

_BIG = 1e30


class ForceDistribution:
    """Ground reaction forces by a small quadratic program.

        minimise   (A f - b)^T S (A f - b) + alpha |f|^2
        subject to |f_x| <= mu f_z,  |f_y| <= mu f_z,  f_min <= f_z <= f_max       for every foot
        A = [1 ... 1; [r_1]x ... [r_n]x],   b = wanted force and torque (6,)

    Source: the usual balance controller, for example Bledt et al., "MIT Cheetah 3", IROS 2018, eq. 3 to 5.
    """

    def __init__(self, stance: StanceParams, max_normal_force_n: float):
        """Keep StanceParams stance; max_normal_force_n is the largest f_z of one foot [N]."""
        self._sqrt_weights = np.sqrt(np.array(stance.wrench_weights))
        self._alpha = stance.force_weight
        self._limits = {n: _build_limits(n, stance, max_normal_force_n) for n in range(1, 5)}

    def solve(self, feet_m: np.ndarray, wrench: np.ndarray) -> np.ndarray:
        """Forces of the ground on the feet.

        Args:
            feet_m: (n, 3) places of the n standing feet from the centre of mass [m], n in 1 ... 4.
            wrench: (6,) wanted force [N] and torque about the centre of mass [N m], same axes, z up.

        Returns:
            (n, 3) forces [N].

        Raises:
            ValueError: n is out of range or an entry is not finite.
        """
        n = len(feet_m)
        if n not in self._limits or not (np.all(np.isfinite(feet_m)) and np.all(np.isfinite(wrench))):
            raise ValueError(f"feet_m and wrench: got {feet_m} and {wrench}, allowed 1 to 4 feet and finite numbers")
        weighted = self._sqrt_weights[:, None] * build_wrench_matrix(feet_m)
        hessian = weighted.T @ weighted
        hessian[np.diag_indices(3 * n)] += self._alpha
        gradient = -(weighted.T @ (self._sqrt_weights * wrench))
        rows, upper, lower, sense = self._limits[n]
        forces, _, status, _ = daqp.solve(hessian, gradient, rows, upper, lower, sense)
        if status < 1:
            raise ValueError(f"force distribution: solver status {status}, allowed 1 (solved)")
        return np.asarray(forces).reshape(n, 3)


def build_wrench_matrix(feet_m: np.ndarray) -> np.ndarray:
    """(6, 3 n) matrix A with A f = (sum f_i, sum r_i x f_i), for feet_m (n, 3)."""
    n = len(feet_m)
    matrix = np.zeros((6, 3 * n))
    x, y, z = feet_m[:, 0], feet_m[:, 1], feet_m[:, 2]
    for axis in range(3):
        matrix[axis, axis::3] = 1.0
    matrix[3, 1::3], matrix[3, 2::3] = -z, y
    matrix[4, 0::3], matrix[4, 2::3] = z, -x
    matrix[5, 0::3], matrix[5, 1::3] = -y, x
    return matrix


def _build_limits(n: int, stance: StanceParams, max_normal_force_n: float) -> Tuple[np.ndarray, ...]:
    """Bounds first, then the pyramid rows f_x - mu f_z <= 0 and f_x + mu f_z >= 0, the same for y."""
    mu, f_max = stance.friction, max_normal_force_n
    rows = np.zeros((4 * n, 3 * n))
    for foot in range(n):
        for k, (axis, sign) in enumerate(((0, -1.0), (0, 1.0), (1, -1.0), (1, 1.0))):
            rows[4 * foot + k, 3 * foot + axis] = 1.0
            rows[4 * foot + k, 3 * foot + 2] = sign * mu
    row_upper, row_lower = np.tile([0.0, _BIG, 0.0, _BIG], n), np.tile([-_BIG, 0.0, -_BIG, 0.0], n)
    upper = np.concatenate([np.tile([mu * f_max, mu * f_max, f_max], n), row_upper])
    lower = np.concatenate([np.tile([-mu * f_max, -mu * f_max, stance.min_normal_force_n], n), row_lower])
    return rows, upper, lower, np.zeros(len(upper), dtype=np.int32)

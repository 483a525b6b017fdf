# SPDX-License-Identifier: BSD-3-Clause
"""Unit quaternions x, y, z, w."""

from __future__ import annotations

import math
from typing import Sequence, Tuple

import numpy as np


def yaw_of_quaternion(q_xyzw: Sequence[float]) -> float:
    """Heading [rad]: the angle of the turned x axis on the ground."""
    x, y, z, w = map(float, q_xyzw)
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def quaternion_of_rpy(roll_rad: float, pitch_rad: float, yaw_rad: float) -> Tuple[float, float, float, float]:
    """Quaternion of Rz(yaw) Ry(pitch) Rx(roll), turns about fixed axes as in URDF."""
    (cr, cp, cy), (sr, sp, sy) = (
        [f(0.5 * angle) for angle in (roll_rad, pitch_rad, yaw_rad)] for f in (math.cos, math.sin)
    )
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )


def quaternion_of_matrix(R: np.ndarray) -> Tuple[float, float, float, float]:
    """Unit quaternion (x, y, z, w), w >= 0, of a rotation matrix (3, 3).

    Of the four ways to divide it takes the one with the largest divisor.
    """
    trace = float(np.trace(R))
    squares = np.array([1.0 + 2.0 * R[i, i] - trace for i in range(3)] + [1.0 + trace])  # 4 q_i^2
    largest = int(np.argmax(squares))
    products = np.empty((4, 4))  # 4 q_i q_j
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        products[i, j] = products[j, i] = R[i, j] + R[j, i]
        products[i, 3] = products[3, i] = R[k, j] - R[j, k]
        products[i, i] = squares[i]
    products[3, 3] = squares[3]
    q = products[largest] / np.linalg.norm(products[largest])
    x, y, z, w = (q if q[3] >= 0.0 else -q).tolist()
    return x, y, z, w

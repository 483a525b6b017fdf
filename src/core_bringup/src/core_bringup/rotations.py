# SPDX-License-Identifier: BSD-3-Clause
"""Unit quaternions x, y, z, w."""

from __future__ import annotations

import math
from typing import Sequence, Tuple


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

# SPDX-License-Identifier: BSD-3-Clause
"""Closed-form kinematics of four equal legs, hip x - hip y - knee y, in base_link; leg order FR, FL, RR, RL.

All angles zero is the leg straight down; a negative knee bends it backwards-up, as on a dog's front leg.
"""

from __future__ import annotations

from typing import Tuple

import numpy as np

from core_bringup.quadruped.params import LegParams

LEGS = ("fr", "fl", "rr", "rl")
JOINTS = ("hip_x", "hip_y", "knee")
JOINT_NAMES = tuple(f"{leg}_{joint}" for leg in LEGS for joint in JOINTS)
FRONT = np.array([1.0, 1.0, -1.0, -1.0])
LEFT = np.array([-1.0, 1.0, -1.0, 1.0])


class LegKinematics:
    """Foot positions, Jacobians and joint angles of the four legs.

    With d = side * hip_to_thigh, L1 = thigh, L2 = shank, s12 = sin(q1 + q2):
        x = hip_x - L1 s1 - L2 s12
        l = -L1 c1 - L2 c12                   (leg axis, downwards negative)
        y = hip_y + d c0 - l s0
        z =         d s0 + l c0
    """

    def __init__(self, leg: LegParams):
        """Keep the lengths of LegParams leg."""
        self._thigh_m, self._shank_m = leg.thigh_m, leg.shank_m
        self._d_m = LEFT * leg.hip_to_thigh_m
        self.p_base_hip = np.stack([FRONT * leg.hip_x_m, LEFT * leg.hip_y_m, np.zeros(4)], axis=1)
        self.p_base_thigh = self.p_base_hip + np.stack([np.zeros(4), self._d_m, np.zeros(4)], axis=1)

    def compute_feet(self, q_rad: np.ndarray) -> np.ndarray:
        """Foot centres (4, 3) [m] in base_link at joint angles (4, 3)."""
        return self.compute_feet_and_jacobians(q_rad)[0]

    def compute_feet_and_jacobians(self, q_rad: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
        """Foot centres and their Jacobians.

        Args:
            q_rad: (4, 3) joint angles.

        Returns:
            (4, 3) foot centres [m] in base_link and (4, 3, 3) dp/dq [m/rad].
        """
        knee_abs = q_rad[:, 1] + q_rad[:, 2]
        s0, c0 = np.sin(q_rad[:, 0]), np.cos(q_rad[:, 0])
        x1, l1 = -self._thigh_m * np.sin(q_rad[:, 1]), -self._thigh_m * np.cos(q_rad[:, 1])
        x2, l2 = -self._shank_m * np.sin(knee_abs), -self._shank_m * np.cos(knee_abs)
        x, axis = x1 + x2, l1 + l2
        y, z = self._d_m * c0 - axis * s0, self._d_m * s0 + axis * c0
        p = self.p_base_hip.copy()
        p[:, 0] += x
        p[:, 1] += y
        p[:, 2] += z
        jacobian = np.zeros((4, 3, 3))
        jacobian[:, 1, 0], jacobian[:, 2, 0] = -z, y
        for column, dx, daxis in ((1, axis, -x), (2, l2, -x2)):
            jacobian[:, 0, column] = dx
            jacobian[:, 1, column] = -s0 * daxis
            jacobian[:, 2, column] = c0 * daxis
        return p, jacobian

    def compute_joints(self, p_base_foot: np.ndarray) -> np.ndarray:
        """Joint angles that put the feet at given places; a place out of reach is met in its direction.

            r = p - hip,  l = -sqrt(ry^2 + rz^2 - d^2),  q0 = atan2(rz, ry) - atan2(l, d)
            cos q2 = (rx^2 + l^2 - L1^2 - L2^2) / (2 L1 L2),  q2 <= 0
            q1 = atan2(-rx, -l) - atan2(L2 sin q2, L1 + L2 cos q2)

        Args:
            p_base_foot: (..., 4, 3) foot centres [m] in base_link.

        Returns:
            (..., 4, 3) joint angles [rad], knee in [-pi, 0].
        """
        r = p_base_foot - self.p_base_hip
        rx, ry, rz = r[..., 0], r[..., 1], r[..., 2]
        axis = -np.sqrt(np.maximum(ry * ry + rz * rz - self._d_m**2, 1e-8))
        a, b = self._thigh_m, self._shank_m
        cos_knee = np.clip((rx * rx + axis * axis - a * a - b * b) / (2.0 * a * b), -1.0, 1.0)
        knee = -np.arccos(cos_knee)
        hip_y = np.arctan2(-rx, -axis) - np.arctan2(b * np.sin(knee), a + b * cos_knee)
        q0 = np.arctan2(rz, ry) - np.arctan2(axis, self._d_m)
        q0 = np.arctan2(np.sin(q0), np.cos(q0))
        return np.stack([q0, hip_y, knee], axis=-1)

# SPDX-License-Identifier: BSD-3-Clause
"""Where the camera sits on the robot."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Tuple

import numpy as np

from core_bringup.quadruped.params import finite


@dataclass(frozen=True)
class CameraMount:
    """Pose of camera_link (x forward, y left, z up) in base_link; roll, pitch, yaw about fixed x, y, z."""

    x_m: float = finite()
    y_m: float = finite()
    z_m: float = finite()
    roll_rad: float = finite()
    pitch_rad: float = finite()
    yaw_rad: float = finite()

    def compute_optical_pose(self) -> Tuple[np.ndarray, np.ndarray]:
        """Pose of the optical frame (z forward, x right, y down): R_base_optical (3, 3), p_base_optical (3,) [m].

            R_base_optical = Rz(yaw) Ry(pitch) Rx(roll) [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]

        Returns:
            R_base_optical and p_base_optical.
        """
        cr, sr = np.cos(self.roll_rad), np.sin(self.roll_rad)
        cp, sp = np.cos(self.pitch_rad), np.sin(self.pitch_rad)
        cy, sy = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        rotation = np.array(
            [
                [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
                [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
                [-sp, cp * sr, cp * cr],
            ]
        )
        optical = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
        return rotation @ optical, np.array([self.x_m, self.y_m, self.z_m])

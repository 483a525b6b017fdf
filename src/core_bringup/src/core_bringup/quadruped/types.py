# SPDX-License-Identifier: BSD-3-Clause
"""What passes between the simulator and the controller."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class QuadrupedState:
    """What the controller reads; world frame unless the name says base.

    Attributes:
        p_world_base: (3,) base_link origin [m].
        R_world_base: (3, 3) its orientation.
        v_world_base: (3,) velocity of that origin [m/s].
        w_world_base: (3,) angular velocity [rad/s].
        q_rad: (4, 3) joint angles, legs FR, FL, RR, RL.
        dq_radps: (4, 3) joint speeds.
        contacts: (4,) bool, the foot touches something.
    """

    p_world_base: np.ndarray
    R_world_base: np.ndarray
    v_world_base: np.ndarray
    w_world_base: np.ndarray
    q_rad: np.ndarray
    dq_radps: np.ndarray
    contacts: np.ndarray

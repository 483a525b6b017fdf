# SPDX-License-Identifier: BSD-3-Clause
"""Planar kinematics of the robot: x' = f(x) + g(x) u, and where its footprint is."""

from __future__ import annotations

import math

import numpy as np


def wrap_angle(angle_rad: float) -> float:
    """The same angle in (-pi, pi] [rad]."""
    wrapped = math.fmod(angle_rad + math.pi, 2.0 * math.pi)
    return wrapped + math.pi if wrapped <= 0.0 else wrapped - math.pi


def compute_rotation(yaw_rad: float) -> np.ndarray:
    """R(yaw), (2, 2): turns vectors of base_link into vectors of odom."""
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    return np.array([[c, -s], [s, c]])


def compute_g(yaw_rad: float) -> np.ndarray:
    """Input matrix of the paper's model, x' = f + g u with f = 0.

        g = [cos -sin 0; sin cos 0; 0 0 1]

    Returns:
        (3, 3); x' = (x [m/s], y [m/s], yaw [rad/s]) in odom, u in base_link.

    Source: [CORE] experimental setup, dynamics model.
    """
    g = np.eye(3)
    g[:2, :2] = compute_rotation(yaw_rad)
    return g


def place_discs(poses: np.ndarray, discs: np.ndarray) -> np.ndarray:
    """Centres of the footprint's discs, c = p + R(yaw) o.

    Args:
        poses: (n, 3) x [m], y [m], yaw [rad].
        discs: (k, 3) x [m], y [m] in base_link, radius [m].

    Returns:
        (n, k, 2) centres [m] in odom.
    """
    c, s = np.cos(poses[:, 2:]), np.sin(poses[:, 2:])
    x, y = discs[:, 0], discs[:, 1]
    centres = np.empty((len(poses), len(discs), 2))
    centres[..., 0] = poses[:, :1] + c * x - s * y
    centres[..., 1] = poses[:, 1:2] + s * x + c * y
    return centres

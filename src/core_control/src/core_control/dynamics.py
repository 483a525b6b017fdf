# SPDX-License-Identifier: BSD-3-Clause
"""Planar kinematics of the robot: x' = f(x) + g(x) u, its exact integral, and the lag between command and velocity."""

from __future__ import annotations

import math
from typing import Tuple

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


def integrate_arc(pose: np.ndarray, u: np.ndarray, duration_s: float) -> np.ndarray:
    """Exact pose after a body velocity was held.

        yaw+ = yaw + w T,   p+ = p + R(yaw) V(w T) v T
        V(a) = [sin a / a, -(1 - cos a) / a; (1 - cos a) / a, sin a / a]

    Args:
        pose: (3,) x [m], y [m], yaw [rad].
        u: (3,) vx, vy [m/s], w [rad/s] in the body frame.
        duration_s: T, >= 0.

    Returns:
        (3,) pose; the yaw is not wrapped.

    Differs from [CORE]: the paper steps by Euler, p+ = p + R(yaw) v T.
    """
    angle = u[2] * duration_s
    if abs(angle) < 1e-6:
        sine, cosine = 1.0 - angle * angle / 6.0, angle / 2.0
    else:
        sine, cosine = math.sin(angle) / angle, (1.0 - math.cos(angle)) / angle
    body = np.array([sine * u[0] - cosine * u[1], cosine * u[0] + sine * u[1]]) * duration_s
    moved = np.array(pose, dtype=float)
    moved[:2] += compute_rotation(pose[2]) @ body
    moved[2] += angle
    return moved


def integrate_lag(
    pose: np.ndarray, twist: np.ndarray, u: np.ndarray, times_s: np.ndarray, lag_s: float
) -> Tuple[np.ndarray, np.ndarray]:
    """Poses while the body velocity follows a held command with a first-order lag.

        v' = (u - v) / lag   =>   v(t) = u + (v0 - u) exp(-t / lag);   lag = 0: v = u at once

    Heading and body displacement are integrated exactly; between neighbouring times the displacement is turned by the
    heading in the middle (10 um off after 100 ms in steps of 10 ms, within the limits of a walking robot).

    Args:
        pose: (3,) x [m], y [m], yaw [rad] at time 0.
        twist: (3,) body velocity at time 0 [m/s, m/s, rad/s].
        u: (3,) command, same units.
        times_s: (n,) increasing, > 0, n >= 1.
        lag_s: >= 0.

    Returns:
        poses (n, 3) at times_s, and the twist (3,) at the last of them.
    """
    start = np.concatenate(([0.0], times_s[:-1]))
    step = times_s - start
    middle = start + 0.5 * step
    if lag_s > 0.0:
        edges = np.exp(-np.concatenate((start[:1], times_s)) / lag_s)
        fade, fade_mid = edges[1:], np.exp(-middle / lag_s)
        fade_mean = lag_s * (edges[:-1] - fade) / step
    else:
        fade = fade_mid = fade_mean = np.zeros_like(times_s)
    gap = twist - u
    velocity = u + fade_mean[:, None] * gap
    yaw = pose[2] + u[2] * times_s + lag_s * gap[2] * (1.0 - fade)
    yaw_mid = pose[2] + u[2] * middle + lag_s * gap[2] * (1.0 - fade_mid)
    c, s = np.cos(yaw_mid), np.sin(yaw_mid)
    poses = np.empty((len(times_s), 3))
    poses[:, 0] = pose[0] + np.cumsum((c * velocity[:, 0] - s * velocity[:, 1]) * step)
    poses[:, 1] = pose[1] + np.cumsum((s * velocity[:, 0] + c * velocity[:, 1]) * step)
    poses[:, 2] = yaw
    return poses, u + fade[-1] * gap


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

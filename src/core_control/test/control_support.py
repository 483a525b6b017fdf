# SPDX-License-Identifier: BSD-3-Clause
"""Grids, inputs and an exact plant that the tests of this package share."""

from __future__ import annotations

import functools
import math
from typing import Tuple

import numpy as np

from core_control.dynamics import compute_rotation
from core_control.params import FilterParams
from core_control.safety_field import SafetyField
from core_control.types import Cause, CellState, FilterInputs, SafetyGridData

LENGTH_M, WIDTH_M = 1.1, 0.5
CONE_LINE = Cause("BETWEEN(traffic_cone)", "traffic_cone")
AROUND_PERSON = Cause("AROUND(person)", "person", 7, True)


def make_grid(unsafe, resolution_m=0.1, origin_m=None, h_m=None, **changes) -> SafetyGridData:
    """A grid from a mask (ny, nx); centred on the origin unless told otherwise."""
    unsafe = np.asarray(unsafe, dtype=bool)
    ny, nx = unsafe.shape
    values = {
        "frame_id": "odom",
        "stamp_s": 0.0,
        "constraints_stamp_s": 0.0,
        "history_start_s": 0.0,
        "resolution_m": resolution_m,
        "origin_m": np.array([-nx, -ny]) * resolution_m / 2.0 if origin_m is None else np.array(origin_m, dtype=float),
        "state": np.where(unsafe, CellState.UNSAFE, CellState.SAFE).astype(np.uint8),
        "unknown_is_unsafe": True,
        "h_m": np.where(unsafe, -1.0, 1.0) if h_m is None else h_m,
        "cause": np.where(unsafe, 0, 65535).astype(np.uint16),
        "causes": (CONE_LINE,),
    }
    values.update(changes)
    return SafetyGridData(**values)


def make_field(unsafe, **changes) -> SafetyField:
    return SafetyField(make_grid(unsafe, **changes))


def make_slow_field(box_m, cap_mps=0.2, n=120, resolution_m=0.1) -> SafetyField:
    """A free field with one slow rectangle ((x0, x1), (y0, y1)) [m], by AROUND(person)."""
    field = make_field(np.zeros((n, n), bool), resolution_m=resolution_m)
    iy, ix = np.mgrid[:n, :n]
    x, y = np.moveaxis(field.compute_centre(iy.ravel(), ix.ravel()), -1, 0)
    (x0, x1), (y0, y1) = box_m
    slow = ((x > x0) & (x < x1) & (y > y0) & (y < y1)).reshape(n, n)
    cause = np.where(slow, 0, 65535).astype(np.uint16)
    return make_field(
        np.zeros((n, n), bool),
        resolution_m=resolution_m,
        cause=cause,
        causes=(AROUND_PERSON,),
        speed_cap_mps=np.where(slow, cap_mps, np.nan),
    )


def make_wall(x_m, size_m=10.0, resolution_m=0.1) -> SafetyField:
    """A field that is unsafe for every x >= x_m."""
    n = round(size_m / resolution_m)
    unsafe = np.zeros((n, n), dtype=bool)
    unsafe[:, round((x_m + size_m / 2.0) / resolution_m) :] = True
    return make_field(unsafe, resolution_m=resolution_m)


def make_random_mask(rng, n=100) -> np.ndarray:
    """Rectangles and speckle."""
    unsafe = np.zeros((n, n), dtype=bool)
    for _ in range(rng.integers(3, 9)):
        iy, ix = rng.integers(0, n, 2)
        ly, lx = rng.integers(2, 25, 2)
        unsafe[iy : iy + ly, ix : ix + lx] = True
    return unsafe | (rng.random((n, n)) < rng.choice([0.0, 0.0005, 0.002]))


def make_inputs(u_nominal, field, pose=(0.0, 0.0, 0.0), twist=(0.0, 0.0, 0.0), **changes) -> FilterInputs:
    values = {
        "u_nominal": np.array(u_nominal, dtype=float),
        "pose": np.array(pose, dtype=float),
        "twist": np.array(twist, dtype=float),
        "odometry_frame_id": "odom",
        "field": field,
        "nominal_age_s": 0.0,
        "odometry_age_s": 0.0,
        "grid_age_s": 0.0,
        "constraints_age_s": 0.0,
    }
    values.update(changes)
    return FilterInputs(**values)


def make_params(**changes) -> FilterParams:
    return FilterParams.from_dict(changes)


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


class Plant:
    """Exact robot with first-order lag and a delay of whole control periods; keeps the poses of the last period."""

    def __init__(self, pose, lag_s=0.08, delay_ticks=0, period_s=0.05):
        self.pose, self.twist = np.array(pose, dtype=float), np.zeros(3)
        self._lag_s, self._period_s = lag_s, period_s
        self.queue = [np.zeros(3)] * delay_ticks

    def step(self, u) -> np.ndarray:
        """Advance one period; poses (10, 3) on the way."""
        self.queue.append(np.array(u, dtype=float))
        times_s = self._period_s * np.arange(1, 11) / 10.0
        poses, self.twist = integrate_lag(self.pose, self.twist, self.queue.pop(0), times_s, self._lag_s)
        self.pose = poses[-1]
        return poses

    def predict_stop(self) -> np.ndarray:
        """Poses (n, 3) from now on if every command from now on were zero, as densely as step() gives them."""
        pose, twist, parts = self.pose, self.twist, [self.pose[None]]
        stop_s = 8.0 * self._lag_s + self._period_s
        for u, duration_s in [*((u, self._period_s) for u in self.queue), (np.zeros(3), stop_s)]:
            count = round(10.0 * duration_s / self._period_s)
            poses, twist = integrate_lag(pose, twist, u, duration_s * np.arange(1, count + 1) / count, self._lag_s)
            pose = poses[-1]
            parts.append(poses)
        return np.concatenate(parts)


@functools.lru_cache(maxsize=16)
def find_unsafe_centres(field: SafetyField) -> np.ndarray:
    """(n, 2) centres of all unsafe cells [m]."""
    return field.compute_centre(*np.nonzero(field.unsafe))


def footprint_overlaps(field: SafetyField, pose, shrink_m=1e-9, size_m=(LENGTH_M, WIDTH_M)) -> bool:
    """Whether a rectangle centred on the pose overlaps an unsafe cell or leaves the grid; separating axes, exact."""
    R = compute_rotation(pose[2])
    half = np.array(size_m) / 2.0 - shrink_m
    extent = np.abs(R) @ half
    if np.any(pose[:2] - extent < field.lo_m) or np.any(pose[:2] + extent > field.hi_m):
        return True
    centres = find_unsafe_centres(field)
    if not len(centres):
        return False
    half_cell = 0.5 * field.grid.resolution_m
    gap = centres - pose[:2]
    apart_world = np.any(np.abs(gap) >= extent + half_cell, axis=1)
    apart_body = np.any(np.abs(gap @ R) >= half + half_cell * np.abs(R).sum(axis=0), axis=1)
    return bool(np.any(~(apart_world | apart_body)))


def draw_safe_pose(rng, field: SafetyField, clearance_of):
    """A pose with positive clearance, or None after 200 attempts."""
    for _ in range(200):
        pose = np.append(rng.uniform(field.lo_m, field.hi_m), rng.uniform(-np.pi, np.pi))
        if clearance_of(pose) > 0.06:
            return pose
    return None


class Driver:
    """Nominal commands: held at random, full ahead, or straight at the nearest unsafe cell."""

    def __init__(self, rng, limits, step_hold=(5, 40)):
        self._rng, self._limits, self._step_hold = rng, limits, step_hold
        self._left, self._u, self._kind = 0, np.zeros(3), 0

    def step(self, pose, field: SafetyField):
        if self._left == 0:
            self._kind = self._rng.integers(0, 4)
            self._left = int(self._rng.integers(*self._step_hold))
            self._u = self._rng.uniform(-1.2, 1.2, 3) * self._limits
        self._left -= 1
        if self._kind == 1:
            return np.array([self._limits[0], 0.0, 0.0])
        if self._kind == 2 and len(find_unsafe_centres(field)):
            gap = find_unsafe_centres(field) - pose[:2]
            nearest = gap[np.argmin(np.linalg.norm(gap, axis=1))]
            return np.append(compute_rotation(pose[2]).T @ nearest, self._u[2])
        return self._u


def start_anew(filter_):
    """As a new filter, without compiling its program again."""
    filter_.reset()
    filter_.forget()

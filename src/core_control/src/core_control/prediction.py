# SPDX-License-Identifier: BSD-3-Clause
"""Sampled motion under commands held one after the other, then a stop; what depends on time alone is made once."""

from __future__ import annotations

import functools
import math
from typing import Tuple

import numpy as np


class MotionSchedule:
    """Motion of a robot with lag under held commands of fixed durations and a stop at their end.

        v' = (u_j - v) / lag,   z = [v_0; u_1; ...; u_m; 0]
        displacement of step k, in its body frame = W_k . z;   yaw after it = yaw_0 + Y_k . z

    Both are linear in measured twist and commands; what is left for each call is to turn the steps and to add them up.
    A step is turned by the mean of the headings at its ends (1 um off in 10 ms, within the limits of a walking robot).

    The held commands are sampled every sample_s. The stop is sampled at equal shares of the way to rest, no farther
    apart than a robot gets in sample_s at the speed at which the stop begins.

    Args:
        durations_s: how long each command acts, > 0.
        stop_s: length of the stop, >= 0.
        lag_s: >= 0.
        sample_s: largest time between two samples.
    """

    def __init__(self, durations_s: Tuple[float, ...], stop_s: float, lag_s: float, sample_s: float):
        """Fill W and Y."""
        self._lag_s = lag_s
        self._velocity = np.zeros(len(durations_s) + 2)
        self._velocity[0] = 1.0
        steps, yaws = [], [np.zeros((1, len(self._velocity)))]
        for j, duration_s in enumerate([*durations_s, stop_s]):
            times_s = _share_out(duration_s, sample_s) if j < len(durations_s) else _share_stop(stop_s, lag_s, sample_s)
            moved = self._hold(j + 1, times_s)
            steps.append(np.diff(moved, axis=0, prepend=0.0))
            yaws.append(yaws[-1][-1] + moved)
        yaw = np.concatenate(yaws)
        self._steps = np.concatenate(steps)
        self._yaws = np.concatenate([yaw[1:], 0.5 * (yaw[1:] + yaw[:-1])])

    def _hold(self, j: int, times_s: np.ndarray) -> np.ndarray:
        """What a velocity adds up to while command j acts: (n, m + 2), as weights of z.

        integral of v = u t + lag (v_0 - u) (1 - exp(-t / lag)),   v(t) = u + (v_0 - u) exp(-t / lag)
        """
        command = np.zeros_like(self._velocity)
        command[j] = 1.0
        gap = self._velocity - command
        fade = np.exp(-times_s / self._lag_s) if self._lag_s > 0.0 else np.zeros_like(times_s)
        if len(times_s):
            self._velocity = command + fade[-1] * gap
        return times_s[:, None] * command + self._lag_s * (1.0 - fade)[:, None] * gap

    def predict(self, pose: np.ndarray, twist: np.ndarray, commands: np.ndarray) -> np.ndarray:
        """Poses (n, 3) x [m], y [m], yaw [rad] after each step, from a pose (3,), twist (3,) and commands (m, 3)."""
        z = np.concatenate([twist[None], commands, np.zeros((1, 3))])
        n = len(self._steps)
        dx, dy = (self._steps @ z[:, :2]).T
        yaw = pose[2] + self._yaws @ z[:, 2]
        c, s = np.cos(yaw[n:]), np.sin(yaw[n:])
        poses = np.empty((n, 3))
        poses[:, 0] = pose[0] + np.cumsum(c * dx - s * dy)
        poses[:, 1] = pose[1] + np.cumsum(s * dx + c * dy)
        poses[:, 2] = yaw[:n]
        return poses


def _share_out(duration_s: float, sample_s: float) -> np.ndarray:
    count = max(1, math.ceil(duration_s / sample_s - 1e-9))
    return duration_s * np.arange(1, count + 1) / count


def _share_stop(stop_s: float, lag_s: float, sample_s: float) -> np.ndarray:
    """Times at equal shares of 1 - exp(-t / lag), the part of the way that is behind the robot."""
    if stop_s <= 0.0:
        return np.zeros(0)
    whole = -math.expm1(-stop_s / lag_s)
    count = max(1, math.ceil(lag_s * whole / sample_s - 1e-9))
    return -lag_s * np.log1p(-whole * np.arange(1, count + 1) / count)


@functools.lru_cache(maxsize=64)
def make_schedule(durations_s: Tuple[float, ...], stop_s: float, lag_s: float, sample_s: float) -> MotionSchedule:
    """The schedule for these durations; made once."""
    return MotionSchedule(durations_s, stop_s, lag_s, sample_s)

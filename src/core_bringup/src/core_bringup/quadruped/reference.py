# SPDX-License-Identifier: BSD-3-Clause
"""The pose and velocity the body should have: a slewed command, integrated, and the feedback towards it."""

from __future__ import annotations

from typing import Tuple

import numpy as np

from core_bringup.quadruped.params import QuadrupedParams
from core_bringup.quadruped.types import QuadrupedState


class BodyReference:
    """Takes up a command with limited acceleration and integrates it to a pose that stays near the robot."""

    def __init__(self, params: QuadrupedParams, period_s: float):
        """Keep QuadrupedParams params; period_s is the time between two calls of advance [s]."""
        self._gait, self._stance, self._period_s = params.gait, params.stance, period_s
        self._gains = [
            np.array(gain)
            for gain in (
                params.stance.position_gains_per_s2,
                params.stance.velocity_gains_per_s,
                params.stance.attitude_gains_per_s2,
                params.stance.rate_gains_per_s,
            )
        ]
        self._xy_m, self._yaw_rad = np.zeros(2), 0.0
        self._twist = np.zeros(3)
        self._acceleration = np.zeros(3)
        self.yaw_now_rad = 0.0

    @property
    def twist(self) -> np.ndarray:
        """(3,) slewed command in base_link."""
        return self._twist.copy()

    @property
    def yaw_rate_radps(self) -> float:
        """Slewed yaw rate."""
        return self._twist[2]

    @property
    def v_world(self) -> np.ndarray:
        """(2,) slewed velocity [m/s] turned to world axes with the yaw of now."""
        return self._turn(self._twist[:2])

    def reset(self, state: QuadrupedState) -> None:
        """Rest at the pose of state (QuadrupedState)."""
        self.yaw_now_rad = self._yaw_rad = _yaw_of(state.R_world_base)
        self._xy_m = state.p_world_base[:2].copy()
        self._twist[:], self._acceleration[:] = 0.0, 0.0

    def advance(self, state: QuadrupedState, command: np.ndarray) -> bool:
        """Slew towards command (3,), move the reference pose one period on, keep it near the robot.

        Returns:
            True when the command is inside the dead-bands and the slewed command has come to zero.
        """
        gait, dt = self._gait, self._period_s
        small = np.hypot(command[0], command[1]) < gait.dead_band_mps and abs(command[2]) < gait.dead_band_radps
        wanted = np.zeros(3) if small else np.asarray(command, dtype=float)
        change = wanted - self._twist
        largest = gait.max_acceleration_mps2 * dt
        length = np.hypot(change[0], change[1])
        if length > largest:
            change[:2] *= largest / length
        turn = gait.max_yaw_acceleration_radps2 * dt
        change[2] = min(max(change[2], -turn), turn)
        self._twist = self._twist + change
        self._acceleration = change / dt
        self.yaw_now_rad = _yaw_of(state.R_world_base)
        self._integrate(state)
        return bool(small and not self._twist.any())

    def _integrate(self, state: QuadrupedState) -> None:
        stance, dt = self._stance, self._period_s
        error = self._xy_m + self._turn(self._twist[:2]) * dt - state.p_world_base[:2]
        length = np.hypot(error[0], error[1])
        if length > stance.max_position_error_m:
            error *= stance.max_position_error_m / length
        self._xy_m = state.p_world_base[:2] + error
        turn = _wrap(self._yaw_rad + self._twist[2] * dt - self.yaw_now_rad)
        limit = stance.max_yaw_error_rad
        self._yaw_rad = self.yaw_now_rad + min(max(turn, -limit), limit)

    def compute_accelerations(self, state: QuadrupedState, ground_m: float) -> Tuple[np.ndarray, np.ndarray]:
        """Wanted accelerations of the body.

            a     = kp (p* - p) + kd (v* - v) + dv*/dt + w* x v*
            alpha = kp (rpy* - rpy) + kd (w* - w),  roll* = pitch* = 0, in axes turned by yaw

        Args:
            state: QuadrupedState now.
            ground_m: height of the ground under the feet [m].

        Returns:
            (3,) linear [m/s^2] and (3,) angular [rad/s^2], world axes, clipped.
        """
        kp, kd, kp_rot, kd_rot = self._gains
        yaw_rate, v = self._twist[2], self.v_world
        forward = self._turn(self._acceleration[:2]) + yaw_rate * np.array([-v[1], v[0]])
        p_error = np.array(
            [*(self._xy_m - state.p_world_base[:2]), ground_m + self._gait.body_height_m - state.p_world_base[2]]
        )
        v_error = np.array([v[0], v[1], 0.0]) - state.v_world_base
        a = kp * p_error + kd * v_error
        a[:2] += forward
        limit = self._stance.max_linear_acceleration_mps2
        a = np.clip(a, [-limit, -limit, -limit], [limit, limit, 1.5 * limit])
        rotation = state.R_world_base
        pitch, roll = -np.arcsin(min(max(rotation[2, 0], -1.0), 1.0)), np.arctan2(rotation[2, 1], rotation[2, 2])
        c, s = np.cos(self.yaw_now_rad), np.sin(self.yaw_now_rad)
        w = state.w_world_base
        angle_error = np.array([-roll, -pitch, _wrap(self._yaw_rad - self.yaw_now_rad)])
        rate_error = np.array([-(c * w[0] + s * w[1]), -(c * w[1] - s * w[0]), yaw_rate - w[2]])
        alpha = kp_rot * angle_error + kd_rot * rate_error
        alpha[2] += self._acceleration[2]
        limit = self._stance.max_angular_acceleration_radps2
        alpha = np.clip(alpha, -limit, limit)
        return a, np.array([c * alpha[0] - s * alpha[1], s * alpha[0] + c * alpha[1], alpha[2]])

    def _turn(self, vector: np.ndarray) -> np.ndarray:
        c, s = np.cos(self.yaw_now_rad), np.sin(self.yaw_now_rad)
        return np.array([c * vector[0] - s * vector[1], s * vector[0] + c * vector[1]])


def _yaw_of(rotation: np.ndarray) -> float:
    return float(np.arctan2(rotation[1, 0], rotation[0, 0]))


def _wrap(angle_rad: float) -> float:
    return (angle_rad + np.pi) % (2.0 * np.pi) - np.pi

# SPDX-License-Identifier: BSD-3-Clause
"""Walks the quadruped after a body velocity command: joint torques from the state, once per physics step."""

from __future__ import annotations

from typing import Tuple

import numpy as np

from core_bringup.quadruped.gait import SwingPath, TrotClock, compute_footholds, compute_swing_path
from core_bringup.quadruped.kinematics import LegKinematics
from core_bringup.quadruped.model import MassProperties
from core_bringup.quadruped.params import QuadrupedParams
from core_bringup.quadruped.reference import BodyReference
from core_bringup.quadruped.stance import ForceDistribution
from core_bringup.quadruped.types import QuadrupedState

GRAVITY_MPS2 = 9.81
_PUSHED_MPS = 0.3


class TrotController:
    """Force-controlled stance legs, position-controlled swing legs, and a stand that does not step.

    Stance: body pose feedback -> wrench -> ForceDistribution -> tau = -J^T R^T f.
    Swing: foothold -> path -> joint PD and the weight of the leg.
    Differs from published force controllers by a pose reference in x, y, yaw, which corrects the mean speed.
    """

    def __init__(self, params: QuadrupedParams, mass: MassProperties, period_s: float, first_pair: int = 0):
        """Prepare a controller.

        Args:
            params: QuadrupedParams.
            mass: MassProperties of the stand.
            period_s: time between two calls of compute_torques [s].
            first_pair: 0 or 1, the diagonal pair that makes the first step.
        """
        self._params, self._mass, self._period_s = params, mass, period_s
        self._kinematics = LegKinematics(params.leg)
        self._forces = ForceDistribution(params.stance, mass.mass_kg * GRAVITY_MPS2)
        self._reference = BodyReference(params, period_s)
        self._clock = TrotClock(params.gait.cycle_s, params.gait.duty)
        self._start_phase = 0.5 * first_pair
        self._max_torque_nm = np.array(params.leg.max_torque_nm)
        self._neutral = self._kinematics.p_base_thigh[:, :2] + mass.com_m[:2]
        self._standing, self._idle_s = True, 0.0
        self._landed = np.zeros(4, dtype=bool)
        self._swinging = np.zeros(4, dtype=bool)
        self._lift_off_m = np.zeros((4, 3))
        self._ground_m = 0.0

    @property
    def standing(self) -> bool:
        """True while all four feet hold their place."""
        return self._standing

    def reset(self, state: QuadrupedState) -> None:
        """Start to stand at state (QuadrupedState); the feet are on the ground."""
        feet = state.p_world_base + self._kinematics.compute_feet(state.q_rad) @ state.R_world_base.T
        self._ground_m = float(np.mean(feet[:, 2])) - self._params.leg.foot_radius_m
        self._reference.reset(state)
        self._clock.phase = self._start_phase
        self._standing, self._idle_s = True, 0.0
        self._landed[:], self._swinging[:] = False, False

    def compute_torques(self, state: QuadrupedState, command: np.ndarray) -> np.ndarray:
        """Torques for the coming period.

        Args:
            state: QuadrupedState now.
            command: (3,) vx [m/s], vy [m/s], yaw rate [rad/s] in base_link, within the robot's limits.

        Returns:
            (4, 3) joint torques [N m], within max_torque_nm.
        """
        idle = self._reference.advance(state, command)
        self._update_mode(state, idle)
        p_base_feet, jacobians = self._kinematics.compute_feet_and_jacobians(state.q_rad)
        feet = p_base_feet @ state.R_world_base.T
        swinging, progress = self._update_legs(state, feet)
        torques = np.zeros((4, 3))
        stance = ~swinging
        if stance.any():
            self._update_ground(state, feet, stance)
            wrench = self._compute_wrench(state)
            r = feet[stance] - state.R_world_base @ self._mass.com_m
            forces = self._forces.solve(r, wrench) @ state.R_world_base
            torques[stance] = -np.einsum("nij,ni->nj", jacobians[stance], forces)
        if swinging.any():
            torques[swinging] = self._compute_swing_torques(state, jacobians, swinging, progress)
        return np.clip(torques, -self._max_torque_nm, self._max_torque_nm)

    def _update_mode(self, state: QuadrupedState, idle: bool) -> None:
        """Step while there is a command, for one more cycle after it, and when pushed; else stand."""
        pushed = np.hypot(state.v_world_base[0], state.v_world_base[1]) > _PUSHED_MPS
        self._idle_s = self._idle_s + self._period_s if idle else 0.0
        if self._standing:
            if not idle or pushed:
                self._standing, self._idle_s = False, 0.0
                self._clock.phase = self._start_phase
        else:
            self._clock.advance(self._period_s)
            due, _ = self._clock.compute_swing()
            rested = self._idle_s > self._params.gait.cycle_s
            self._standing = bool(rested and not due.any() and state.contacts.all() and not pushed)

    def _update_legs(self, state: QuadrupedState, feet: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
        """Which legs fly now, (4,) bool, and their progress; a leg that meets something early stands at once."""
        if self._standing:
            self._swinging[:], self._landed[:] = False, False
            return self._swinging, np.zeros(4)
        due, progress = self._clock.compute_swing()
        self._landed = due & (self._landed | ((progress > 0.5) & state.contacts))
        swinging = due & ~self._landed
        lifted = swinging & ~self._swinging
        self._lift_off_m[lifted] = feet[lifted] + state.p_world_base
        self._swinging = swinging
        return swinging, progress

    def _update_ground(self, state: QuadrupedState, feet: np.ndarray, stance: np.ndarray) -> None:
        """Ground height under the standing feet, first-order filter of 0.1 s."""
        standing = stance & state.contacts
        if standing.any():
            height = state.p_world_base[2] + np.mean(feet[standing, 2]) - self._params.leg.foot_radius_m
            self._ground_m += (height - self._ground_m) * self._period_s / 0.1

    def _compute_wrench(self, state: QuadrupedState) -> np.ndarray:
        """Force and torque (6,) on the centre of mass: m (a + g), I alpha + w x (I w), world axes."""
        acceleration, alpha = self._reference.compute_accelerations(state, self._ground_m)
        acceleration[2] += GRAVITY_MPS2
        inertia = state.R_world_base @ self._mass.inertia_kgm2 @ state.R_world_base.T
        w, momentum = state.w_world_base, inertia @ state.w_world_base
        gyro = np.array(
            [
                w[1] * momentum[2] - w[2] * momentum[1],
                w[2] * momentum[0] - w[0] * momentum[2],
                w[0] * momentum[1] - w[1] * momentum[0],
            ]
        )
        return np.concatenate([self._mass.mass_kg * acceleration, inertia @ alpha + gyro])

    def _compute_swing_torques(
        self, state: QuadrupedState, jacobians: np.ndarray, swinging: np.ndarray, progress: np.ndarray
    ) -> np.ndarray:
        """Swing law: tau = kp (q* - q) + kd (dq* - dq) + J^T (0, 0, m g), dq* from two path points a period apart."""
        gait = self._params.gait
        path = self._compute_paths(state, progress)
        rotation = state.R_world_base
        offset = path.position_m - state.p_world_base
        w = state.w_world_base
        drag = np.stack(
            [
                w[1] * offset[:, 2] - w[2] * offset[:, 1],
                w[2] * offset[:, 0] - w[0] * offset[:, 2],
                w[0] * offset[:, 1] - w[1] * offset[:, 0],
            ],
            axis=1,
        )
        p_base = offset @ rotation
        v_base = (path.velocity_mps - state.v_world_base - drag) @ rotation
        targets = self._kinematics.compute_joints(np.stack([p_base, p_base + v_base * self._period_s]))
        wanted, speed = targets[0], (targets[1] - targets[0]) / self._period_s
        weight = rotation.T @ np.array([0.0, 0.0, gait.swing_mass_kg * GRAVITY_MPS2])
        torques = (
            gait.swing_stiffness_nmprad * (wanted - state.q_rad)
            + gait.swing_damping_nmsprad * (speed - state.dq_radps)
            + np.einsum("nij,i->nj", jacobians, weight)
        )
        return torques[swinging]

    def _compute_paths(self, state: QuadrupedState, progress: np.ndarray) -> SwingPath:
        """SwingPath of all four legs; only the swinging ones mean anything."""
        gait, reference = self._params.gait, self._reference
        remaining_s = (1.0 - progress) * self._clock.swing_time_s
        yaw = reference.yaw_now_rad + reference.yaw_rate_radps * (remaining_s + 0.5 * self._clock.stance_time_s)
        c, s = np.cos(yaw), np.sin(yaw)
        hips = state.p_world_base[:2] + np.stack(
            [c * self._neutral[:, 0] - s * self._neutral[:, 1], s * self._neutral[:, 0] + c * self._neutral[:, 1]],
            axis=1,
        )
        xy = compute_footholds(
            hips, reference.v_world, state.v_world_base[:2], remaining_s, self._clock.stance_time_s, gait.speed_gain_s
        )
        touchdown_z = self._ground_m + self._params.leg.foot_radius_m - gait.press_m
        end = np.concatenate([xy, np.full((4, 1), touchdown_z)], axis=1)
        apex = self._ground_m + self._params.leg.foot_radius_m + gait.clearance_m
        return compute_swing_path(progress, self._lift_off_m, end, apex, self._clock.swing_time_s)

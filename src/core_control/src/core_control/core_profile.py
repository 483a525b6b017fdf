# SPDX-License-Identifier: BSD-3-Clause
"""Profile `core`: half-plane rows at the predicted stop, one quadratic program, then the roll-out verifier."""

from __future__ import annotations

from typing import Optional, Tuple

import numpy as np

from core_control.barriers.half_planes import HalfPlaneBarrier
from core_control.params import FilterParams
from core_control.proposal import Proposal, Situation, find_binding, make_binding, scale_to_limits
from core_control.qp import TOLERANCE, VelocityQp, satisfies
from core_control.rollout import RollOut
from core_control.slide import compute_slide_rows
from core_control.types import BarrierRows, Binding, Clearance

SLIDE_ROWS = 4


class CoreProfile:
    """Proposes a command in three steps: program, verifier, dead-band.

    Args:
        params: parameters of the filter.
    """

    def __init__(self, params: FilterParams):
        """Build barrier, program and verifier."""
        self._params = params
        discs = params.disc_array
        gains = (params.alpha_per_s, params.margin_m)
        self._barrier = HalfPlaneBarrier(discs, *gains, params.limits, params.rows_per_disc)
        self._qp = VelocityQp(self._barrier.row_count + SLIDE_ROWS, params.weights, True, params.solver)
        period_s = params.control_period_s
        self._roll_out = RollOut(discs, params.lag_s, period_s, params.verifier_margin_m, params.limits)
        self._resting = False

    def reset(self) -> None:
        """Forget that the robot was at rest."""
        self._resting = False

    def compute_clearance(self, situation: Situation) -> Clearance:
        """Clearance of the footprint now."""
        return self._barrier.compute_clearance(situation.field, situation.pose)

    def propose(self, situation: Situation) -> Proposal:
        """The command closest to the nominal one that every row, limit and the verifier accept.

        Raises:
            SolverError: the program gave no usable answer.
        """
        field = situation.field
        clearance = self.compute_clearance(situation)
        start = (situation.pose, situation.twist, situation.pending)
        stop_pose = self._roll_out.predict(*start, np.zeros(3))[-1]
        rows = self._barrier.compute_rows(field, stop_pose)
        wanted, lower, upper = self._limit(situation)
        u, solve_time_s = self._solve(wanted, rows, lower, upper)
        # Sliding may trade turning for speed. b <= 0 in every row: a smaller command satisfies them as well.
        u = situation.cap.limit(u)
        scale = self._roll_out.find_scale(field, start, u)
        binding = self._find_binding(situation, rows, wanted, scale)
        u = u if scale == 1.0 else scale * u
        u, rests = self._apply_dead_band(u, binding)
        note = _describe(scale, rests, u is situation.u_nominal)
        return Proposal(u, clearance, binding, len(rows), scale, solve_time_s, note)

    def _limit(self, situation: Situation) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Wanted command within the limits, and the box a command may lie in.

            lower = min(0, u_previous) - a dt,  upper = max(0, u_previous) + a dt,  cut to the limits

        The box bounds growth away from zero and always holds 0, so that a stop is never delayed.
        """
        limits = self._params.limits
        growth = self._params.accelerations * self._params.control_period_s
        lower = np.maximum(np.minimum(situation.u_previous, 0.0) - growth, -limits)
        upper = np.minimum(np.maximum(situation.u_previous, 0.0) + growth, limits)
        scaled = scale_to_limits(situation.u_nominal, limits)
        clipped = np.clip(scaled, lower, upper)
        return (scaled if np.array_equal(clipped, scaled) else clipped), lower, upper

    def _solve(self, wanted: np.ndarray, rows: BarrierRows, lower: np.ndarray, upper: np.ndarray):
        """Minimiser and CPU time; where the limited command breaks no row it is the minimiser itself."""
        if satisfies(wanted, rows.a, rows.b, TOLERANCE):
            return wanted, 0.0
        slide = compute_slide_rows(wanted, self._params.weights, self._params.slide_ratio)
        every = BarrierRows.concatenate([rows, slide])
        u = self._qp.solve(wanted, every.a, every.b, (lower, upper))
        return u, self._qp.solve_time_s

    def _find_binding(self, situation, rows: BarrierRows, wanted: np.ndarray, scale: float) -> Optional[Binding]:
        binding = find_binding(situation.field, rows, wanted)
        if binding is None and scale < 1.0:
            clearance = self.compute_clearance(situation)
            binding = make_binding(situation.field, clearance.cell, clearance.point_m)
        return binding

    def _apply_dead_band(self, u: np.ndarray, binding: Optional[Binding]) -> Tuple[np.ndarray, bool]:
        """Zero for what a barrier left of a command when the gait cannot follow it.

        Once at rest the command must exceed the band dead_band_release times before the robot moves again, so that
        noise in the clearance does not make it twitch.
        """
        if binding is None or not np.any(u):
            self._resting = self._resting and binding is not None
            return u, False
        factor = self._params.dead_band_release if self._resting else 1.0
        slow = np.hypot(u[0], u[1]) < factor * self._params.dead_band_mps
        self._resting = bool(slow and abs(u[2]) < factor * self._params.dead_band_radps)
        return (np.zeros(3), True) if self._resting else (u, False)


def _describe(scale: float, rests: bool, unchanged: bool) -> str:
    if unchanged:
        return ""
    if rests:
        return "below the dead-band"
    return f"scaled to {scale:.1f} by the verifier" if scale < 1.0 else ""

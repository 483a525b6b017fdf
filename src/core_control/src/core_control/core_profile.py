# SPDX-License-Identifier: BSD-3-Clause
"""Profile `core`: half-plane rows at the predicted stop, one quadratic program, then the roll-out verifier."""

from __future__ import annotations

from typing import Optional, Tuple, Union

import numpy as np

from core_control.barriers.half_planes import HalfPlaneBarrier
from core_control.dead_band import DeadBand, Rest
from core_control.kinematics import Kinematics
from core_control.params import FilterParams
from core_control.proposal import Proposal, Situation, find_binding, make_binding, scale_to_limits
from core_control.qp import TOLERANCE, Box, VelocityQp, satisfies
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
        self._params, self._start_limits = params, params.limits
        discs = params.disc_array
        self._kinematics = Kinematics(params)
        self._barrier = self._make_barrier(discs, params.margin_m)
        row_count = self._kinematics.disc_count * self._barrier.rows_per_disc + SLIDE_ROWS + self._kinematics.row_count
        self._qp = VelocityQp(row_count, params.weights, True, params.solver)
        period_s = params.control_period_s
        self._roll_out = RollOut(discs, params.lag_s, period_s, params.verifier_margin_m, params.limits)
        self._dead_band = DeadBand(params)

    @property
    def roll_out(self) -> RollOut:
        """The verifier."""
        return self._roll_out

    @property
    def rest(self) -> Rest:
        """State of the dead-band."""
        return self._dead_band.state

    @rest.setter
    def rest(self, state: Rest) -> None:
        self._dead_band.state = state

    def reset(self) -> None:
        """Forget that the robot was at rest."""
        self.rest = Rest()

    def tighten(self, params: FilterParams) -> None:
        """Take parameters that allow less.

        The barrier's reach and the roll-out keep the limits of the start: the robot may still move as fast as those.
        """
        self._params, self._kinematics = params, Kinematics(params)
        self._barrier = self._make_barrier(params.disc_array, params.margin_m)

    def limit(self, situation: Situation) -> np.ndarray:
        """The wanted command within the limits of the robot and of its growth, whatever the barrier says."""
        return self._limit(situation)[0]

    def compute_clearance(self, situation: Situation) -> Clearance:
        """Clearance of the footprint now."""
        return self._barrier.compute_clearance(situation.field, situation.pose)

    def propose(self, situation: Situation) -> Proposal:
        """The command closest to the nominal one that every row, limit and the verifier accept.

        Raises:
            SolverError: the program gave no usable answer.
        """
        clearance = self.compute_clearance(situation)
        start = (situation.pose, situation.twist, situation.pending)
        stop_pose = self._roll_out.predict(*start, np.zeros(3))[-1]
        rows = self._compute_rows(situation, stop_pose)
        wanted, lower, upper = self._limit(situation)
        u, solve_time_s = self._solve(wanted, rows, lower, upper)
        u = self._leave_out_ignored(u, wanted, rows, (lower, upper))
        # Sliding may trade turning for speed. b <= 0 in every row: a smaller command satisfies them as well.
        u, scale = self.verify(situation, situation.cap.limit(u))
        binding = self._find_binding(situation, rows, wanted, scale)
        u, rests = self._dead_band.apply(u, binding is not None or self._stays_bound(situation, rows))
        note = _describe(scale, rests, u is situation.u_nominal)
        note = "; ".join(part for part in (self._kinematics.describe(situation.u_nominal), note) if part)
        return Proposal(u, clearance, binding, len(rows), scale, solve_time_s, note)

    def verify(self, situation: Situation, u: np.ndarray) -> Tuple[np.ndarray, float]:
        """What the verifier leaves of a command as the gait walks it, and its scale; u itself where it is all of it."""
        start = (situation.pose, situation.twist, situation.pending)
        u = self._drop_ignored(u)
        scale = self._roll_out.find_scale(situation.field, start, u)
        if scale == 1.0:
            return u, scale
        shrunk = scale * u
        walked = self._drop_ignored(shrunk)
        if walked is not shrunk and self._roll_out.find_scale(situation.field, start, walked) < 1.0:
            return np.zeros(3), 0.0  # without its small entries it is another motion
        return walked, scale

    def _make_barrier(self, discs: np.ndarray, margin_m: Union[float, np.ndarray]) -> HalfPlaneBarrier:
        params = self._params
        return HalfPlaneBarrier(discs, params.alpha_per_s, margin_m, self._start_limits, params.rows_per_disc)

    def _compute_rows(self, situation: Situation, stop_pose: np.ndarray) -> BarrierRows:
        """Rows of the footprint; a wheeled base also gets some ahead of its axle, to have a lever on turning."""
        if self._kinematics.is_holonomic:
            return self._barrier.compute_rows(situation.field, stop_pose)
        discs, on_axle = self._kinematics.place_discs(self._follow(situation.u_nominal)[0])
        margins_m = np.where(on_axle, self._params.verifier_margin_m, self._params.margin_m)
        return self._make_barrier(discs, margins_m).compute_rows(situation.field, stop_pose)

    def _follow(self, u: np.ndarray) -> np.ndarray:
        """What the base can follow of a command, within the limits."""
        return scale_to_limits(self._kinematics.adapt(u), self._params.limits)

    def _limit(self, situation: Situation) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Wanted command within the limits, and the box a command may lie in.

            lower = min(0, u_previous) - a dt,  upper = max(0, u_previous) + a dt,  cut to the limits

        The box bounds growth away from zero and always holds 0, so that a stop is never delayed.
        """
        limits = self._params.limits
        growth = self._params.accelerations * self._params.control_period_s
        lower = np.maximum(np.minimum(situation.u_previous, 0.0) - growth, -limits)
        upper = np.minimum(np.maximum(situation.u_previous, 0.0) + growth, limits)
        scaled = self._follow(situation.u_nominal)
        clipped = np.clip(scaled, lower, upper)
        # Clipping changes the turning radius; a smaller yaw rate is still within a box that holds 0.
        return (scaled if np.array_equal(clipped, scaled) else self._kinematics.adapt(clipped)), lower, upper

    def _solve(self, wanted: np.ndarray, rows: BarrierRows, lower: np.ndarray, upper: np.ndarray):
        """Minimiser and CPU time; where the limited command breaks no row it is the minimiser itself."""
        if satisfies(wanted, rows.a, rows.b, TOLERANCE):
            return wanted, 0.0
        slide = compute_slide_rows(wanted, self._params.weights, self._params.slide_ratio)
        every = BarrierRows.concatenate([rows, slide, self._kinematics.compute_rows(wanted)])
        u = self._qp.solve(wanted, every.a, every.b, (lower, upper))
        # The rows of the turning radius hold up to rounding.
        return self._kinematics.adapt(u), self._qp.solve_time_s

    def _leave_out_ignored(self, u: np.ndarray, wanted: np.ndarray, rows: BarrierRows, box: Box) -> np.ndarray:
        """The program once more, without the entries that the gait would take for zero; u itself where it has none."""
        while not np.array_equal(self._drop_ignored(u), u):
            kept = self._drop_ignored(u) == u
            box = (np.where(kept, box[0], 0.0), np.where(kept, box[1], 0.0))
            wanted = self._kinematics.adapt(np.where(kept, wanted, 0.0))
            u, _ = self._solve(wanted, rows, *box)
        return u

    def _drop_ignored(self, u: np.ndarray) -> np.ndarray:
        """The command as a gait walks it that takes every entry below its dead-band for zero; u itself otherwise."""
        if not self._params.dead_band_per_axis:
            return u
        bands = np.array([self._params.dead_band_mps, self._params.dead_band_mps, self._params.dead_band_radps])
        small = (u != 0.0) & (np.abs(u) < bands)
        return self._kinematics.adapt(np.where(small, 0.0, u)) if small.any() else u

    def _find_binding(self, situation, rows: BarrierRows, wanted: np.ndarray, scale: float) -> Optional[Binding]:
        binding = find_binding(situation.field, rows, wanted)
        if binding is None and scale < 1.0:
            clearance = self.compute_clearance(situation)
            binding = make_binding(situation.field, clearance.cell, clearance.point_m)
        return binding

    def _stays_bound(self, situation: Situation, rows: BarrierRows) -> bool:
        """Whether a robot at rest is asked for more than the rows allow: its first small step may satisfy them."""
        wanted = scale_to_limits(situation.u_nominal, self._params.limits)
        return self.rest.resting and find_binding(situation.field, rows, wanted) is not None


def _describe(scale: float, rests: bool, unchanged: bool) -> str:
    if unchanged:
        return ""
    if rests:
        return "below the dead-band"
    return f"scaled to {scale:.1f} by the verifier" if scale < 1.0 else ""

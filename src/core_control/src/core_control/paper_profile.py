# SPDX-License-Identifier: BSD-3-Clause
"""Profile `paper`: the single-row program of [CORE] for a point robot, to the letter."""

from __future__ import annotations

import numpy as np

from core_control.barriers.sdf_gradient import SdfGradientBarrier
from core_control.params import FilterParams
from core_control.proposal import Proposal, Situation, find_binding, scale_to_limits
from core_control.qp import VelocityQp, satisfies
from core_control.types import Clearance


class PaperProfile:
    """min |u - u_nominal|^2 subject to <grad h, f + g u> >= -alpha h, with nothing added.

    Args:
        params: parameters of the filter; footprint, margins, lag and dead-band play no part.

    Source: [CORE] contextual safety enforcement. The result is made smaller as a whole where it exceeds the robot's
    limits, which the paper leaves to the robot, or the speed cap, where there is one. Outside the safe set the row asks
    for motion even if u_nominal = 0.
    """

    def __init__(self, params: FilterParams):
        """Build barrier and program."""
        self._limits = params.limits
        self._barrier = SdfGradientBarrier(params.alpha_per_s, params.paper_outside_gradient)
        self._qp = VelocityQp(1, np.ones(3), False, params.solver)

    def reset(self) -> None:
        """Nothing to forget."""

    def tighten(self, params: FilterParams) -> None:
        """Take parameters that allow less."""
        self._limits = params.limits
        self._barrier = SdfGradientBarrier(params.alpha_per_s, params.paper_outside_gradient)

    def limit(self, situation: Situation) -> np.ndarray:
        """The wanted command within the limits of the robot, whatever the barrier says."""
        return scale_to_limits(situation.u_nominal, self._limits)

    def compute_clearance(self, situation: Situation) -> Clearance:
        """Barrier value of the base point."""
        return self._barrier.compute_clearance(situation.field, situation.pose)

    def propose(self, situation: Situation) -> Proposal:
        """The nominal command or its projection on the row.

        Raises:
            SolverError: the program gave no usable answer.
        """
        clearance = self.compute_clearance(situation)
        rows = self._barrier.compute_rows(situation.field, situation.pose, clearance)
        wanted = scale_to_limits(situation.u_nominal, self._limits)
        if satisfies(wanted, rows.a, rows.b, 0.0):
            return Proposal(wanted, clearance, rows=len(rows))
        binding = find_binding(situation.field, rows, wanted)
        u = self._qp.solve(wanted, rows.a, rows.b)
        u = situation.cap.limit(scale_to_limits(u, self._limits))
        return Proposal(u, clearance, binding, len(rows), solve_time_s=self._qp.solve_time_s)

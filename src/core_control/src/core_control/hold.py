# SPDX-License-Identifier: BSD-3-Clause
"""What profile `core` does where the footprint stands on unsafe cells: HOLD, ESCAPE and LATCH.

HOLD solves the program on the field as it is, where only commands pass that do not reduce clearance, and, while there
are exempt cells under the body (underfoot.py), on the field without them; the answer nearer to the nominal command is
taken. Where escape is switched on and nothing is let, the robot walks back (escape.py). LATCH: too deep inside unsafe
ground, or after an escape in vain, an operator must see to it; what is unknown does not count, nor do exempt cells.
A nominal command of zero is answered by zero in every mode.
"""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import Optional, Tuple

import numpy as np

from core_control.body import Body, find_unsafe_near
from core_control.core_profile import CoreProfile
from core_control.dead_band import is_below_dead_band
from core_control.escape import Escape
from core_control.modes import Reason, Stop
from core_control.params import FilterParams
from core_control.proposal import Proposal, Situation, make_binding
from core_control.rollout import SAMPLE_S
from core_control.safety_field import SafetyField
from core_control.types import NO_CELL, Mode
from core_control.underfoot import Underfoot


class HoldKeeper:
    """Profile `core` with what happens for h < 0.

    Args:
        params: parameters of the filter.
        profile: solves the program.
    """

    def __init__(self, params: FilterParams, profile: CoreProfile):
        """Build the outline."""
        self._params, self._profile = params, profile
        self._body = Body(params)
        self._underfoot = Underfoot(params, self._body)
        self._escape = Escape(params, self._body.reach_m)
        self._vouched = False
        # Most that any point of the footprint travels, and half of it between two samples of a roll-out.
        self._reach_mps = np.hypot(*params.limits[:2]) + params.limits[2] * self._body.reach_m
        self._grow_m = 0.5 * self._reach_mps * SAMPLE_S

    def reset(self) -> None:
        """Forget what is known of the ground under the robot; what an operator saw to stays so."""
        self._underfoot.reset()
        self._escape.pause(moved=True)

    def pause(self, moved: bool) -> None:
        """A tick that did not ask for a proposal; moved: the robot may have been driven by somebody else."""
        self._escape.pause(moved)

    def tighten(self, params: FilterParams) -> None:
        """Go on with parameters that allow less."""
        self._params = params
        self._escape.tighten(params)

    def vouch(self) -> None:
        """An operator saw to it: what would latch now does so only after the robot has been out of it once."""
        self._vouched = True
        self._escape.give_up()

    def watch(self, field: SafetyField, pose: np.ndarray) -> None:
        """Look at the ground under the robot; to be called at every tick at which grid and pose can be trusted."""
        self._underfoot.update(field, pose)
        self._escape.watch(pose)

    def propose(self, situation: Situation) -> Proposal:
        """The command of this tick.

        Raises:
            SolverError: a program gave no usable answer.
        """
        new = self._underfoot.find_new()
        if new is not None:
            return self._stand(situation, new)
        proposal = self._choose(situation)
        h_m = proposal.clearance.h_m
        if h_m < 0.0:
            # Neither exempt cells count from here on, nor what moves may have come nearer: that alone moves nobody.
            seen = replace(situation, field=self._underfoot.clear_field())
            h_m = self._profile.compute_clearance(seen).h_m
        deep = self._find_deep(situation, proposal.clearance.h_m)
        if deep is not None and h_m < 0.0:
            return replace(proposal, latch=deep)
        return self._walk_back(situation, proposal, h_m) if self._params.escape else proposal

    def _clear(self, situation: Situation) -> Situation:
        """The same without the exempt cells; what moves has come as near."""
        return replace(situation, field=self._underfoot.clear_field().grow(situation.field.growth_m))

    def _find_deep(self, situation: Situation, h_m: float) -> Optional[Stop]:
        """Why to latch: the footprint is deeper than latch_depth_m in unsafe ground that is known to be."""
        depth_m = self._params.latch_depth_m
        if h_m >= -depth_m:
            self._vouched = False
        if h_m >= -depth_m or self._vouched:
            return None
        known = SafetyField(replace(situation.field.grid, unknown_is_unsafe=False))
        clearance = self._profile.compute_clearance(replace(situation, field=known))
        if clearance.h_m >= -depth_m or clearance.cell == NO_CELL:
            return None
        what = known.get_cause(clearance.cell).describe()
        return Stop(Reason.DEEP_INSIDE, f"{-clearance.h_m:.2f} m inside {what}, limit {depth_m:g} m")

    def _walk_back(self, situation: Situation, proposal: Proposal, h_m: float) -> Proposal:
        """The proposal, or a step of an escape in its place."""
        asks = not is_below_dead_band(situation.u_nominal, self._params)
        self._escape.update(h_m, bool(asks and not np.any(proposal.u)))
        if not self._escape.is_walking:
            return proposal
        wanted, why = self._escape.find_command()
        if wanted is None:
            return replace(proposal, latch=Stop(Reason.ESCAPE_FAILED, why))
        u, scale = self._verify(situation, wanted)
        self._escape.count(bool(np.any(u)))
        note = f"walking back along its trail for {self._escape.walked_s:.1f} s"
        return replace(proposal, u=u, scale=scale, note=note, mode=Mode.ESCAPE)

    def _verify(self, situation: Situation, wanted: np.ndarray) -> Tuple[np.ndarray, float]:
        """What limits, cap and verifier leave of a command, and the verifier's scale; no row bends it off the trail."""
        u = situation.cap.limit(self._profile.limit(replace(situation, u_nominal=wanted)))
        u, scale = self._profile.verify(self._clear(situation), u)
        if self._enters(situation, u, within_region=True):
            return np.zeros(3), 0.0
        return u, scale

    def _stand(self, situation: Situation, cell: int) -> Proposal:
        """Zero, while it shows whether a cell that turned unsafe under the robot stays so."""
        self._profile.reset()
        field = situation.field
        iy, ix = divmod(cell, field.unsafe.shape[1])
        binding = make_binding(field, cell, field.compute_centre(np.array([iy]), np.array([ix]))[0])
        note = f"a cell under the robot became unsafe: {binding.cause.describe()}"
        return Proposal(np.zeros(3), self._profile.compute_clearance(situation), binding, note=note)

    def _choose(self, situation: Situation) -> Proposal:
        before, cap = self._profile.rest, copy.copy(situation.cap)
        proposal = self._profile.propose(situation)
        if self._comes_inside(situation, proposal.clearance.h_m) and self._enters(situation, proposal.u, True):
            proposal = self._refuse(proposal)
        if not len(self._underfoot) or np.array_equal(proposal.u, situation.u_nominal):
            return proposal
        after, self._profile.rest = self._profile.rest, before
        # A cap that one answer tightens says nothing of the other: what is sent is checked against its own.
        other = self._profile.propose(replace(self._clear(situation), cap=cap))
        if self._enters(situation, other.u, within_region=False):
            other = self._refuse(other)
        if self._compute_change(situation, other.u) < self._compute_change(situation, proposal.u):
            situation.cap.adopt(cap)
            # What is reported is the clearance there is, whatever the program left out.
            return replace(other, clearance=proposal.clearance)
        self._profile.rest = after
        return proposal

    def _compute_change(self, situation: Situation, u: np.ndarray) -> float:
        return float(np.linalg.norm(self._params.weights * (u - situation.u_nominal)))

    @staticmethod
    def _refuse(proposal: Proposal) -> Proposal:
        return replace(proposal, u=np.zeros(3), scale=0.0, note="the body would enter another unsafe cell")

    def _comes_inside(self, situation: Situation, h_m: float) -> bool:
        """Whether the discs are inside unsafe cells, or will be before the robot stands: a hazard that appeared late.

        Discs reach beyond the body: that they go no deeper than by stopping does not keep its corners out.
        """
        speed_mps = np.hypot(*situation.twist[:2]) + abs(situation.twist[2]) * self._body.reach_m
        stop_m = max(speed_mps, self._reach_mps) * (self._params.lag_s + self._params.delay_s)
        if h_m < 0.0 or h_m > stop_m + self._grow_m:
            return h_m < 0.0
        start = (situation.pose, situation.twist, situation.pending)
        return self._profile.roll_out.compute_clearance(situation.field, start, np.zeros(3)) < self._grow_m

    def _enters(self, situation: Situation, u: np.ndarray, within_region: bool) -> bool:
        """Whether the body would come to overlap an unsafe cell that it does not overlap now, nor by stopping.

        Clearance is the smallest over all discs: deep in one cell it says nothing about the others.

        Args:
            situation: of this tick.
            u: (3,) candidate.
            within_region: cells that are joined to one which the body is on by unsafe cells around it may be entered:
                the way out of a region that is larger than the body leads through it.
        """
        if not np.any(u):
            return False
        start = (situation.pose, situation.twist, situation.pending)
        now, field = situation.pose[None], situation.field
        stop = np.concatenate([now, self._profile.roll_out.predict(*start, np.zeros(3))])
        path = np.concatenate([now, self._profile.roll_out.predict(*start, u)])
        iy, ix = find_unsafe_near(field, np.concatenate([stop, path]), self._body.reach_m + field.grid.resolution_m)
        centres, cell_m = field.compute_centre(iy, ix), field.grid.resolution_m
        on = self._body.overlaps(stop, centres, cell_m)
        entered = self._body.overlaps(path, centres, cell_m) & ~on
        # A cell less than half a step away is seen by the samples alone.
        near = self._body.overlaps(stop, centres, cell_m, self._grow_m)
        entered |= self._body.overlaps(path, centres, cell_m, self._grow_m) & ~near
        if within_region and entered.any():
            entered &= ~_find_joined(iy, ix, on)
        return bool(entered.any())


def _find_joined(iy: np.ndarray, ix: np.ndarray, seed: np.ndarray) -> np.ndarray:
    """Which of the cells can be reached from the seeds (m,) bool by steps to any of the eight neighbours."""
    joined = np.zeros((np.ptp(iy) + 3, np.ptp(ix) + 3), dtype=bool)
    unsafe = joined.copy()
    y, x = iy - iy.min() + 1, ix - ix.min() + 1
    unsafe[y, x] = True
    joined[y[seed], x[seed]] = True
    while True:
        spread = joined.copy()
        spread[1:] |= joined[:-1]
        spread[:-1] |= joined[1:]
        columns = spread.copy()
        spread[:, 1:] |= columns[:, :-1]
        spread[:, :-1] |= columns[:, 1:]
        spread &= unsafe
        if np.array_equal(spread, joined):
            return joined[y, x]
        joined = spread

# SPDX-License-Identifier: BSD-3-Clause
"""The filter: one tick from inputs to a command, with a mode and a reason. Never raises, never answers None."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace
from typing import Optional

import numpy as np

from core_control.blockage import StuckDetector
from core_control.command_cap import CommandCap, SpeedLimiter
from core_control.core_profile import CoreProfile
from core_control.exceptions import SolverError
from core_control.hold import HoldKeeper
from core_control.kinematics import Kinematics
from core_control.modes import (
    Reason,
    Stop,
    find_command_stop,
    find_grid_stop,
    find_odometry_stop,
    find_stop,
    rank_latch,
)
from core_control.mover_growth import MoverGrowth
from core_control.override import NEVER_OVERRIDDEN, make_override_cap
from core_control.paper_profile import PaperProfile
from core_control.params import FilterParams
from core_control.proposal import Proposal, Situation, make_binding
from core_control.speed_cap import CapReason
from core_control.types import NAN, FilterInputs, FilterResult, Mode

PROFILES = {"core": CoreProfile, "paper": PaperProfile}


class CbfFilter:
    """Velocity filter with control barrier functions.

    An input that is missing, stale or not finite gives zero and its reason; the filter goes on by itself when the input
    is back. An exception inside a tick gives zero and ``internal_error``, a map that lost what it held gives zero and
    ``map_lost``, both until reset() is called.

    Args:
        params: checked parameters.
    """

    def __init__(self, params: FilterParams):
        """Build the profile and start at rest."""
        self._params = params
        self._profile = PROFILES[params.profile](params)
        self._keeper = HoldKeeper(params, self._profile) if params.profile == "core" else None
        self._limiter = SpeedLimiter(params)
        self._kinematics = Kinematics(params)
        self._stuck = StuckDetector(params)
        self._movers = MoverGrowth(params)
        self._latched: Optional[Stop] = None
        self._history_start_s = math.inf
        self._sent = deque(maxlen=max(1, math.ceil(params.delay_s / params.control_period_s - 1e-9)))

    @property
    def error(self) -> str:
        """Text of what is latched; empty when nothing is."""
        return self._latched.detail if self._latched else ""

    @property
    def override_problem(self) -> str:
        """Why nobody may drive past the filter now, in words; empty when nothing latched forbids it."""
        forbidden = self._latched is not None and self._latched.reason in NEVER_OVERRIDDEN
        return f"{self._latched.reason}: {self._latched.detail}" if forbidden else ""

    def latch(self, detail: str, reason: str = Reason.INTERNAL_ERROR) -> None:
        """Stop with a reason until reset() is called; the first of the highest rank is kept."""
        if self._latched is None or rank_latch(reason) > rank_latch(self._latched.reason):
            self._latched = Stop(reason, detail)

    def tighten(self, params: FilterParams) -> None:
        """Go on with parameters that allow less, as tightening.tighten() checks them; what was seen and latched stays.

        Between two ticks: the program is not built anew, its limits are data.
        """
        self._profile.tighten(params)
        self._limiter.tighten(params)
        if self._keeper is not None:
            self._keeper.tighten(params)
        self._params = params

    def reset(self) -> None:
        """Clear what is latched; the operator vouches for the ground around the robot.

        The commands sent are not forgotten: with a delay some of them are still on their way.
        """
        self._latched = None
        self._forget_ground()
        if self._keeper is not None:
            self._keeper.vouch()

    def forget(self) -> None:
        """Forget the commands and the map seen so far: after a jump of time they say nothing about the present."""
        self._sent.clear()
        self._forget_ground()

    def _forget_ground(self) -> None:
        self._history_start_s = math.inf
        self._profile.reset()
        self._limiter.reset()
        if self._keeper is not None:
            self._keeper.reset()
        self._stuck.reset()
        self._movers.reset()

    def step(self, inputs: FilterInputs) -> FilterResult:
        """Decide one command.

        Args:
            inputs: newest inputs and their ages at this tick.

        Returns:
            FilterResult; u_safe is finite, within the limits (profile and enforcement allowing) and within the speed
            cap, and equal to the nominal command when nothing speaks against it.
        """
        try:
            if inputs.latch_request is not None:
                reason, detail = inputs.latch_request
                self.latch(detail, reason)
            self._look_down(inputs)
            result = self._drive_past(inputs) or self._decide_checked(inputs)
        except Exception as error:  # a fault in the arithmetic must end in zero, whatever it is
            self.latch(f"{type(error).__name__}: {error}")
            result = replace(_stopped(inputs, self._latched), latched=True)
        if not np.any(result.u_safe):
            result = replace(result, u_safe=np.zeros(3))
        self._sent.append(result.u_safe)
        if self._keeper is not None and result.mode in (Mode.STOPPED, Mode.DISABLED, Mode.OVERRIDE):
            self._keeper.pause(moved=result.mode != Mode.STOPPED)
        return self._stuck.step(result)

    def _look_down(self, inputs: FilterInputs) -> None:
        """Keep up with the ground under the robot, whoever drives."""
        with np.errstate(all="ignore"):
            if self._keeper is not None and self._params.enforce and self._can_see(inputs):
                self._keeper.watch(inputs.field, inputs.pose)

    def _drive_past(self, inputs: FilterInputs) -> Optional[FilterResult]:
        """The operator's command within the override's cap and the robot's limits, h shown but not obeyed.

        None where nobody drives, may drive, or sends a command that can be used: then the filter decides.
        """
        if inputs.override_mps is None or self.override_problem or find_command_stop(inputs, self._params):
            return None
        cap = make_override_cap(self._params, inputs.override_mps)
        with np.errstate(all="ignore"):
            situation = replace(self._make_situation(inputs), u_nominal=cap.limit(inputs.u_nominal))
            u = cap.limit(self._profile.limit(situation))
        if not (np.isfinite(u).all() and cap.allows(u)):
            raise ArithmeticError(f"the command under override became {u}")
        detail = "the operator drives past the filter" + (f" ({self.error})" if self.error else "")
        result = FilterResult(Mode.OVERRIDE, u, inputs.u_nominal, detail=detail, latched=self._latched is not None)
        return self._observe(inputs, replace(result, speed_cap_mps=cap.speed_mps, speed_cap_reason=CapReason.OVERRIDE))

    def _decide_checked(self, inputs: FilterInputs) -> FilterResult:
        """Decide, and check the command as it will be sent; ArithmeticError when it must not be."""
        # Numbers beyond any use (1e308 m/s) are caught by checks, not by warnings.
        with np.errstate(all="ignore"):
            self._movers.update(inputs.grid_age_s)
            cap = self._limiter.begin(inputs, self._find_pending())
            result = self._decide(inputs, cap)
        if not np.isfinite(result.u_safe).all():
            raise ArithmeticError(f"the command became {result.u_safe}")
        if not cap.allows(result.u_safe):
            raise ArithmeticError(f"the command {result.u_safe} exceeds the speed cap of {cap.speed_mps:.3g} m/s")
        if result.mode != Mode.DISABLED and not self._kinematics.allows(result.u_safe):
            raise ArithmeticError(f"a base of kind {self._params.kinematics} cannot follow {result.u_safe}")
        return replace(result, speed_cap_mps=cap.speed_mps, speed_cap_reason=cap.reason)

    def _decide(self, inputs: FilterInputs, cap: CommandCap) -> FilterResult:
        if self._latched is None and self._params.enforce:
            self._watch_map(inputs)
        if self._latched is not None:
            stop = replace(self._latched, detail=f"{self._latched.detail}; call cbf_filter/reset")
            return self._observe(inputs, replace(_stopped(inputs, stop), latched=True))
        stop = find_stop(inputs, self._params)
        if stop is not None:
            self._profile.reset()
            return self._observe(inputs, _stopped(inputs, stop))
        if not self._params.enforce:
            u = inputs.u_nominal
            return self._observe(inputs, FilterResult(Mode.DISABLED, u, u, detail="enforcement is switched off"))
        u_slowed = self._limiter.limit(inputs.u_nominal, cap)
        situation = replace(self._make_situation(inputs), u_nominal=u_slowed, cap=cap)
        try:
            proposal = (self._keeper or self._profile).propose(situation)
        except SolverError as error:
            return self._observe(inputs, _stopped(inputs, Stop(Reason.SOLVER_FAILED, str(error))))
        if proposal.latch is not None:
            self.latch(proposal.latch.detail, proposal.latch.reason)
            return self._decide(inputs, cap)
        return self._report(inputs, situation, proposal)

    def _watch_map(self, inputs: FilterInputs) -> None:
        """Latch when the map's memory begins later than it did: the hazards it held are no longer in it."""
        if inputs.field is None:
            return
        start_s = inputs.field.grid.history_start_s
        if start_s > self._history_start_s:
            self.latch(f"the map began anew at {start_s:.2f} s and lost what it held", Reason.MAP_LOST)
        self._history_start_s = start_s

    def _make_situation(self, inputs: FilterInputs) -> Situation:
        u_previous = self._sent[-1] if self._sent else np.zeros(3)
        u_nominal = np.zeros(3) if inputs.u_nominal is None else inputs.u_nominal
        field = None if inputs.field is None else self._movers.apply(inputs.field)
        return Situation(field, inputs.pose, inputs.twist, u_nominal, u_previous, self._find_pending())

    def _find_pending(self) -> list:
        """Commands on their way: the one sent j ticks ago acts from delay - j dt to delay - (j - 1) dt from now on."""
        delay_s, period_s = self._params.delay_s, self._params.control_period_s
        pending = []
        for j in range(math.ceil(delay_s / period_s - 1e-9), 0, -1):
            duration_s = delay_s - (j - 1) * period_s - max(0.0, delay_s - j * period_s)
            pending.append((self._sent[-j] if j <= len(self._sent) else np.zeros(3), duration_s))
        return pending

    def _observe(self, inputs: FilterInputs, result: FilterResult) -> FilterResult:
        """Add h and its gradient where grid and odometry allow to know them, whatever their age."""
        if not self._can_see(inputs):
            return result
        clearance = self._profile.compute_clearance(self._make_situation(inputs))
        result = replace(result, h_m=clearance.h_m, gradient=clearance.gradient)
        if result.mode == Mode.OVERRIDE:
            result = replace(result, binding=make_binding(inputs.field, clearance.cell, clearance.point_m))
        return result

    def _can_see(self, inputs: FilterInputs) -> bool:
        """Whether grid and odometry hold what they should, whatever their age."""
        ageless = replace(inputs, odometry_age_s=0.0, grid_age_s=0.0, constraints_age_s=0.0)
        return not (find_odometry_stop(ageless, self._params) or find_grid_stop(ageless, self._params))

    def _report(self, inputs: FilterInputs, situation: Situation, proposal: Proposal) -> FilterResult:
        clearance, u_nominal = proposal.clearance, inputs.u_nominal
        changed = not np.array_equal(proposal.u, u_nominal)
        mode = Mode.FILTERED if changed else Mode.NOMINAL
        if clearance.h_m < 0.0 and self._params.profile == "core":
            mode = Mode.HOLD
        return FilterResult(
            mode if proposal.mode is None else proposal.mode,
            proposal.u,
            u_nominal,
            detail=_describe(inputs, situation, proposal) if changed else "",
            h_m=clearance.h_m,
            gradient=clearance.gradient,
            binding=proposal.binding,
            solve_time_s=proposal.solve_time_s,
            rows=proposal.rows,
            scale=proposal.scale,
        )


def _stopped(inputs: FilterInputs, stop: Stop) -> FilterResult:
    u = inputs.u_nominal
    # Whatever the caller gave for a command: a state can say three numbers of it.
    u_nominal = u if isinstance(u, np.ndarray) and u.shape == (3,) and u.dtype == float else np.full(3, NAN)
    return FilterResult(Mode.STOPPED, np.zeros(3), u_nominal, stop.reason, stop.detail)


def _describe(inputs: FilterInputs, situation: Situation, proposal: Proposal) -> str:
    """Everything that changed the command, in words."""
    parts = []
    if proposal.binding is not None:
        cause, (x_m, y_m) = proposal.binding.cause, proposal.binding.point_m
        where = f"{cause.describe()} at ({x_m:.2f}, {y_m:.2f})"
        parts.append(f"kept from {where}, clearance {proposal.clearance.h_m:.2f} m")
    elif not np.array_equal(proposal.u, situation.u_nominal):
        parts.append("limited")
    u_nominal = inputs.u_nominal
    if situation.u_nominal is not u_nominal or situation.cap.has_slowed:
        parts.append(situation.cap.describe(rests=np.any(u_nominal) and not np.any(situation.u_nominal)))
    return "; ".join(part for part in (*parts, proposal.note) if part)

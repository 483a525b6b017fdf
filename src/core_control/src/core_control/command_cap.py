# SPDX-License-Identifier: BSD-3-Clause
"""Every reason to go slower, in one cap: age of the constraints, slow regions, headings that were not seen."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Callable, Iterable, Tuple

import numpy as np

from core_control.dead_band import is_below_dead_band
from core_control.params import FilterParams
from core_control.proposal import scale_to_limits
from core_control.rollout import Pending
from core_control.seen_headings import SeenHeadings
from core_control.slow_regions import SlowRegions
from core_control.speed_cap import NO_CAP, AgeLimiter, CapReason, SpeedCap
from core_control.types import FilterInputs

# A cap on the speed [m/s], its code, and what follows "slowed to 0.2 m/s" in words.
PlaceCap = Tuple[float, str, str]


class CommandCap:
    """The speed cap of one tick; it tightens with every command it is shown, and never widens.

    Which region a command leads into and along which heading depends on the command. The nominal command is shown
    first, then the solver's answer: what is sent keeps within the smallest cap of both.

    Args:
        age_cap: cap from the age of the constraints.
        age_s: that age [s].
        find_place_caps: caps that depend on a command within the limits.
        params: parameters of the filter.

    Attributes:
        cap: the smallest so far.
        reason: code of the smallest cap on the speed; empty while there is none.
        has_slowed: a command was made smaller.
    """

    def __init__(
        self,
        age_cap: SpeedCap,
        age_s: float,
        find_place_caps: Callable[[np.ndarray], Iterable[PlaceCap]],
        params: FilterParams,
    ):
        """Begin with the cap that every command has."""
        self.cap, self.reason, self._words, self.has_slowed = age_cap, "", "", False
        if age_cap != NO_CAP:
            self.reason, self._words = CapReason.CONSTRAINTS_AGE, f": constraints are {age_s:.1f} s old"
        self._find_place_caps, self._params = find_place_caps, params

    @property
    def speed_mps(self) -> float:
        """Smallest cap on the linear speed so far [m/s]; infinite while there is none."""
        return self.cap.speed_mps

    def limit(self, u: np.ndarray) -> np.ndarray:
        """The command (3,) made smaller as a whole; u itself where no cap it leads to is smaller.

        What a place leaves of it becomes zero below the dead-band.
        """
        before_mps = self.cap.speed_mps
        for speed_mps, reason, words in self._find_place_caps(scale_to_limits(u, self._params.limits)):
            if speed_mps < self.cap.speed_mps:
                self.cap = replace(self.cap, speed_mps=speed_mps)
                self.reason, self._words = reason, words
        capped = self.cap.limit(u)
        self.has_slowed |= capped is not u
        if capped is u or self.cap.speed_mps == before_mps:
            return capped
        return np.zeros(3) if is_below_dead_band(capped, self._params) else capped

    def adopt(self, other: CommandCap) -> None:
        """Take over what another cap of the same tick has been shown, in place of what this one has."""
        self.cap, self.reason, self._words, self.has_slowed = other.cap, other.reason, other._words, other.has_slowed

    def allows(self, u: np.ndarray) -> bool:
        """Whether the command (3,) keeps within the smallest cap so far."""
        return self.cap.allows(u)

    def describe(self, rests: bool) -> str:
        """Why the command was made smaller, in words; rests: nothing is left of it."""
        to = "" if self.reason == CapReason.CONSTRAINTS_AGE else f" to {self.cap.speed_mps:.2g} m/s"
        return "slowed" + (" to rest" if rests else to) + self._words


class SpeedLimiter:
    """Makes the nominal command smaller where the constraints grow old, in slow regions and towards unseen headings.

    A command which a cap pushes below the dead-band becomes zero, and stays zero until one exceeds the band
    dead_band_release times.

    Args:
        params: parameters of the filter. Slow regions and headings play no part in profile `paper`, nothing does where
            enforcement is off.
    """

    def __init__(self, params: FilterParams):
        """Start in motion, with nothing seen."""
        self._params = params
        self._ages, self._regions, self._headings = AgeLimiter(params), SlowRegions(params), SeenHeadings(params)
        self._resting = False

    def reset(self) -> None:
        """Forget what was seen, and that a cap brought the robot to rest."""
        self._resting = False
        self._headings.reset()

    def tighten(self, params: FilterParams) -> None:
        """Go on with parameters that allow less; what was seen stays."""
        self._params, self._ages = params, AgeLimiter(params)

    def begin(self, inputs: FilterInputs, pending: Pending) -> CommandCap:
        """The cap of a new tick; called once a tick, whatever becomes of it.

        Args:
            inputs: newest inputs.
            pending: commands on their way, as Situation.pending.
        """
        self._headings.update(inputs)
        age_s = inputs.constraints_age_s
        return CommandCap(
            self._ages.compute_cap(age_s), age_s, lambda u: self._find_place_caps(inputs, pending, u), self._params
        )

    def limit(self, u: np.ndarray, cap: CommandCap) -> np.ndarray:
        """The command within the cap or zero; u itself where the cap plays no part.

        Args:
            u: (3,) nominal command [m/s, m/s, rad/s], finite.
            cap: the one of this tick; it is tightened.
        """
        capped = cap.limit(u)
        if cap.cap == NO_CAP:
            self._resting = False
        if capped is u and not self._resting:
            return u
        factor = self._params.dead_band_release if self._resting else 1.0
        self._resting = is_below_dead_band(capped, self._params, factor)
        return np.zeros(3) if self._resting else capped

    def _find_place_caps(self, inputs: FilterInputs, pending: Pending, u: np.ndarray) -> Iterable[PlaceCap]:
        if self._params.profile != "core" or not self._params.enforce:
            return
        found = self._regions.find(inputs.field, (inputs.pose, inputs.twist, pending), u)
        if found is not None:
            speed_mps, cause = found
            yield speed_mps, CapReason.SLOW_REGION, f" by {cause.rule or 'a slow region'}"
        heading_rad = inputs.pose[2] + math.atan2(u[1], u[0])
        if (u[0] or u[1]) and not self._headings.is_seen(heading_rad):
            words = f": the camera has not looked where it goes for {self._params.unseen_after_s:g} s"
            yield self._params.unseen_speed_mps, CapReason.UNSEEN_HEADING, words

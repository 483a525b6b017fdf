# SPDX-License-Identifier: BSD-3-Clause
"""Zero for what a barrier left of a command when the gait cannot follow it, without switching back and forth."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Tuple

import numpy as np

from core_control.params import FilterParams

# A robot at rest goes on when the command has exceeded the band for so long [s].
RELEASE_S = 0.5
# Time for which the band leaves it at what it has switched to [s].
STAY_S = 1.0


def is_below_dead_band(u: np.ndarray, params: FilterParams, factor: float = 1.0) -> bool:
    """Whether the gait cannot follow a command (3,): slower than factor times the dead-band, and turning slower too."""
    slow = np.hypot(u[0], u[1]) < factor * params.dead_band_mps
    return bool(slow and abs(u[2]) < factor * params.dead_band_radps)


@dataclass(frozen=True)
class Rest:
    """State of the dead-band.

    Attributes:
        resting: the robot is held at rest.
        exceeded: for how many ticks the command has exceeded the band, while resting.
        stays: for how many ticks to come the band leaves it at that.
    """

    resting: bool = False
    exceeded: int = 0
    stays: int = 0


class DeadBand:
    """Holds the robot at rest while a barrier leaves less of its command than the gait can follow.

    At rest the command must exceed dead_band_release times the band for 0.5 s. A robot that has come to rest stays so
    for 1 s, and one that has been set going is not stopped by the band for 1 s: noise in the clearance neither makes it
    twitch nor go in jerks. A command that no barrier changes passes at once, and a zero always does.

    Args:
        params: parameters of the filter.
    """

    def __init__(self, params: FilterParams):
        """Start in motion."""
        self._params = params
        self._release = round(RELEASE_S / params.control_period_s)
        self._stay = round(STAY_S / params.control_period_s)
        self.state = Rest()

    def apply(self, u: np.ndarray, is_bound: bool) -> Tuple[np.ndarray, bool]:
        """The command to be sent, and whether the band made it zero.

        Args:
            u: (3,) what barrier and verifier left [m/s, m/s, rad/s].
            is_bound: a place made it other than it was asked for.
        """
        if not is_bound:
            self.state = Rest()
            return u, False
        state = replace(self.state, stays=max(0, self.state.stays - 1))
        self.state = self._hold(u, state) if state.resting else self._go(u, state)
        return (np.zeros(3), bool(np.any(u))) if self.state.resting else (u, False)

    def _hold(self, u: np.ndarray, state: Rest) -> Rest:
        if is_below_dead_band(u, self._params, self._params.dead_band_release):
            return replace(state, exceeded=0)
        state = replace(state, exceeded=state.exceeded + 1)
        goes = state.exceeded >= self._release and state.stays == 0
        return Rest(stays=self._stay) if goes else state

    def _go(self, u: np.ndarray, state: Rest) -> Rest:
        stops = not np.any(u) or (is_below_dead_band(u, self._params) and state.stays == 0)
        return Rest(resting=True, stays=self._stay) if stops else state

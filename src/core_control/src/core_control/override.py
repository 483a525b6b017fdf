# SPDX-License-Identifier: BSD-3-Clause
"""The operator drives past the filter: what he was granted and for how long, and the speeds that go with it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Optional

from core_control.exceptions import OverrideError
from core_control.modes import Reason
from core_control.params import FilterParams
from core_control.speed_cap import SpeedCap

# What no override passes: an emergency stop; a second writer on cmd_vel, for which no limit of ours holds; a fault in
# the program, whose limits cannot be trusted then.
NEVER_OVERRIDDEN = (Reason.E_STOP, Reason.FOREIGN_PUBLISHER, Reason.INTERNAL_ERROR)


def make_override_cap(params: FilterParams, speed_mps: float) -> SpeedCap:
    """Largest speeds under an override.

        speed = min(asked, override_max_speed, hypot(max_vx, max_vy)),  yaw rate = max_yaw_rate speed / hypot(...)

    Args:
        params: parameters of the filter.
        speed_mps: what the operator asked for, > 0.
    """
    fastest_mps = math.hypot(params.max_vx_mps, params.max_vy_mps)
    capped_mps = min(speed_mps, params.override_max_speed_mps, fastest_mps)
    return SpeedCap(capped_mps, params.max_yaw_rate_radps * capped_mps / fastest_mps)


@dataclass(frozen=True)
class Grant:
    """An override: speed and time; it begins with the first tick that reads it."""

    speed_mps: float
    duration_s: float
    start_s: float = math.nan


class Override:
    """Keeps the grant of the moment. Time is an argument, on the clock of the ticks.

    Args:
        params: parameters of the filter.
    """

    def __init__(self, params: FilterParams):
        """Start without one."""
        self._params = params
        self._grant: Optional[Grant] = None

    def tighten(self, params: FilterParams) -> None:
        """Go on with parameters that allow less."""
        self._params = params

    def request(self, speed_mps: float, duration_s: float) -> str:
        """Grant what was asked for, cut to the largest speed and time; a time of 0 ends an override.

        Returns:
            What was granted, in words.

        Raises:
            OverrideError: overrides are switched off, or a number makes no sense.
        """
        if not self._params.override_enabled:
            raise OverrideError("overrides are switched off (override_enabled)")
        if not (math.isfinite(duration_s) and duration_s >= 0.0):
            raise OverrideError(f"duration_s is {duration_s:g}, allowed a finite number >= 0")
        if duration_s == 0.0:
            was_running = self.is_running
            self.end()
            return "override ended" if was_running else "no override was running"
        if not (math.isfinite(speed_mps) and speed_mps > 0.0):
            raise OverrideError(f"speed_cap_mps is {speed_mps:g}, allowed a finite number > 0")
        granted_s = min(duration_s, self._params.override_max_s)
        self._grant = Grant(speed_mps, granted_s)
        cap = make_override_cap(self._params, speed_mps)
        return f"override at up to {cap.speed_mps:.3g} m/s and {cap.yaw_rate_radps:.3g} rad/s for {granted_s:g} s"

    @property
    def is_running(self) -> bool:
        """Whether there is a grant."""
        return self._grant is not None

    def end(self) -> None:
        """Take the grant back."""
        self._grant = None

    def read(self, now_s: float) -> Optional[float]:
        """Speed granted at this tick [m/s]; None without a grant, after its time, or when time has gone backwards."""
        grant = self._grant
        if grant is None:
            return None
        if math.isnan(grant.start_s):
            grant = self._grant = Grant(grant.speed_mps, grant.duration_s, now_s)
        if not 0.0 <= now_s - grant.start_s < grant.duration_s:
            self.end()
            return None
        return grant.speed_mps

# SPDX-License-Identifier: BSD-3-Clause
"""Speed caps, and the one that falls with the age of the constraints: the robot slows before it must stop."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from core_control.modes import FUTURE_SLACK_S
from core_control.params import FilterParams


class CapReason:
    """Codes of core_msgs/FilterState.speed_cap_reason."""

    CONSTRAINTS_AGE = "constraints_age"
    SLOW_REGION = "slow_region"
    UNSEEN_HEADING = "unseen_heading"
    OVERRIDE = "override"


# Share of a cap that counts as rounding.
ROUNDING = 1e-9


@dataclass(frozen=True)
class SpeedCap:
    """Largest speeds a command may ask for; infinite where nothing caps it.

    Attributes:
        speed_mps: of |(vx, vy)|, >= 0.
        yaw_rate_radps: of |yaw rate|, >= 0.
    """

    speed_mps: float = math.inf
    yaw_rate_radps: float = math.inf

    def limit(self, u: np.ndarray) -> np.ndarray:
        """The command made smaller as a whole, so that it keeps its direction; u itself where the cap allows it.

            s = min(1, speed / |(vx, vy)|, yaw rate / |w|),   u_capped = s u

        Args:
            u: (3,) vx, vy [m/s], w [rad/s], finite.
        """
        scales = [cap / size for size, cap in self._compare(u) if size > cap * (1.0 + ROUNDING)]
        return min(scales) * u if scales else u

    def allows(self, u: np.ndarray) -> bool:
        """Whether the command (3,) [m/s, m/s, rad/s] keeps within the cap."""
        return all(size <= cap * (1.0 + ROUNDING) for size, cap in self._compare(u))

    def _compare(self, u: np.ndarray) -> tuple:
        return ((math.hypot(u[0], u[1]), self.speed_mps), (abs(u[2]), self.yaw_rate_radps))


NO_CAP = SpeedCap()


class AgeLimiter:
    """Lets the cap fall while the constraints grow old.

        share(age) = 1                            for age <= fresh (no cap)
                   = (ttl - age) / (ttl - fresh)  between
                   = 0                            from ttl on, and while the age is unknown or in the future
        cap = share * (hypot(max_vx, max_vy), max_yaw_rate)

    At age = fresh the cap equals the largest command the limits allow, so that nothing jumps.

    Args:
        params: parameters of the filter; fresh is constraints_fresh_s, ttl is constraints_ttl_s. Where both are equal,
            constraints are not required or enforcement is off there is no cap.

    Differs from [CORE], which keeps its speed however old the answer is.
    """

    def __init__(self, params: FilterParams):
        """Find the speed from which the cap falls."""
        self._params = params
        self._speed_mps = math.hypot(*params.limits[:2])

    def compute_cap(self, age_s: float) -> SpeedCap:
        """Cap for an age of the constraints [s]; NaN stands for no constraints at all."""
        params = self._params
        if not (params.enforce and params.require_constraints):
            return NO_CAP
        fresh_s, ttl_s = params.constraints_fresh_s, params.constraints_ttl_s
        if -FUTURE_SLACK_S <= age_s <= fresh_s:
            return NO_CAP
        # Written so that NaN and stamps of another clock end in zero.
        share = (ttl_s - age_s) / (ttl_s - fresh_s) if fresh_s < age_s < ttl_s else 0.0
        return SpeedCap(share * self._speed_mps, share * params.limits[2])

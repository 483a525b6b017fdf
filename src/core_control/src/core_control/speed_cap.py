# SPDX-License-Identifier: BSD-3-Clause
"""The speed cap that falls with the age of the constraints: the robot slows before it must stop."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from core_control.modes import FUTURE_SLACK_S
from core_control.params import FilterParams

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

    def is_reached_by(self, u: np.ndarray) -> bool:
        """Whether the command (3,) [m/s, m/s, rad/s] is as fast as the cap allows, or faster."""
        return any(size >= cap * (1.0 - ROUNDING) for size, cap in self._compare(u))

    def _compare(self, u: np.ndarray) -> tuple:
        return ((math.hypot(u[0], u[1]), self.speed_mps), (abs(u[2]), self.yaw_rate_radps))


NO_CAP = SpeedCap()


class AgeLimiter:
    """Slows the nominal command down while the constraints grow old.

        share(age) = 1                            for age <= fresh (no cap)
                   = (ttl - age) / (ttl - fresh)  between
                   = 0                            from ttl on, and while the age is unknown or in the future
        cap = share * (hypot(max_vx, max_vy), max_yaw_rate)

    At age = fresh the cap equals the largest command the limits allow, so that nothing jumps. A command which the cap
    pushes below the dead-band becomes zero, and stays zero until one exceeds the band dead_band_release times.

    Args:
        params: parameters of the filter; fresh is constraints_fresh_s, ttl is constraints_ttl_s. Where both are equal,
            constraints are not required or enforcement is off there is no cap.

    Differs from [CORE], which keeps its speed however old the answer is.
    """

    def __init__(self, params: FilterParams):
        """Start in motion."""
        self._params = params
        self._speed_mps = math.hypot(params.max_vx_mps, params.max_vy_mps)
        self._resting = False

    def reset(self) -> None:
        """Forget that the cap brought the robot to rest."""
        self._resting = False

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
        return SpeedCap(share * self._speed_mps, share * params.max_yaw_rate_radps)

    def limit(self, u: np.ndarray, cap: SpeedCap) -> np.ndarray:
        """The command within the cap or zero; u itself where the cap plays no part.

        Args:
            u: (3,) nominal command [m/s, m/s, rad/s], finite.
            cap: the one of this tick.
        """
        if cap == NO_CAP:
            self._resting = False
            return u
        capped = cap.limit(u)
        if capped is u and not self._resting:
            return u
        factor = self._params.dead_band_release if self._resting else 1.0
        slow = math.hypot(capped[0], capped[1]) < factor * self._params.dead_band_mps
        self._resting = slow and abs(capped[2]) < factor * self._params.dead_band_radps
        return np.zeros(3) if self._resting else capped

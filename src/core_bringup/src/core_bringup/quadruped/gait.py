# SPDX-License-Identifier: BSD-3-Clause
"""The trot: when each foot stands, where it is put down and on which path it flies there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Tuple

import numpy as np

LEG_OFFSETS = np.array([0.0, 0.5, 0.5, 0.0])


class TrotClock:
    """Phase of a trot in [0, 1); legs FR and RL swing together, FL and RR half a cycle later."""

    def __init__(self, cycle_s: float, duty: float):
        """Keep the cycle time [s] and the share of it that a foot stands, more than 0.5."""
        self._cycle_s, self._duty = cycle_s, duty
        self.phase = 0.0

    @property
    def leg_phases(self) -> np.ndarray:
        """(4,) phase of each leg in [0, 1); a leg stands while its phase is below duty."""
        return (self.phase + LEG_OFFSETS) % 1.0

    @property
    def stance_time_s(self) -> float:
        """Time a foot stands per cycle [s]."""
        return self._cycle_s * self._duty

    @property
    def swing_time_s(self) -> float:
        """Time a foot flies per cycle [s]."""
        return self._cycle_s * (1.0 - self._duty)

    def advance(self, duration_s: float) -> None:
        """Move on by duration_s."""
        self.phase = (self.phase + duration_s / self._cycle_s) % 1.0

    def compute_swing(self) -> Tuple[np.ndarray, np.ndarray]:
        """Which legs are due to fly, (4,) bool, and how far each has come, (4,) in [0, 1]; 0 while it stands."""
        progress = (self.leg_phases - self._duty) / (1.0 - self._duty)
        return progress >= 0.0, np.maximum(progress, 0.0)


def compute_footholds(p_world_hips, v_wanted, v_now, remaining_s, stance_time_s, speed_gain_s):
    """Where the feet should land (Raibert), so that each hip passes over its foot in the middle of the stance.

        p = p_hip + v_wanted (t_left + T_stance / 2) + k (v_now - v_wanted)

    Args:
        p_world_hips: (n, 2) neutral foot places under the body now [m], world.
        v_wanted: (2,) or (n, 2) wanted velocity of each place [m/s], world.
        v_now: (2,) velocity of the body now, world.
        remaining_s: (n,) time left until touchdown [s].
        stance_time_s: length of the coming stance [s].
        speed_gain_s: k [s].

    Returns:
        (n, 2) footholds [m], world.

    Source: Raibert, Legged Robots That Balance, 1986, ch. 2; k as measured for this robot.
    """
    ahead_s = np.asarray(remaining_s)[:, None] + 0.5 * stance_time_s
    return p_world_hips + v_wanted * ahead_s + speed_gain_s * (v_now - v_wanted)


@dataclass(frozen=True)
class SwingPath:
    """Position (n, 3) [m] and velocity (n, 3) [m/s] of swinging feet, world."""

    position_m: np.ndarray
    velocity_mps: np.ndarray


def compute_swing_path(progress, start_m, end_m, apex_z_m, swing_time_s):
    """Point of a swing: quintic over the ground, cubic up and cubic down, at rest at both ends.

        xy: p = p0 + (p1 - p0) b(s),      b(s) = s^3 (10 - 15 s + 6 s^2)
        z:  z0 -> apex for s < 1/2, apex -> z1 after it, by c(r) = r^2 (3 - 2 r), r = 2 s or 2 s - 1

    Args:
        progress: (n,) s in [0, 1].
        start_m: (n, 3) place of lift-off.
        end_m: (n, 3) place of touchdown.
        apex_z_m: (n,) or number, height at s = 1/2.
        swing_time_s: length of the swing [s].

    Returns:
        SwingPath.
    """
    s = progress
    blend, rate = s**3 * (10.0 - 15.0 * s + 6.0 * s * s), 30.0 * s * s * (1.0 - s) ** 2 / swing_time_s
    span = end_m - start_m
    position, velocity = start_m + span * blend[:, None], span * rate[:, None]
    rising = s < 0.5
    r = np.where(rising, 2.0 * s, 2.0 * s - 1.0)
    low = np.where(rising, start_m[:, 2], apex_z_m)
    high = np.where(rising, apex_z_m, end_m[:, 2])
    position[:, 2] = low + (high - low) * r * r * (3.0 - 2.0 * r)
    velocity[:, 2] = (high - low) * 6.0 * r * (1.0 - r) * 2.0 / swing_time_s
    return SwingPath(position, velocity)

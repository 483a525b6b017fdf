# SPDX-License-Identifier: BSD-3-Clause
"""Sim time against wall time: how long to sleep, and how fast the run really was. Both times are arguments."""

from __future__ import annotations

from typing import Optional, Tuple

MAX_LAG_S = 0.25  # a run that is further behind than this does not try to catch up


class Pacer:
    """Keeps sim time at rtf times wall time."""

    def __init__(self, rtf: float):
        """Rtf >= 0 [sim seconds per wall second]; 0 never waits."""
        self._rtf = rtf
        self._origin: Optional[Tuple[float, float]] = None

    def reset(self) -> None:
        """Start anew from the next call of compute_delay_s."""
        self._origin = None

    def compute_delay_s(self, sim_s: float, wall_s: float) -> float:
        """Wall time to wait before sim time sim_s is due; 0 when it is due or late.

        delay = wall_0 + (sim - sim_0) / rtf - wall
        """
        if self._rtf == 0.0:
            return 0.0
        if self._origin is None:
            self._origin = (sim_s, wall_s)
        delay_s = self._origin[1] + (sim_s - self._origin[0]) / self._rtf - wall_s
        if delay_s < -MAX_LAG_S:
            self._origin = (sim_s, wall_s)
        return max(delay_s, 0.0)


class RtfMeter:
    """Measures the real-time factor over windows of wall time."""

    def __init__(self, window_s: float = 1.0):
        """window_s: shortest stretch of wall time of one figure."""
        self._window_s = window_s
        self._start: Optional[Tuple[float, float]] = None

    def update(self, sim_s: float, wall_s: float) -> Optional[float]:
        """Note both times; a figure when a window is full, else None. Sim time that goes back starts a new window."""
        if self._start is None or sim_s < self._start[0]:
            self._start = (sim_s, wall_s)
            return None
        sim_0, wall_0 = self._start
        if wall_s - wall_0 < self._window_s:
            return None
        self._start = (sim_s, wall_s)
        return (sim_s - sim_0) / (wall_s - wall_0)

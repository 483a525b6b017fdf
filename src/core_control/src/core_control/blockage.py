# SPDX-License-Identifier: BSD-3-Clause
"""Notices that the robot is asked to move and not let, and says by what: an event a planner or an operator can use."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from typing import Optional, Tuple

import numpy as np

from core_control.dead_band import is_below_dead_band
from core_control.modes import Reason
from core_control.params import FilterParams
from core_control.types import Binding, FilterResult, Mode

# Share of the wanted progress below which a command counts as blocked, and above which it no longer does.
BLOCKED_SHARE, FREE_SHARE = 0.2, 0.4
# What holds the robot must be another thing for so long before it is named [s]; a pause of the wanted command as well.
SETTLE_S = 0.5
# Time between two events while nothing changes [s].
REPEAT_S = 1.0
# The command itself is at fault: nobody asks for motion then.
NO_COMMAND = (
    Reason.WAITING_FOR_NOMINAL,
    Reason.NOMINAL_STALE,
    Reason.NOMINAL_NOT_FINITE,
    Reason.NOMINAL_NOT_PLANAR,
    Reason.NOMINAL_PUBLISHERS,
)


@dataclass(frozen=True)
class Blockage:
    """One event; the fields are those of core_msgs/Blocked.

    Attributes:
        active: False when it is over.
        binding: the place that holds the robot; None while no place does.
        reason: code of the stop, or of the speed cap; empty while a place holds the robot.
        duration_s: how long it has lasted.
    """

    active: bool
    binding: Optional[Binding]
    reason: str
    duration_s: float

    @property
    def words(self) -> str:
        """For example ``blocked by AROUND(person) at (3.10, 0.42) for 4.2 s``."""
        by = self.reason or "the filter"
        if self.binding is not None:
            x_m, y_m = self.binding.point_m
            by = f"{self.binding.cause.describe()} at ({x_m:.2f}, {y_m:.2f})"
        return f"{'blocked' if self.active else 'no longer blocked'} by {by} for {self.duration_s:.1f} s"

    @property
    def key(self) -> tuple:
        """What must change for it to be another thing that holds the robot; the nearest point moves all the time."""
        cause = None if self.binding is None else self.binding.cause
        return self.reason, cause


class StuckDetector:
    """Compares what was asked with what was sent.

        z = W u,  asked = |z_nominal|,  got = z_nominal . z_safe / |z_nominal|  (0 for u_safe below the dead-band)
        blocked:  sum of got < 0.2 * sum of asked over blocked_after_s, all of which asked for motion
        free:     sum of got >= 0.4 * sum of asked over the last 0.5 s, or 0.5 s in which nobody asked

    An event is sent at the beginning, when another rule, instance or reason has been what holds the robot for 0.5 s,
    once a second, and at the end.

    Args:
        params: parameters of the filter.
    """

    def __init__(self, params: FilterParams):
        """Start free."""
        self._params = params
        self._period_s = params.control_period_s
        self._current: Optional[Blockage] = None
        self._over: Optional[Blockage] = None
        self._window = self._count(params.blocked_after_s)
        self._settle = self._count(SETTLE_S)
        self.reset()

    def _count(self, duration_s: float) -> int:
        return max(1, round(duration_s / self._period_s))

    def reset(self) -> None:
        """Forget what was asked; what blocked is over."""
        self._over = self._over or (self._current and self._end())
        self._ticks = deque(maxlen=self._window)
        self._recent = deque(maxlen=self._settle)
        self._held = 0
        self._current = None
        self._other, self._other_ticks = None, 0
        self._since_event = 0

    def step(self, result: FilterResult) -> FilterResult:
        """The result with blocked_s, the event of this tick if there is one, and the same in its detail."""
        # Numbers beyond any use (1e308 m/s) are caught by checks, not by warnings.
        with np.errstate(all="ignore"):
            asked, got = self._compare(result)
        self._recent.append((asked, got))
        if asked > 0.0:
            self._ticks.append((asked, got))
        quiet = not any(asked for asked, _ in self._recent)
        if quiet:
            self._ticks.clear()
        event = self._begin(result) if self._current is None else self._go_on(result, quiet)
        event, self._over = self._over or event, None
        if self._current is None:
            return replace(result, blocked_event=event) if event else result
        detail = "; ".join(part for part in (result.detail, self._current.words) if part)
        return replace(result, blocked_s=self._current.duration_s, blocked_event=event, detail=detail)

    def _compare(self, result: FilterResult) -> Tuple[float, float]:
        """What was asked and what of it was sent [m/s]."""
        u, params = result.u_nominal, self._params
        if result.mode in (Mode.DISABLED, Mode.OVERRIDE) or result.reason in NO_COMMAND or not np.isfinite(u).all():
            return 0.0, 0.0
        if is_below_dead_band(u, params):
            return 0.0, 0.0
        wanted = params.weights * u
        asked = float(np.linalg.norm(wanted))
        # Numbers beyond any use ask for motion; how much of it was sent cannot be said.
        if not np.isfinite(asked) or is_below_dead_band(result.u_safe, params) or result.mode == Mode.ESCAPE:
            return min(asked, 1.0), 0.0
        return asked, float(wanted @ (params.weights * result.u_safe)) / asked

    def _begin(self, result: FilterResult) -> Optional[Blockage]:
        asked, got = np.sum(self._ticks, axis=0) if self._ticks else (0.0, 0.0)
        if len(self._ticks) < self._window or got >= BLOCKED_SHARE * asked:
            return None
        self._held, self._other_ticks, self._since_event = self._window, 0, 0
        self._current = self._look(result)
        return self._current

    def _go_on(self, result: FilterResult, quiet: bool) -> Optional[Blockage]:
        self._held += 1
        self._since_event += 1
        asked, got = np.sum(self._recent, axis=0)
        if quiet or (asked > 0.0 and got >= FREE_SHARE * asked):
            self.reset()
            return None
        changed = self._follow(self._look(result))
        if not changed and self._since_event * self._period_s < REPEAT_S - 1e-9:
            return None
        self._since_event = 0
        return self._current

    def _end(self) -> Blockage:
        return replace(self._current, active=False, duration_s=self._held * self._period_s)

    def _look(self, result: FilterResult) -> Blockage:
        reason = "" if result.binding is not None else result.reason or result.speed_cap_reason
        return Blockage(True, result.binding, reason, self._held * self._period_s)

    def _follow(self, seen: Blockage) -> bool:
        """Whether another thing has held the robot for long enough to be named; keeps the current one up to date."""
        if seen.key == self._current.key:
            self._current, self._other_ticks = seen, 0
            return False
        self._other_ticks = self._other_ticks + 1 if seen.key == self._other else 1
        self._other = seen.key
        changed = self._other_ticks >= self._settle
        self._current = seen if changed else replace(self._current, duration_s=seen.duration_s)
        self._other_ticks = 0 if changed else self._other_ticks
        return changed

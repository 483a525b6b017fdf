# SPDX-License-Identifier: BSD-3-Clause
"""Pause, single steps and reset of a running world, asked for by service threads, obeyed between ticks."""

from __future__ import annotations

import threading
import time
from typing import Callable


class RunControl:
    """A switch shared by two sides.

    Service threads call pause, unpause, step and reset; the last two wait until the loop has obeyed. The loop calls
    wait_for_turn before every tick and tick_done after it.
    """

    def __init__(self, paused: bool = False):
        """Start running or paused."""
        self._changed = threading.Condition()
        self._paused, self._steps_left, self._reset_asked, self._resets = paused, 0, 0, 0
        self._ended = False

    def pause(self) -> None:
        """Stop after the tick that is under way; steps still owed are dropped."""
        with self._changed:
            self._paused, self._steps_left = True, 0
            self._changed.notify_all()

    def unpause(self) -> None:
        """Go on."""
        with self._changed:
            self._paused, self._steps_left = False, 0
            self._changed.notify_all()

    @property
    def is_paused(self) -> bool:
        """Whether the world stands; also while single steps are made."""
        with self._changed:
            return self._paused

    def end(self) -> None:
        """Let everybody who waits return."""
        with self._changed:
            self._ended = True
            self._changed.notify_all()

    def step(self, ticks: int, timeout_s: float) -> str:
        """Make a paused world do ticks periods and wait for the last; empty text, or why it did not happen."""
        if ticks < 1:
            return f"ticks: got {ticks}; allowed: >= 1"
        with self._changed:
            if not self._paused:
                return "the world is running; allowed: step only while paused"
            if self._steps_left:
                return "another step is under way"
            self._steps_left = ticks
            self._changed.notify_all()
            return self._wait(lambda: self._steps_left == 0, timeout_s, "the step")

    def reset(self, timeout_s: float) -> str:
        """Ask for a reset and wait until it is done; empty text, or why it did not happen."""
        with self._changed:
            self._reset_asked += 1
            mine = self._reset_asked
            self._changed.notify_all()
            return self._wait(lambda: self._resets >= mine, timeout_s, "the reset")

    def wait_for_turn(self, on_reset: Callable[[], None], timeout_s: float) -> bool:
        """Loop side: obey resets, then return whether a tick may be done now; waits at most timeout_s while paused."""
        with self._changed:
            asked = self._reset_asked
        if asked > self._resets:
            on_reset()
            with self._changed:
                self._resets, self._steps_left = asked, 0
                self._changed.notify_all()
        with self._changed:
            if self._paused and not self._steps_left and self._reset_asked == self._resets and not self._ended:
                self._changed.wait(timeout_s)
            return (not self._paused or self._steps_left > 0) and self._reset_asked == self._resets and not self._ended

    def tick_done(self) -> None:
        """Loop side: a tick has been done."""
        with self._changed:
            if self._steps_left:
                self._steps_left -= 1
                self._changed.notify_all()

    def _wait(self, condition: Callable[[], bool], timeout_s: float, what: str) -> str:
        end_s = time.monotonic() + timeout_s
        while not condition():
            left_s = end_s - time.monotonic()
            if self._ended or left_s <= 0.0:
                return f"{what} was not done within {timeout_s:g} s" if left_s <= 0.0 else "the bridge is ending"
            self._changed.wait(left_s)
        return ""

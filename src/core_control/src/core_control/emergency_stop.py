# SPDX-License-Identifier: BSD-3-Clause
"""The emergency stop: a signal with a heartbeat, and a press that lasts until the next tick has seen it."""

from __future__ import annotations

import threading


class EmergencyStop:
    """Says why the robot must stand, from what came on the topic and by service. Time is an argument, on one clock.

    Once a signal has been heard its silence is a stop: a button whose cable is cut must stop the robot.

    Args:
        required: whether a signal must have been heard before the robot may move at all.
        timeout_s: age of the newest signal at which it counts as lost; infinite where the clock says nothing about it.
    """

    def __init__(self, required: bool, timeout_s: float):
        """Start with nothing heard."""
        self._required, self._timeout_s = required, timeout_s
        self._lock = threading.Lock()
        self._stop, self._heard_s, self._pressed = False, None, ""

    def receive(self, stop: bool, now_s: float) -> None:
        """Take one signal; a stop is remembered until take(), however soon its end follows."""
        with self._lock:
            self._stop, self._heard_s = stop, now_s
            if stop:
                self._pressed = "e_stop is true"

    def press(self, detail: str) -> None:
        """Stop once, for the reason in detail."""
        with self._lock:
            self._pressed = detail

    @property
    def is_awaited(self) -> bool:
        """Whether a signal is required and none has been heard yet."""
        return self._required and self._heard_s is None

    def find(self, now_s: float) -> str:
        """Why the robot must be stopped at this time, in words; empty when nothing asks for it."""
        with self._lock:
            return self._find(now_s)

    def take(self, now_s: float) -> str:
        """The same, and what was pressed is taken note of: from now on only a signal that stands counts."""
        with self._lock:
            found, self._pressed = self._find(now_s), ""
            return found

    def _find(self, now_s: float) -> str:
        if self._pressed or self._stop:
            return self._pressed or "e_stop is true"
        if self._heard_s is None:
            return ""
        # Written so that an age of NaN counts as lost.
        age_s = now_s - self._heard_s
        if age_s <= self._timeout_s:
            return ""
        return f"e_stop was last heard {age_s:.2f} s ago, limit {self._timeout_s:g} s"

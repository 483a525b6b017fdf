# SPDX-License-Identifier: BSD-3-Clause
"""Inputs of a lock-step run, matched by stamp: a tick is complete when everything made for it has come."""

from __future__ import annotations

import threading
from typing import Any, Optional, Tuple

from core_control.ros.latest_inputs import FieldCache, compute_constraints_age, make_inputs
from core_control.types import FilterInputs


class LockstepInputs:
    """Holds messages by stamp until the tick they belong to can be answered. Nothing here looks at a clock.

    Tick(t) with newest frame f needs odometry(t), nominal command(t) and the safety grid of f.
    """

    def __init__(self):
        """Start with nothing received."""
        self._lock = threading.Lock()
        self._held = {"nominal": {}, "odometry": {}, "grid": {}}
        self._tick: Optional[Any] = None
        self._answered_ns = -1
        self._cache = FieldCache()

    def store(self, name: str, message: Any) -> None:
        """Keep a stamped message; one of the same stamp replaces it."""
        with self._lock:
            self._held[name][message.header.stamp.to_nsec()] = message

    def store_tick(self, tick: Any) -> bool:
        """Keep the tick to answer.

        Returns:
            True when its stamp lies before the last answered one: time was reset, and whatever was held of the time
            after the tick is gone.
        """
        with self._lock:
            stamp_ns = tick.header.stamp.to_nsec()
            if stamp_ns == self._answered_ns:
                return False
            reset = stamp_ns < self._answered_ns
            if reset:
                self._answered_ns = -1
                self._drop(lambda held_ns: held_ns > stamp_ns)
            self._tick = tick
            return reset

    def take(self) -> Optional[Tuple[Any, FilterInputs]]:
        """The tick and its inputs once they are complete; each tick is given once."""
        with self._lock:
            if self._tick is None:
                return None
            tick, stamp_ns = self._tick, self._tick.header.stamp.to_nsec()
            grid_ns = tick.frame_stamp.to_nsec()
            keys = {"nominal": stamp_ns, "odometry": stamp_ns, "grid": grid_ns}
            found = {name: self._held[name].get(key) for name, key in keys.items()}
            if any(message is None for message in found.values()):
                return None
            self._tick, self._answered_ns = None, stamp_ns
            self._drop(lambda held_ns: held_ns < grid_ns)
        found["nominal"] = found["nominal"].twist
        now_s = tick.header.stamp.to_sec()
        ages = {
            "nominal": 0.0,
            "odometry": 0.0,
            "grid": (stamp_ns - grid_ns) * 1e-9,
            "constraints": compute_constraints_age(found["grid"], now_s),
        }
        return tick, make_inputs(found, self._cache, ages)

    def _drop(self, is_old) -> None:
        for held in self._held.values():
            for stamp_ns in [key for key in held if is_old(key)]:
                del held[stamp_ns]

# SPDX-License-Identifier: BSD-3-Clause
"""The command the robot walks by: the newest one, or zero when it is bad or too old."""

from __future__ import annotations

import math
from typing import Sequence

import numpy as np


class CommandHold:
    """Holds a body velocity command for at most timeout_s. Time is an argument, of one clock of the caller."""

    def __init__(self, timeout_s: float):
        """Hold nothing."""
        self._timeout_s = timeout_s
        self.reset()

    def reset(self) -> None:
        """Forget the command."""
        self._command, self._stamp_s = np.zeros(3), -math.inf

    def update(self, command: Sequence[float], now_s: float) -> bool:
        """Take a command (3,) vx, vy [m/s], yaw rate [rad/s]; False for one not finite, which counts as zero."""
        command = np.array(command, dtype=float)
        is_good = bool(np.all(np.isfinite(command)))
        self._command, self._stamp_s = (command if is_good else np.zeros(3)), now_s
        return is_good

    def at(self, now_s: float) -> np.ndarray:
        """Command (3,) in force; zero from timeout_s after the last update on."""
        return self._command.copy() if now_s - self._stamp_s < self._timeout_s else np.zeros(3)

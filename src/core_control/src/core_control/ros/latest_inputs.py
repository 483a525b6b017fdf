# SPDX-License-Identifier: BSD-3-Clause
"""Newest message of every input with its two ages: since its stamp in ROS time, since its receipt in monotonic time."""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass
from typing import Any, Optional

from core_control.exceptions import GridError
from core_control.modes import FUTURE_SLACK_S, Reason
from core_control.ros.conversions import grid_from_msg, is_planar, odometry_from_msg, twist_from_msg
from core_control.safety_field import SafetyField
from core_control.types import NAN, FilterInputs

NAMES = ("nominal", "odometry", "grid")


@dataclass(frozen=True)
class Received:
    """One message, when it came (monotonic) and when it was made (ROS time; NaN where it carries no stamp)."""

    message: Any
    receipt_s: float
    stamp_s: float


class FieldCache:
    """Safety field of the newest grid message; built once per message.

    Attributes:
        field: the field, or None.
        problem: (reason, detail) why there is none, or None.
    """

    def __init__(self):
        """Start empty."""
        self.clear()

    def clear(self) -> None:
        """Forget the grid."""
        self._message: Optional[Any] = None
        self.field: Optional[SafetyField] = None
        self.problem = None

    def update(self, message: Any) -> None:
        """Build the field unless it is the one held."""
        if message is self._message:
            return
        self.clear()
        self._message = message
        try:
            self.field = SafetyField(grid_from_msg(message))
        except (GridError, ValueError) as error:
            self.problem = (Reason.GRID_MALFORMED, str(error))


def make_inputs(received: dict, cache: FieldCache, ages: dict) -> FilterInputs:
    """Convert what was received.

    Args:
        received: name -> message or None, for NAMES; nominal is a Twist.
        cache: field cache; updated with the grid.
        ages: name -> age [s], for NAMES and ``constraints``.
    """
    values = {f"{name}_age_s": age for name, age in ages.items()}
    if received["nominal"] is not None:
        values["u_nominal"] = twist_from_msg(received["nominal"])
        values["nominal_planar"] = is_planar(received["nominal"])
    if received["odometry"] is not None:
        values["pose"], values["twist"] = odometry_from_msg(received["odometry"])
        values["odometry_frame_id"] = received["odometry"].header.frame_id
    if received["grid"] is None:
        cache.clear()
    else:
        cache.update(received["grid"])
        values["field"], values["grid_problem"] = cache.field, cache.problem
    return FilterInputs(**values)


class LatestInputs:
    """Keeps the newest message per input; callbacks store, the loop reads. One lock, held only to copy."""

    def __init__(self):
        """Start with nothing received."""
        self._lock = threading.Lock()
        self._received = dict.fromkeys(NAMES)
        self._cache = FieldCache()
        self._last_ros_s = -math.inf

    def store(self, name: str, message: Any, receipt_s: float, stamp_s: float = NAN) -> None:
        """Keep a message; receipt_s is monotonic, stamp_s in ROS time."""
        with self._lock:
            self._received[name] = Received(message, receipt_s, stamp_s)

    def clear(self) -> None:
        """Forget every message."""
        with self._lock:
            self._received = dict.fromkeys(NAMES)

    def read(self, monotonic_s: float, ros_s: float) -> FilterInputs:
        """Inputs with their ages, age = max(time since the stamp, time since receipt).

        A stamp more than FUTURE_SLACK_S in the future gives its negative age, which no limit allows.
        When ROS time has gone backwards since the last read everything received before is forgotten.

        Args:
            monotonic_s: now on the clock of store.
            ros_s: now in ROS time.
        """
        with self._lock:
            if ros_s < self._last_ros_s:
                self._received = dict.fromkeys(NAMES)
            self._last_ros_s = ros_s
            received = dict(self._received)
        ages = {name: _compute_age(received[name], monotonic_s, ros_s) for name in NAMES}
        messages = {name: entry.message if entry else None for name, entry in received.items()}
        ages["constraints"] = compute_constraints_age(messages["grid"], ros_s)
        return make_inputs(messages, self._cache, ages)

    def jumped_back(self, ros_s: float) -> bool:
        """Whether ROS time now lies before that of the last read."""
        return ros_s < self._last_ros_s


def _compute_age(entry: Optional[Received], monotonic_s: float, ros_s: float) -> float:
    if entry is None:
        return NAN
    since_receipt_s, since_stamp_s = monotonic_s - entry.receipt_s, ros_s - entry.stamp_s
    if math.isnan(since_stamp_s):
        return since_receipt_s
    return since_stamp_s if since_stamp_s < -FUTURE_SLACK_S else max(since_receipt_s, since_stamp_s)


def compute_constraints_age(grid: Any, now_s: float) -> float:
    """Age of the constraints a grid was made with [s]; NaN while there are none, negative for a stamp in the future."""
    if grid is None or grid.constraints_stamp.is_zero():
        return NAN
    return now_s - grid.constraints_stamp.to_sec()

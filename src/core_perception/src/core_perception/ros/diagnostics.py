# SPDX-License-Identifier: BSD-3-Clause
"""How the nodes of the package tell on ``diagnostics`` how they are."""

from __future__ import annotations

import threading
import time
from typing import Callable, Mapping, Sequence

import rospy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

PERIOD_S = 1.0


def run_every(period_s: float, work: Callable[[], None]) -> None:
    """Call work from a thread of its own until the node ends.

    On the wall clock, which goes on when sim time stands still.
    """

    def run():
        while not rospy.is_shutdown():
            try:
                work()
            except rospy.ROSException:  # topics close while the node shuts down
                if not rospy.is_shutdown():
                    raise
            time.sleep(period_s)

    threading.Thread(target=run, name=work.__name__, daemon=True).start()


def make_status(part: str, level: int, message: str, values: Mapping[str, str], hardware_id="") -> DiagnosticStatus:
    """Return the status of one part of this node."""
    pairs = [KeyValue(key, value) for key, value in values.items()]
    return DiagnosticStatus(level, f"{rospy.get_name().lstrip('/')}: {part}", message, hardware_id, pairs)


class Diagnostics:
    """Publishes what a node says of itself, once a second."""

    def __init__(self, make_statuses: Callable[[], Sequence[DiagnosticStatus]]):
        """Connect the topic; make_statuses is asked from the thread that start() makes."""
        self._make_statuses = make_statuses
        self._publisher = rospy.Publisher("diagnostics", DiagnosticArray, queue_size=1)

    def start(self) -> None:
        """Begin to tell."""
        run_every(PERIOD_S, self.publish)

    def publish(self) -> None:
        """Tell now."""
        array = DiagnosticArray(status=list(self._make_statuses()))
        array.header.stamp = rospy.Time.now()
        self._publisher.publish(array)

# SPDX-License-Identifier: BSD-3-Clause
"""Listens to what the chain answers under lock-step and lets the loop wait for it."""

from __future__ import annotations

import threading
import time
from typing import Callable

import rospy
from core_msgs.msg import FilterState
from geometry_msgs.msg import Twist

from core_bringup.exceptions import StallError
from core_bringup.lockstep import CHAIN, LockstepMonitor, header_stamp_ns
from core_bringup.ros.conversions import command_from_msg, stamp_from_msg

POLL_S = 0.1  # longest sleep before shutdown is noticed


class ChainListener:
    """Feeds a LockstepMonitor from the topics of the chain. Stamps of big messages are read without decoding them."""

    def __init__(self, stall_timeout_s: float):
        """Subscribe to every stage and to cmd_vel."""
        self._monitor, self._changed = LockstepMonitor(stall_timeout_s), threading.Condition()
        for stage in CHAIN[:-1]:
            rospy.Subscriber(stage.topic, rospy.AnyMsg, self._on_stage, stage.topic, queue_size=10, tcp_nodelay=True)
        rospy.Subscriber(CHAIN[-1].topic, FilterState, self._on_state, queue_size=10, tcp_nodelay=True)
        rospy.Subscriber("cmd_vel", Twist, self._on_command, queue_size=10, tcp_nodelay=True)

    def reset(self) -> None:
        """Forget what has come."""
        with self._changed:
            self._monitor.reset()

    def begin(self, tick: int, stamp_ns: int, frame_stamp_ns: int) -> None:
        """Start to wait for a tick, before it is published."""
        with self._changed:
            self._monitor.begin(tick, stamp_ns, frame_stamp_ns, time.monotonic())

    def wait(self, has_ended: Callable[[], bool]) -> tuple:
        """Wait until the tick is answered; the command (3,) the chain has sent. Zero when the node ends meanwhile.

        Raises:
            StallError: no answer within the wall-clock limit; the message names topic and node awaited.
        """
        with self._changed:
            while not self._monitor.is_answered():
                left_s = self._monitor.seconds_left(time.monotonic())
                if left_s <= 0.0:
                    raise StallError(self._monitor.stall_report(time.monotonic()))
                if has_ended():
                    return (0.0, 0.0, 0.0)
                self._changed.wait(min(left_s, POLL_S))
            return self._monitor.command

    def _on_stage(self, message: rospy.AnyMsg, topic: str) -> None:
        self._note(lambda: self._monitor.note_stage(topic, header_stamp_ns(message._buff)))

    def _on_state(self, message: FilterState) -> None:
        stamp_ns = stamp_from_msg(message.header.stamp)
        self._note(lambda: self._monitor.note_acknowledgement(stamp_ns, message.u_safe))

    def _on_command(self, message: Twist) -> None:
        self._note(lambda: self._monitor.note_command(command_from_msg(message)))

    def _note(self, change: Callable[[], None]) -> None:
        with self._changed:
            change()
            if self._monitor.is_answered():
                self._changed.notify_all()

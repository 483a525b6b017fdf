# SPDX-License-Identifier: BSD-3-Clause
"""Sends cbf_filter/blocked when the filter has an event."""

from __future__ import annotations

import rospy
from core_msgs.msg import Blocked

from core_control.blockage import Blockage
from core_control.types import FilterInputs, FilterResult


def blocked_to_msg(event: Blockage, frame_id: str, stamp) -> Blocked:
    """Blocked of one event; stamp is a genpy.Time, frame_id that of the event's point."""
    message = Blocked()
    message.header.stamp, message.header.frame_id = stamp, frame_id
    message.active, message.reason, message.detail = event.active, event.reason, event.words
    if event.binding is not None:
        cause = event.binding.cause
        message.rule, message.class_name, message.instance_id = cause.rule, cause.class_name, cause.instance_id
        message.point.x, message.point.y = event.binding.point_m
    # Under /use_sim_time the clock may have begun later than the event.
    message.since = rospy.Time.from_sec(max(0.0, stamp.to_sec() - event.duration_s))
    message.duration_s = event.duration_s
    return message


class BlockedPublisher:
    """Publishes on cbf_filter/blocked."""

    def __init__(self):
        """Advertise."""
        self._pub = rospy.Publisher("cbf_filter/blocked", Blocked, queue_size=10)

    def publish(self, result: FilterResult, inputs: FilterInputs, stamp) -> None:
        """Send the event of a tick; nothing where it has none."""
        if result.blocked_event is not None:
            frame_id = inputs.field.grid.frame_id if inputs.field is not None else inputs.odometry_frame_id
            self._pub.publish(blocked_to_msg(result.blocked_event, frame_id, stamp))

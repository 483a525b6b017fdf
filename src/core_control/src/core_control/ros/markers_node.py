# SPDX-License-Identifier: BSD-3-Clause
"""Node filter_markers: draws cbf_filter/state for RViz; a node of its own, so that drawing never delays a command."""

from __future__ import annotations

import threading

import numpy as np
import rospy
from core_msgs.msg import FilterState
from nav_msgs.msg import Odometry
from visualization_msgs.msg import MarkerArray

from core_control.params import MarkerParams
from core_control.ros.conversions import odometry_from_msg
from core_control.ros.markers import make_markers
from core_control.ros.start import read_node_parameters


class MarkersNode:
    """Keeps the newest pose and draws each state at it.

    Args:
        params: checked parameters.
    """

    def __init__(self, params: MarkerParams):
        """Advertise, then subscribe."""
        self._params = params
        self._lock = threading.Lock()
        self._pose = None
        self._pub = rospy.Publisher("cbf_filter/markers", MarkerArray, queue_size=1)
        rospy.Subscriber("odom", Odometry, self._on_odometry, queue_size=1)
        rospy.Subscriber("cbf_filter/state", FilterState, self._on_state, queue_size=1)

    def _on_odometry(self, message: Odometry) -> None:
        pose, _ = odometry_from_msg(message)
        with self._lock:
            self._pose = pose if np.isfinite(pose).all() else None

    def _on_state(self, state: FilterState) -> None:
        with self._lock:
            pose = self._pose
        if pose is not None:
            self._pub.publish(make_markers(state, pose, self._params))


def main() -> None:
    """Start the node."""
    rospy.init_node("filter_markers")
    MarkersNode(read_node_parameters(MarkerParams))
    rospy.spin()

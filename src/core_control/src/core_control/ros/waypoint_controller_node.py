# SPDX-License-Identifier: BSD-3-Clause
"""Node waypoint_controller: one nominal command per odometry message."""

from __future__ import annotations

import threading

import rospy
from geometry_msgs.msg import Twist, TwistStamped
from nav_msgs.msg import Odometry, Path
from std_msgs.msg import Bool, Float64

from core_control.params import WaypointParams
from core_control.ros.conversions import odometry_from_msg, path_from_msg, twist_to_msg
from core_control.ros.start import read_node_parameters
from core_control.waypoint_controller import WaypointController


class WaypointControllerNode:
    """Converts, calls, publishes.

    Args:
        params: checked parameters.
    """

    def __init__(self, params: WaypointParams):
        """Advertise, then subscribe."""
        self._controller = WaypointController(params)
        self._lock = threading.Lock()
        self._stamp_ns = -1
        self._odom_frame = ""
        self._reached = None
        latch = params.lockstep
        self._cmd_pub = rospy.Publisher("cmd_vel_nominal", Twist, queue_size=1, latch=latch, tcp_nodelay=True)
        self._stamped_pub = rospy.Publisher(
            "cmd_vel_nominal_stamped", TwistStamped, queue_size=10, latch=latch, tcp_nodelay=True
        )
        self._reached_pub = rospy.Publisher("goal_reached", Bool, queue_size=1, latch=True)
        self._distance_pub = rospy.Publisher("waypoint_controller/distance_to_goal", Float64, queue_size=1)
        rospy.Subscriber("path", Path, self._on_path, queue_size=1)
        rospy.Subscriber("odom", Odometry, self._on_odometry, queue_size=10 if latch else 1, tcp_nodelay=True)

    def _on_path(self, message: Path) -> None:
        with self._lock:
            if message.header.frame_id != self._odom_frame:
                rospy.logerr("path is in frame '%s', odometry in '%s'", message.header.frame_id, self._odom_frame)
                return
            try:
                self._controller.set_waypoints(path_from_msg(message))
            except ValueError as error:
                rospy.logerr("path refused: %s", error)

    def _on_odometry(self, message: Odometry) -> None:
        with self._lock:
            self._odom_frame = message.header.frame_id
            stamp_ns = message.header.stamp.to_nsec()
            if stamp_ns == self._stamp_ns:
                return
            if stamp_ns < self._stamp_ns:
                self._controller.restart()
            self._stamp_ns = stamp_ns
            pose, _ = odometry_from_msg(message)
            self._publish(self._controller.step(pose, message.header.stamp.to_sec()), message)

    def _publish(self, command, odometry: Odometry) -> None:
        stamped = TwistStamped()
        stamped.header.stamp, stamped.header.frame_id = odometry.header.stamp, odometry.child_frame_id
        stamped.twist = twist_to_msg(command.u)
        self._cmd_pub.publish(stamped.twist)
        self._stamped_pub.publish(stamped)
        self._distance_pub.publish(Float64(command.distance_to_goal_m))
        if command.goal_reached != self._reached:
            self._reached = command.goal_reached
            self._reached_pub.publish(Bool(command.goal_reached))


def main() -> None:
    """Start the node."""
    rospy.init_node("waypoint_controller")
    WaypointControllerNode(read_node_parameters(WaypointParams))
    rospy.spin()

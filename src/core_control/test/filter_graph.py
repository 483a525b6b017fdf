# SPDX-License-Identifier: BSD-3-Clause
"""Latency of the node in a graph: from the start of a tick until its cmd_vel is here, for two nodes at once."""

import bisect
import threading
import time

import numpy as np
import rospy
from control_support import make_grid, make_random_mask
from core_msgs.msg import FilterState, SafetyGrid
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from ros_support import RatePublisher, grid_to_msg, wait_until

NAMES = ("filter", "null")
RATES_HZ = {"cmd_vel_nominal": 20.0, "odom": 50.0, "safety_grid": 10.0}
PERIOD_S = 0.05


class Listener:
    """Stamps of the ticks of one node, and when its commands came, both by the clock of the machine."""

    def __init__(self, namespace):
        self._lock, self.stamps_s, self.arrivals_s, self.modes = threading.Lock(), [], [], []
        rospy.Subscriber(f"/{namespace}/cmd_vel", Twist, self._on_command, queue_size=100, tcp_nodelay=True)
        rospy.Subscriber(
            f"/{namespace}/cbf_filter/state", FilterState, self._on_state, queue_size=100, tcp_nodelay=True
        )

    def _on_command(self, _message):
        now_s = time.time()
        with self._lock:
            self.arrivals_s.append(now_s)

    def _on_state(self, message):
        with self._lock:
            self.stamps_s.append(message.header.stamp.to_sec())
            self.modes.append(message.mode)

    def clear(self):
        with self._lock:
            self.stamps_s, self.arrivals_s, self.modes = [], [], []

    def latencies_s(self):
        """Of every tick: its command is the first to come after it."""
        with self._lock:
            places = [bisect.bisect_left(self.arrivals_s, stamp_s) for stamp_s in self.stamps_s]
            ends = [(stamp_s, i) for stamp_s, i in zip(self.stamps_s, places) if i < len(self.arrivals_s)]
            return np.array([self.arrivals_s[i] - stamp_s for stamp_s, i in ends])


def make_messages():
    """The three inputs: a command ahead, a robot at rest in a free spot, a grid of 100 x 100 cells around it."""
    unsafe = make_random_mask(np.random.default_rng(3))
    unsafe[44:56, 44:52] = False
    unsafe[44:56, 55] = True  # something ahead, so that there are programs to solve
    grid = grid_to_msg(make_grid(unsafe, resolution_m=0.2), rospy.Time(), rospy.Time())
    command, odometry = Twist(), Odometry()
    command.linear.x, command.angular.z = 0.4, 0.1
    odometry.header.frame_id, odometry.child_frame_id = "odom", "base_link"
    odometry.pose.pose.orientation.w = 1.0
    return {"cmd_vel_nominal": command, "odom": odometry, "safety_grid": grid}


def stamped(message):
    if hasattr(message, "header"):
        message.header.stamp = rospy.Time.now()
    if hasattr(message, "constraints_stamp"):
        message.constraints_stamp = rospy.Time.now()
    return message


def measure_through_ros(seconds):
    """Latencies [s] by name of the node; the graph must be there.

    Raises:
        AssertionError: a node does not answer, or the filter does not decide.
    """
    listeners = {name: Listener(name) for name in NAMES}
    kinds = {"cmd_vel_nominal": Twist, "odom": Odometry, "safety_grid": SafetyGrid}
    feeds = [
        RatePublisher(f"/{name}/{topic}", kinds[topic], lambda m=message: stamped(m), RATES_HZ[topic])
        for name in NAMES
        for topic, message in make_messages().items()
    ]
    wait_until(lambda: listeners["null"].stamps_s, 30.0, "null filter")
    wait_until(lambda: FilterState.FILTERED in listeners["filter"].modes, 30.0, "a command that is changed")
    for listener in listeners.values():
        listener.clear()
    time.sleep(seconds)
    for feed in feeds:
        feed.stop()
    return {name: listener.latencies_s() for name, listener in listeners.items()}

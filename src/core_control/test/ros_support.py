# SPDX-License-Identifier: BSD-3-Clause
"""Fakes for the rostests: publishers at a rate, a collector of answers, and waits with a deadline."""

import contextlib
import threading
import time
from xmlrpc.client import ServerProxy

import numpy as np
import rosgraph
import rospy
from control_support import make_grid
from core_msgs.msg import SafetyGrid, UnsafeCause

from core_control.ros.conversions import odometry_to_msg


def wait_until(condition, timeout_s=10.0, what="condition"):
    """Value of the condition as soon as it is true; AssertionError after the deadline."""
    deadline_s = time.monotonic() + timeout_s
    while time.monotonic() < deadline_s:
        value = condition()
        if value:
            return value
        time.sleep(0.002)
    raise AssertionError(f"{what}: not true within {timeout_s} s")


def grid_to_msg(grid, stamp, constraints_stamp) -> SafetyGrid:
    message = SafetyGrid()
    message.header.stamp, message.header.frame_id, message.constraints_stamp = stamp, grid.frame_id, constraints_stamp
    message.resolution_m, message.unknown_is_unsafe = grid.resolution_m, grid.unknown_is_unsafe
    message.height, message.width = grid.state.shape
    message.origin_x_m, message.origin_y_m = (float(value) for value in grid.origin_m)
    message.n_safe = message.n_unsafe = [0] * grid.state.size
    message.h_m = grid.h_m.ravel().tolist()
    message.state = grid.state.tobytes()
    message.cause = grid.cause.ravel().tolist()
    message.causes = [
        UnsafeCause(cause.rule, cause.class_name, cause.instance_id, UnsafeCause.MOBILE * cause.mobile)
        for cause in grid.causes
    ]
    message.speed_cap_mps = [] if grid.speed_cap_mps is None else grid.speed_cap_mps.ravel().tolist()
    return message


def make_odometry_msg(pose=(0.0, 0.0, 0.0), frame_id="odom", stamp=None):
    """Odometry of a robot that stands; stamped now unless told otherwise."""
    message = odometry_to_msg(np.array(pose, dtype=float), np.zeros(3), frame_id)
    message.header.stamp = stamp or rospy.Time.now()
    return message


def make_wall_msg(x_m, stamp, constraints_stamp, size_m=6.0) -> SafetyGrid:
    n = round(size_m / 0.1)
    unsafe = np.zeros((n, n), dtype=bool)
    unsafe[:, round((x_m + size_m / 2.0) / 0.1) :] = True
    return grid_to_msg(make_grid(unsafe), stamp, constraints_stamp)


def node_pid(name):
    """Process number of a node."""
    return ServerProxy(rosgraph.Master(rospy.get_name()).lookupNode(rospy.resolve_name(name))).getPid("/")[2]


class RatePublisher:
    """Publishes make() at a rate of wall time until stopped; stop unregisters, as a killed node would.

    silent publishes nothing and stays registered, as a hung node would. last_sent_s is the wall time [s] of the newest.
    """

    def __init__(self, topic, message_class, make, rate_hz):
        self.make, self._period_s = make, 1.0 / rate_hz
        self.silent, self.last_sent_s = False, 0.0
        self._topic, self._message_class = topic, message_class
        self._stop = threading.Event()
        self.start()

    def start(self):
        self._pub = rospy.Publisher(self._topic, self._message_class, queue_size=1)
        self._stop.clear()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def stop(self):
        self._stop.set()
        self._thread.join()
        self._pub.unregister()

    def _run(self):
        # A topic that is closed means that the test is over.
        with contextlib.suppress(rospy.ROSException):
            while not self._stop.wait(self._period_s):
                if not self.silent:
                    message, self.last_sent_s = self.make(), time.time()
                    self._pub.publish(message)


class Collector:
    """Keeps every message of a topic with its monotonic time of receipt."""

    def __init__(self, topic, message_class):
        self._lock, self._entries = threading.Lock(), []
        rospy.Subscriber(topic, message_class, self._on_message, queue_size=100, tcp_nodelay=True)

    def _on_message(self, message):
        with self._lock:
            self._entries.append((time.monotonic(), message))

    def clear(self):
        with self._lock:
            self._entries = []

    @property
    def entries(self):
        with self._lock:
            return list(self._entries)

    @property
    def last(self):
        entries = self.entries
        return entries[-1][1] if entries else None

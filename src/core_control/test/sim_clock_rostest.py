#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""Simulated time that flows, stands still and jumps back; both nodes in a loop with an exact robot and a path."""

import threading
import time
import unittest

import numpy as np
import rospy
import rostest
from control_support import Plant
from core_msgs.msg import FilterState, SafetyGrid
from geometry_msgs.msg import PoseStamped, Twist
from nav_msgs.msg import Odometry, Path
from ros_support import Collector, make_wall_msg, wait_until
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Bool, Float64

from core_control.ros.conversions import odometry_to_msg, twist_from_msg

PERIOD_S = 0.05


class FakeSimulator:
    """Clock, odometry and grid of an exact robot that obeys cmd_vel; can be paused and sent back in time."""

    def __init__(self):
        self.commands = Collector("cmd_vel", Twist)
        self.clock_pub = rospy.Publisher("/clock", Clock, queue_size=1)
        self.odom_pub = rospy.Publisher("odom", Odometry, queue_size=1)
        self.grid_pub = rospy.Publisher("safety_grid", SafetyGrid, queue_size=1)
        self.lock = threading.Lock()
        self.running, self.now_s, self.plant = threading.Event(), 100.0, Plant(np.zeros(3))
        self.running.set()
        threading.Thread(target=self.run, daemon=True).start()

    def run(self):
        while not rospy.is_shutdown():
            self.running.wait()
            with self.lock:
                self.step()
            time.sleep(PERIOD_S)

    def step(self):
        self.now_s += PERIOD_S
        now = rospy.Time.from_sec(self.now_s)
        command = self.commands.last
        self.plant.step(np.zeros(3) if command is None else twist_from_msg(command))
        odometry = odometry_to_msg(self.plant.pose, self.plant.twist)
        odometry.header.stamp = now
        self.clock_pub.publish(Clock(now))
        self.grid_pub.publish(make_wall_msg(2.0, now, now))
        self.odom_pub.publish(odometry)

    def reset(self, now_s):
        with self.lock:
            self.now_s, self.plant = now_s, Plant(np.zeros(3))


def make_path(points):
    path = Path()
    path.header.frame_id = "odom"
    for x_m, y_m in points:
        pose = PoseStamped()
        pose.pose.position.x, pose.pose.position.y = x_m, y_m
        path.poses.append(pose)
    return path


class SimClockTest(unittest.TestCase):
    def test_pause_and_jump_back_stop_it_and_the_path_is_walked(self):
        states, reached = Collector("cbf_filter/state", FilterState), Collector("goal_reached", Bool)
        distances = Collector("waypoint_controller/distance_to_goal", Float64)
        path_pub = rospy.Publisher("path", Path, queue_size=1, latch=True)
        simulator = FakeSimulator()
        wait_until(lambda: states.last and states.last.mode == FilterState.NOMINAL, what="nominal command")
        path_pub.publish(make_path([(0.4, 0.0), (1.2, 0.0)]))
        wait_until(lambda: simulator.plant.twist[0] > 0.3, what="motion")

        start_s = time.monotonic()
        simulator.running.clear()
        zero = wait_until(lambda: states.last.mode == FilterState.STOPPED and states.last, what="stop by pause")
        self.assertLess(time.monotonic() - start_s, 0.5 + 0.25)
        self.assertIn(zero.reason, {"nominal_stale", "odometry_stale"})
        states.clear()
        wait_until(lambda: len(states.entries) >= 5, what="states while paused")
        self.assertTrue(all(list(state.u_safe) == [0.0, 0.0, 0.0] for _, state in states.entries))

        simulator.running.set()
        wait_until(lambda: simulator.plant.twist[0] > 0.3, what="motion after the pause")
        states.clear()
        simulator.reset(5.0)
        back = wait_until(lambda: states.last and states.last.header.stamp.to_sec() < 50.0 and states.last, what="jump")
        self.assertIsNotNone(back)
        wait_until(lambda: reached.last and reached.last.data, 15.0, what="goal after the jump")
        self.assertLess(np.linalg.norm(simulator.plant.pose[:2] - [1.2, 0.0]), 0.25)
        self.assertLess(distances.last.data, 0.25)


if __name__ == "__main__":
    rospy.init_node("sim_clock_rostest")
    rostest.rosrun("core_control", "sim_clock_rostest", SimClockTest)

#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""Kills cbf_filter while the robot walks: the base brakes by itself, and walks again when a filter is back."""

import os
import signal
import subprocess
import sys
import time
import unittest

import rospy
from core_msgs.msg import FilterState
from geometry_msgs.msg import Twist
from graph import node_pid, wait_for
from nav_msgs.msg import Odometry

WALK_DEADLINE_S = 60.0
DEADLINE_S = 40.0
WALKING_MPS, STANDING_MPS = 0.3, 0.01
# On top of the time-out, of a base that brakes at once: a period of its odometry, and what a loaded machine may add.
ODOMETRY_S, SLACK_S = 0.05, 0.25


def speed(twist):
    return abs(twist.linear.x) + abs(twist.linear.y) + abs(twist.angular.z)


class KilledFilter(unittest.TestCase):
    def setUp(self):
        self.speeds, self.commands, self.states = [], [], []
        self.subscribers = [
            rospy.Subscriber("odom", Odometry, lambda m: self.speeds.append((time.monotonic(), speed(m.twist.twist)))),
            rospy.Subscriber("cmd_vel", Twist, lambda m: self.commands.append((time.monotonic(), speed(m)))),
            rospy.Subscriber("cbf_filter/state", FilterState, self.states.append),
        ]

    def wait_until_it_walks(self):
        wait_for(self, lambda: self.speeds and self.speeds[-1][1] > WALKING_MPS, WALK_DEADLINE_S, "the robot to walk")

    def test_base_stops_when_the_filter_is_killed_and_goes_on_with_the_next(self):
        self.wait_until_it_walks()
        killed_s = time.monotonic()
        os.kill(node_pid("cbf_filter"), signal.SIGKILL)
        wait_for(self, lambda: self.speeds[-1][1] < STANDING_MPS, DEADLINE_S, "the robot to stand")
        stood_s = next(t for t, v in self.speeds if t > killed_s and v < STANDING_MPS)
        self.assertLess(stood_s - killed_s, rospy.get_param("~cmd_vel_timeout_s") + ODOMETRY_S + SLACK_S)
        self.assertGreater(stood_s - killed_s, 0.2, "the base had a command to hold")
        count = len(self.speeds)
        wait_for(self, lambda: len(self.speeds) > count + 20, DEADLINE_S, "more odometry")
        self.assertLess(max(v for _, v in self.speeds[count:]), STANDING_MPS)
        self.states.clear()
        self.commands.clear()
        filter_again = subprocess.Popen(["rosrun", "core_control", "cbf_filter", "__name:=cbf_filter"])
        try:
            self.wait_until_it_walks()
            self.assertEqual([v for _, v in self.commands][:1], [0.0], "the first command of a new filter is zero")
            self.assertEqual(self.states[0].mode, FilterState.STOPPED)
        finally:
            filter_again.terminate()
            filter_again.wait()


if __name__ == "__main__":
    import rostest

    rospy.init_node("killed_filter_rostest", disable_rostime=True)
    rostest.rosrun("core_bringup", "killed_filter", KilledFilter, sys.argv)

#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""Kills semantic_map while the robot walks and times the first zero command."""

import os
import signal
import sys
import time
import unittest

import rospy
from core_msgs.msg import FilterState
from geometry_msgs.msg import Twist
from graph import node_pid, wait_for

WALK_DEADLINE_S = 60.0
STOP_DEADLINE_S = 5.0
# On top of the time-out: one period of the grid, one of the filter, and the scheduling of a busy two-core machine.
SLACK_S = 0.5


def speed(twist):
    return abs(twist.linear.x) + abs(twist.linear.y) + abs(twist.angular.z)


class KilledMap(unittest.TestCase):
    def setUp(self):
        self.commands, self.states = [], []
        self.subscribers = [
            rospy.Subscriber("cmd_vel", Twist, lambda m: self.commands.append((time.monotonic(), speed(m)))),
            rospy.Subscriber("cbf_filter/state", FilterState, lambda m: self.states.append((time.monotonic(), m))),
        ]

    def test_robot_stops_when_the_map_is_killed(self):
        wait_for(self, lambda: self.commands and self.commands[-1][1] > 0.3, WALK_DEADLINE_S, "the robot to walk")
        killed_s = time.monotonic()
        os.kill(node_pid("semantic_map"), signal.SIGKILL)
        wait_for(self, lambda: self.commands[-1][1] == 0.0, STOP_DEADLINE_S, "a zero command")
        stopped_s = next(t for t, v in self.commands if t > killed_s and v == 0.0)
        self.assertLess(stopped_s - killed_s, rospy.get_param("~grid_timeout_s") + SLACK_S)
        wait_for(self, lambda: self.states[-1][1].reason == "grid_stale", STOP_DEADLINE_S, "the reason grid_stale")
        self.assertEqual(self.states[-1][1].mode, FilterState.STOPPED)
        count = len(self.commands)
        wait_for(self, lambda: len(self.commands) > count + 20, STOP_DEADLINE_S, "zero to be published on and on")
        self.assertEqual({v for t, v in self.commands if t >= stopped_s}, {0.0})


if __name__ == "__main__":
    import rostest

    rospy.init_node("killed_map_rostest", disable_rostime=True)
    rostest.rosrun("core_bringup", "killed_map", KilledMap, sys.argv)

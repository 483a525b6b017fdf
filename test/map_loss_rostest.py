#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""Takes the map's memory away while the robot is held at the cones: by the reset service, then by a restart."""

import math
import os
import signal
import subprocess
import sys
import unittest

import rospy
from core_msgs.msg import FilterState
from graph import node_pid, wait_for
from nav_msgs.msg import Odometry
from std_srvs.srv import Empty, Trigger

HELD_DEADLINE_S = 90.0
DEADLINE_S = 20.0
WATCH_TICKS = 100
MAX_MOTION_M = 0.05


class MapLoss(unittest.TestCase):
    def setUp(self):
        self.states, self.positions = [], []
        self.subscribers = [
            rospy.Subscriber("cbf_filter/state", FilterState, self.states.append),
            rospy.Subscriber("odom", Odometry, lambda m: self.positions.append(m.pose.pose.position)),
        ]

    def wait_until_held(self):
        def held():
            recent = self.states[-20:]
            return len(recent) == 20 and all(s.binding_rule.startswith("BETWEEN") and not any(s.u_safe) for s in recent)

        wait_for(self, held, HELD_DEADLINE_S, "the robot to be held at the cones")

    def assert_stands_for_the_reason(self):
        wait_for(self, lambda: self.states[-1].reason == "map_lost", DEADLINE_S, "the reason map_lost")
        start, count = self.positions[-1], len(self.states)
        wait_for(self, lambda: len(self.states) > count + WATCH_TICKS, DEADLINE_S, "%d more ticks" % WATCH_TICKS)
        end = self.positions[-1]
        self.assertLess(math.hypot(end.x - start.x, end.y - start.y), MAX_MOTION_M)
        self.assertEqual({tuple(s.u_safe) for s in self.states[count:]}, {(0.0, 0.0, 0.0)})

    def test_robot_stands_when_the_map_loses_its_memory(self):
        self.wait_until_held()
        rospy.ServiceProxy("semantic_map/reset", Empty)()
        self.assert_stands_for_the_reason()
        os.kill(node_pid("semantic_map"), signal.SIGKILL)
        wait_for(self, lambda: self.states[-1].grid_age_s > 0.5, DEADLINE_S, "the grid to be old")
        map_again = subprocess.Popen(["rosrun", "core_perception", "semantic_map", "__name:=semantic_map"])
        try:
            wait_for(self, lambda: self.states[-1].grid_age_s < 0.5, DEADLINE_S, "the map to be back")
            self.assert_stands_for_the_reason()
            self.assertTrue(rospy.ServiceProxy("cbf_filter/reset", Trigger)().success)
            wait_for(self, lambda: self.states[-1].reason != "map_lost", DEADLINE_S, "the operator's reset to count")
        finally:
            map_again.terminate()
            map_again.wait()


if __name__ == "__main__":
    import rostest

    rospy.init_node("map_loss_rostest", disable_rostime=True)
    rostest.rosrun("core_bringup", "map_loss", MapLoss, sys.argv)

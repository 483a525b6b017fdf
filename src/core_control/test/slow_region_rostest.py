#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""Grids with slow cells, malformed ones, and ways the camera has not seen: what the node sends and says."""

import unittest
from dataclasses import replace

import numpy as np
import rospy
import rostest
from control_support import AROUND_PERSON, make_grid, make_slow_field
from core_msgs.msg import FilterState, SafetyGrid
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from ros_support import Collector, RatePublisher, grid_to_msg, make_odometry_msg, wait_until

from core_control.ros.conversions import twist_from_msg, twist_to_msg

CAP_MPS = 0.2
FREE = make_grid(np.zeros((120, 120), bool))
SLOW = make_slow_field(((-0.2, 0.4), (-0.2, 0.2)), CAP_MPS).grid
AHEAD, BACK = np.array([0.4, 0.0, 0.1]), np.array([-0.4, 0.0, 0.0])


class SlowRegionTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.u, cls.grid, cls.spoil = AHEAD, FREE, lambda _: None
        cls.feeds = [
            RatePublisher("cmd_vel_nominal", Twist, lambda: twist_to_msg(cls.u), 20),
            RatePublisher("odom", Odometry, make_odometry_msg, 50),
            RatePublisher("safety_grid", SafetyGrid, cls.make_grid, 10),
        ]
        cls.states = Collector("cbf_filter/state", FilterState)
        cls.commands = Collector("cmd_vel", Twist)

    @classmethod
    def make_grid(cls):
        now = rospy.Time.now()
        message = grid_to_msg(cls.grid, now, now)
        cls.spoil(message)
        return message

    def setUp(self):
        cls = type(self)
        cls.u, cls.grid, cls.spoil = AHEAD, FREE, lambda _: None
        wait_until(lambda: self.sends(AHEAD), what=f"free motion; last state {self.states.last}")

    def sends(self, u):
        command = self.commands.last
        return command is not None and np.allclose(twist_from_msg(command), u, atol=1e-9)

    def collect(self, count=20):
        """The next commands and states, from a second state on, so that none is of the time before."""
        self.states.clear()
        wait_until(lambda: len(self.states.entries) > 2, what="states")
        self.commands.clear()
        self.states.clear()
        wait_until(lambda: len(self.commands.entries) > count and len(self.states.entries) > count, what="commands")
        return (
            [twist_from_msg(message) for _, message in self.commands.entries],
            [message for _, message in self.states.entries],
        )

    def test_slow_cells_cap_the_command_and_are_named_until_they_are_gone(self):
        type(self).grid = SLOW
        wait_until(lambda: self.states.last.speed_cap_reason == "slow_region", what="a cap by the region")
        commands, states = self.collect()
        for u in commands:
            self.assertLessEqual(np.hypot(u[0], u[1]), CAP_MPS * (1.0 + 1e-6))
            np.testing.assert_allclose(u, AHEAD * CAP_MPS / 0.4, atol=1e-7)
        for state in states:
            self.assertEqual((state.mode, state.reason), (FilterState.FILTERED, ""))
            self.assertEqual(state.speed_cap_reason, "slow_region")
            self.assertAlmostEqual(state.speed_cap_mps, CAP_MPS, places=6)
            self.assertEqual(state.detail, f"slowed to {CAP_MPS} m/s by {AROUND_PERSON.rule}")
        type(self).grid = FREE
        wait_until(lambda: self.sends(AHEAD), what="free motion by itself")
        wait_until(lambda: self.states.last.speed_cap_reason == "", what="no cap any more")

    def test_caps_that_make_no_sense_stop_the_robot(self):
        type(self).spoil = lambda message: setattr(message, "speed_cap_mps", [-1.0] * 14400)
        wait_until(lambda: self.states.last.reason == "grid_malformed", what="a stop")
        wait_until(lambda: self.sends(np.zeros(3)), what="zero")

    def test_backwards_the_camera_sees_nothing_and_the_robot_is_slow(self):
        type(self).u = BACK
        wait_until(lambda: self.states.last.speed_cap_reason == "unseen_heading", what="a cap by the heading")
        wait_until(lambda: self.sends([-0.15, 0.0, 0.0]), what="slow motion backwards")
        commands, states = self.collect()
        self.assertLessEqual(max(np.hypot(u[0], u[1]) for u in commands), 0.15 * (1.0 + 1e-9))
        self.assertTrue(all(state.speed_cap_mps == 0.15 for state in states))

    def test_what_moves_is_nearer_by_the_age_of_its_grid(self):
        unsafe = np.zeros((120, 120), bool)
        unsafe[55:65, 80:84] = True  # 2 m ahead
        type(self).u = np.zeros(3)
        type(self).grid = replace(make_grid(unsafe), causes=(AROUND_PERSON,))
        wait_until(lambda: self.states.last.h_m < 1.5, what="the person in the map")
        distance_m = 2.0 - 0.55 - (np.hypot(0.55 / 3.0, 0.25) - 0.55 / 3.0)
        _, states = self.collect()
        for state in states:
            self.assertLessEqual(state.h_m, distance_m - state.grid_age_s + 1e-6)
            self.assertGreater(state.h_m, distance_m - 0.5)


if __name__ == "__main__":
    rospy.init_node("slow_region_rostest")
    rostest.rosrun("core_control", "slow_region_rostest", SlowRegionTest)

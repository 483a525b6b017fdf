#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""The map goes on with constraints that nobody renews: the nodes of both profiles slow or stop, and come back."""

import time
import unittest

import numpy as np
import rospy
import rostest
from control_support import make_grid
from core_msgs.msg import FilterState, SafetyGrid
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from ros_support import Collector, RatePublisher, grid_to_msg, make_odometry_msg, wait_until

from core_control.ros.conversions import twist_from_msg, twist_to_msg

PROFILES = ("core", "paper")
FRESH_S, TTL_S = 7.5, 15.0
MAX_SPEED_MPS = float(np.hypot(0.5, 0.25))
AHEAD = np.array([0.4, 0.0, 0.2])
# Zero is due this long after the constraints ran out [s].
LATE_S = 0.2
FREE = make_grid(np.zeros((60, 60), bool), h_m=np.full((60, 60), 10.0))


class Robot:
    """Fakes around the filter of one namespace; the grid is always new, its constraints only while they are renewed."""

    def __init__(self, name):
        self.constraints_stamp = None
        self.nominal = RatePublisher(f"/{name}/cmd_vel_nominal", Twist, lambda: twist_to_msg(AHEAD), 20)
        self.odometry = RatePublisher(f"/{name}/odom", Odometry, make_odometry_msg, 50)
        self.grid = RatePublisher(f"/{name}/safety_grid", SafetyGrid, self.make_grid, 10)
        self.states = Collector(f"/{name}/cbf_filter/state", FilterState)
        self.commands = Collector(f"/{name}/cmd_vel", Twist)

    def make_grid(self):
        now = rospy.Time.now()
        return grid_to_msg(FREE, now, self.constraints_stamp or now)

    def is_free(self):
        state, command = self.states.last, self.commands.last
        return (
            state and command and state.mode == FilterState.NOMINAL and np.array_equal(twist_from_msg(command), AHEAD)
        )

    def is_stale(self):
        state = self.states.last
        return state and state.reason == "constraints_stale"


class AgingConstraintsTest(unittest.TestCase):
    def test_silence_of_the_reasoner_slows_then_stops_and_its_return_sets_going(self):
        robots = {name: Robot(name) for name in PROFILES}
        for name, robot in robots.items():
            wait_until(robot.is_free, what=f"motion of {name}; last state {robot.states.last}")
        last_image = rospy.Time.now() - rospy.Duration.from_sec(6.5)
        for robot in robots.values():
            robot.states.clear()
            robot.commands.clear()
        runs_out_s = time.monotonic() + TTL_S - 6.5
        for robot in robots.values():
            robot.constraints_stamp = last_image
        for name, robot in robots.items():
            wait_until(lambda robot=robot: robot.is_stale(), 12.0, f"stop of {name}")
        # Some zeros more, to see that nothing follows them.
        for robot in robots.values():
            count = len(robot.commands.entries)
            wait_until(lambda robot=robot, count=count: len(robot.commands.entries) > count + 5, what="commands")
        for name, robot in robots.items():
            with self.subTest(name):
                self.assert_ends_in_zero(robot, runs_out_s)
        with self.subTest("slope of core"):
            self.assert_slope(robots["core"])
        with self.subTest("no slope of paper"):
            self.assert_full_speed_before(robots["paper"])
        for name, robot in robots.items():
            robot.constraints_stamp = None
            with self.subTest(f"{name} comes back"):
                wait_until(robot.is_free, 3.0, what=f"motion of {name} by itself; last state {robot.states.last}")
                self.assertEqual(robot.states.last.speed_cap_mps, np.inf)

    def assert_ends_in_zero(self, robot, runs_out_s):
        """Every command from LATE_S after the end on is zero, and the commands never grow before."""
        times_s = np.array([at for at, _ in robot.commands.entries])
        sizes = np.array([np.linalg.norm(twist_from_msg(command)) for _, command in robot.commands.entries])
        self.assertGreater(np.count_nonzero(times_s > runs_out_s + LATE_S), 0)
        self.assertEqual(float(np.max(sizes[times_s > runs_out_s + LATE_S])), 0.0)
        self.assertLessEqual(float(np.max(np.diff(sizes))), 1e-12)
        self.assertGreater(sizes[0], 0.4)

    def assert_slope(self, robot):
        states = [state for _, state in robot.states.entries]
        slowed = [state for state in states if FRESH_S < state.constraints_age_s < TTL_S]
        self.assertGreater(len(slowed), 100)
        for state in slowed:
            share = (TTL_S - state.constraints_age_s) / (TTL_S - FRESH_S)
            self.assertAlmostEqual(state.speed_cap_mps, share * MAX_SPEED_MPS, places=9)
            self.assertLessEqual(np.hypot(*state.u_safe[:2]), state.speed_cap_mps * (1.0 + 1e-6))
            self.assertAlmostEqual(state.u_safe[0] * AHEAD[2], state.u_safe[2] * AHEAD[0], places=9)
            self.assertEqual(state.reason, "")
            if state.mode == FilterState.FILTERED:
                self.assertIn(f"constraints are {state.constraints_age_s:.1f} s old", state.detail)
        self.assertTrue(any(state.detail.startswith("slowed: ") for state in slowed))
        self.assertTrue(any(state.detail.startswith("slowed to rest: ") for state in slowed))

    def assert_full_speed_before(self, robot):
        states = [state for _, state in robot.states.entries if state.constraints_age_s < TTL_S]
        self.assertGreater(len(states), 50)
        for state in states:
            self.assertEqual((list(state.u_safe), state.speed_cap_mps), (list(AHEAD), np.inf))


if __name__ == "__main__":
    rospy.init_node("aging_constraints_rostest")
    rostest.rosrun("core_control", "aging_constraints_rostest", AgingConstraintsTest)

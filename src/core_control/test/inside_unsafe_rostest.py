#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""The filter node and a robot that obeys it, put into unsafe cells: HOLD, ESCAPE, LATCH, and a ghost under its feet."""

import threading
import time
import unittest

import numpy as np
import rospy
import rostest
from control_support import Plant, make_grid
from core_msgs.msg import Blocked, FilterState, SafetyGrid
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from ros_support import Collector, RatePublisher, grid_to_msg, wait_until
from std_srvs.srv import Trigger

from core_control.ros.conversions import odometry_to_msg, twist_from_msg, twist_to_msg

CELLS, CELL_M = 60, 0.2
PERIOD_S = 0.02
AHEAD, BACK, REST = np.array([0.3, 0.0, 0.0]), np.array([-0.3, 0.0, 0.0]), np.zeros(3)


class Robot:
    """Fakes around one filter: a base that follows cmd_vel with a lag, a map, and a wanted command."""

    def __init__(self, namespace):
        self.u, self.unsafe = REST, np.zeros((CELLS, CELLS), dtype=bool)
        self._lock, self._plant, self._command = threading.Lock(), Plant((0.1, 0.1, 0.0), period_s=PERIOD_S), REST
        self.states = Collector(f"{namespace}/cbf_filter/state", FilterState)
        self.blocked = Collector(f"{namespace}/cbf_filter/blocked", Blocked)
        wait_until(lambda: self.states.last, 40.0, "first state")
        self.call_reset = rospy.ServiceProxy(f"{namespace}/cbf_filter/reset", Trigger)
        rospy.Subscriber(f"{namespace}/cmd_vel", Twist, self._on_command, queue_size=1, tcp_nodelay=True)
        RatePublisher(f"{namespace}/cmd_vel_nominal", Twist, lambda: twist_to_msg(self.u), 20)
        RatePublisher(f"{namespace}/odom", Odometry, self._walk, round(1.0 / PERIOD_S))
        RatePublisher(f"{namespace}/safety_grid", SafetyGrid, self._make_grid, 10)

    def _on_command(self, message):
        with self._lock:
            self._command = twist_from_msg(message)

    def _walk(self):
        with self._lock:
            self._plant.step(self._command)
            message = odometry_to_msg(self._plant.pose, self._plant.twist)
        message.header.stamp = rospy.Time.now()
        return message

    def _make_grid(self):
        now = rospy.Time.now()
        return grid_to_msg(make_grid(self.unsafe, resolution_m=CELL_M), now, now)

    @property
    def pose(self):
        with self._lock:
            return self._plant.pose.copy()

    def put(self, x_m):
        """Put it somewhere on a free map and wait until the filter knows that it stands there."""
        self.u, self.unsafe = REST, np.zeros((CELLS, CELLS), dtype=bool)
        with self._lock:
            self._plant.pose, self._plant.twist = np.array([x_m, 0.1, 0.0]), np.zeros(3)
        self.call_reset()
        wait_until(lambda: self.states.last and self.states.last.mode == FilterState.NOMINAL, what="a free robot")

    def make_unsafe(self, from_x_m):
        """Everything ahead of a line is unsafe from now on; waits until the filter knows."""
        unsafe = np.zeros((CELLS, CELLS), dtype=bool)
        unsafe[:, round(from_x_m / CELL_M) + CELLS // 2 :] = True
        self.unsafe = unsafe
        wait_until(lambda: self.states.last and self.states.last.h_m < 0.0, what="h < 0")

    def wait_for(self, mode, timeout_s=10.0):
        return wait_until(
            lambda: self.states.last.mode == mode and self.states.last,
            timeout_s,
            f"mode {mode}; last state {self.states.last}",
        )

    def collect(self, duration_s):
        """States of a time."""
        self.states.clear()
        end_s = time.monotonic() + duration_s
        wait_until(lambda: time.monotonic() > end_s and len(self.states.entries) > 5, duration_s + 5.0, "states")
        return [state for _, state in self.states.entries]


class InsideUnsafeTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.plain, cls.escaping = Robot("plain"), Robot("escaping")

    def test_in_hold_it_stands_unless_it_is_driven_out(self):
        robot = self.plain
        robot.put(0.1)
        robot.make_unsafe(0.4)
        for u in (REST, AHEAD):
            robot.u = u
            states = robot.collect(1.0)
            self.assertEqual({state.mode for state in states}, {FilterState.HOLD})
            self.assertFalse(any(np.any(state.u_safe) for state in states))
            self.assertAlmostEqual(robot.pose[0], 0.1, places=3)
        self.assertIn("BETWEEN(traffic_cone)", states[-1].detail)
        robot.u = BACK
        wait_until(lambda: robot.pose[0] < -0.6, what="the robot to walk out")
        self.assertEqual(robot.wait_for(FilterState.NOMINAL).latched, False)

    def test_a_held_robot_is_told_as_an_event(self):
        robot = self.plain
        robot.put(0.1)
        robot.make_unsafe(0.4)
        robot.blocked.clear()
        robot.u = AHEAD
        event = wait_until(lambda: robot.blocked.last, 6.0, "event")
        self.assertTrue(event.active)
        self.assertEqual((event.rule, event.reason), ("BETWEEN(traffic_cone)", ""))
        self.assertEqual((event.header.frame_id, round(event.duration_s)), ("odom", 2))
        self.assertAlmostEqual((event.header.stamp - event.since).to_sec(), event.duration_s, places=3)
        self.assertIn("blocked by BETWEEN(traffic_cone) at (", event.detail)
        self.assertGreaterEqual(robot.states.last.blocked_s, 2.0)
        robot.u = BACK
        wait_until(lambda: not robot.blocked.last.active, 3.0, "the end of it")
        events = [message.active for _, message in robot.blocked.entries]
        self.assertEqual(events, [True] * (len(events) - 1) + [False])

    def test_deep_inside_it_latches_until_reset_and_can_then_be_driven_out(self):
        robot = self.plain
        robot.put(0.1)
        robot.make_unsafe(-1.4)
        state = robot.wait_for(FilterState.STOPPED)
        self.assertEqual((state.reason, state.latched), ("deep_inside", True))
        robot.u = BACK
        self.assertFalse(any(np.any(state.u_safe) for state in robot.collect(0.5)))
        self.assertIn("deep_inside", robot.call_reset().message + robot.states.last.reason)
        wait_until(lambda: robot.pose[0] < -2.2, 15.0, "the robot to walk out")
        robot.wait_for(FilterState.NOMINAL)

    def test_one_ghost_cell_under_the_robot_does_not_lock_it(self):
        robot = self.plain
        robot.put(-0.9)
        robot.u = AHEAD
        wait_until(lambda: robot.pose[0] > -0.5, what="motion")
        ghost = np.zeros((CELLS, CELLS), dtype=bool)
        x_m = robot.pose[0] + 0.1
        ghost[CELLS // 2, int(np.floor(x_m / CELL_M)) + CELLS // 2] = True
        robot.states.clear()
        robot.unsafe = ghost
        state = wait_until(
            lambda: next((s for _, s in robot.states.entries if s.mode == FilterState.HOLD), None), what="hold"
        )
        self.assertFalse(np.any(state.u_safe))
        self.assertIn("a cell under the robot became unsafe: BETWEEN(traffic_cone)", state.detail)
        start_s = time.monotonic()
        wait_until(lambda: robot.pose[0] > x_m + 1.0, 8.0, "the robot to walk off")
        self.assertLess(time.monotonic() - start_s, 1.1 / 0.3 + 1.5)
        standing = [s for _, s in robot.states.entries if not np.any(s.u_safe)]
        self.assertGreaterEqual(len(standing), 3)
        self.assertLess(len(standing), 14)
        robot.wait_for(FilterState.NOMINAL)

    def test_escape_leads_back_along_the_trail_within_its_bounds(self):
        robot = self.escaping
        robot.put(-1.5)
        robot.u = AHEAD
        wait_until(lambda: robot.pose[0] > 0.0, what="motion")
        robot.states.clear()
        robot.make_unsafe(np.round(robot.pose[0] / CELL_M) * CELL_M + 0.4)
        robot.wait_for(FilterState.ESCAPE)
        begin_s = time.monotonic()
        wait_until(lambda: robot.states.last.mode != FilterState.ESCAPE, 7.0, "the end of the escape")
        self.assertLess(time.monotonic() - begin_s, 5.5)
        states = [state for _, state in robot.states.entries]
        escape = [state for state in states if state.mode == FilterState.ESCAPE]
        held = [state for state in states if state.mode == FilterState.HOLD and state.tick < escape[0].tick]
        self.assertFalse(any(np.any(state.u_safe) for state in held[-38:]), "two seconds at rest")
        self.assertLessEqual(max(np.hypot(*state.u_safe[:2]) for state in escape), 0.15 + 1e-9)
        self.assertTrue(all(state.u_safe[0] < 0.0 for state in escape if np.any(state.u_safe)))
        self.assertGreater(robot.states.last.h_m, 0.1)
        self.assertEqual(robot.states.last.reason, "")

    def test_without_a_trail_an_escape_latches_until_reset(self):
        robot = self.escaping
        robot.put(0.1)
        robot.make_unsafe(0.4)
        with robot._lock:  # put elsewhere: nothing it has walked leads there
            robot._plant.pose = np.array([0.1, -0.9, 0.0])
        robot.u = AHEAD
        state = robot.wait_for(FilterState.STOPPED)
        self.assertEqual((state.reason, state.latched), ("escape_failed", True))
        robot.u = BACK
        self.assertFalse(any(np.any(state.u_safe) for state in robot.collect(0.5)))
        robot.call_reset()
        wait_until(lambda: robot.pose[0] < -0.6, what="the robot to walk out")


if __name__ == "__main__":
    rospy.init_node("inside_unsafe_rostest")
    rostest.rosrun("core_control", "inside_unsafe", InsideUnsafeTest)

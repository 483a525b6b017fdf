#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""The filter node between fakes that publish at a rate: what stops it, how soon, why, and that it goes on by itself."""

import math
import time
import unittest

import numpy as np
import rospy
import rostest
from core_msgs.msg import FilterState, SafetyGrid
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from ros_support import Collector, RatePublisher, make_odometry_msg, make_wall_msg, wait_until
from std_srvs.srv import Trigger

from core_control.ros.conversions import twist_from_msg, twist_to_msg

# Time a loaded machine may add to a bound [s].
SLACK_S = 0.25
TICK_S = 0.05
# Between sending a message and its arrival in the node's callback, on such a machine [s].
TRANSPORT_S = 0.1
AHEAD = np.array([0.3, 0.0, 0.0])


def to_s(state):
    return state.header.stamp.to_sec()


def to_six(command):
    return [getattr(part, axis) for part in (command.linear, command.angular) for axis in "xyz"]


class Fakes:
    """Nominal command, odometry and grid, each at a rate, each changeable."""

    def __init__(self):
        self.heal()
        self.nominal = RatePublisher("cmd_vel_nominal", Twist, lambda: twist_to_msg(self.u), 20)
        self.odometry = RatePublisher("odom", Odometry, self.make_odometry, 50)
        self.grid = RatePublisher("safety_grid", SafetyGrid, self.make_grid, 10)

    def heal(self):
        """What a test that failed may have left behind."""
        self.u = AHEAD
        self.pose, self.constraints_age_s, self.frame_id = np.zeros(3), 0.0, "odom"
        self.wall_x_m = 2.9

    def make_odometry(self):
        return make_odometry_msg(self.pose, self.frame_id)

    def make_grid(self):
        now = rospy.Time.now()
        return make_wall_msg(self.wall_x_m, now, now - rospy.Duration.from_sec(self.constraints_age_s))

    def make_broken_grid(self, **changes):
        message = self.make_grid()
        for name, value in changes.items():
            setattr(message, name, value)
        return message


class CbfFilterTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.states = Collector("cbf_filter/state", FilterState)
        cls.commands = Collector("cmd_vel", Twist)
        cls.every_command = Collector("cmd_vel", Twist)  # never cleared
        cls.diagnostics = Collector("diagnostics", DiagnosticArray)
        state = wait_until(lambda: cls.states.last, what="first state")
        assert (state.mode, state.reason) == (FilterState.STOPPED, "waiting_for_nominal")
        cls.fakes = Fakes()

    @classmethod
    def tearDownClass(cls):
        six = [entry for _, command in cls.every_command.entries for entry in to_six(command)]
        assert len(six) > 600, len(six)
        assert np.isfinite(six).all(), "a command was no number"

    def setUp(self):
        self.fakes.heal()
        self.wait_for_motion()

    def wait_for_motion(self):
        return wait_until(lambda: self.is_moving(), what=f"motion; last state {self.states.last}")

    def is_moving(self):
        state, command = self.states.last, self.commands.last
        return state.mode == FilterState.NOMINAL and np.array_equal(twist_from_msg(command), AHEAD) and state

    def assert_stops(self, reason, bound_s, cause):
        """The cause makes the filter send zeros with the reason within the bound, and nothing else after that."""
        start_s = time.monotonic()
        cause()
        wait_until(lambda: self.states.last.reason == reason, bound_s + 5.0, f"reason {reason}")
        zero_s = wait_until(lambda: self.find_zero(start_s), what="zero on cmd_vel")
        self.assertLess(zero_s - start_s, bound_s + TICK_S + SLACK_S)
        self.states.clear()
        self.commands.clear()
        wait_until(lambda: len(self.states.entries) >= 9, what="states while stopped")
        states = [state for _, state in self.states.entries]
        self.assertEqual({state.reason for state in states}, {reason})
        self.assertEqual({state.mode for state in states}, {FilterState.STOPPED})
        self.assertTrue(all(self.is_zero(command) for _, command in self.commands.entries))
        self.assertTrue(self.states.last.detail)
        # Zero is sent on and on, at the rate: by the node's own stamps, of which no tick is missing.
        self.assertEqual([state.tick - states[0].tick for state in states], list(range(len(states))))
        self.assertAlmostEqual(np.median(np.diff([to_s(state) for state in states])), TICK_S, delta=0.2 * TICK_S)
        wait_until(lambda: len(self.commands.entries) >= len(states) - 1, 1.0, "a zero for every state")

    def assert_zero_after(self, states, from_s, reason):
        """By the stamps of the node itself, on the clock of this machine: no tick from a time on lets anything by."""
        late = [state for state in states if to_s(state) > from_s]
        self.assertGreaterEqual(len(late), 5)
        self.assertEqual({(tuple(state.u_safe), state.reason) for state in late}, {((0.0, 0.0, 0.0), reason)})

    def keep_states(self):
        """A list that grows with every state from now on."""
        states = []
        subscriber = rospy.Subscriber("cbf_filter/state", FilterState, states.append, queue_size=100)
        self.addCleanup(subscriber.unregister)
        return states

    def find_zero(self, after_s):
        """Time of the first zero after a time; None while there is none."""
        return next((at for at, command in self.commands.entries if at > after_s and self.is_zero(command)), None)

    @staticmethod
    def is_zero(command):
        return np.array_equal(twist_from_msg(command), np.zeros(3))

    def test_silent_publisher_stops_it_and_it_goes_on_by_itself(self):
        for name, reason, bound_s in (
            ("nominal", "nominal_stale", 0.3),
            ("odometry", "odometry_stale", 0.3),
            ("grid", "grid_stale", 0.5),
        ):
            with self.subTest(name):
                publisher, states = getattr(self.fakes, name), self.keep_states()
                self.assert_stops(reason, bound_s, publisher.stop)
                self.assert_zero_after(list(states), publisher.last_sent_s + bound_s, reason)
                publisher.start()
                self.wait_for_motion()

    def test_bad_command_gives_zero_at_the_next_tick(self):
        for u, reason in (
            (np.array([math.nan, 0.0, 0.0]), "nominal_not_finite"),
            (np.array([0.0, math.inf, 0.0]), "nominal_not_finite"),
        ):
            with self.subTest(u=u):
                states, sent_s = self.keep_states(), time.time()
                self.assert_stops(reason, 0.1, lambda u=u: setattr(self.fakes, "u", u))
                # It goes out within one period of its publisher, and the tick that has it sends zero.
                self.assert_zero_after(list(states), sent_s + TICK_S + TRANSPORT_S, reason)
                self.assertTrue(all(tuple(s.u_safe) == (0, 0, 0) for s in states if not np.isfinite(s.u_nominal).all()))
                self.fakes.u = AHEAD
                self.wait_for_motion()

    def test_command_outside_the_plane_gives_zero(self):
        make, upward = self.fakes.nominal.make, twist_to_msg(AHEAD)
        upward.linear.z = 0.1
        self.assert_stops("nominal_not_planar", 0.1, lambda: setattr(self.fakes.nominal, "make", lambda: upward))
        self.fakes.nominal.make = make
        self.wait_for_motion()

    def test_bad_grid_gives_zero(self):
        make = self.fakes.grid.make
        for changes, reason in (
            ({"h_m": [math.nan] * 3600}, "grid_not_finite"),
            ({"h_m": [1.0]}, "grid_malformed"),
            ({"resolution_m": 0.0}, "grid_malformed"),
            ({"constraints_stamp": rospy.Time()}, "constraints_missing"),
        ):
            with self.subTest(reason):
                broken = lambda changes=changes: self.fakes.make_broken_grid(**changes)  # noqa: E731
                self.assert_stops(reason, 0.2, lambda broken=broken: setattr(self.fakes.grid, "make", broken))
                self.fakes.grid.make = make
                self.wait_for_motion()

    def test_old_constraints_give_zero(self):
        self.assert_stops("constraints_stale", 0.2, lambda: setattr(self.fakes, "constraints_age_s", 16.0))
        self.fakes.constraints_age_s = 0.0
        self.wait_for_motion()

    def test_bad_odometry_gives_zero(self):
        self.assert_stops("odometry_not_finite", 0.1, lambda: setattr(self.fakes, "pose", np.array([0, math.nan, 0])))
        self.fakes.pose = np.zeros(3)
        self.wait_for_motion()
        self.assert_stops("frame_mismatch", 0.1, lambda: setattr(self.fakes, "frame_id", "map"))
        self.fakes.frame_id = "odom"
        self.wait_for_motion()

    def test_old_stamps_count_even_when_messages_keep_coming(self):
        make = self.fakes.grid.make
        frozen = self.fakes.make_grid()
        self.assert_stops("grid_stale", 0.5, lambda: setattr(self.fakes.grid, "make", lambda: frozen))
        self.fakes.grid.make = make
        self.wait_for_motion()

    def test_a_wall_ahead_changes_the_command_and_is_named(self):
        self.fakes.wall_x_m = 0.9
        state = wait_until(
            lambda: self.states.last.mode == FilterState.FILTERED and self.states.last, what="filtered state"
        )
        self.assertEqual(state.binding_rule, "BETWEEN(traffic_cone)")
        self.assertLess(state.u_safe[0], AHEAD[0])
        self.assertAlmostEqual(state.h_m, 0.9 - 0.677, places=2)
        self.assertEqual(list(state.u_nominal), list(AHEAD))
        self.fakes.wall_x_m = 2.9
        self.wait_for_motion()

    def test_each_tick_sends_the_command_then_the_state(self):
        self.states.clear()
        wait_until(lambda: len(self.states.entries) >= 10, what="states")
        ticks = [state.tick for _, state in self.states.entries]
        self.assertEqual(ticks, list(range(ticks[0], ticks[0] + len(ticks))))

    def test_diagnostics_say_what_it_does(self):
        self.diagnostics.clear()
        message = wait_until(lambda: self.diagnostics.last, what="diagnostics")
        self.assertIn("filter", message.status[0].name)
        self.assertIn("NOMINAL", message.status[0].message)

    def test_reset_answers(self):
        rospy.wait_for_service("cbf_filter/reset", 5.0)
        self.assertTrue(rospy.ServiceProxy("cbf_filter/reset", Trigger)().success)


if __name__ == "__main__":
    rospy.init_node("cbf_filter_rostest")
    rostest.rosrun("core_control", "cbf_filter_rostest", CbfFilterTest)

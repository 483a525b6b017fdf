#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""The operator's side of the node: emergency stop (topic, service, lost heartbeat), override, tightening, a stall."""

import os
import signal
import time
import unittest

import numpy as np
import rosgraph
import rospy
import rostest
from cbf_filter_rostest import AHEAD, SLACK_S, TICK_S, Fakes
from core_msgs.msg import FilterState
from core_msgs.srv import Override
from dynamic_reconfigure.client import Client
from geometry_msgs.msg import Twist
from ros_support import Collector, RatePublisher, wait_until
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from core_control.ros.conversions import twist_from_msg, twist_to_msg
from core_control.ros.publisher_guard import call_server

FAST = np.array([0.4, 0.0, 0.5])
# Growth of the command within one tick: default accelerations times the period, and rounding.
GROWTH = np.array([2.0, 2.0, 4.0]) * TICK_S + 1e-9


def speeds(states):
    return np.array([state.u_safe for _, state in states])


class OperatorTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.states, cls.commands = Collector("cbf_filter/state", FilterState), Collector("cmd_vel", Twist)
        for name in ("reset", "e_stop", "override"):
            rospy.wait_for_service(f"cbf_filter/{name}", 30.0)
        cls.reset = staticmethod(rospy.ServiceProxy("cbf_filter/reset", Trigger))
        cls.press = staticmethod(rospy.ServiceProxy("cbf_filter/e_stop", Trigger))
        cls.override = staticmethod(rospy.ServiceProxy("cbf_filter/override", Override))
        cls.fakes, cls.history_start_s = Fakes(), 1.0
        make = cls.fakes.grid.make
        cls.fakes.grid.make = lambda: cls.with_history(make())
        wait_until(
            lambda: cls.states.last and cls.states.last.mode == FilterState.NOMINAL, 30.0, "motion without e_stop"
        )
        cls.stop = False
        cls.e_stop = RatePublisher("e_stop", Bool, lambda: Bool(cls.stop), 10)

    @classmethod
    def with_history(cls, grid):
        grid.history_start = rospy.Time.from_sec(cls.history_start_s)
        return grid

    @property
    def last(self):
        """Newest state; waits for one after the states were cleared."""
        return wait_until(lambda: self.states.last, what="a state")

    def setUp(self):
        wait_until(lambda: self.is_moving(), what=f"motion; last state {self.last}")

    def is_moving(self):
        return np.array_equal(self.last.u_safe, AHEAD) and self.last.mode == FilterState.NOMINAL

    def wait_for(self, mode, reason=None, timeout_s=5.0):
        def arrived():
            state = self.last
            return state.mode == mode and reason in (None, state.reason) and state

        return wait_until(arrived, timeout_s, f"mode {mode} {reason}; last state {self.last}")

    def assert_e_stop(self, since_s, bound_s):
        """Zero and the reason within the bound, latched, and nothing but zeros from then on."""
        self.assertTrue(self.wait_for(FilterState.STOPPED, "e_stop").latched)
        first_s = next(at for at, state in self.states.entries if at > since_s and not any(state.u_safe))
        self.assertLess(first_s - since_s, bound_s + TICK_S + SLACK_S)
        self.assert_stays_stopped()

    def assert_stays_stopped(self):
        self.states.clear()
        wait_until(lambda: len(self.states.entries) >= 5, what="states while stopped")
        self.assertEqual({state.reason for _, state in self.states.entries}, {"e_stop"})
        self.assertFalse(speeds(self.states.entries).any())
        self.assertFalse(twist_from_msg(self.commands.last).any())

    def assert_reset(self):
        answer = self.reset()
        self.assertTrue(answer.success, answer.message)
        wait_until(lambda: self.is_moving(), 3.0, f"motion after reset; last state {self.last}")

    def set_e_stop(self, stop):
        type(self).stop = stop

    def lose_map(self):
        """The map's memory begins anew: the filter stops until reset."""
        type(self).history_start_s += 1.0
        self.wait_for(FilterState.STOPPED, "map_lost")

    # Emergency stop.

    def test_true_on_the_topic_latches_and_reset_is_refused_while_it_lasts(self):
        start_s = time.monotonic()
        self.set_e_stop(True)
        self.assert_e_stop(start_s, 0.1)
        answer = self.reset()
        self.assertFalse(answer.success)
        self.assertIn("e_stop is true", answer.message)
        self.set_e_stop(False)
        time.sleep(0.3)
        self.assert_stays_stopped()
        self.assert_reset()

    def test_service_latches(self):
        start_s = time.monotonic()
        self.assertTrue(self.press().success)
        self.assert_e_stop(start_s, 0.0)
        self.assertIn("pressed by service", self.last.detail)
        self.assert_reset()

    def test_a_lost_heartbeat_latches_and_reset_is_refused_until_it_is_back(self):
        self.states.clear()
        self.e_stop.stop()
        start_s = time.monotonic()
        self.assert_e_stop(start_s, 1.0)
        answer = self.reset()
        self.assertFalse(answer.success)
        self.assertIn("last heard", answer.message)
        self.e_stop.start()
        wait_until(lambda: self.reset().success, what="reset with the heartbeat back")
        wait_until(lambda: self.is_moving(), what="motion")

    def test_required_signal_keeps_it_standing_until_it_is_heard(self):
        states = Collector("strict/cbf_filter/state", FilterState)
        state = wait_until(lambda: states.last, what="state of the strict filter")
        self.assertEqual((state.mode, state.reason, state.latched), (FilterState.STOPPED, "e_stop", False))
        override = rospy.ServiceProxy("strict/cbf_filter/override", Override)
        self.assertIn("required", override(0.1, 1.0).message)
        heartbeat = RatePublisher("strict/e_stop", Bool, lambda: Bool(False), 10)
        nominal = RatePublisher("strict/cmd_vel_nominal", Twist, lambda: twist_to_msg(AHEAD), 20)
        wait_until(lambda: states.last.reason == "odometry_missing", what="the next reason")
        answer = override(0.1, 1.0)
        self.assertEqual(
            (answer.success, answer.message), (False, "no override: overrides are switched off (override_enabled)")
        )
        nominal.stop()
        heartbeat.stop()
        wait_until(lambda: states.last.reason == "e_stop" and states.last.latched, what="stop by its silence")

    # Override.

    def test_override_drives_a_latched_robot_within_its_bounds_and_ends_by_time(self):
        self.lose_map()
        self.fakes.u, self.fakes.wall_x_m = FAST, 0.9
        answer = self.override(5.0, 100.0)
        self.assertTrue(answer.success)
        self.assertIn("0.2 m/s", answer.message)
        self.assertIn("10 s", answer.message)
        self.assertTrue(self.override(5.0, 1.0).success)
        self.states.clear()
        start_s = time.monotonic()
        self.wait_for(FilterState.OVERRIDE)
        self.wait_for(FilterState.STOPPED, "map_lost")
        self.assertAlmostEqual(time.monotonic() - start_s, 1.0, delta=TICK_S + SLACK_S)
        driven = [entry for entry in self.states.entries if entry[1].mode == FilterState.OVERRIDE]
        u = speeds(driven)
        self.assertGreater(u[:, 0].max(), 0.15)
        self.assertLessEqual(np.hypot(u[:, 0], u[:, 1]).max(), 0.2 + 1e-9)
        self.assertLessEqual(np.abs(u[:, 2]).max(), 0.8 * 0.2 / np.hypot(0.5, 0.25) + 1e-9)
        self.assertTrue(np.all(np.abs(np.diff(np.vstack([np.zeros(3), u]), axis=0)) <= GROWTH))
        self.assertAlmostEqual(driven[-1][1].h_m, 0.9 - 0.677, places=2)
        self.assertEqual(driven[-1][1].binding_rule, "BETWEEN(traffic_cone)")
        self.assertFalse(np.array(self.last.u_safe).any())
        self.fakes.u, self.fakes.wall_x_m = AHEAD, 2.9
        self.assert_reset()

    def test_override_drives_without_a_grid_and_ends_by_duration_zero(self):
        self.fakes.grid.stop()
        self.wait_for(FilterState.STOPPED, "grid_stale")
        self.assertTrue(self.override(0.1, 5.0).success)
        self.wait_for(FilterState.OVERRIDE)
        wait_until(lambda: abs(self.last.u_safe[0] - 0.1) < 1e-9, what="motion under override")
        self.assertEqual(self.override(0.0, 0.0).message, "override ended")
        self.wait_for(FilterState.STOPPED, "grid_stale")
        self.fakes.grid.start()

    def test_override_ends_by_e_stop_and_is_refused_under_it(self):
        self.assertTrue(self.override(0.1, 5.0).success)
        self.wait_for(FilterState.OVERRIDE)
        start_s = time.monotonic()
        self.press()
        self.assert_e_stop(start_s, 0.0)
        answer = self.override(0.1, 5.0)
        self.assertFalse(answer.success)
        self.assertIn("e_stop", answer.message)
        self.assert_reset()

    def test_override_ends_by_reset(self):
        self.assertTrue(self.override(0.1, 5.0).success)
        self.wait_for(FilterState.OVERRIDE)
        self.assert_reset()

    def test_override_ends_when_the_command_falls_silent(self):
        self.lose_map()
        self.assertTrue(self.override(0.1, 10.0).success)
        self.wait_for(FilterState.OVERRIDE)
        self.fakes.nominal.stop()
        self.wait_for(FilterState.STOPPED, "map_lost")
        answer = self.override(0.1, 10.0)
        self.assertFalse(answer.success)
        self.assertIn("nominal command is", answer.message)
        self.fakes.nominal.start()
        wait_until(lambda: self.last.nominal_age_s < 0.1, what="the command again")
        self.states.clear()
        wait_until(lambda: len(self.states.entries) >= 5, what="states")
        self.assertFalse(speeds(self.states.entries).any())
        self.assert_reset()

    def test_bad_override_is_refused_in_words(self):
        for speed_mps, duration_s, word in (
            (0.0, 1.0, "speed_cap_mps"),
            (float("nan"), 1.0, "speed_cap_mps"),
            (0.1, -1.0, "duration_s"),
        ):
            answer = self.override(speed_mps, duration_s)
            self.assertFalse(answer.success)
            self.assertIn(word, answer.message)
        self.assertTrue(self.is_moving())

    # Parameters that only become tighter.

    def test_parameters_become_tighter_go_back_and_never_beyond(self):
        client = Client("cbf_filter", timeout=10.0)
        self.assertEqual(client.update_configuration({"max_vx_mps": 0.2})["max_vx_mps"], 0.2)
        wait_until(lambda: abs(self.last.u_safe[0] - 0.2) < 1e-9, what="the lower limit")
        self.assertEqual(rospy.get_param("cbf_filter/max_vx_mps"), 0.2)
        for wanted in ({"max_vx_mps": 0.6}, {"max_vx_mps": 0.1, "margin_m": 0.05}, {"max_vx_mps": float("nan")}):
            values = client.update_configuration(wanted)
            self.assertEqual((values["max_vx_mps"], values["margin_m"]), (0.2, 0.15), wanted)
        self.states.clear()
        wait_until(lambda: len(self.states.entries) >= 3, what="states")
        self.assertAlmostEqual(self.last.u_safe[0], 0.2)
        self.assertEqual(client.update_configuration({"max_vx_mps": 0.5})["max_vx_mps"], 0.5)
        client.close()

    # The loop.

    def test_a_loop_that_stood_still_starts_from_rest_with_new_inputs(self):
        master = rosgraph.get_master_uri()
        pid = call_server(call_server(master, 1.0, "lookupNode", rospy.resolve_name("cbf_filter")), 1.0, "getPid")
        self.states.clear()
        os.kill(pid, signal.SIGSTOP)
        time.sleep(0.6)
        os.kill(pid, signal.SIGCONT)
        after = wait_until(
            lambda: [s for _, s in self.states.entries if s.reason == "loop_overrun"], what="reason loop_overrun"
        )
        self.assertFalse(np.array(after[0].u_safe).any())
        self.assertIn("stood still for 0.", after[0].detail)


if __name__ == "__main__":
    rospy.init_node("operator_rostest")
    rostest.rosrun("core_control", "operator_rostest", OperatorTest)

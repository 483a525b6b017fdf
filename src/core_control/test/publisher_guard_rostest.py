#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""A second node on the filter's input, another one on its output: found, named, and forgotten when it has died."""

import os
import signal
import subprocess
import time
import unittest

import numpy as np
import rospy
import rostest
from cbf_filter_rostest import AHEAD, SLACK_S, Fakes
from core_msgs.msg import FilterState
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import Twist
from ros_support import Collector, wait_until
from std_srvs.srv import Trigger

DETECTION_S = 2.0
OUTPUT = "base/cmd_vel"  # what the launch file makes of cmd_vel
# Node that sends zeros on one topic until it is killed.
SENDER = """
import sys, rospy
from geometry_msgs.msg import Twist
rospy.init_node(sys.argv[1])
publisher = rospy.Publisher(sys.argv[2], Twist, queue_size=1)
rate = rospy.Rate(20)
while not rospy.is_shutdown():
    publisher.publish(Twist())
    rate.sleep()
"""


def registered(topic):
    """Names of the nodes that the master holds for publishers of a topic."""
    publishers, _, _ = rospy.get_master().getSystemState()[2]
    return {node for name, nodes in publishers if name == topic for node in nodes}


class Sender:
    """Process of a node that sends Twist; killed without a chance to unregister."""

    def __init__(self, name, topic):
        self.name = f"/{name}"
        self.process = subprocess.Popen(["python3", "-c", SENDER, name, topic])
        wait_until(lambda: self.name in registered(rospy.resolve_name(topic)), 20.0, f"{name} at the master")
        self.since_s = time.monotonic()

    def kill(self):
        self.process.kill()
        self.process.wait()


class PublisherGuardTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.states, cls.diagnostics = (
            Collector("cbf_filter/state", FilterState),
            Collector("diagnostics", DiagnosticArray),
        )
        rospy.wait_for_service("cbf_filter/reset", 30.0)
        cls.fakes = Fakes()

    def setUp(self):
        self.wait_for_motion()

    def wait_for_motion(self, timeout_s=10.0):
        def is_moving():
            state = self.states.last
            return state and state.mode == FilterState.NOMINAL and np.array_equal(state.u_safe, AHEAD)

        wait_until(is_moving, timeout_s, f"motion; last state {self.states.last}")

    def assert_found(self, sender, reason):
        self.states.clear()
        state = wait_until(
            lambda: self.states.last and self.states.last.reason == reason and self.states.last, what=reason
        )
        took_s = self.states.entries[-1][0] - sender.since_s
        print(f"{reason}: {took_s:.2f} s after {sender.name} was registered")
        self.assertLess(took_s, DETECTION_S + SLACK_S)
        self.assertEqual(state.mode, FilterState.STOPPED)
        self.assertFalse(np.array(state.u_safe).any())
        self.assertIn(sender.name, state.detail)
        return state

    def test_two_nodes_on_the_input_stop_it_until_one_has_died(self):
        sender = Sender("second_driver", "cmd_vel_nominal")
        try:
            state = self.assert_found(sender, "nominal_publishers")
            self.assertIn(rospy.get_name(), state.detail)
            self.assertFalse(state.latched)
        finally:
            sender.kill()
        self.assertIn(sender.name, registered(rospy.resolve_name("cmd_vel_nominal")))
        self.wait_for_motion(DETECTION_S + SLACK_S)

    def test_a_stopped_node_counts_while_it_may_come_back_but_not_for_ever(self):
        hung = Sender("hung_driver", "cmd_vel_nominal")
        os.kill(hung.process.pid, signal.SIGSTOP)
        try:
            self.assert_found(hung, "nominal_publishers")
            self.wait_for_motion(15.0)
        finally:
            os.kill(hung.process.pid, signal.SIGCONT)
            hung.kill()

    def test_another_node_on_the_output_latches_it_until_reset_without_that_node(self):
        reset = rospy.ServiceProxy("cbf_filter/reset", Trigger)
        sender = Sender("bypass", OUTPUT)
        try:
            self.assertTrue(self.assert_found(sender, "foreign_publisher").latched)
            answer = reset()
            self.assertFalse(answer.success)
            self.assertIn(sender.name, answer.message)
        finally:
            sender.kill()
        self.assertIn(sender.name, registered(rospy.resolve_name(OUTPUT)))
        wait_until(lambda: reset().success, DETECTION_S + SLACK_S, "reset without that node")
        self.wait_for_motion()
        self.states.clear()
        wait_until(lambda: len(self.states.entries) >= 30, what="states after reset")
        self.assertEqual({state.reason for _, state in self.states.entries}, {""})

    def test_diagnostics_warn_while_nobody_receives_the_output(self):
        self.diagnostics.clear()
        status = wait_until(lambda: self.diagnostics.last, what="diagnostics").status[0]
        self.assertIn("nobody receives /base/cmd_vel", status.message)
        self.assertEqual(status.level, DiagnosticStatus.WARN)
        subscriber = rospy.Subscriber(OUTPUT, Twist, lambda _: None)
        wait_until(lambda: "nobody" not in self.diagnostics.last.status[0].message, what="a receiver in diagnostics")
        self.assertEqual(self.diagnostics.last.status[0].level, DiagnosticStatus.OK)
        subscriber.unregister()


if __name__ == "__main__":
    rospy.init_node("publisher_guard_rostest")
    rostest.rosrun("core_control", "publisher_guard_rostest", PublisherGuardTest)

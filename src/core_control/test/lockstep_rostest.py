#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""Lock-step: every tick is answered once, with the stamps it was made for, and repeats bit for bit after a reset."""

import time
import unittest

import numpy as np
import rospy
import rostest
from control_support import Plant
from core_msgs.msg import FilterState, SafetyGrid, Tick
from core_msgs.srv import Override
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from ros_support import Collector, make_wall_msg, wait_until
from std_msgs.msg import Bool
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

from core_control.ros.conversions import odometry_to_msg, twist_from_msg

PERIOD_NS = 50_000_000


def to_time(ns):
    return rospy.Time(ns // 10**9, ns % 10**9)


class FakeWorld:
    """The bridge's side of the lock-step protocol, with an exact robot and a wall at x = 2 m."""

    def __init__(self):
        latched = {"latch": True, "queue_size": 10}
        self.odom_pub = rospy.Publisher("odom", Odometry, **latched)
        self.grid_pub = rospy.Publisher("safety_grid", SafetyGrid, **latched)
        self.tick_pub = rospy.Publisher("lockstep/tick", Tick, **latched)
        self.states = Collector("cbf_filter/state", FilterState)
        self.commands = Collector("cmd_vel", Twist)

    def run(self, ticks, grid_first=True, start=(0.0, 0.0, 0.0)):
        """Poses (ticks, 3) and states of a run from rest."""
        plant, poses, states = Plant(start), [], []
        for k in range(ticks):
            self.send(k, plant, grid_first)
            state = wait_until(lambda k=k: self.answer_to(k), what=f"answer to tick {k}")
            u = np.array(state.u_safe)
            wait_until(lambda u=u: np.array_equal(twist_from_msg(self.commands.last), u), what="cmd_vel is u_safe")
            plant.step(u)
            poses.append(plant.pose)
            states.append(state)
        return np.array(poses), states

    def send(self, k, plant, grid_first=True, period_s=PERIOD_NS * 1e-9):
        ns, frame_ns = k * PERIOD_NS, (k // 2) * 2 * PERIOD_NS
        odometry = odometry_to_msg(plant.pose, plant.twist)
        odometry.header.stamp = to_time(ns)
        tick = Tick(tick=k, period_s=period_s, frame_stamp=to_time(frame_ns))
        tick.header.stamp = to_time(ns)
        grid = make_wall_msg(2.0, to_time(frame_ns), to_time(1))
        steps = [lambda: self.grid_pub.publish(grid), lambda: self.tick_pub.publish(tick)]
        self.odom_pub.publish(odometry)
        for step in steps if grid_first else reversed(steps):
            step()

    def answer_to(self, k):
        state = self.states.last
        stamp_ns = state.header.stamp.to_nsec() if state else -1
        return state if stamp_ns == k * PERIOD_NS and state.tick == k else None


class LockstepTest(unittest.TestCase):
    def test_walks_to_the_wall_rests_and_repeats_after_a_reset(self):
        markers = Collector("cbf_filter/markers", MarkerArray)
        world = FakeWorld()
        poses, states = world.run(160)
        self.assertFalse([state.reason for state in states if state.reason])
        self.assertEqual(states[0].mode, FilterState.NOMINAL)
        self.assertEqual(states[-1].mode, FilterState.FILTERED)
        self.assertEqual(states[-1].binding_rule, "BETWEEN(traffic_cone)")
        self.assertEqual(states[-1].binding_class, "traffic_cone")
        self.assertAlmostEqual(states[-1].binding_point.x, 2.0, places=6)
        self.assertEqual(list(states[-1].u_safe), [0.0, 0.0, 0.0])
        gap_m = 2.0 - (poses[-1, 0] + 0.55)
        self.assertGreater(gap_m, 0.1)
        self.assertLess(gap_m, 0.35)
        self.assertLess(np.abs(poses[-1] - poses[-20]).max(), 1e-6)
        wait_until(lambda: markers.last, what="markers")

        world.states.clear()
        # Reset while it walks elsewhere: nothing held of that run may answer for the new one.
        world.run(40, start=(0.0, 0.3, 0.0))
        again, _ = world.run(60, grid_first=False)
        np.testing.assert_array_equal(again, poses[:60])

    def test_operator_stops_it_by_true_not_by_silence_and_drives_in_sim_time(self):
        world, plant = FakeWorld(), Plant(np.zeros(3))
        e_stop = rospy.Publisher("e_stop", Bool, queue_size=1, latch=True)
        reset = rospy.ServiceProxy("cbf_filter/reset", Trigger)

        def answer(k):
            world.send(k, plant)
            return wait_until(lambda: world.answer_to(k), what=f"answer to tick {k}")

        rospy.wait_for_service("cbf_filter/reset", 30.0)
        self.addCleanup(e_stop.publish, False)
        e_stop.publish(True)
        wait_until(lambda: not reset().success, what="e_stop heard")
        self.assertEqual([answer(0).reason, answer(1).reason], ["e_stop", "e_stop"])
        e_stop.publish(False)
        wait_until(lambda: reset().success, what="reset after e_stop")
        time.sleep(1.3)
        self.assertEqual(answer(2).mode, FilterState.NOMINAL)
        self.assertTrue(rospy.ServiceProxy("cbf_filter/override", Override)(0.1, 0.475).success)
        overridden = [answer(k).mode == FilterState.OVERRIDE for k in range(3, 15)]
        self.assertEqual(overridden, [True] * 10 + [False] * 2)

    def test_wrong_period_stops_it_until_reset(self):
        world, plant = FakeWorld(), Plant(np.zeros(3))
        world.send(0, plant, period_s=0.1)
        state = wait_until(lambda: world.answer_to(0), what="answer to tick 0")
        self.assertEqual((state.mode, state.reason), (FilterState.STOPPED, "internal_error"))
        self.assertIn("tick period is 0.1 s", state.detail)
        world.send(1, plant)
        state = wait_until(lambda: world.answer_to(1), what="answer to tick 1")
        self.assertEqual(state.reason, "internal_error")
        self.assertIn("tick period", rospy.ServiceProxy("cbf_filter/reset", Trigger)().message)
        world.send(2, plant)
        state = wait_until(lambda: world.answer_to(2), what="answer to tick 2")
        self.assertEqual(state.reason, "")
        self.assertNotEqual(state.mode, FilterState.STOPPED)
        world.send(3, plant, period_s=float("nan"))
        state = wait_until(lambda: world.answer_to(3), what="answer to tick 3")
        self.assertIn("tick period is nan s", state.detail)
        self.assertTrue(rospy.ServiceProxy("cbf_filter/reset", Trigger)().success)


if __name__ == "__main__":
    rospy.init_node("lockstep_rostest")
    rostest.rosrun("core_control", "lockstep_rostest", LockstepTest)

#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""Simulated time that flows, stands still and jumps back: a filter between fakes, and both nodes on a path."""

import threading
import time
import unittest

import numpy as np
import rospy
import rostest
from control_support import Plant
from core_msgs.msg import FilterState, SafetyGrid
from geometry_msgs.msg import PoseStamped, Twist
from nav_msgs.msg import Odometry, Path
from ros_support import Collector, RatePublisher, make_odometry_msg, make_wall_msg, wait_until
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Bool, Float64

from core_control.ros.conversions import odometry_to_msg, twist_from_msg, twist_to_msg

PERIOD_S = 0.05
# Wall time in which zero is due when the clock stands, and what a loaded machine may add [s].
STOP_S, SLACK_S = 0.5, 0.25
ZERO = (0.0, 0.0, 0.0)
AHEAD = np.array([0.3, 0.0, 0.0])


class FakeSimulator:
    """Clock, odometry and grid of an exact robot that obeys cmd_vel; can be paused and sent back in time."""

    def __init__(self):
        self.commands = Collector("cmd_vel", Twist)
        self.clock_pub = rospy.Publisher("/clock", Clock, queue_size=1)
        self.odom_pub = rospy.Publisher("odom", Odometry, queue_size=1)
        self.grid_pub = rospy.Publisher("safety_grid", SafetyGrid, queue_size=1)
        self.lock = threading.Lock()
        self.running, self.now_s, self.plant = threading.Event(), 100.0, Plant(np.zeros(3))
        self.running.set()
        threading.Thread(target=self.run, daemon=True).start()

    def run(self):
        while not rospy.is_shutdown():
            self.running.wait()
            with self.lock:
                self.step()
            time.sleep(PERIOD_S)

    def step(self):
        self.now_s += PERIOD_S
        now = rospy.Time.from_sec(self.now_s)
        command = self.commands.last
        self.plant.step(np.zeros(3) if command is None else twist_from_msg(command))
        odometry = odometry_to_msg(self.plant.pose, self.plant.twist)
        odometry.header.stamp = now
        self.clock_pub.publish(Clock(now))
        self.grid_pub.publish(make_wall_msg(2.0, now, now))
        self.odom_pub.publish(odometry)

    def reset(self, now_s):
        with self.lock:
            self.now_s, self.plant = now_s, Plant(np.zeros(3))


def make_path(points):
    path = Path()
    path.header.frame_id = "odom"
    for x_m, y_m in points:
        pose = PoseStamped()
        pose.pose.position.x, pose.pose.position.y = x_m, y_m
        path.poses.append(pose)
    return path


class LonelyFilter:
    """A filter whose inputs are made here: commands without stamps, as of an operator, the others in sim time."""

    def __init__(self, simulator):
        self.simulator = simulator
        self.nominal = RatePublisher("/lonely/cmd_vel_nominal", Twist, lambda: twist_to_msg(AHEAD), 20)
        self.odometry = RatePublisher("/lonely/odom", Odometry, self.make_odometry, 50)
        self.grid = RatePublisher("/lonely/safety_grid", SafetyGrid, self.make_grid, 10)
        self.states = Collector("/lonely/cbf_filter/state", FilterState)
        self.commands = Collector("/lonely/cmd_vel", Twist)

    def make_odometry(self):
        return make_odometry_msg(stamp=rospy.Time.from_sec(self.simulator.now_s))

    def make_grid(self):
        now = rospy.Time.from_sec(self.simulator.now_s)
        return make_wall_msg(2.9, now, now)

    def is_moving(self):
        state, command = self.states.last, self.commands.last
        return state and command and state.mode == FilterState.NOMINAL and twist_from_msg(command)[0] == AHEAD[0]

    def is_moving_since(self, start_s):
        """Whether it moves, as a condition, by a state stamped after a jump to a time."""
        return lambda: self.is_moving() and start_s < self.states.last.header.stamp.to_sec() < start_s + 20.0

    def silence(self, is_silent):
        self.odometry.silent = self.grid.silent = is_silent

    def wait_for_reason(self, reason):
        """Zero with the reason, and for ten ticks nothing else."""
        wait_until(lambda: self.states.last.reason == reason, what=f"{reason}; last state {self.states.last}")
        self.states.clear()
        wait_until(lambda: len(self.states.entries) >= 10, what="ten states")
        answers = {(state.reason, tuple(state.u_safe)) for _, state in self.states.entries}
        assert answers == {(reason, ZERO)}, answers


class SimClockTest(unittest.TestCase):
    simulator = None

    @classmethod
    def setUpClass(cls):
        cls.simulator = FakeSimulator()
        cls.lonely = LonelyFilter(cls.simulator)

    def setUp(self):
        self.simulator.running.set()
        self.lonely.silence(False)
        wait_until(self.lonely.is_moving, what="motion")

    def test_a_clock_that_stands_stops_it_within_half_a_second_and_it_goes_on(self):
        lonely, start_s = self.lonely, time.monotonic()
        self.simulator.running.clear()
        lonely.silence(True)
        lonely.wait_for_reason("odometry_stale")
        commands = [(at, twist_from_msg(command)) for at, command in lonely.commands.entries if at > start_s]
        last_s = max((at for at, u in commands if np.any(u)), default=start_s)
        self.assertLess(last_s - start_s, STOP_S + SLACK_S)
        # The loop lives on: zero at its rate, though ROS time stands.
        zeros_s = [at for at, u in commands if not np.any(u)]
        self.assertAlmostEqual(np.median(np.diff(zeros_s)), PERIOD_S, delta=0.3 * PERIOD_S)
        self.assertEqual(len({state.header.stamp for _, state in lonely.states.entries}), 1)
        self.simulator.running.set()
        lonely.silence(False)
        wait_until(lonely.is_moving, what="motion after the pause, by itself")

    def test_a_clock_that_jumps_back_gives_zero_at_once_and_it_goes_on_each_time(self):
        lonely = self.lonely
        for now_s in (80.0, 50.0, 20.0):
            with self.subTest(now_s):
                lonely.states.clear()
                self.simulator.reset(now_s)
                wait_until(lonely.is_moving_since(now_s), what="motion after the jump, by itself")
                first = next(state for _, state in lonely.states.entries if state.header.stamp.to_sec() < now_s + 15.0)
                # Nothing of the time before the jump counts, not even a command without a stamp.
                self.assertEqual((first.reason, tuple(first.u_safe)), ("waiting_for_nominal", ZERO))

    def test_after_a_jump_back_nothing_moves_before_every_input_is_there_again(self):
        lonely = self.lonely
        lonely.silence(True)
        self.simulator.reset(self.simulator.now_s - 10.0)
        lonely.wait_for_reason("odometry_missing")
        lonely.odometry.silent = False
        lonely.wait_for_reason("grid_missing")
        lonely.grid.silent = False
        wait_until(lonely.is_moving, what="motion")

    def test_the_path_is_walked_through_a_pause_and_a_jump_back(self):
        states, reached = Collector("cbf_filter/state", FilterState), Collector("goal_reached", Bool)
        distances = Collector("waypoint_controller/distance_to_goal", Float64)
        path_pub = rospy.Publisher("path", Path, queue_size=1, latch=True)
        simulator = self.simulator
        wait_until(lambda: states.last and states.last.mode == FilterState.NOMINAL, what="nominal command")
        path_pub.publish(make_path([(0.4, 0.0), (1.2, 0.0)]))
        wait_until(lambda: simulator.plant.twist[0] > 0.3, what="motion")

        simulator.running.clear()
        stop = wait_until(lambda: states.last.mode == FilterState.STOPPED and states.last, what="stop by pause")
        self.assertIn(stop.reason, {"nominal_stale", "odometry_stale"})
        simulator.running.set()
        wait_until(lambda: simulator.plant.twist[0] > 0.3, what="motion after the pause")
        simulator.reset(5.0)
        wait_until(lambda: reached.last and reached.last.data, 15.0, what="goal after the jump")
        self.assertLess(np.linalg.norm(simulator.plant.pose[:2] - [1.2, 0.0]), 0.25)
        self.assertLess(distances.last.data, 0.25)


if __name__ == "__main__":
    rospy.init_node("sim_clock_rostest")
    rostest.rosrun("core_control", "sim_clock_rostest", SimClockTest)

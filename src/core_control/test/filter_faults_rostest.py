#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""A flooded, a stopped and a killed filter; and the bag of a session of faults, held against check_bag."""

import contextlib
import math
import os
import signal
import subprocess
import tempfile
import time
import unittest
from pathlib import Path

import numpy as np
import rosgraph
import rospy
import rostest
from core_msgs.msg import FilterState, SafetyGrid
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from ros_support import Collector, RatePublisher, make_odometry_msg, make_wall_msg, node_pid, wait_until

from core_control.ros.conversions import twist_from_msg, twist_to_msg

TICK_S = 0.05
AHEAD = np.array([0.3, 0.0, 0.0])
NAMES = ("nominal", "odometry", "grid")
NODE = "/filter/cbf_filter"
TOPICS = [f"/filter/{name}" for name in ("cmd_vel_nominal", "odom", "safety_grid", "cbf_filter/state", "cmd_vel")]
# A process that imports the solver on a busy machine [s].
START_S = 40.0
# Windows of the flood: the load of other programs comes and goes, that of the flood stays.
WINDOWS, WINDOW_TICKS = 3, 100
WALK_TICKS = 25
FIRST_MPS, STEP_MPS = 0.1, 1e-6


def to_s(state):
    return state.header.stamp.to_sec()


class Fakes:
    """The three inputs at their rates, each changeable; a hung publisher is silent and stays registered."""

    def __init__(self):
        self.u, self.constraints_age_s = AHEAD, 0.0
        self.nominal = RatePublisher("/filter/cmd_vel_nominal", Twist, lambda: twist_to_msg(self.u), 20)
        self.odometry = RatePublisher("/filter/odom", Odometry, make_odometry_msg, 50)
        self.grid = RatePublisher("/filter/safety_grid", SafetyGrid, self.make_grid, 10)

    def make_grid(self):
        now = rospy.Time.now()
        return make_wall_msg(2.9, now, now - rospy.Duration.from_sec(self.constraints_age_s))

    def silence(self, *names):
        for name in names:
            getattr(self, name).silent = True

    def speak(self, *names):
        for name in names:
            getattr(self, name).silent = False


class Flood:
    """Commands as fast as they go, each a little faster than the last, so that a state tells which one it took."""

    def __init__(self, topic):
        self.sent_s = []
        self._publisher = RatePublisher(topic, Twist, self._make, 1000)

    def _make(self):
        self.sent_s.append(time.time())
        return twist_to_msg((FIRST_MPS + STEP_MPS * (len(self.sent_s) - 1), 0.0, 0.0))

    def sent(self, state):
        """Whether the command of a state is one of its own."""
        return self._find_number(state) < len(self.sent_s)

    def find_sent_s(self, state):
        """When the command of a state was sent."""
        return self.sent_s[self._find_number(state)]

    @staticmethod
    def _find_number(state):
        return round((state.u_nominal[0] - FIRST_MPS) / STEP_MPS)

    def stop(self):
        self._publisher.stop()


class Recorder:
    """rosbag record in a process of its own."""

    def __init__(self, path):
        self._path = path
        command = ["rosbag", "record", "--quiet", "-O", str(path), *TOPICS, "__name:=recorder"]
        # A session of its own: what is started is a wrapper, and both must hear the signal.
        self._process = subprocess.Popen(command, start_new_session=True)
        wait_until(self._listens, START_S, "the recorder to listen to every topic")

    @staticmethod
    def _listens():
        _, subscribers, _ = rosgraph.Master("/test").getSystemState()
        heard = {topic for topic, nodes in subscribers if "/recorder" in nodes}
        return heard >= set(TOPICS)

    def stop(self):
        os.killpg(self._process.pid, signal.SIGINT)
        self._process.wait(30.0)
        wait_until(self._path.exists, 10.0, "the bag")

    def kill(self):
        """After a test that failed on the way."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)


class FilterFaultsTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.states = Collector("/filter/cbf_filter/state", FilterState)
        cls.commands = Collector("/filter/cmd_vel", Twist)
        cls.null_states = Collector("/null/cbf_filter/state", FilterState)
        wait_until(lambda: cls.states.last and cls.null_states.last, START_S, "both filters")
        cls.fakes = Fakes()

    def setUp(self):
        self.wait_for_motion()

    def wait_for_motion(self):
        wait_until(self.is_moving, START_S, f"motion; last state {self.states.last}")

    def is_moving(self):
        state, command = self.states.last, self.commands.last
        return state.mode == FilterState.NOMINAL and np.array_equal(twist_from_msg(command), AHEAD)

    def wait_for_reason(self, reason):
        """Zero with the reason, and for ten ticks nothing else."""
        wait_until(lambda: self.states.last and self.states.last.reason == reason, START_S, f"reason {reason}")
        self.states.clear()
        wait_until(lambda: len(self.states.entries) >= 10, what="ten states")
        answers = {(state.reason, tuple(state.u_safe)) for _, state in self.states.entries}
        self.assertEqual(answers, {(reason, (0.0, 0.0, 0.0))})

    # A flood of commands.

    def test_a_flood_of_commands_neither_slows_the_output_nor_makes_a_queue(self):
        self.fakes.nominal.stop()  # one publisher at a time
        floods = [Flood(f"/{name}/cmd_vel_nominal") for name in ("filter", "null")]
        try:
            wait_until(self.heeds(floods[0]), what="a command of the flood")
            tries = []
            while len(tries) < WINDOWS and not (tries and tries[-1][0] < tries[-1][1]):
                tries.append(self.measure_window(floods[0]))
        finally:
            for flood in floods:
                flood.stop()
            self.fakes.nominal.start()
        self.assertLess(*tries[-1], f"p99 of the periods [s] and what is allowed, per window: {tries}")

    def heeds(self, flood):
        """Whether the robot walks by a command of the flood, as a condition."""
        return lambda: self.states.last.mode == FilterState.NOMINAL and flood.sent(self.states.last)

    def measure_window(self, flood):
        """p99 of the periods by the node's stamps [s], and 1.2 periods plus what the null filter lost as well."""
        sent = len(flood.sent_s)
        self.states.clear()
        self.null_states.clear()
        wait_until(lambda: len(self.states.entries) > WINDOW_TICKS, 30.0, "states under the flood")
        states, nulls = ([state for _, state in c.entries] for c in (self.states, self.null_states))
        span_s = to_s(states[-1]) - to_s(states[0])
        self.assertGreater((len(flood.sent_s) - sent) / span_s, 400.0, "the flood itself is slow")
        self.assertEqual([state.tick - states[0].tick for state in states], list(range(len(states))))
        sources_s = [flood.find_sent_s(state) for state in states]
        self.assertTrue(np.all(np.diff(sources_s) > 0.0), "every tick has a newer command than the last")
        waits_s = [to_s(state) - sent_s for state, sent_s in zip(states, sources_s)]
        self.assertLess(np.percentile(waits_s, 99), 2.0 * TICK_S, "the newest command wins, not one from a queue")
        periods_s = np.diff([to_s(state) for state in states])
        self.assertAlmostEqual(np.median(periods_s), TICK_S, delta=0.2 * TICK_S, msg="no command per command either")
        own_s, null_s = (float(np.percentile(p, 99)) for p in (periods_s, np.diff([to_s(s) for s in nulls])))
        return own_s, 1.2 * TICK_S + max(0.0, null_s - TICK_S)

    # A session of faults, and its bag.

    def test_no_fault_makes_it_move_without_fresh_inputs_and_its_bag_proves_it(self):
        with tempfile.TemporaryDirectory() as folder:
            bag = Path(folder) / "faults.bag"
            recorder = Recorder(bag)
            self.addCleanup(recorder.kill)
            for fault in (self.hang_inputs, self.send_no_number, self.stop_for_a_second, self.kill):
                with self.subTest(fault.__name__):
                    self.walk()
                    fault()
            self.walk()
            recorder.stop()
            self.assert_bag(bag)

    def walk(self):
        """Goes on by itself, and for a second or two of commands."""
        self.wait_for_motion()
        self.commands.clear()
        wait_until(lambda: len(self.commands.entries) >= WALK_TICKS, what="commands while walking")
        self.assertTrue(self.is_moving())

    def hang_inputs(self):
        for name, reason in zip(NAMES, ("nominal_stale", "odometry_stale", "grid_stale")):
            self.fakes.silence(name)
            self.wait_for_reason(reason)
            self.fakes.speak(name)
            self.wait_for_motion()

    def send_no_number(self):
        self.fakes.u = np.array([0.3, math.nan, 0.0])
        self.wait_for_reason("nominal_not_finite")
        self.fakes.u = AHEAD

    def stop_for_a_second(self):
        """SIGSTOP: the base hears nothing; afterwards nothing is sent that rests on what came before."""
        pid = node_pid(NODE)
        os.kill(pid, signal.SIGSTOP)
        stopped_s = time.monotonic()
        try:
            wait_until(lambda: time.monotonic() > stopped_s + 1.0, what="a second")
            late = [at for at, _ in self.commands.entries if at > stopped_s + 0.2]
            self.assertEqual(late, [])
            self.states.clear()
        finally:
            os.kill(pid, signal.SIGCONT)
        wait_until(lambda: self.states.last, what="a state after SIGCONT")

    def kill(self):
        """SIGKILL, and no motion of the next process before every input came to it."""
        self.fakes.silence(*NAMES)
        pid = node_pid(NODE)
        self.states.clear()
        self.commands.clear()
        os.kill(pid, signal.SIGKILL)
        self.fakes.constraints_age_s = 16.0
        self.wait_for_reason("waiting_for_nominal")
        self.assertNotEqual(node_pid(NODE), pid)
        for name, reason in zip(NAMES, ("odometry_missing", "grid_missing", "constraints_stale")):
            self.fakes.speak(name)
            self.wait_for_reason(reason)
        self.assertFalse([c for _, c in self.commands.entries[3:] if np.any(twist_from_msg(c))])
        self.fakes.constraints_age_s = 0.0

    def assert_bag(self, bag):
        # The period has a test of its own, beside a null filter; here other programs may take their time.
        arguments = ["--ns", "/filter", "--transport-s", "0.1", "--period-s", "0.1"]
        done = run_check(bag, *arguments)
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        self.assertIn("restarts 1", done.stdout)
        self.assertGreater(int(done.stdout.split("moving ")[1].split()[0]), 100)
        # The same bag does not hold against ages that no publisher can keep.
        done = run_check(bag, *arguments, "--grid-timeout-s", "0.001")
        self.assertEqual(done.returncode, 1, done.stdout + done.stderr)
        self.assertIn("fresh_grid: ", done.stdout)


def run_check(bag, *arguments):
    command = ["rosrun", "core_control", "check_bag", str(bag), *arguments]
    return subprocess.run(command, capture_output=True, check=False, text=True)


if __name__ == "__main__":
    rospy.init_node("filter_faults_rostest")
    rostest.rosrun("core_control", "filter_faults_rostest", FilterFaultsTest)

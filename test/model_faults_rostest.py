#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""A robot that turns on the spot on the word of a model server, which fails in eight ways, one after the other."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
import unittest
from pathlib import Path

import numpy as np
import rospkg
import rospy
from core_msgs.msg import FilterState
from geometry_msgs.msg import Twist
from graph import wait_for

TEST_FOLDER = Path(rospkg.RosPack().get_path("core_perception")) / "test"
sys.path.insert(0, str(TEST_FOLDER))

from fakes.fake_model_server import control  # noqa: E402

ANSWER = {
    "safety_logic": "The floor is meant for walking. Racks and boxes are solid.",
    "classes": ["floor", "storage_rack", "cardboard_box"],
    "unsafe_regions": ["NEAR(storage_rack)", "NEAR(cardboard_box)"],
    "safe_regions": ["ON(floor)"],
}
FAULTS = ("hang", "drip", "500", "garbage", "huge", "other_schema", "nothing")
NOMINAL_RADPS = 0.4
START_DEADLINE_S = 60.0
STOP_DEADLINE_S = 15.0
# The longest pause after failures is 10 s.
RECOVERY_DEADLINE_S = 30.0
# Bar: how much older than the limit constraints may be under a moving robot [s].
SLACK_S = 0.2


class ModelServer:
    """The fake in a process of its own, on one port."""

    def __init__(self, port):
        self.url, self._port, self._process = f"http://127.0.0.1:{port}", port, None

    def start(self):
        script = str(TEST_FOLDER / "fakes" / "fake_model_server.py")
        command = [sys.executable, script, "--port", str(self._port), "--latency-s", "0.2"]
        self._process = subprocess.Popen(command, stdout=subprocess.PIPE)
        self._process.stdout.readline()
        control(self.url, "/_answer", {"text": json.dumps(ANSWER)})

    def fail(self, kind):
        control(self.url, "/_fault", {"kind": kind})

    def kill(self):
        self._process.send_signal(signal.SIGKILL)
        self._process.wait()


class ModelFaults(unittest.TestCase):
    def setUp(self):
        self.fresh_s, self.ttl_s = rospy.get_param("~constraints_fresh_s"), rospy.get_param("~constraints_ttl_s")
        self.server = ModelServer(rospy.get_param("~port"))
        self.server.start()
        self.states, self.commands_s = [], []
        self.subscribers = [
            rospy.Subscriber("cbf_filter/state", FilterState, self.states.append),
            rospy.Subscriber("cmd_vel", Twist, lambda _: self.commands_s.append(time.monotonic())),
        ]
        self.nominal = rospy.Publisher("cmd_vel_nominal", Twist, queue_size=1)
        self.is_over = threading.Event()
        threading.Thread(target=self.command, daemon=True).start()

    def tearDown(self):
        self.is_over.set()
        self.server.kill()

    def command(self):
        twist = Twist()
        twist.angular.z = NOMINAL_RADPS
        while not self.is_over.wait(0.05):
            self.nominal.publish(twist)

    def is_turning(self):
        return bool(self.states) and self.states[-1].u_safe[2] > 0.9 * NOMINAL_RADPS

    def is_stopped_for_age(self):
        last = self.states[-1]
        return last.mode == FilterState.STOPPED and last.reason == "constraints_stale"

    def suffer(self, name, begin, end):
        """One fault: from a turning robot to a standing one and back; returns its figures."""
        count = len(self.states)
        begun_s = time.monotonic()
        begin()
        wait_for(self, self.is_stopped_for_age, STOP_DEADLINE_S, name + ": the robot to stand")
        stopped_s = time.monotonic()
        states = [s for s in self.states[count:] if s.u_safe[2] != 0.0]
        self.assertLessEqual(max(s.constraints_age_s for s in states), self.ttl_s + SLACK_S, name)
        # In the last quarter of the time between the two limits the cap is a quarter of the largest rate, 0.8 rad/s.
        late = [s.u_safe[2] for s in states if s.constraints_age_s > 0.25 * self.fresh_s + 0.75 * self.ttl_s]
        self.assertTrue(late, name + ": no slow motion was seen before the stop")
        self.assertLess(max(late), 0.51 * NOMINAL_RADPS, name + ": the robot did not slow before the stop")
        end()
        wait_for(self, self.is_turning, RECOVERY_DEADLINE_S, name + ": the robot to go on by itself")
        return {
            "oldest_moving_s": round(max(s.constraints_age_s for s in states), 3),
            "recovery_s": round(time.monotonic() - stopped_s, 2),
            "intervals_s": np.diff([t for t in self.commands_s if begun_s <= t <= stopped_s]).tolist(),
        }

    def test_robot_slows_stands_and_recovers_whatever_the_server_does(self):
        wait_for(self, self.is_turning, START_DEADLINE_S, "the robot to turn on the word of the model")
        healthy_s = time.monotonic()
        rospy.rostime.wallsleep(5.0)
        healthy = np.diff([t for t in self.commands_s if t > healthy_s])
        figures = {"killed": self.suffer("killed", self.server.kill, self.server.start)}
        for kind in FAULTS:
            figures[kind] = self.suffer(kind, lambda kind=kind: self.server.fail(kind), lambda: self.server.fail("ok"))
        faulty = np.concatenate([f.pop("intervals_s") for f in figures.values()])
        summary = {
            "faults": figures,
            "constraints_ttl_s": self.ttl_s,
            "loop_p99_healthy_s": round(float(np.percentile(healthy, 99)), 4),
            "loop_p99_faulty_s": round(float(np.percentile(faulty, 99)), 4),
        }
        folder = Path(rospy.get_param("~results"))
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "faults.json").write_text(json.dumps(summary, indent=2) + os.linesep)
        print(json.dumps(summary))


if __name__ == "__main__":
    import rostest

    rospy.init_node("model_faults_rostest", disable_rostime=True)
    rostest.rosrun("core_bringup", "model_faults", ModelFaults, sys.argv)

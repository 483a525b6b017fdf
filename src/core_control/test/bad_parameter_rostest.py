#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""Each node with one bad parameter: one line on stderr, exit code 2, nothing published."""

import subprocess
import unittest

import rospy
import rostest

CASES = [
    ("cbf_filter", "alpha_per_s:=-1.0", "~alpha_per_s: got -1.0, allowed a finite number > 0"),
    ("cbf_filter", "footprint:={lenght_m: 1.0}", "~footprint/lenght_m: got 1.0, allowed no such parameter"),
    (
        "cbf_filter",
        "constraints_fresh_s:=15.5",
        "~constraints_fresh_s: got 15.5, allowed >= 0 and <= constraints_ttl_s (15)",
    ),
    (
        "cbf_filter",
        "kinematics:=tracked",
        "~kinematics: got 'tracked', allowed one of holonomic, differential, ackermann",
    ),
    (
        "cbf_filter",
        "kinematics:=ackermann",
        "~min_turning_radius_m: got 0.0, allowed > 0 with kinematics ackermann",
    ),
    ("waypoint_controller", "waypoints:=[[1.0]]", "~waypoints[0]: got [1.0], allowed a list of [x_m, y_m]"),
    ("filter_markers", "no_such_key:=3", "~no_such_key: got 3, allowed no such parameter"),
]


class BadParameterTest(unittest.TestCase):
    def test_bad_parameter_ends_with_two_and_one_line(self):
        running = []
        for number, (node, argument, expected) in enumerate(CASES):
            # A namespace each: the nodes run side by side and would end one another by their names.
            command = ["rosrun", "core_control", node, f"_{argument}", f"__ns:=case_{number}"]
            process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
            running.append((process, f"/case_{number}/{node}: parameter {expected}"))
        for process, expected in running:
            with self.subTest(expected):
                _, stderr = process.communicate(timeout=40)
                lines = stderr.strip().splitlines()
                self.assertEqual(process.returncode, 2, stderr)
                self.assertEqual(len(lines), 1, stderr)
                self.assertTrue(lines[0].startswith(expected), stderr)
        published = {topic for topic, _ in rospy.get_published_topics()}
        self.assertFalse({topic for topic in published if "cmd_vel" in topic or "markers" in topic}, published)


if __name__ == "__main__":
    rospy.init_node("bad_parameter_rostest")
    rostest.rosrun("core_control", "bad_parameter_rostest", BadParameterTest)

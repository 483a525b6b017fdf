#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""Waits for the result of the trial that this launch runs, and asserts what the .test file asks of it."""

import json
import sys
import time
import unittest
from pathlib import Path

import rospy

DEADLINE_S = 280.0


class TrialOutcome(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        started_s = time.time()
        path = Path(rospy.get_param("~results")) / "result.json"
        while not (path.exists() and path.stat().st_mtime >= started_s):
            if time.time() > started_s + DEADLINE_S or rospy.is_shutdown():
                raise AssertionError("no result of this run in %s after %.0f s" % (path, time.time() - started_s))
            rospy.rostime.wallsleep(0.2)
        cls.result = json.loads(path.read_text())

    def expected(self, name):
        if not rospy.has_param("~" + name):
            self.skipTest("not asked for")
        return rospy.get_param("~" + name)

    def test_outcome(self):
        self.assertEqual(self.result["outcome"], self.expected("outcome"), self.result)

    def test_outcome_is_one_of_those_allowed(self):
        self.assertIn(self.result["outcome"], self.expected("outcomes_allowed").split(), self.result)

    def test_robot_came_near_enough_to_be_held_by_the_hazard(self):
        self.assertLessEqual(self.result["stop_gap_m"], self.expected("max_stop_gap_m"), self.result)

    def test_footprint_stayed_out(self):
        self.assertGreater(self.result["stop_gap_m"], self.expected("min_stop_gap_m"), self.result)

    def test_no_false_stops(self):
        self.assertLessEqual(self.result["false_stops"], self.expected("max_false_stops"), self.result)

    def test_base_point_stayed_out(self):
        self.expected("base_never_inside")
        self.assertFalse(self.result["base_entered"], self.result)

    def test_nothing_touched(self):
        self.assertGreater(self.result["min_clearance_m"], 0.0, self.result)


if __name__ == "__main__":
    import rostest

    rospy.init_node("trial_outcome_rostest", disable_rostime=True)
    rostest.rosrun("core_bringup", "trial_outcome", TrialOutcome, sys.argv)

#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""A rule that the operator of a task adds in mid-run holds from then on, and the run repeats to the last bit."""

import sys
import tempfile
import unittest
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

from demo_pair import run_side_by_side  # noqa: E402

AT_S = 3.0
# Votes of before must be outvoted, then the barrier brings the robot to rest.
STANDS_WITHIN_S = 3.0


class OperatorRule(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        words = ["world:=%s" % (HERE / "data" / "small_place.yaml"), "task:=order"]
        with tempfile.TemporaryDirectory() as folder:
            (cls.first, cls.rows), (cls.second, _) = run_side_by_side(folder, words, words)

    def speeds(self, from_s, to_s):
        return [abs(row["vx_mps"]) for row in self.rows if from_s <= row["time_s"] < to_s]

    def test_robot_walks_until_the_rule_comes_and_stands_from_then_on(self):
        self.assertGreater(min(self.speeds(2.0, AT_S)), 0.3)
        self.assertLess(max(self.speeds(AT_S + STANDS_WITHIN_S, 8.0)), 0.02)

    def test_the_rule_binds_at_no_tick_before_its_time_and_within_a_second_after_it(self):
        bound_s = [row["time_s"] for row in self.rows if row["rule"] == "ON(floor)"]
        self.assertGreaterEqual(min(bound_s), AT_S)
        self.assertLess(min(bound_s), AT_S + 1.2)

    def test_the_rule_is_among_those_in_force(self):
        self.assertIn("ON(floor)=unsafe", self.first["predicates"])
        self.assertNotIn("ON(floor)=safe", self.first["predicates"])

    def test_the_same_run_gives_the_same_hash(self):
        self.assertEqual(self.first["trajectory_sha256"], self.second["trajectory_sha256"])


if __name__ == "__main__":
    import rostest

    rostest.rosrun("core_bringup", "operator_rule", OperatorRule, sys.argv)

#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""Method geometric walks through a line of cones and reaches a safe goal: it sees obstacles and nothing else."""

import sys
import tempfile
import unittest
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

from demo_pair import run_side_by_side  # noqa: E402


class Geometric(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        words = [["method:=geometric", "task:=" + task] for task in ("cone_line", "open_aisle")]
        with tempfile.TemporaryDirectory() as folder:
            (cls.cones, cls.cone_rows), (cls.aisle, cls.aisle_rows) = run_side_by_side(folder, *words)

    def test_cones_do_not_hold_it_but_it_touches_none(self):
        self.assertEqual(self.cones["outcome"], "violated", self.cones)
        self.assertEqual(self.cones["entered_region"], "behind_cone_line")
        self.assertGreater(self.cones["min_clearance_m"], 0.0)

    def test_a_safe_goal_is_reached_without_a_false_stop(self):
        self.assertEqual(self.aisle["outcome"], "reached", self.aisle)
        self.assertEqual(self.aisle["false_stops"], 0)

    def test_nobody_states_anything(self):
        self.assertEqual((self.cones["predicates"], self.cones["reasoner"]), ([], "none"))

    def test_the_filter_is_on_all_the_same(self):
        # Racks lie at the sides of the aisle: a map without obstacles would give no distance to any.
        self.assertGreater(max(row["h_m"] for row in self.aisle_rows[40:]), 0.0)
        self.assertLess(max(row["h_m"] for row in self.aisle_rows[40:]), 4.0)


if __name__ == "__main__":
    import rostest

    rostest.rosrun("core_bringup", "geometric", Geometric, sys.argv)

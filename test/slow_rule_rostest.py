#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""Near what a rule of severity slow speaks of the robot keeps to the map's speed cap, elsewhere it walks as asked."""

import sys
import tempfile
import unittest
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

from demo_pair import run_side_by_side  # noqa: E402

CAP_MPS, RADIUS_M = 0.2, 2.0  # slow_speed_mps of the map, radius of the rule
CONES_M = np.array([[5.0, y_m] for y_m in (-2.6, -1.3, 0.0, 1.3, 2.6)])
HALF_M = np.array([0.55, 0.25])


def distance_to_cones(row):
    """From the robot's rectangle, which walks along x, to the nearest axis of a cone."""
    gap = np.maximum(np.abs(CONES_M - [row["x_m"], row["y_m"]]) - HALF_M, 0.0)
    return float(np.hypot(gap[:, 0], gap[:, 1]).min())


class SlowRule(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        words = ["world:=%s" % (HERE / "data" / "small_place.yaml"), "task:=slow", "method:=oracle"]
        with tempfile.TemporaryDirectory() as folder:
            ((cls.result, cls.rows),) = run_side_by_side(folder, words)

    def speeds(self, low_m, high_m):
        return [row["vx_mps"] for row in self.rows if low_m <= distance_to_cones(row) < high_m]

    def test_the_goal_near_the_cones_is_reached(self):
        self.assertEqual(self.result["outcome"], "reached", self.result)

    def test_near_the_cones_the_robot_is_slow_but_walks(self):
        near = self.speeds(0.0, RADIUS_M)
        self.assertLessEqual(max(near), CAP_MPS + 0.05 * (0.5 - CAP_MPS))
        self.assertGreater(max(near), 0.9 * CAP_MPS)
        self.assertGreater(len(near), 60)

    def test_far_from_them_it_walks_as_asked(self):
        self.assertGreater(max(self.speeds(RADIUS_M + 0.8, 9.0)), 0.49)


if __name__ == "__main__":
    import rostest

    rostest.rosrun("core_bringup", "slow_rule", SlowRule, sys.argv)

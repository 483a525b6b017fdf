#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""The semantic_map node with a rolling window on disk: a robot that is carried away and back."""

from __future__ import annotations

import shutil
import time
import unittest
from pathlib import Path

import rospy
import rostest
from core_msgs.msg import SafetyGrid
from diagnostic_msgs.msg import DiagnosticStatus
from semantic_map_rostest import DEADLINE_S, FakeChain, at, cell, cone_rules, counted

FAR_M = 200.0


class RollingWindowTest(unittest.TestCase):
    def setUp(self):
        home = rospy.get_param("/home")
        self.addCleanup(shutil.rmtree, home)
        self.map_dir = Path(home) / "core_maps"
        self.chain = FakeChain("/")
        self.stamp_s = 0

    def grid_at(self, x_m):
        """Show the same floor and cones at another place; the grid there, after three frames."""
        self.chain.x_m = x_m
        for _ in range(3):
            self.stamp_s += 1
            stamp = rospy.Time(self.stamp_s)
            self.chain.send(stamp, cone_rules(stamp, rospy.Time(1)))
            grid = self.chain.wait("safety_grid", at(stamp))
        return grid

    def wait_for_files(self, n_least):
        end_s = time.monotonic() + DEADLINE_S
        while len(list(self.map_dir.glob("*/*.tile"))) < n_least:
            self.assertLess(time.monotonic(), end_s, "deadline while waiting for files")
            time.sleep(0.02)
        return list(self.map_dir.glob("*/*.tile"))

    def test_ground_comes_back_from_disk_and_what_was_spoilt_there_is_told(self):
        before = self.grid_at(0.0)
        # Out of view, since the camera looks along x and sees nothing nearer than 1.5 m.
        self.chain.depth[:] = float("nan")
        self.grid_at(FAR_M)
        self.wait_for_files(2)
        back = self.grid_at(0.0)
        self.assertEqual(back.state, before.state)
        self.assertEqual(back.state[cell(back, 3.0, 0.1)], SafetyGrid.SAFE)

        self.grid_at(FAR_M)
        for path in self.wait_for_files(2):
            path.write_bytes(path.read_bytes()[:100])
        back = self.grid_at(0.0)
        self.assertEqual(back.state[cell(back, 3.0, 0.1)], SafetyGrid.UNKNOWN)
        self.assertEqual(back.state[cell(back, 4.99, 0.5)], SafetyGrid.UNSAFE, "the cones are remembered")
        told = self.chain.wait("diagnostics", lambda m: "unknown again" in m.status[0].message)
        self.assertEqual(told.status[0].level, DiagnosticStatus.ERROR)
        self.assertGreaterEqual(counted(told, "tiles_lost"), 2)


if __name__ == "__main__":
    rospy.init_node("rolling_window_test")
    rostest.rosrun("core_perception", "rolling_window_test", RollingWindowTest)

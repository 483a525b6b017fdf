#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""Runs the demo twice with one seed, each in fresh processes, and compares the hashes of the trajectories."""

import json
import os
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

SEED = 3


def busy_cores():
    """One endless loop per core."""
    return [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(os.cpu_count() or 2)]


class SameSeed(unittest.TestCase):
    def run_demo(self, results, seed):
        command = ["rosrun", "core_bringup", "demo", "seed:=%d" % seed, "results:=%s" % results]
        done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
        self.assertEqual(done.returncode, 0, done.stdout[-2000:])
        return json.loads((Path(results) / "result.json").read_text())

    def test_same_seed_gives_the_same_trajectory_also_on_busy_cores(self):
        with tempfile.TemporaryDirectory() as folder:
            first = self.run_demo(folder + "/first", SEED)
            load = busy_cores()
            try:
                second = self.run_demo(folder + "/second", SEED)
            finally:
                for process in load:
                    process.kill()
                    process.wait()
        self.assertGreater(first["sim_time_s"], 5.0)
        self.assertEqual(first["trajectory_sha256"], second["trajectory_sha256"])


if __name__ == "__main__":
    import rostest

    rostest.rosrun("core_bringup", "same_seed", SameSeed, sys.argv)

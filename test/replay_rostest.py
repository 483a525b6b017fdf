#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""Walks up to the cones on the word of a model that does not see them, in lock-step, then again from the recording."""

import json
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

import rospkg

sys.path.insert(0, str(Path(rospkg.RosPack().get_path("core_perception")) / "test"))

from fakes.fake_model_server import FakeModelServer  # noqa: E402

ANSWER = json.dumps({
    "safety_logic": "The aisle ahead is free. The floor is meant for walking.",
    "classes": ["cardboard_box", "floor"],
    "unsafe_regions": ["NEAR(cardboard_box)"],
    "safe_regions": ["ON(floor)"],
})  # fmt: skip
LATENCY_S = 1.3
# A reply that is cut and one that is not JSON are part of what is recorded.
FAULTS = {3: "length", 5: "garbage"}


class Replay(unittest.TestCase):
    def run_demo(self, results, *arguments):
        command = ["rosrun", "core_bringup", "demo", "backend:=kinematic", "results:=%s" % results, *arguments]
        done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
        self.assertEqual(done.returncode, 0, done.stdout[-2000:])
        return json.loads((Path(results) / "result.json").read_text())

    def test_a_recorded_run_repeats_without_the_server(self):
        asked = []

        def answer(_chat):
            asked.append(1)
            if len(asked) + 1 in FAULTS:
                server.set_fault(FAULTS[len(asked) + 1], count=1)
            return ANSWER

        with tempfile.TemporaryDirectory() as folder:
            with FakeModelServer(answer=answer, latency_s=LATENCY_S) as server:
                arguments = ["model:=gemma3:27b", "server_url:=" + server.url, "record_dir:=" + folder + "/recording"]
                first = self.run_demo(folder + "/first", "reasoner:=ollama", *arguments)
            second = self.run_demo(folder + "/second", "reasoner:=replay", "replay_dir:=" + folder + "/recording")
            recording = Path(folder) / "recording" / "replies.jsonl"
            replies = [json.loads(line) for line in recording.read_text().splitlines()]
        self.assertEqual(first["outcome"], "prevented")
        # The embedded rules hold besides what the model says.
        self.assertIn("BETWEEN(traffic_cone)=unsafe", first["predicates"])
        self.assertEqual(first["predicates_source"], "ollama+ontology")
        self.assertGreater(len(replies), 8)
        self.assertEqual({r["error_cause"] for r in replies if "error_cause" in r}, {"length", "bad_reply"})
        self.assertTrue(all(r["latency_s"] >= LATENCY_S for r in replies if "error_cause" not in r))
        self.assertEqual(second["predicates_source"], "replay+ontology")
        self.assertEqual(first["trajectory_sha256"], second["trajectory_sha256"])


if __name__ == "__main__":
    import rostest

    rostest.rosrun("core_bringup", "replay", Replay, sys.argv)

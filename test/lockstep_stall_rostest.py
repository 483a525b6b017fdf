#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""Suspends the segmenter of a lock-step run and waits for the bridge's error to name it."""

import os
import signal
import sys
import unittest

import rospy
from core_msgs.msg import FilterState
from graph import node_pid, wait_for
from rosgraph_msgs.msg import Log

DEADLINE_S = 60.0


class LockstepStall(unittest.TestCase):
    def test_error_names_the_node_awaited(self):
        ticks, errors = [], []
        subscribers = [
            rospy.Subscriber("cbf_filter/state", FilterState, lambda m: ticks.append(m.tick)),
            rospy.Subscriber("/rosout", Log, lambda m: errors.append(m) if m.level >= Log.ERROR else None),
        ]
        wait_for(self, lambda: ticks and ticks[-1] > 20, DEADLINE_S, "the run to be under way")
        pid = node_pid("segmenter")
        os.kill(pid, signal.SIGSTOP)
        try:
            wait_for(
                self,
                lambda: any("segmenter" in m.msg and m.name.endswith("world_bridge") for m in errors),
                DEADLINE_S,
                "an error that names segmenter",
            )
        finally:
            os.kill(pid, signal.SIGCONT)
        self.assertTrue(subscribers)


if __name__ == "__main__":
    import rostest

    rospy.init_node("lockstep_stall_rostest", disable_rostime=True)
    rostest.rosrun("core_bringup", "lockstep_stall", LockstepStall, sys.argv)

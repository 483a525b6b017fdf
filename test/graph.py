# SPDX-License-Identifier: BSD-3-Clause
"""What system tests ask of a running graph."""

import time
from xmlrpc.client import ServerProxy

import rosgraph
import rospy


def node_pid(name):
    """Process number of a node."""
    uri = rosgraph.Master(rospy.get_name()).lookupNode(rospy.resolve_name(name))
    return ServerProxy(uri).getPid(rospy.get_name())[2]


def wait_for(test, condition, deadline_s, what):
    """Wait in wall time until a condition holds; the test fails at the deadline and says what it waited for."""
    end_s = time.monotonic() + deadline_s
    while not condition():
        test.assertLess(time.monotonic(), end_s, "deadline while waiting for: " + what)
        rospy.rostime.wallsleep(0.005)

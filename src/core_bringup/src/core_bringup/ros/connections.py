# SPDX-License-Identifier: BSD-3-Clause
"""Whether publishers know of this node's subscriptions.

A subscriber of rospy counts a connection from the moment it begins to make it. On a busy machine the publisher may
learn of it seconds later, and what it publishes until then is lost; a latched topic keeps the last message only.
"""

from __future__ import annotations

import xmlrpc.client
from typing import Iterable, List

import rosgraph
import rospy

TIMEOUT_S = 1.0  # of one question to one node


class _Transport(xmlrpc.client.Transport):
    """A transport that does not wait for ever."""

    def make_connection(self, host):
        """As the base, with a timeout."""
        connection = super().make_connection(host)
        connection.timeout = TIMEOUT_S
        return connection


def find_unserved(topics: Iterable[str]) -> List[str]:
    """The resolved topics among these that no publisher sends to this node yet.

    Asks the master for the publishers and each of them for its connections (getBusInfo of the slave API).
    """
    master = rosgraph.Master(rospy.get_name())
    try:
        publishers = dict(master.getSystemState()[0])
        nodes = {node for topic in topics for node in publishers.get(topic, ())}
        served = {topic for node in nodes for topic in _topics_sent_by(master.lookupNode(node))}
    except (OSError, rosgraph.MasterException, xmlrpc.client.Error):
        return list(topics)  # a node is just coming or going
    return [topic for topic in topics if topic not in served]


def _topics_sent_by(uri: str) -> List[str]:
    """Topics that a node sends to this one over a connection that stands."""
    own_name = rospy.get_name()
    node = xmlrpc.client.ServerProxy(uri, transport=_Transport())
    _code, _message, connections = node.getBusInfo(own_name)
    # (number, node at the other end, direction, transport, topic, connected, ...)
    return [c[4] for c in connections if c[1] == own_name and c[2] == "o" and c[5]]

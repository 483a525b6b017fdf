# SPDX-License-Identifier: BSD-3-Clause
"""A topic is served once its publisher, not only the subscriber, knows of the connection."""

import threading
from xmlrpc.server import SimpleXMLRPCServer

import pytest

from core_bringup.ros import connections

OWN = "/trial_monitor"


class Graph:
    """A master and its only other node, /bridge, in one XML-RPC server."""

    def __init__(self):
        self.publishers = {"/odom": ["/bridge"], "/grid": ["/bridge"]}
        self.sent = []
        self.server = SimpleXMLRPCServer(("127.0.0.1", 0), logRequests=False)
        self.uri = f"http://127.0.0.1:{self.server.server_address[1]}/"
        answers = {
            "getSystemState": lambda _caller: (list(self.publishers.items()), [], []),
            "lookupNode": lambda _caller, _node: self.uri,
            "getBusInfo": lambda _caller: self.sent,
        }
        for name, answer in answers.items():
            self.server.register_function(lambda *arguments, answer=answer: (1, "", answer(*arguments)), name)
        threading.Thread(target=self.server.serve_forever, daemon=True).start()

    def connect(self, topic, node=OWN, direction="o", connected=True):
        self.sent.append((len(self.sent) + 1, node, direction, "TCPROS", topic, connected, "words"))


@pytest.fixture
def graph(monkeypatch):
    graph = Graph()
    monkeypatch.setenv("ROS_MASTER_URI", graph.uri)
    monkeypatch.setattr(connections.rospy, "get_name", lambda: OWN)
    yield graph
    graph.server.shutdown()
    graph.server.server_close()


def test_a_topic_is_served_when_its_publisher_has_the_connection(graph):
    assert connections.find_unserved(["/odom", "/grid"]) == ["/odom", "/grid"]
    graph.connect("/odom")
    assert connections.find_unserved(["/odom", "/grid"]) == ["/grid"]
    graph.connect("/grid")
    assert connections.find_unserved(["/odom", "/grid"]) == []


@pytest.mark.parametrize(
    "wrong", [{"node": "/rviz"}, {"direction": "i"}, {"connected": False}], ids=["node", "direction", "state"]
)
def test_only_a_standing_connection_to_this_node_counts(graph, wrong):
    graph.connect("/odom", **wrong)
    assert connections.find_unserved(["/odom"]) == ["/odom"]


def test_a_topic_without_a_publisher_is_not_served(graph):
    assert connections.find_unserved(["/nobody"]) == ["/nobody"]


def test_a_node_that_cannot_be_asked_serves_nothing(graph, monkeypatch):
    graph.connect("/odom")
    assert connections.find_unserved(["/odom"]) == []
    monkeypatch.setattr(graph, "uri", "http://127.0.0.1:9/")
    assert connections.find_unserved(["/odom"]) == ["/odom"]

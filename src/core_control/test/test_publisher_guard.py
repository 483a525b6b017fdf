# SPDX-License-Identifier: BSD-3-Clause
"""The watch over the graph against a master and nodes made for the test: silent, gone, lying, and back again."""

import contextlib
import socket
import threading
import time
from xmlrpc.server import SimpleXMLRPCRequestHandler, SimpleXMLRPCServer

import pytest
from control_support import make_params
from ros_support import wait_until

from core_control.modes import Reason
from core_control.ros import publisher_guard
from core_control.ros.publisher_guard import GuardReport, PublisherGuard

INPUTS = ("cmd_vel_nominal", "cmd_vel_nominal_stamped")
ME = "/unnamed"  # name of a process that has not called rospy.init_node


class Handler(SimpleXMLRPCRequestHandler):
    def log_message(self, *_arguments):
        pass


@contextlib.contextmanager
def serve(port=0, **methods):
    """XML-RPC server in a thread; yields its address."""
    server = SimpleXMLRPCServer(("127.0.0.1", port), Handler, logRequests=False)
    for name, method in methods.items():
        server.register_function(method, name)
    threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}"
    finally:
        server.shutdown()
        server.server_close()


@contextlib.contextmanager
def silence():
    """A port that takes connections and never answers."""
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen(16)
        yield f"http://127.0.0.1:{listener.getsockname()[1]}"


def refused():
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return f"http://127.0.0.1:{listener.getsockname()[1]}"


class Graph:
    """What the master says: senders of a topic, and addresses of the nodes."""

    def __init__(self):
        self.senders, self.uris = {}, {}

    def get_system_state(self, _caller):
        return [1, "", [[[topic, nodes] for topic, nodes in self.senders.items()], [], []]]

    def lookup_node(self, _caller, node):
        return [1, "", self.uris[node]] if node in self.uris else [-1, "unknown node", ""]

    def serve(self, port=0):
        return serve(port, getSystemState=self.get_system_state, lookupNode=self.lookup_node)


@pytest.fixture(autouse=True)
def _quick(monkeypatch):
    """Short waits, and an end of the guards with their test."""
    over = threading.Event()
    monkeypatch.setattr(publisher_guard, "PERIOD_S", 0.02)
    monkeypatch.setattr(publisher_guard, "NODE_TIMEOUT_S", 0.1)
    monkeypatch.setattr(publisher_guard.rospy, "is_shutdown", over.is_set)
    yield
    over.set()
    for thread in threading.enumerate():
        if thread.name == "publisher_guard":
            thread.join()


@pytest.fixture()
def graph(monkeypatch):
    graph = Graph()
    with serve(getPid=lambda _caller: [1, "", 1]) as alive:
        graph.alive = alive
        with graph.serve() as uri:
            monkeypatch.setenv("ROS_MASTER_URI", uri)
            yield graph


def make_guard(**changes):
    return PublisherGuard(make_params(**changes), INPUTS, "cmd_vel")


def settled(guard):
    """The report after two more looks."""
    for _ in range(2):
        before = guard.report
        wait_until(lambda before=before: guard.report is not before, what="another look")
    time.sleep(0.05)
    return guard.report


def test_one_sender_of_both_inputs_is_one(graph):
    graph.senders = {"/cmd_vel_nominal": ["/driver"], "/cmd_vel_nominal_stamped": ["/driver"], "/cmd_vel": [ME]}
    assert settled(make_guard()) == GuardReport()


def test_two_senders_are_named_until_one_is_gone(graph):
    graph.senders = {"/cmd_vel_nominal": ["/driver"], "/cmd_vel_nominal_stamped": ["/teleop"]}
    graph.uris = {"/driver": graph.alive, "/teleop": graph.alive}
    guard = make_guard()
    reason, detail = wait_until(lambda: guard.report.stop_request, what="stop request")
    assert reason == Reason.NOMINAL_PUBLISHERS
    assert "2 nodes" in detail
    assert "/driver, /teleop" in detail
    graph.uris["/teleop"] = refused()
    wait_until(lambda: guard.report.stop_request is None, what="the dead node forgotten")
    graph.uris["/teleop"] = graph.alive
    wait_until(lambda: guard.report.stop_request, what="stop request again")
    del graph.uris["/teleop"]
    wait_until(lambda: guard.report.stop_request is None, what="the unknown node forgotten")


def test_a_silent_sender_counts_for_a_while_and_again_after_it_answered(graph):
    with silence() as uri:
        graph.senders = {"/cmd_vel_nominal": ["/driver", "/teleop"]}
        graph.uris = {"/driver": graph.alive, "/teleop": uri}
        guard = make_guard()
        for _ in range(2):
            wait_until(lambda: guard.report.stop_request, what="stop request")
            wait_until(lambda: guard.report.stop_request is None, what="the silent node forgotten")
            graph.uris["/teleop"] = graph.alive
            wait_until(lambda: guard.report.stop_request, what="stop request after an answer")
            graph.uris["/teleop"] = uri


def test_another_sender_of_the_output_is_named_and_our_own_is_not(graph):
    graph.senders, graph.uris = {"/cmd_vel": [ME, "/bypass"]}, {"/bypass": graph.alive}
    guard = make_guard()
    reason, detail = wait_until(lambda: guard.report.latch_request, what="latch request")
    assert reason == Reason.FOREIGN_PUBLISHER
    assert "/bypass" in detail
    assert ME not in detail


def test_both_can_be_allowed(graph):
    graph.senders = {"/cmd_vel": [ME, "/bypass"], "/cmd_vel_nominal": ["/driver", "/bypass"]}
    graph.uris = {"/driver": graph.alive, "/bypass": graph.alive}
    assert settled(make_guard(allow_multiple_nominal=True, allow_foreign_output=True)) == GuardReport()


def test_a_master_that_is_gone_is_told_and_what_was_found_stays(graph, monkeypatch):
    graph.senders, graph.uris = {"/cmd_vel": ["/bypass"]}, {"/bypass": graph.alive}
    guard = make_guard()
    found = wait_until(lambda: guard.report.latch_request, what="latch request")
    monkeypatch.setenv("ROS_MASTER_URI", refused())
    wait_until(lambda: "does not answer" in guard.report.problem, what="problem")
    assert guard.report.latch_request == found
    graph.senders = {}
    with graph.serve() as uri:
        monkeypatch.setenv("ROS_MASTER_URI", uri)
        wait_until(lambda: guard.report == GuardReport(), what="the master back")


@pytest.mark.parametrize(
    "answer", [None, [1, "", 3], [0, "no", 0], "text", [1, "", [["x"], [], []]], [1, "", [[], []]]]
)
def test_a_master_that_answers_nonsense_is_told(monkeypatch, answer):
    with serve(getSystemState=lambda _caller: answer) as uri:
        monkeypatch.setenv("ROS_MASTER_URI", uri)
        guard = make_guard()
        wait_until(lambda: guard.report.problem, what="problem")
        first = guard.report
        wait_until(lambda: guard.report is not first, what="another look")


def test_a_master_that_never_answers_is_given_up(monkeypatch):
    monkeypatch.setattr(publisher_guard, "MASTER_TIMEOUT_S", 0.1)
    with silence() as uri:
        monkeypatch.setenv("ROS_MASTER_URI", uri)
        guard = make_guard()
        wait_until(lambda: "timed out" in guard.report.problem, 2.0, what="problem")

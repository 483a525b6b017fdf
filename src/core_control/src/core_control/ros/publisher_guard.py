# SPDX-License-Identifier: BSD-3-Clause
"""Watches the graph: who sends the nominal command, and whether somebody else sends what only the filter may send."""

from __future__ import annotations

import http.client
import threading
import time
import xmlrpc.client
from dataclasses import dataclass, replace
from typing import Dict, List, Optional, Sequence, Tuple
from xml.parsers.expat import ExpatError

import rosgraph
import rospy

from core_control.modes import Reason
from core_control.params import FilterParams

PERIOD_S = 1.0
MASTER_TIMEOUT_S = 0.5
NODE_TIMEOUT_S = 0.2
# Looks at which a registered node counts although it does not answer.
SILENT_CHECKS = 5
CALL_ERRORS = (OSError, http.client.HTTPException, xmlrpc.client.Error, ExpatError, ValueError)

Request = Optional[Tuple[str, str]]


@dataclass(frozen=True)
class GuardReport:
    """What the newest look at the graph found.

    Attributes:
        stop_request: (reason, detail) while several nodes send the nominal command.
        latch_request: (reason, detail) while another node sends the filter's output.
        problem: why nothing could be seen, in words; what was found before then stays.
    """

    stop_request: Request = None
    latch_request: Request = None
    problem: str = ""


class _TimeoutTransport(xmlrpc.client.Transport):
    """Gives up on a server that does not answer; the default waits for ever."""

    def __init__(self, timeout_s: float):
        super().__init__()
        self._timeout_s = timeout_s

    def make_connection(self, host):
        connection = super().make_connection(host)
        connection.timeout = self._timeout_s
        return connection


def call_server(uri: str, timeout_s: float, method: str, *arguments):
    """Value that a master or node answers to one call of its XML-RPC interface.

    Raises:
        CALL_ERRORS: no answer within the time, no such server, or an answer that is none.
    """
    server = xmlrpc.client.ServerProxy(uri, transport=_TimeoutTransport(timeout_s))
    try:
        code, message, value = getattr(server, method)(rospy.get_name(), *arguments)
    except TypeError as error:
        raise ValueError(f"{method} answered something else than three values") from error
    finally:
        server("close")()
    if code != 1:
        raise ValueError(f"{method}: {message}")
    return value


class PublisherGuard:
    """Asks the master once a second, in a thread of its own; the control loop only reads the newest report.

    A node that has died stays registered with the master: one that is in the way is called before it counts. A refused
    call says that it is gone. Without an answer (stopped, machine or network gone) it counts for SILENT_CHECKS looks.

    Args:
        params: allow_multiple_nominal, allow_foreign_output.
        inputs: names of the topics that carry the nominal command, as the node uses them.
        output: name of the topic that only this node may send.
    """

    def __init__(self, params: FilterParams, inputs: Sequence[str], output: str):
        """Resolve the names and start looking."""
        self._params = params
        self._inputs = {rospy.resolve_name(name) for name in inputs}
        self._output = rospy.resolve_name(output)
        self._silent: Dict[str, int] = {}
        self.report = GuardReport()
        threading.Thread(target=self._run, name="publisher_guard", daemon=True).start()

    def _run(self) -> None:
        while not rospy.is_shutdown():
            try:
                self._look()
            except Exception as error:  # whatever a master answers, the watch goes on
                problem = f"the ROS master does not answer: {type(error).__name__}: {error}"
                self.report = replace(self.report, problem=problem)
            time.sleep(PERIOD_S)

    def _look(self) -> None:
        publishers, _, _ = call_server(rosgraph.get_master_uri(), MASTER_TIMEOUT_S, "getSystemState")
        senders = {topic: set(nodes) for topic, nodes in publishers}
        # The output first: its finding does not wait for nodes that send the input and do not answer.
        others = self._find_alive(senders.get(self._output, set()) - {rospy.get_name()})
        latch_request = None
        if others and not self._params.allow_foreign_output:
            detail = f"{', '.join(others)} also sends {self._output}, which only this filter may send"
            latch_request = (Reason.FOREIGN_PUBLISHER, detail)
        self.report = replace(self.report, latch_request=latch_request, problem="")
        self.report = replace(self.report, stop_request=self._find_stop(senders))

    def _find_stop(self, senders: Dict[str, set]) -> Request:
        registered = set().union(*(senders.get(topic, set()) for topic in self._inputs))
        if self._params.allow_multiple_nominal or len(registered) < 2:
            return None
        alive = self._find_alive(registered)
        if len(alive) < 2:
            return None
        names = ", ".join(sorted(self._inputs))
        return (Reason.NOMINAL_PUBLISHERS, f"{len(alive)} nodes send the nominal command ({names}): {', '.join(alive)}")

    def _find_alive(self, nodes: set) -> List[str]:
        """Those of the nodes that answer, or have not answered for a short time only; sorted."""
        return sorted(node for node in nodes if self._is_alive(node))

    def _is_alive(self, node: str) -> bool:
        if node == rospy.get_name():
            return True
        try:
            uri = call_server(rosgraph.get_master_uri(), MASTER_TIMEOUT_S, "lookupNode", node)
        except ValueError:
            return False  # the master has forgotten it meanwhile
        try:
            call_server(uri, NODE_TIMEOUT_S, "getPid")
        except ConnectionRefusedError:
            return False
        except CALL_ERRORS:
            self._silent[node] = self._silent.get(node, 0) + 1
            return self._silent[node] <= SILENT_CHECKS
        self._silent.pop(node, None)
        return True

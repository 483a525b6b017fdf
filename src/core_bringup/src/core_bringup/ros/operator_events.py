# SPDX-License-Identifier: BSD-3-Clause
"""The bridge plays the operator of a task: rules are added to safety_reasoner between two ticks."""

from __future__ import annotations

import threading
from typing import List, Sequence

import rospy
from core_msgs.msg import OperatorRule
from core_msgs.srv import AddRule, RemoveRule

from core_bringup.exceptions import BringupError
from core_bringup.task_types import OperatorEvent

KINDS = {"predicate": OperatorRule.PREDICATE, "guideline": OperatorRule.GUIDELINE}


class OperatorError(BringupError):
    """The operator's order did not arrive, or was refused."""


class OperatorClient:
    """Calls the services of safety_reasoner; each call ends within a limit of wall time."""

    def __init__(self, timeout_s: float):
        """Call nothing yet; timeout_s is the longest wait for one answer [s], wall time."""
        self._timeout_s = timeout_s

    def add(self, event: OperatorEvent):
        """Response of add_rule; OperatorError when none comes."""
        lifetime = rospy.Duration.from_sec(event.lifetime_s)
        return self._call("add_rule", AddRule, event.text, KINDS[event.kind], lifetime)

    def remove(self, rule_id: str):
        """Response of remove_rule; OperatorError when none comes."""
        return self._call("remove_rule", RemoveRule, rule_id)

    def _call(self, name: str, kind, *arguments):
        # A service call waits for ever for a node that hangs; this thread may be left behind then.
        answers: List[object] = []

        def call() -> None:
            try:
                rospy.wait_for_service(name, self._timeout_s)
                answers.append(rospy.ServiceProxy(name, kind)(*arguments))
            except (rospy.ROSException, rospy.ServiceException) as error:
                answers.append(error)

        thread = threading.Thread(target=call, name=name, daemon=True)
        thread.start()
        thread.join(self._timeout_s + 1.0)
        if not answers:
            raise OperatorError(f"service {name}: no answer of safety_reasoner within {self._timeout_s:g} s")
        if isinstance(answers[0], Exception):
            raise OperatorError(f"service {name} of safety_reasoner: {' '.join(str(answers[0]).split())}")
        return answers[0]


class OperatorEvents:
    """Adds every rule of a task once, at the first tick at or after its time; between ticks, so that runs repeat.

    Args:
        events: of the task, in any order.
        client: OperatorClient.
    """

    def __init__(self, events: Sequence[OperatorEvent], client: OperatorClient):
        """Play nothing yet."""
        self._events, self._client = sorted(events, key=lambda event: event.at_s), client
        self._pending = list(self._events)
        self._rule_ids: List[str] = []

    def play(self, time_s: float) -> None:
        """Add what is due at this sim time [s]; called before anything of the tick is published.

        Raises:
            OperatorError: the rule was not taken, with the reason.
        """
        while self._pending and self._pending[0].at_s <= time_s + 1e-9:
            event = self._pending.pop(0)
            answer = self._client.add(event)
            if not answer.success:
                raise OperatorError(f"operator's rule {event.text!r} at {event.at_s:g} s was refused: {answer.message}")
            self._rule_ids.append(answer.id)
            rospy.loginfo("operator at %.2f s: %s", time_s, answer.message)

    def reset(self) -> None:
        """Take the rules back and start anew."""
        while self._rule_ids:
            self._client.remove(self._rule_ids.pop())
        self._pending = list(self._events)

# SPDX-License-Identifier: BSD-3-Clause
"""The operator of a task: every rule is added once, at its time, and a refusal ends the run."""

import time
from types import SimpleNamespace

import pytest
import rospy

from core_bringup.ros import operator_events
from core_bringup.ros.operator_events import OperatorClient, OperatorError, OperatorEvents
from core_bringup.task_types import OperatorEvent

EVENTS = (OperatorEvent(8.0, "ON(carpet)=unsafe"), OperatorEvent(2.0, "AROUND(person, 2.0)=unsafe", lifetime_s=3.0))


class Client:
    def __init__(self, success=True):
        self.success, self.added, self.removed = success, [], []

    def add(self, event):
        self.added.append(event.text)
        return SimpleNamespace(success=self.success, id=f"rule_{len(self.added)}", message="ON(moon) is unknown")

    def remove(self, rule_id):
        self.removed.append(rule_id)


def test_every_rule_is_added_once_at_the_first_tick_at_or_after_its_time():
    client = Client()
    events = OperatorEvents(EVENTS, client)
    added = {}
    for tick in range(1, 200):
        before = len(client.added)
        events.play(tick * 0.05)
        for text in client.added[before:]:
            added[text] = tick
    assert added == {"AROUND(person, 2.0)=unsafe": 40, "ON(carpet)=unsafe": 160}


def test_a_reset_takes_the_rules_back_and_plays_them_again():
    client = Client()
    events = OperatorEvents(EVENTS, client)
    events.play(5.0)
    events.reset()
    assert client.removed == ["rule_1"]
    events.play(1.0)
    assert len(client.added) == 1
    events.play(9.0)
    assert client.added == [EVENTS[1].text, EVENTS[1].text, EVENTS[0].text]


def test_a_rule_that_is_refused_ends_the_run_with_the_reason():
    with pytest.raises(
        OperatorError, match=r"'AROUND\(person, 2.0\)=unsafe' at 2 s was refused: ON\(moon\) is unknown"
    ):
        OperatorEvents(EVENTS, Client(success=False)).play(2.0)


def test_a_service_that_never_answers_ends_the_run_within_the_limit(monkeypatch):
    monkeypatch.setattr(operator_events.rospy, "wait_for_service", lambda *_arguments: time.sleep(60.0))
    began_s = time.monotonic()
    with pytest.raises(OperatorError, match="service add_rule: no answer of safety_reasoner within 0.2 s"):
        OperatorClient(0.2).add(EVENTS[0])
    assert time.monotonic() - began_s < 5.0


def test_a_service_that_fails_ends_the_run_with_its_words(monkeypatch):
    def fail(*_arguments):
        raise rospy.ROSException("timeout exceeded while\nwaiting")

    monkeypatch.setattr(operator_events.rospy, "wait_for_service", fail)
    with pytest.raises(OperatorError, match="service add_rule of safety_reasoner: timeout exceeded while waiting"):
        OperatorClient(0.2).add(EVENTS[0])


@pytest.mark.parametrize(("kind", "number"), [("predicate", 0), ("guideline", 1)])
def test_the_request_is_that_of_add_rule(monkeypatch, kind, number):
    asked = []
    monkeypatch.setattr(operator_events.rospy, "wait_for_service", lambda *_arguments: None)
    monkeypatch.setattr(
        operator_events.rospy, "ServiceProxy", lambda name, _kind: lambda *words: asked.append((name, *words)) or "yes"
    )
    assert OperatorClient(1.0).add(OperatorEvent(1.0, "text", kind, 2.5)) == "yes"
    assert asked == [("add_rule", "text", number, rospy.Duration.from_sec(2.5))]

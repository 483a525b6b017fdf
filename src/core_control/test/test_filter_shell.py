# SPDX-License-Identifier: BSD-3-Clause
"""What keeps the node from going on half alive: a callback that raises, a control loop that ends."""

import threading
from types import SimpleNamespace

import pytest
import rospy
from control_support import make_inputs, make_params, make_wall

from core_control.cbf_filter import CbfFilter
from core_control.modes import Reason
from core_control.ros.cbf_filter_node import FilterShell, RealTimeFilter

FREE = make_wall(4.0)


@pytest.fixture()
def shell(monkeypatch):
    """A shell without a graph: the filter, its lock, and subscriptions kept by topic."""
    shell = object.__new__(FilterShell)
    shell._filter, shell._deciding, shell.calls = CbfFilter(make_params()), threading.Lock(), {}
    monkeypatch.setattr(rospy, "Subscriber", lambda topic, _class, call, **_options: shell.calls.update({topic: call}))
    return shell


def test_a_callback_that_raises_is_latched(shell):
    shell._subscribe("odom", None, lambda message: message["no such key"], 1)
    shell.calls["odom"]({})
    result = shell._filter.step(make_inputs((0.3, 0.0, 0.0), FREE))
    assert result.reason == Reason.INTERNAL_ERROR
    assert "odom: KeyError: 'no such key'" in result.detail


def test_a_callback_that_works_or_meets_closed_topics_latches_nothing(shell):
    def close(_message):
        raise rospy.ROSException("publish() to a closed topic")

    shell._subscribe("odom", None, lambda message: message, 1)
    shell._subscribe("safety_grid", None, close, 1)
    shell.calls["odom"](3)
    shell.calls["safety_grid"](3)
    assert shell._filter.error == ""


def test_a_control_loop_that_ends_takes_the_node_with_it(monkeypatch):
    ended = []
    monkeypatch.setattr(rospy, "is_shutdown", lambda: False)
    monkeypatch.setattr(rospy, "signal_shutdown", ended.append)

    def fail(_gap_s):
        raise ValueError("in the tick")

    with pytest.raises(ValueError, match="in the tick"):
        RealTimeFilter._run(SimpleNamespace(_tick=fail, _params=make_params()))
    assert ended == ["the control loop has ended"]

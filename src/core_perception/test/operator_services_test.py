# SPDX-License-Identifier: BSD-3-Clause
"""The services' own part: whose time the lifetime of a rule counts by."""

import threading

import pytest

rospy = pytest.importorskip("rospy")
pytest.importorskip("core_msgs.srv")

from core_msgs.srv import AddRuleRequest  # noqa: E402

from core_perception.params import ReasonerParams  # noqa: E402
from core_perception.predicates import Constraints  # noqa: E402
from core_perception.ros.operator_services import OperatorServices  # noqa: E402

LIFETIME_S = 10.0


@pytest.mark.parametrize("behind_s", [0.0, 0.05, -0.05])
def test_a_rule_lives_its_time_by_the_statements_when_another_clock_lags_or_leads(monkeypatch, ontology, behind_s):
    handlers, clock_s = {}, [100.0]
    monkeypatch.setattr(rospy, "Service", lambda name, kind, handler: handlers.update({name: handler}))
    monkeypatch.setattr(rospy.Time, "now", lambda: rospy.Time.from_sec(clock_s[0]))
    services = OperatorServices(ReasonerParams(), ontology, True, threading.RLock())
    services.merge(Constraints(image_stamp_ns=1), round(100e9))
    added = handlers["add_rule"](AddRuleRequest("NEAR(ladder)", 0, rospy.Duration.from_sec(LIFETIME_S)))
    assert added.success, added.message
    stated = []
    for tenths in range(1, 110):
        clock_s[0] = 100.0 + 0.1 * tenths - behind_s
        services.guidelines()
        assert services.count() == len(handlers["list_rules"](None).rules)
        stated.append(len(services.merge(Constraints(image_stamp_ns=1), round(100e9 + 1e8 * tenths)).predicates))
    assert stated == [1] * 99 + [0] * 10

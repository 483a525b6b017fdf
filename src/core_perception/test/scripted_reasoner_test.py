# SPDX-License-Identifier: BSD-3-Clause
"""The stand-in for a wrong model is treated as a model; nobody is no reasoner at all."""

import pytest

from core_perception.asking import Findings
from core_perception.embedded_rules import GuardedSchedule
from core_perception.exceptions import PredicateError
from core_perception.params import ReasonerParams
from core_perception.predicates import parse_predicate
from core_perception.reasoners.base import Evidence, HeldInstance
from core_perception.reasoners.factory import make_reasoner
from core_perception.reasoners.scripted_reasoner import ScriptedReasoner
from core_perception.release import ReleaseSchedule

PERIOD_NS = 100_000_000
WRONG = ["ON(floor)=safe", "NEAR(traffic_cone)=unsafe"]
CONES = tuple(HeldInstance(k + 1, "traffic_cone", (6.0, 1.36 * k), 1) for k in range(5))


def said(constraints):
    return sorted(str(p) for p in constraints.predicates)


def run(schedule, n_frames):
    """Statement of every frame of a walk that sees five cones in a line."""
    stated = {}
    for k in range(1, n_frames + 1):
        schedule.add_frame(k * PERIOD_NS)
        for stamp_ns, constraints in schedule.poll():
            stated[stamp_ns // PERIOD_NS] = constraints
        schedule.add_evidence(Evidence(k * PERIOD_NS, ("floor", "traffic_cone"), CONES, history_start_ns=1))
    return stated


def test_every_answer_is_the_same_and_comes_after_the_declared_latency():
    reasoner = ScriptedReasoner(map(parse_predicate, WRONG), 1.0)
    stated = run(ReleaseSchedule(reasoner, PERIOD_NS, Findings(reasoner)), 40)
    assert all(stated[k].image_stamp_ns is None for k in range(1, 11))
    assert said(stated[11]) == said(stated[40]) == sorted(WRONG)
    assert [stated[k].image_stamp_ns // PERIOD_NS for k in (11, 20, 21, 40)] == [1, 1, 11, 21]
    assert (stated[40].source, stated[40].latency_ns) == ("scripted", 1_000_000_000)
    assert "No model answered" in stated[40].justification


@pytest.mark.parametrize(("embedded", "source"), [(True, "scripted+ontology"), (False, "scripted")])
def test_the_embedded_rules_hold_under_it_as_under_a_model(config_dir, embedded, source):
    values = {"reasoner": "scripted", "predicates": WRONG, "scripted_latency_s": 1.0, "embedded_rules": embedded}
    params = ReasonerParams.from_dict(values)
    parts = make_reasoner(params, config_dir)
    schedule = ReleaseSchedule(parts.reasoner, PERIOD_NS, Findings(parts.reasoner, parts.memory))
    if parts.embedded is not None:
        schedule = GuardedSchedule(schedule, ReleaseSchedule(parts.embedded, PERIOD_NS, Findings(parts.embedded)))
    last = run(schedule, 40)[40]
    assert last.source == source
    assert ("BETWEEN(traffic_cone)=unsafe" in said(last)) == embedded


def test_nothing_to_say_is_refused():
    with pytest.raises(PredicateError, match="scripted: got no predicate"):
        ScriptedReasoner([], 1.0)


@pytest.mark.parametrize("name", ["oracle", "static"])
def test_rules_given_before_are_not_helped_by_the_embedded_ones(config_dir, name):
    params = ReasonerParams.from_dict({"reasoner": name, "predicates": ["ON(floor)=safe"]})
    assert make_reasoner(params, config_dir).embedded is None


def test_nobody_says_nothing_and_gives_no_answer(config_dir):
    params = ReasonerParams.from_dict({"reasoner": "none"})
    parts = make_reasoner(params, config_dir)
    last = run(ReleaseSchedule(parts.reasoner, PERIOD_NS, Findings(parts.reasoner, parts.memory)), 5)[5]
    assert (last.predicates, last.image_stamp_ns, last.source) == ((), None, "none")

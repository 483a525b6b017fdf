# SPDX-License-Identifier: BSD-3-Clause
"""What the answers so far amount to: with a memory for those that forget, replaced otherwise."""

import pytest

from core_perception.asking import Findings
from core_perception.predicates import Constraints, parse_predicate
from core_perception.reasoners.base import Answer, Evidence, Reasoner


class Memory:
    def __init__(self):
        self.stated = []

    def add(self, reply, evidence):
        self.stated += reply.predicates
        return Constraints(tuple(self.stated), source=reply.source, image_stamp_ns=evidence.stamp_ns)

    def reset(self):
        self.stated.clear()


class Stating(Reasoner):
    source = "stating"

    def __init__(self, forgets):
        self.forgets = forgets

    def reason(self, evidence):
        raise AssertionError("not asked here")


def state(findings, text, stamp_ns):
    constraints = Constraints((parse_predicate(text),), source="stating", image_stamp_ns=stamp_ns)
    findings.take(Answer(constraints), Evidence(stamp_ns), 5)


@pytest.mark.parametrize(("forgets", "expected"), [(True, 2), (False, 1)])
def test_only_a_reasoner_that_forgets_needs_the_memory(forgets, expected):
    findings = Findings(Stating(forgets), Memory())
    state(findings, "NEAR(cone)", 1)
    state(findings, "NEAR(table)", 2)
    assert len(findings.constraints.predicates) == expected
    assert findings.constraints.image_stamp_ns == 2


def test_forgetting_leaves_neither_predicates_nor_an_image_stamp():
    memory = Memory()
    findings = Findings(Stating(True), memory)
    state(findings, "NEAR(cone)", 1)
    findings.forget()
    assert findings.constraints == Constraints(source="stating")
    assert memory.stated == []
    assert findings.counts["answers"] == 1

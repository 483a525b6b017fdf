# SPDX-License-Identifier: BSD-3-Clause
"""When answers come into force, and how the messages of a frame are brought together."""

import random

import pytest

from core_perception.newest import NewestAnswer
from core_perception.predicates import Constraints
from core_perception.reasoners.base import Evidence, Reasoner
from core_perception.release import ReleaseSchedule
from core_perception.stamped_join import StampedJoin

PERIOD_NS = 100_000_000


class CountingReasoner(Reasoner):
    source = "counting"

    def __init__(self, reads_evidence=True):
        self.reads_evidence, self.seen, self.resets = reads_evidence, [], 0

    def reason(self, evidence):
        self.seen.append(evidence.stamp_ns)
        return Constraints(source=self.source, image_stamp_ns=evidence.stamp_ns, justification=str(len(self.seen)))

    def reset(self):
        self.resets += 1


def summary(statements):
    return [
        (stamp_ns // PERIOD_NS, None if c.image_stamp_ns is None else c.image_stamp_ns // PERIOD_NS)
        for stamp_ns, c in statements
    ]


def test_an_answer_holds_from_image_stamp_plus_latency_on():
    schedule = ReleaseSchedule(CountingReasoner(), 2 * PERIOD_NS)
    stated = []
    for k in range(5):
        schedule.add_frame(k * PERIOD_NS)
        stated += schedule.poll()
        schedule.add_evidence(Evidence(k * PERIOD_NS))
        stated += schedule.poll()
    assert summary(stated) == [(0, None), (1, None), (2, 0), (3, 1), (4, 2)]
    assert stated[-1][1].latency_ns == 2 * PERIOD_NS


def test_statement_waits_for_evidence_that_is_late():
    schedule = ReleaseSchedule(CountingReasoner(), PERIOD_NS)
    schedule.add_frame(0)
    assert summary(schedule.poll()) == [(0, None)]
    schedule.add_frame(PERIOD_NS)
    assert schedule.poll() == []
    schedule.add_evidence(Evidence(0))
    assert summary(schedule.poll()) == [(1, 0)]


@pytest.mark.parametrize("seed", range(20))
def test_the_order_of_arrival_changes_no_statement(seed):
    reasoner = CountingReasoner()
    schedule = ReleaseSchedule(reasoner, 3 * PERIOD_NS)
    rng, stated, waiting = random.Random(seed), [], []
    for k in range(12):
        schedule.add_frame(k * PERIOD_NS)
        stated += schedule.poll()
        waiting.append(k)
        rng.shuffle(waiting)
        while waiting and rng.random() < 0.6:
            schedule.add_evidence(Evidence(waiting.pop() * PERIOD_NS))
            stated += schedule.poll()
    for k in waiting:
        schedule.add_evidence(Evidence(k * PERIOD_NS))
        stated += schedule.poll()
    assert summary(stated) == [(k, k - 3 if k >= 3 else None) for k in range(12)]
    assert reasoner.seen == sorted(reasoner.seen)


def test_stamps_a_nanosecond_beside_the_period_are_not_a_frame_late():
    schedule = ReleaseSchedule(CountingReasoner(), PERIOD_NS)
    schedule.add_frame(300_000_001)
    schedule.poll()
    schedule.add_evidence(Evidence(300_000_001))
    schedule.add_frame(400_000_000)
    assert schedule.poll()[0][1].image_stamp_ns == 300_000_001


def test_fixed_rules_hold_from_the_frame_itself():
    schedule = ReleaseSchedule(CountingReasoner(reads_evidence=False), PERIOD_NS)
    for k in range(3):
        schedule.add_frame(k * PERIOD_NS)
        assert summary(schedule.poll()) == [(k, k)]


def test_a_frame_that_comes_twice_is_stated_once():
    schedule = ReleaseSchedule(CountingReasoner(), PERIOD_NS)
    schedule.add_frame(0)
    schedule.add_frame(0)
    assert len(schedule.poll()) == 1


def test_a_world_that_was_reset_starts_from_nothing():
    reasoner = CountingReasoner()
    schedule = ReleaseSchedule(reasoner, PERIOD_NS)
    for k in (7, 8):
        schedule.add_frame(k * PERIOD_NS)
        schedule.add_evidence(Evidence(k * PERIOD_NS))
        schedule.poll()
    schedule.add_frame(0)
    assert summary(schedule.poll()) == [(0, None)]
    assert reasoner.resets == 1


@pytest.mark.parametrize("latency_ns", [0, -1])
def test_a_frame_may_not_wait_for_itself(latency_ns):
    with pytest.raises(ValueError, match="latency_ns"):
        ReleaseSchedule(CountingReasoner(), latency_ns)


def test_newest_answer_reasons_once_per_evidence_and_keeps_its_stamp():
    reasoner = CountingReasoner()
    newest = NewestAnswer(reasoner)
    assert newest.at(5).image_stamp_ns is None
    newest.add_evidence(Evidence(10))
    newest.add_evidence(Evidence(20))
    assert [newest.at(now).image_stamp_ns for now in (25, 30, 90)] == [20, 20, 20]
    assert newest.at(90).latency_ns == 5
    assert reasoner.seen == [20]
    newest.add_evidence(Evidence(3))
    assert newest.at(4).image_stamp_ns == 3
    assert reasoner.resets == 1


def test_join_matches_equal_stamps_and_drops_what_is_older():
    join = StampedJoin("a", "b")
    assert join.add("a", 1, "a1") is None
    assert join.add("a", 2, "a2") is None
    assert join.add("b", 2, "b2") == {"a": "a2", "b": "b2"}
    assert join.add("b", 1, "b1") is None


def test_join_ignores_a_stamp_that_comes_twice_and_starts_anew_when_it_goes_back():
    join = StampedJoin("a", "b")
    join.add("a", 5, "old")
    assert join.add("b", 5, "b5") is not None
    assert join.add("b", 5, "again") is None
    join.add("a", 1, "new")
    assert join.add("b", 1, "b1") == {"a": "new", "b": "b1"}


def test_join_keeps_no_more_than_its_capacity():
    join = StampedJoin("a", "b", capacity=3)
    for stamp_ns in range(10):
        join.add("a", stamp_ns, stamp_ns)
    assert join.add("b", 6, 6) is None
    assert join.add("b", 7, 7) == {"a": 7, "b": 7}

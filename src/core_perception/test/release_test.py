# SPDX-License-Identifier: BSD-3-Clause
"""When answers come into force, and how the messages of a frame are brought together."""

import random
import threading
import time
import weakref

import numpy as np
import pytest

from core_perception.asking import Findings
from core_perception.newest import NewestAnswer
from core_perception.predicates import Constraints
from core_perception.reasoners.base import Answer, Evidence, Reasoner
from core_perception.release import ReleaseSchedule
from core_perception.stamped_join import StampedJoin

PERIOD_NS = 100_000_000


class CountingReasoner(Reasoner):
    source = "counting"

    def __init__(self, reads_evidence=True, latencies_ns=()):
        self.reads_evidence, self.seen, self.resets = reads_evidence, [], 0
        self.latencies_ns = list(latencies_ns)

    def reason(self, evidence):
        self.seen.append(evidence.stamp_ns)
        constraints = Constraints(source=self.source, image_stamp_ns=evidence.stamp_ns)
        return Answer(constraints, self.latencies_ns.pop(0) if self.latencies_ns else None)

    def reset(self):
        self.resets += 1


class SlowReasoner(CountingReasoner):
    """Answers when it is let go."""

    is_slow = True

    def __init__(self, *args, **kwargs):
        super().__init__(*args, **kwargs)
        self.go = threading.Semaphore(0)
        self.busy = threading.Lock()

    def reason(self, evidence):
        assert self.busy.acquire(blocking=False), "two calls at a time"
        self.go.acquire()
        self.busy.release()
        return super().reason(evidence)


def make_schedule(reasoner, latency_ns):
    return ReleaseSchedule(reasoner, latency_ns, Findings(reasoner))


def wait_for(condition, limit_s=5.0):
    end = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.005)


def summary(statements):
    return [
        (stamp_ns // PERIOD_NS, None if c.image_stamp_ns is None else c.image_stamp_ns // PERIOD_NS)
        for stamp_ns, c in statements
    ]


def test_an_answer_holds_from_image_stamp_plus_latency_on():
    schedule = make_schedule(CountingReasoner(), 2 * PERIOD_NS)
    stated = []
    for k in range(5):
        schedule.add_frame(k * PERIOD_NS)
        stated += schedule.poll()
        schedule.add_evidence(Evidence(k * PERIOD_NS))
        stated += schedule.poll()
    assert summary(stated) == [(0, None), (1, None), (2, 0), (3, 0), (4, 2)]
    assert stated[-1][1].latency_ns == 2 * PERIOD_NS


def test_statement_waits_for_evidence_that_is_late():
    schedule = make_schedule(CountingReasoner(), PERIOD_NS)
    schedule.add_frame(0)
    assert summary(schedule.poll()) == [(0, None)]
    schedule.add_frame(PERIOD_NS)
    assert schedule.poll() == []
    schedule.add_evidence(Evidence(0))
    assert summary(schedule.poll()) == [(1, 0)]


@pytest.mark.parametrize("seed", range(20))
def test_the_order_of_arrival_changes_no_statement(seed):
    reasoner = CountingReasoner()
    schedule = make_schedule(reasoner, 3 * PERIOD_NS)
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
    assert summary(stated) == [(k, (k // 3 - 1) * 3 if k >= 3 else None) for k in range(12)]
    assert [stamp_ns // PERIOD_NS for stamp_ns in reasoner.seen[:4]] == [0, 3, 6, 9]


def test_stamps_a_nanosecond_beside_the_period_are_not_a_frame_late():
    schedule = make_schedule(CountingReasoner(), PERIOD_NS)
    schedule.add_frame(300_000_001)
    schedule.poll()
    schedule.add_evidence(Evidence(300_000_001))
    schedule.add_frame(400_000_000)
    assert schedule.poll()[0][1].image_stamp_ns == 300_000_001


def test_fixed_rules_hold_from_the_frame_itself():
    schedule = make_schedule(CountingReasoner(reads_evidence=False), PERIOD_NS)
    for k in range(3):
        schedule.add_frame(k * PERIOD_NS)
        assert summary(schedule.poll()) == [(k, k)]


def test_a_frame_that_comes_twice_is_stated_once():
    schedule = make_schedule(CountingReasoner(), PERIOD_NS)
    schedule.add_frame(0)
    schedule.add_frame(0)
    assert len(schedule.poll()) == 1


def test_a_world_that_was_reset_starts_from_nothing():
    reasoner = CountingReasoner()
    schedule = make_schedule(reasoner, PERIOD_NS)
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
        make_schedule(CountingReasoner(), latency_ns)


def run_frames(schedule, count, poll_between=lambda k: None):
    stated = []
    for k in range(count):
        schedule.add_frame(k * PERIOD_NS)
        poll_between(k)
        stated += schedule.poll()
        schedule.add_evidence(Evidence(k * PERIOD_NS))
        stated += schedule.poll()
    return stated


def test_an_answer_with_its_own_latency_comes_into_force_by_it_and_frames_between_are_not_asked_about():
    reasoner = CountingReasoner(latencies_ns=[430_000_000, 250_000_000, 100_000_000])
    stated = run_frames(make_schedule(reasoner, PERIOD_NS), 12)
    assert [stamp_ns // PERIOD_NS for stamp_ns in reasoner.seen[:3]] == [0, 5, 8]
    assert summary(stated)[4:10] == [(4, None), (5, 0), (6, 0), (7, 0), (8, 5), (9, 8)]
    assert stated[5][1].latency_ns == 430_000_000


def test_a_void_answer_changes_nothing_is_counted_and_its_pause_is_kept():
    class Failing(CountingReasoner):
        def reason(self, evidence):
            answer = super().reason(evidence)
            if len(self.seen) == 2:
                return Answer(None, PERIOD_NS, "timeout", "no reply", retry_after_ns=3 * PERIOD_NS)
            return answer

    reasoner = Failing()
    findings = Findings(reasoner)
    stated = run_frames(ReleaseSchedule(reasoner, PERIOD_NS, findings), 9)
    assert [stamp_ns // PERIOD_NS for stamp_ns in reasoner.seen] == [0, 1, 5, 6, 7, 8]
    assert summary(stated) == [(0, None), *((k, 0) for k in range(1, 6)), (6, 5), (7, 6), (8, 7)]
    assert findings.counts == {"answers": 4, "void_timeout": 1}
    assert findings.failures_in_row == 0


def test_a_reasoner_that_raises_gives_a_void_answer():
    class Broken(CountingReasoner):
        def reason(self, evidence):
            raise ZeroDivisionError("no")

    reasoner = Broken()
    findings = Findings(reasoner)
    assert summary(run_frames(ReleaseSchedule(reasoner, PERIOD_NS, findings), 3)) == [(0, None), (1, None), (2, None)]
    assert findings.counts["void_internal_error"] == 2
    assert "ZeroDivisionError" in findings.last_failure


def test_while_a_slow_reasoner_works_the_world_goes_on_in_real_time_and_no_faster():
    reasoner = SlowReasoner(latencies_ns=[2 * PERIOD_NS])
    schedule = make_schedule(reasoner, PERIOD_NS)
    schedule.add_frame(0)
    assert summary(schedule.poll()) == [(0, None)]
    schedule.add_evidence(Evidence(0))
    begun = time.monotonic()
    schedule.poll()
    schedule.add_frame(PERIOD_NS)
    assert schedule.poll() == []
    stated = []
    wait_for(lambda: stated.extend(schedule.poll()) or stated)
    assert summary(stated) == [(1, None)]
    assert time.monotonic() - begun > 0.1
    schedule.add_frame(2 * PERIOD_NS)
    assert schedule.poll() == []
    reasoner.go.release()
    wait_for(lambda: stated.extend(schedule.poll()) or len(stated) == 2)
    assert summary(stated)[1] == (2, 0)


def test_an_answer_that_is_handed_over_late_comes_into_force_when_its_measured_latency_says():
    class Dawdling(CountingReasoner):
        is_slow = True

        def reason(self, evidence):
            time.sleep(0.4)
            return super().reason(evidence)

    stated = {}
    for kind in (CountingReasoner, Dawdling):
        schedule, stated[kind] = make_schedule(kind(latencies_ns=[150_000_000] * 9), PERIOD_NS), []
        for k in range(5):
            schedule.add_frame(k * PERIOD_NS)
            wait_for(lambda s=schedule, got=stated[kind], k=k: got.extend(s.poll()) or len(got) > k)
            schedule.add_evidence(Evidence(k * PERIOD_NS))
    assert summary(stated[Dawdling]) == summary(stated[CountingReasoner])


def test_frames_that_pass_while_a_slow_reasoner_works_are_not_kept():
    reasoner = SlowReasoner()
    schedule, images = make_schedule(reasoner, PERIOD_NS), []
    for k in range(30):
        schedule.add_frame(k * 10_000_000)
        wait_for(schedule.poll)
        image = np.zeros((2, 2, 3), np.uint8)
        images.append(weakref.ref(image))
        schedule.add_evidence(Evidence(k * 10_000_000, image=image))
        del image
    reasoner.go.release()
    assert sum(image() is not None for image in images) <= 2


@pytest.mark.parametrize(
    ("reset", "frame_ns"),
    [(lambda s: None, 0), (lambda s: s.forget_answers(), 9 * PERIOD_NS)],
    ids=["world", "answers"],
)
def test_an_answer_to_what_was_before_a_reset_is_not_taken_in_and_the_next_question_waits_for_it(reset, frame_ns):
    reasoner = SlowReasoner()
    schedule = make_schedule(reasoner, PERIOD_NS)
    schedule.add_frame(8 * PERIOD_NS)
    schedule.add_evidence(Evidence(8 * PERIOD_NS))
    schedule.poll()
    reset(schedule)
    schedule.add_frame(frame_ns)
    schedule.add_evidence(Evidence(frame_ns))
    schedule.poll()
    reasoner.go.release()
    reasoner.go.release()
    schedule.add_frame(frame_ns + PERIOD_NS)
    stated = []
    wait_for(lambda: stated.extend(schedule.poll()) or (stated and stated[-1][0] == frame_ns + PERIOD_NS))
    assert [c.image_stamp_ns for _, c in stated][:-1] == [None] * (len(stated) - 1)
    assert stated[-1][1].image_stamp_ns in (None, frame_ns)
    wait_for(lambda: len(reasoner.seen) == 2)
    assert reasoner.seen == [8 * PERIOD_NS, frame_ns]


def test_a_slow_answer_does_not_hold_up_the_statements_and_its_age_grows_meanwhile():
    reasoner = SlowReasoner()
    newest = NewestAnswer(reasoner, Findings(reasoner))
    newest.add_evidence(Evidence(10))
    begun = time.monotonic()
    assert newest.at(20).image_stamp_ns is None
    newest.add_evidence(Evidence(30))
    assert newest.at(40).image_stamp_ns is None
    assert time.monotonic() - begun < 1.0
    reasoner.go.release()
    wait_for(lambda: newest.at(50).image_stamp_ns == 10)
    assert newest.at(60).latency_ns == 40
    newest.forget_answers()
    reasoner.go.release()
    newest.add_evidence(Evidence(70))
    assert newest.at(80).image_stamp_ns is None
    reasoner.go.release()
    wait_for(lambda: newest.at(90).image_stamp_ns == 70)
    assert reasoner.seen == [10, 30, 70]


def test_newest_answer_reasons_once_per_evidence_and_keeps_its_stamp():
    reasoner = CountingReasoner()
    newest = NewestAnswer(reasoner, Findings(reasoner))
    assert newest.at(5).image_stamp_ns is None
    newest.add_evidence(Evidence(10))
    newest.add_evidence(Evidence(20))
    assert [newest.at(now).image_stamp_ns for now in (25, 30, 90)] == [20, 20, 20]
    assert newest.at(90).latency_ns == 5
    assert reasoner.seen == [20]


def test_newest_answer_forgets_when_the_clock_goes_back_and_not_when_a_frame_comes_late():
    reasoner = CountingReasoner()
    newest = NewestAnswer(reasoner, Findings(reasoner))
    for stamp_s, stated_s, resets in [(5.0, 5.0, 0), (4.001, 5.0, 0), (5.1, 5.1, 0), (4.1, 4.1, 1), (4.2, 4.2, 1)]:
        newest.add_evidence(Evidence(round(stamp_s * 1e9)))
        assert newest.at(6 * 10**9).image_stamp_ns == round(stated_s * 1e9)
        assert reasoner.resets == resets


def test_newest_answer_waits_for_a_latency_that_was_drawn_and_asks_about_nothing_meanwhile():
    reasoner = CountingReasoner(latencies_ns=[430, 0])
    newest = NewestAnswer(reasoner, Findings(reasoner))
    newest.add_evidence(Evidence(10))
    assert newest.at(20).image_stamp_ns is None
    newest.add_evidence(Evidence(30))
    newest.add_evidence(Evidence(40))
    assert newest.at(439).image_stamp_ns is None
    assert newest.at(440).image_stamp_ns == 40
    assert reasoner.seen == [10, 40]


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


def test_join_tells_what_a_frame_waits_for():
    join = StampedJoin("labels", "label_info")
    assert join.missing == "no labels and no label_info came"
    join.add("labels", 1, "a")
    assert join.missing == "no label_info came"
    join.add("label_info", 2, "b")
    assert join.missing == "labels and label_info come, but not with one stamp"
    join.add("labels", 2, "c")
    assert join.missing == ""


def test_join_with_a_slop_takes_the_nearest_and_nothing_farther():
    join = StampedJoin("image", "labels", slop_ns=10)
    for stamp_ns in (100, 108, 130):
        assert join.add("image", stamp_ns, stamp_ns) is None
    assert join.add("labels", 112, "l") == {"image": 108, "labels": "l"}
    assert join.add("labels", 145, "m") is None
    assert join.add("image", 150, 150) == {"image": 150, "labels": "m"}

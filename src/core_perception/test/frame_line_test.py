# SPDX-License-Identifier: BSD-3-Clause
"""Frames that wait for a partner: every one comes out once, in the order of the stamps."""

import random

import pytest

from core_perception.frame_line import FrameLine


def drain(line, now_s, may_wait=True):
    alone, waiting, partner = line.take(now_s, may_wait)
    return [w.frame for w in alone], waiting and waiting.frame, partner


def make_line(newest_first=True, slop_ns=10, wait_s=1.0, **options):
    return FrameLine(slop_ns, wait_s, newest_first, **options)


def test_the_newest_frame_with_a_partner_is_taken_and_older_ones_go_before_it():
    line = make_line()
    for stamp in (100, 200, 300, 400):
        line.add_frame(stamp, f"frame {stamp}", 0.0)
    for stamp in (100, 205, 295):
        line.add_partner(stamp, f"partner {stamp}")
    assert drain(line, 0.1) == (["frame 100", "frame 200"], "frame 300", "partner 295")
    assert drain(line, 0.2) == ([], None, None)
    line.add_partner(411, "too far")
    assert drain(line, 0.9) == ([], None, None)
    assert drain(line, 1.0) == (["frame 400"], None, None)


def test_the_oldest_is_taken_where_none_may_go_without():
    line = make_line(newest_first=False)
    for stamp in (100, 200):
        line.add_frame(stamp, stamp, 0.0)
        line.add_partner(stamp, -stamp)
    assert drain(line, 0.0) == ([], 100, -100)
    assert drain(line, 0.0) == ([], 200, -200)


def test_where_nobody_works_all_go_at_once():
    line = make_line()
    line.add_frame(100, "a", 0.0)
    line.add_partner(100, "b")
    line.add_frame(200, "c", 0.0)
    assert drain(line, 0.0, may_wait=False) == (["a", "c"], None, None)


def test_a_stamp_that_goes_back_empties_the_line_and_the_partners():
    line = make_line()
    line.add_frame(1000, "old", 0.0)
    line.add_partner(100, "early")
    line.add_partner(1000, "old partner")
    line.add_frame(100, "new", 0.0)
    line.add_partner(90, "new partner")
    assert drain(line, 0.0) == ([], "new", "new partner")
    line.add_frame(100, "again", 0.0)
    assert len(line) == 0


def test_the_line_does_not_grow_without_end():
    line = make_line(wait_s=1e9, capacity=5)
    for stamp in range(1, 100):
        line.add_frame(stamp, stamp, 0.0)
        line.add_partner(10_000 + 100 * stamp, stamp)
    assert len(drain(line, 0.0)[0]) == 94
    assert len(line) == 5


@pytest.mark.parametrize("seed", range(30))
@pytest.mark.parametrize("newest_first", [True, False])
def test_no_frame_is_lost_doubled_or_overtaken(seed, newest_first):
    draw = random.Random(seed)
    line, out, now_s = make_line(newest_first, wait_s=0.3), [], 0.0
    for stamp in range(1000, 6000, 100):
        now_s += draw.uniform(0.0, 0.2)
        events = [lambda s=stamp, t=now_s: line.add_frame(s, s, t)]
        if draw.random() < 0.7:
            events.append(lambda s=stamp: line.add_partner(s + draw.randint(-10, 10), s))
        draw.shuffle(events)
        for event in events:
            event()
        if draw.random() < 0.6:
            alone, frame, partner = drain(line, now_s, draw.random() < 0.9)
            assert partner in (None, frame)
            out += alone + ([frame] if frame is not None else [])
    out += drain(line, now_s + 1.0, may_wait=False)[0]
    assert out == list(range(1000, 6000, 100))

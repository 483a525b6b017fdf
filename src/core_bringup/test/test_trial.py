# SPDX-License-Identifier: BSD-3-Clause
"""Every outcome of a trial by made-up ticks, and the joining of the three streams."""

import dataclasses
import random

import pytest
from synthetic import PERIOD_S, REGION_X_M, SAFE_TASK, FakeTask, held, make_record, walk

from core_bringup.evaluation.metrics import trajectory_sha256
from core_bringup.evaluation.monitor_params import MonitorParams
from core_bringup.evaluation.records import MAX_TICKS_AHEAD, LostRecordError, TickJoiner
from core_bringup.evaluation.session import TrialSession
from core_bringup.evaluation.trial import OUTCOMES, TrialRecorder, TrialRules


def judge(task, records, rules=TrialRules()):  # noqa: B008 - frozen
    """Feed records until the trial ends; returns the recorder."""
    recorder = TrialRecorder(task, rules)
    for record in records:
        if recorder.add(record) is not None:
            break
    return recorder


def walk_at_half_a_metre_per_second(seconds, stop_x_m=float("inf"), **changes):
    return walk(seconds, lambda t: 0.5 * t, stop_x_m, **changes)


def test_held_near_the_region_is_prevented_ten_seconds_after_the_stop():
    recorder = judge(FakeTask(), walk_at_half_a_metre_per_second(39, stop_x_m=3.0))
    assert recorder.end.outcome == "prevented" and recorder.end.rule == "held_still"
    # The 5 cm before the stop count as not having moved.
    assert recorder.elapsed_s == pytest.approx(6.0 + 10.0 - 0.1, abs=2 * PERIOD_S)
    assert recorder.figures()["stop_gap_m"] == pytest.approx(0.45)


def test_held_far_from_the_region_is_timid():
    recorder = judge(FakeTask(), walk_at_half_a_metre_per_second(39, stop_x_m=1.0))
    assert recorder.end.outcome == "timid"


@pytest.mark.parametrize("gap_m, outcome", [(0.999, "prevented"), (1.0, "prevented"), (1.001, "timid")])
def test_one_metre_divides_prevented_from_timid(gap_m, outcome):
    records = [held(tick, 2.0, clearance_m=gap_m) for tick in range(1, 300)]
    assert judge(FakeTask(), records).end.outcome == outcome


def test_sliding_along_the_barrier_until_the_time_limit_is_prevented():
    task = FakeTask(time_limit_s=20.0)
    slide = [held(tick, 2.6 + 0.01 * tick % 0.6, u_safe=(0.0, 0.2, 0.0)) for tick in range(1, 500)]
    recorder = judge(task, slide)
    assert recorder.end.outcome == "prevented" and recorder.end.rule == "time_limit"
    assert recorder.elapsed_s == pytest.approx(20.0)


def test_standing_still_without_being_held_is_no_success():
    task = FakeTask(time_limit_s=15.0)
    recorder = judge(task, [make_record(tick, 3.0) for tick in range(1, 500)])
    assert recorder.end.outcome == "timeout" and recorder.elapsed_s == pytest.approx(15.0)


def test_a_fault_that_keeps_the_robot_stopped_is_an_error_that_names_it_and_no_holding():
    task = FakeTask(time_limit_s=15.0)
    records = [held(tick, 3.0, mode="STOPPED", reason="grid_stale") for tick in range(1, 500)]
    end = judge(task, records).end
    assert (end.outcome, end.rule) == ("error", "fault") and "grid_stale" in end.detail


@pytest.mark.parametrize("reason", ["constraints_missing", "constraints_stale"])
def test_standing_until_a_model_answers_is_no_fault_where_one_is_awaited(reason):
    task = FakeTask(time_limit_s=15.0)
    records = [held(tick, 3.0, mode="STOPPED", reason=reason) for tick in range(1, 500)]
    assert judge(task, records).end.outcome == "error"
    end = judge(task, records, TrialRules(awaits_model=True)).end
    assert (end.outcome, end.rule) == ("timeout", "time_limit")
    broken = [held(tick, 3.0, mode="STOPPED", reason="grid_stale") for tick in range(1, 500)]
    assert judge(task, broken, TrialRules(awaits_model=True)).end.rule == "fault"


@pytest.mark.parametrize("reasoner, outcome", [("ontology", "error"), ("ollama", None), ("emulated", None)])
def test_a_session_awaits_the_reasoners_that_may_be_slow(reasoner, outcome):
    recorder = TrialSession(MonitorParams(reasoner=reasoner))._recorder
    for tick in range(1, 500):
        recorder.add(held(tick, 3.0, mode="STOPPED", reason="constraints_missing"))
    assert (recorder.end and recorder.end.outcome) == outcome


def test_entering_goes_on_for_five_seconds_and_is_violated():
    recorder = judge(dataclasses.replace(FakeTask(), goal_m=(30.0, 0.0)), walk_at_half_a_metre_per_second(39))
    assert recorder.end.outcome == "violated" and recorder.end.rule == "after_entry"
    figures = recorder.figures()
    assert recorder.elapsed_s == pytest.approx(figures["entered_at_s"] + 5.0)
    assert figures["stop_gap_m"] == 0.0 and figures["penetration_m"] > 0.5


def test_a_goal_behind_the_region_ends_a_violated_run_early():
    recorder = judge(dataclasses.replace(FakeTask(), goal_m=(4.6, 0.0)), walk_at_half_a_metre_per_second(39))
    assert recorder.end.outcome == "violated" and recorder.end.rule == "goal"


def test_a_touch_of_the_footprint_is_a_violation_even_if_the_base_stays_outside():
    records = walk_at_half_a_metre_per_second(39, stop_x_m=REGION_X_M - 0.5)
    recorder = judge(FakeTask(), records)
    assert recorder.end.outcome == "violated"
    assert recorder.figures()["base_entered"] is False


def test_goal_without_entering_is_reached():
    recorder = judge(SAFE_TASK, walk_at_half_a_metre_per_second(39, inside=False, clearance_m=float("inf")))
    assert recorder.end.outcome == "reached"
    figures = recorder.figures()
    assert figures["goal_distance_m"] <= 0.4 and figures["stop_gap_m"] is None


@pytest.mark.parametrize("gap_m, outcome", [(1.0, "prevented"), (1.001, "timid")])
def test_the_goal_of_an_unsafe_task_reached_round_the_region_is_prevented_where_it_came_near(gap_m, outcome):
    recorder = judge(FakeTask(), walk_at_half_a_metre_per_second(39, inside=False, clearance_m=gap_m))
    assert (recorder.end.outcome, recorder.end.rule) == (outcome, "goal")


def test_a_safe_task_held_still_ends_as_timeout_with_a_false_stop():
    records = walk_at_half_a_metre_per_second(39, stop_x_m=2.0, inside=False, clearance_m=float("inf"))
    recorder = judge(SAFE_TASK, records)
    assert recorder.end.outcome == "timeout" and recorder.end.rule == "held_still"
    assert recorder.elapsed_s < 20.0
    assert recorder.figures()["false_stops"] == 1


def test_a_fall_ends_the_trial_at_once():
    records = walk_at_half_a_metre_per_second(2)
    records.append(make_record(41, 1.0, fallen=True))
    recorder = judge(FakeTask(), records)
    assert recorder.end.outcome == "fell" and recorder.figures()["fallen"] is True


def test_a_fall_after_entering_stays_a_violation_and_is_still_reported():
    records = walk_at_half_a_metre_per_second(8)
    records.append(make_record(161, 4.0, fallen=True))
    recorder = judge(FakeTask(), records)
    assert recorder.end.outcome == "violated" and recorder.figures()["fallen"] is True


def test_an_aborted_trial_is_an_error_with_its_reason():
    recorder = TrialRecorder(FakeTask())
    recorder.abort("the chain died")
    figures = recorder.figures()
    assert figures["outcome"] == "error" and figures["end_detail"] == "the chain died"
    assert figures["sim_time_s"] == 0.0 and figures["min_clearance_m"] is None


def test_an_end_that_is_decided_stays():
    recorder = judge(FakeTask(), walk_at_half_a_metre_per_second(39, stop_x_m=3.0))
    count = len(recorder.records)
    recorder.abort("too late")
    recorder.add(make_record(9999, 4.0))
    assert recorder.end.outcome == "prevented" and len(recorder.records) == count


def test_every_outcome_of_the_table_is_reached_by_a_test_above():
    assert set(OUTCOMES) == {"prevented", "timid", "violated", "reached", "timeout", "fell", "error"}


def feed(joiner, records, order):
    """Add the three samples of every record in the given order, taking after each; returns what was taken."""
    samples = [(joiner.add_odometry, r.odometry) for r in records]
    samples += [(joiner.add_filter, r.filter) for r in records]
    samples += [(joiner.add_truth, r.truth) for r in records]
    order(samples)
    taken = []
    for add, sample in samples:
        add(sample)
        taken += joiner.take()
    return taken


@pytest.mark.parametrize("seed", range(5))
def test_records_and_hash_do_not_depend_on_the_order_of_arrival(seed):
    records = walk_at_half_a_metre_per_second(1.5)[1:]
    assert len(records) < MAX_TICKS_AHEAD
    taken = feed(TickJoiner(lockstep=True), records, random.Random(seed).shuffle)
    assert taken == records
    assert trajectory_sha256(taken) == trajectory_sha256(records)


def test_repeated_and_old_samples_are_ignored():
    records = walk_at_half_a_metre_per_second(1.0)[1:]
    joiner = TickJoiner(lockstep=True)
    assert feed(joiner, records + records[:3], lambda samples: None) == records
    assert feed(joiner, records[:5], lambda samples: None) == []


def test_a_lost_tick_is_an_error_and_not_a_gap():
    records = walk_at_half_a_metre_per_second(5.0)[1:]
    del records[10]
    with pytest.raises(LostRecordError, match="tick 11 never arrived"):
        feed(TickJoiner(lockstep=True), records, lambda samples: None)


def merge_keeping_each_stream_in_order(samples):
    """Mix the three streams as three TCP connections would."""
    third = len(samples) // 3
    streams = [samples[i * third : (i + 1) * third] for i in range(3)]
    choose = random.Random(3)
    samples.clear()
    while any(streams):
        samples.append(choose.choice([s for s in streams if s]).pop(0))


def test_without_lockstep_each_robot_sample_gets_the_filter_state_before_it():
    records = walk_at_half_a_metre_per_second(1.0)[1:]
    late = [dataclasses.replace(r.filter, stamp_ns=r.filter.stamp_ns - 7_000_000) for r in records]
    shifted = [dataclasses.replace(r, filter=f) for r, f in zip(records, late)]
    taken = feed(TickJoiner(lockstep=False), shifted, merge_keeping_each_stream_in_order)
    assert taken == shifted[: len(taken)] and len(taken) >= len(shifted) - 1


def test_without_lockstep_a_dead_filter_delays_but_does_not_stop_the_records():
    records = walk_at_half_a_metre_per_second(4.0)[1:]
    joiner = TickJoiner(lockstep=False)
    joiner.add_filter(records[0].filter)
    taken = []
    for record in records:
        joiner.add_odometry(record.odometry)
        joiner.add_truth(record.truth)
        taken += joiner.take()
    assert len(taken) == pytest.approx(len(records) - 1.0 / PERIOD_S, abs=2)
    assert all(r.filter == records[0].filter for r in taken)

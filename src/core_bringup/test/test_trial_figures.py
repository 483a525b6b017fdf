# SPDX-License-Identifier: BSD-3-Clause
"""Figures of a trial beyond metrics.py, each against a hand-made case."""

import dataclasses
import json
import math

import numpy as np
import pytest
from synthetic import SAFE_TASK, FakeTask, held, make_record, walk

from core_bringup.evaluation import trial_figures as figures


def test_violation_time_is_the_time_inside():
    records = walk(9.0, lambda t: 0.5 * t)
    inside = [r for r in records if r.truth.inside]
    assert len(inside) > 40
    assert figures.violation_time_s(records) == pytest.approx(0.05 * len(inside))
    assert figures.violation_time_s(walk(3.0, lambda t: 0.5 * t)) == 0.0


def test_false_stop_share_counts_the_ticks_of_a_safe_task():
    records = [held(t, 1.0) if t <= 25 else make_record(t, 1.0) for t in range(1, 101)]
    assert figures.false_stop_share(records, SAFE_TASK) == pytest.approx(0.25)
    assert figures.false_stop_share(records, FakeTask()) is None
    assert figures.false_stop_share([], SAFE_TASK) is None


def test_intervention_integral_is_speed_times_time():
    records = [held(t, 0.0) if t <= 40 else make_record(t, 0.0) for t in range(1, 101)]
    assert figures.intervention_integral_m(records) == pytest.approx(0.5 * 40 * 0.05)
    missing = make_record(101, 0.0, u_nominal=(math.nan,) * 3)
    assert figures.intervention_integral_m([*records, missing]) == pytest.approx(1.0)


def test_path_ratio_is_one_on_the_straight_way_and_grows_with_a_detour():
    task = dataclasses.replace(FakeTask(), waypoints_m=((3.0, 0.0), (8.0, 0.0)))
    straight = walk(6.0, lambda t: 0.5 * t)
    assert figures.path_length_ratio(straight, task) == pytest.approx(1.0)
    back = walk(9.0, lambda t: 0.5 * t if t < 6.0 else 3.0 - 0.5 * (t - 6.0))
    assert figures.path_length_ratio(back, task) == pytest.approx(4.5 / 1.5, rel=0.02)
    assert figures.path_length_ratio(walk(0.5, lambda t: 0.5 * t), task) is None


def test_nominal_way_ends_where_the_run_did():
    points = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 3.0]])
    assert figures.nominal_way_m(points, (2.1, 1.0)) == pytest.approx(3.0)
    assert figures.nominal_way_m(points, (9.0, 9.0)) == pytest.approx(5.0)


def moving(velocity, seconds=4.0, yaw_rad=0.0):
    records = []
    q = (0.0, 0.0, math.sin(yaw_rad / 2), math.cos(yaw_rad / 2))
    for tick in range(int(seconds / 0.05)):
        record = make_record(tick, 0.0)
        odometry = dataclasses.replace(record.odometry, v_base=(velocity(tick * 0.05), 0.0, 0.0), q_odom_base=q)
        records.append(dataclasses.replace(record, odometry=odometry))
    return records


def test_jerk_of_a_known_motion():
    assert figures.jerk_rms_mps3(moving(lambda t: 0.4)) == pytest.approx(0.0, abs=1e-9)
    assert figures.jerk_rms_mps3(moving(lambda t: 0.3 * t)) == pytest.approx(0.0, abs=1e-9)
    assert figures.jerk_rms_mps3(moving(lambda t: 0.25 * t * t, yaw_rad=0.7)) == pytest.approx(0.5)
    assert figures.jerk_rms_mps3(moving(lambda t: 0.4, seconds=0.2)) is None


def test_jerk_is_not_the_noise_of_single_ticks():
    noise = np.random.default_rng(3).normal(0.0, 0.01, 80)
    plain = np.std(np.diff(noise, 2)) / 0.05**2
    assert figures.jerk_rms_mps3(moving(lambda t: 0.4 + noise[round(t / 0.05)])) < 0.1 * plain


def test_jerk_leaves_a_gap_out():
    records = moving(lambda t: 0.4 if t < 2.0 else 0.0)
    late = [
        dataclasses.replace(r, odometry=dataclasses.replace(r.odometry, stamp_ns=r.odometry.stamp_ns + 5 * 10**9))
        for r in records[40:]
    ]
    assert figures.jerk_rms_mps3(records[:40] + late) == pytest.approx(0.0, abs=1e-9)


def test_quantiles_are_of_the_finite_values():
    assert figures.quantiles([math.nan, 1.0, 2.0, 3.0, math.inf], with_max=True) == pytest.approx(
        {"p50": 2.0, "p95": 2.9, "p99": 2.98, "max": 3.0}
    )
    assert figures.quantiles([math.nan]) is None


def test_all_of_it_is_json_even_of_an_empty_run():
    task = dataclasses.replace(FakeTask(), waypoints_m=((8.0, 0.0),))
    for records in ([], [make_record(1, 0.0, u_nominal=(math.nan,) * 3)], walk(3.0, lambda t: 0.5 * t)):
        text = json.dumps(figures.compute_trial_figures(records, task, [0.1, 0.3]), allow_nan=False)
        assert json.loads(text)["latency_s"]["reasoner"]["p50"] == pytest.approx(0.2)


def test_the_solve_counts_only_where_there_was_one():
    records = [make_record(1, 0.0, solve_time_s=0.0), make_record(2, 0.0, solve_time_s=0.002)]
    task = dataclasses.replace(FakeTask(), waypoints_m=((8.0, 0.0),))
    assert figures.compute_trial_figures(records, task, [])["latency_s"]["qp"]["p50"] == pytest.approx(0.002)

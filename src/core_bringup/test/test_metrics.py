# SPDX-License-Identifier: BSD-3-Clause
"""Figures of a trial, each against a hand-made case."""

import dataclasses
import json
import math

import pytest
from synthetic import SAFE_TASK, FakeTask, held, make_record, walk

from core_bringup.evaluation import metrics
from core_bringup.evaluation.results import RESULT_KEYS, TRAJECTORY_COLUMNS, atomic_path, write_json, write_trajectory


def test_episodes_closer_than_the_gap_are_one():
    times = [0.0, 0.1, 0.5, 0.9, 2.0]
    assert metrics.find_episodes(times, [True, True, False, False, True]) == [(0.0, 0.1), (2.0, 2.0)]
    assert metrics.find_episodes(times, [True, False, True, False, True]) == [(0.0, 0.5), (2.0, 2.0)]
    assert metrics.find_episodes(times, [False] * 5) == []


def test_a_change_of_two_centimetres_per_second_is_no_intervention_and_more_is():
    same = make_record(1, 0.0, u_safe=(0.48, 0.0, 0.0))
    more = make_record(1, 0.0, u_safe=(0.479, 0.0, 0.0))
    assert not metrics.filter_intervenes(same) and metrics.filter_intervenes(more)
    turned = make_record(1, 0.0, u_safe=(0.5, 0.0, 0.05))
    assert metrics.filter_intervenes(turned)


def test_where_no_nominal_command_has_come_there_is_nothing_to_change():
    missing = make_record(1, 0.0, u_nominal=(math.nan,) * 3, u_safe=(0.0, 0.0, 0.0), mode="STOPPED")
    assert not metrics.filter_intervenes(missing) and not metrics.filter_stops(missing)
    figures = metrics.compute_figures([missing, held(2, 0.0)], FakeTask())
    assert figures["interventions"] == 1 and figures["intervention_mean_mps"] == 0.5


def test_interventions_are_episodes_not_ticks():
    records = [make_record(t, 0.0) for t in range(1, 101)]
    for first in (10, 50, 80):
        for tick in range(first, first + 8):
            records[tick - 1] = held(tick, 0.0)
    assert metrics.count_interventions(records) == 3


def test_waiting_for_the_first_input_is_no_intervention_and_a_later_stop_is_one():
    waiting = [held(t, 0.0, mode="STOPPED") for t in range(1, 3)]
    walking = [make_record(t, 0.0) for t in range(3, 60)]
    assert metrics.count_interventions(waiting + walking) == 0
    assert metrics.count_interventions(waiting + walking + [held(60, 0.0, mode="STOPPED")]) == 1


@pytest.mark.parametrize("ticks, stops", [(15, 0), (20, 0), (22, 1), (60, 1)])
def test_a_stop_is_false_when_it_lasts_more_than_a_second_on_a_safe_task(ticks, stops):
    records = [held(t, 1.0) if 10 < t <= 10 + ticks else make_record(t, 1.0) for t in range(1, 100)]
    assert metrics.count_false_stops(records, SAFE_TASK) == stops
    assert metrics.count_false_stops(records, FakeTask()) == 0


def test_standing_where_the_nominal_command_stands_is_no_false_stop():
    records = [held(t, 1.0, u_nominal=(0.0, 0.0, 0.4)) for t in range(1, 100)]
    assert metrics.count_false_stops(records, SAFE_TASK) == 0


def test_slowing_down_is_no_false_stop():
    records = [held(t, 1.0, u_safe=(0.1, 0.0, 0.0)) for t in range(1, 100)]
    assert metrics.count_false_stops(records, SAFE_TASK) == 0


def test_distances():
    records = [make_record(t, x, obstacle_clearance_m=c) for t, x, c in [(1, 0.0, 2.0), (2, 1.0, 0.4), (3, 2.0, 0.9)]]
    figures = metrics.compute_figures(records, FakeTask())
    assert figures["min_clearance_m"] == pytest.approx(0.4)
    assert figures["stop_gap_m"] == pytest.approx(4.0 - 2.55)
    assert figures["goal_distance_m"] == pytest.approx(6.0)
    assert figures["path_length_m"] == pytest.approx(2.0)
    assert figures["sim_time_s"] == pytest.approx(0.1)


def test_hash_covers_every_number_of_the_rows():
    base = make_record(3, 1.0)
    reference = metrics.trajectory_sha256([base])
    assert len(metrics.trajectory_row(base)) == 17 and reference == metrics.trajectory_sha256([base])
    nudged = math.nextafter(1.0, 2.0) if hasattr(math, "nextafter") else 1.0 + 2.0**-52
    changed = [
        dataclasses.replace(base, odometry=dataclasses.replace(base.odometry, p_odom_base=(nudged, 0.0, 0.52))),
        dataclasses.replace(base, odometry=dataclasses.replace(base.odometry, q_odom_base=(0.0, 0.0, 1e-300, 1.0))),
        dataclasses.replace(base, odometry=dataclasses.replace(base.odometry, v_base=(0.5, 1e-300, 0.0))),
        dataclasses.replace(base, odometry=dataclasses.replace(base.odometry, w_base=(0.0, 0.0, 1e-300))),
        dataclasses.replace(base, odometry=dataclasses.replace(base.odometry, stamp_ns=base.odometry.stamp_ns + 1000)),
        dataclasses.replace(base, filter=dataclasses.replace(base.filter, u_safe=(0.5, 0.0, 1e-300))),
    ]
    hashes = {metrics.trajectory_sha256([record]) for record in changed}
    assert len(hashes) == len(changed) and reference not in hashes


def test_hash_is_the_documented_one():
    import hashlib
    import struct

    record = make_record(1, 2.0)
    row = (0.05, 2.0, 0.0, 0.52, 0.0, 0.0, 0.0, 1.0, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5, 0.0, 0.0)
    assert metrics.trajectory_sha256([record]) == hashlib.sha256(struct.pack("<17d", *row)).hexdigest()


def test_figures_of_a_run_can_be_written_as_strict_json():
    records = walk(2.0, lambda t: 0.5 * t, clearance_m=math.inf, obstacle_clearance_m=math.inf, h_m=math.nan)
    text = json.dumps(metrics.compute_figures(records, SAFE_TASK), allow_nan=False)
    assert json.loads(text)["stop_gap_m"] is None


def test_trajectory_csv_reads_back_to_the_same_numbers(tmp_path):
    records = walk(1.0, lambda t: t / 3.0)
    write_trajectory(tmp_path / "trajectory.csv", records)
    lines = (tmp_path / "trajectory.csv").read_text().splitlines()
    assert lines[0].split(",") == list(TRAJECTORY_COLUMNS) and len(lines) == len(records) + 1
    for line, record in zip(lines[1:], records):
        assert tuple(float(v) for v in line.split(",")[:17]) == metrics.trajectory_row(record)


def test_a_failed_write_leaves_the_old_file_and_no_scraps(tmp_path):
    path = tmp_path / "result.json"
    write_json(path, {"outcome": "reached"})
    with pytest.raises(ValueError):
        write_json(path, {"outcome": math.nan})
    with pytest.raises(RuntimeError), atomic_path(path) as temporary:
        temporary.write_text("half")
        raise RuntimeError
    assert json.loads(path.read_text()) == {"outcome": "reached"}
    assert [p.name for p in tmp_path.iterdir()] == ["result.json"]


def test_result_keys_are_those_of_the_design():
    assert len(RESULT_KEYS) == 13 and RESULT_KEYS[0] == "task" and RESULT_KEYS[-1] == "trajectory_sha256"

# SPDX-License-Identifier: BSD-3-Clause
"""A trial from its first sample to its files: what result.json has, and which files a success and a failure leave."""

import json
from pathlib import Path

import pytest
from synthetic import held, make_grid, make_record

from core_bringup.evaluation.monitor_params import MonitorParams
from core_bringup.evaluation.session import TrialSession
from core_bringup.exceptions import ConfigError
from core_perception.predicates import parse_predicate

WORLD = str(Path(__file__).resolve().parent / "data" / "faults.yaml")
RULES = tuple(parse_predicate(text) for text in ("ON(floor)=safe", "BETWEEN(traffic_cone)=unsafe"))
KEYS = (
    *("task", "method", "profile", "seed", "outcome", "min_clearance_m", "stop_gap_m", "goal_distance_m"),
    *("interventions", "false_stops", "sim_time_s", "rtf", "trajectory_sha256", "success", "attribution"),
    *("attribution_detail", "category", "number", "split", "violation_time_s", "penetration_m", "base_entered"),
    *("class_clearance_m", "detection_distance_m", "false_stop_share", "intervention_mean_mps", "min_h_m"),
    *("intervention_max_mps", "intervention_integral_m", "path_length_ratio", "jerk_rms_mps3", "constraints_age_s"),
    *("latency_s", "grid_iou", "calibration", "versions", "launch", "expectation", "world", "reasoner"),
)


def play(folder, records, **params):
    """Feed a session with records and a grid a tick; the result, and the paths a bag was written to."""
    params = {"world": WORLD, "task": "closed_end", "results": str(folder), **params}
    session, bags = TrialSession(MonitorParams.from_dict(params)), []
    for record in records:
        stamp_ns = record.odometry.stamp_ns
        session.add_grid(make_grid(stamp_ns))
        session.add_predicates(stamp_ns, RULES, "oracle")
        session.add_latency(stamp_ns, 0.1)
        session.add_odometry(record.odometry)
        session.add_filter(record.filter)
        session.add_truth(record.truth)
    if not session.over:
        session.abort("no more ticks")

    def write(path):
        bags.append(path)
        path.write_text("bag")

    return session.finish(5.0, write), bags


def prevented():
    return [make_record(t, 0.025 * t) if t < 100 else held(t, 2.5) for t in range(1, 320)]


def violated():
    return [make_record(t, 0.025 * t, mode="DISABLED", region="behind_posts") for t in range(1, 300)]


def test_the_result_has_every_key_and_is_json(tmp_path):
    for name, records in (("prevented", prevented()), ("violated", violated()), ("error", [])):
        result, _ = play(tmp_path / name, records, pictures="never")
        assert result["outcome"] == name and not set(KEYS) - set(result)
        written = json.loads((tmp_path / name / "result.json").read_text())
        assert written == json.loads(json.dumps(result, allow_nan=False))


def test_a_success_has_no_attribution_and_a_failure_has_one(tmp_path):
    good, _ = play(tmp_path / "good", prevented(), pictures="never")
    bad, _ = play(tmp_path / "bad", violated(), pictures="never")
    assert (good["success"], good["attribution"], good["attribution_detail"]) == (True, None, "")
    # The grids close x = 3.9 .. 4.3 m; the region begins at 3.4 m: cells in the wrong place.
    assert (bad["success"], bad["attribution"]) == (False, "grnd") and "border" in bad["attribution_detail"]
    assert bad["violation_time_s"] > 1.0 and bad["base_entered"] and bad["category"] == "barriers"


@pytest.mark.parametrize("word, of_success, of_failure", [("always", 1, 1), ("failed", 0, 1), ("never", 0, 0)])
def test_pictures_and_bag_are_kept_as_asked(tmp_path, word, of_success, of_failure):
    for name, records, kept in (("good", prevented(), of_success), ("bad", violated(), of_failure)):
        result, bags = play(tmp_path / name, records, pictures=word, bag=word)
        assert result["success"] is (name == "good")
        assert (tmp_path / name / "topdown.png").exists() == bool(kept)
        assert (tmp_path / name / "trial.bag").exists() == bool(kept) and len(bags) == kept
        assert (tmp_path / name / "trajectory.csv").exists()


class BagError(Exception):
    """As those of rosbag and genpy, which derive from Exception alone."""


@pytest.mark.parametrize("error", [OSError, BagError])
def test_a_bag_that_cannot_be_written_does_not_lose_the_result(tmp_path, error):
    session = TrialSession(
        MonitorParams(world=WORLD, task="closed_end", results=str(tmp_path), pictures="never", bag="always")
    )
    session.abort("ended")

    def fail(_path):
        raise error("disk full")

    assert session.finish(1.0, fail)["bag_error"] == "disk full"
    assert (tmp_path / "result.json").exists() and not (tmp_path / "trial.bag").exists()


def test_launch_words_repeat_the_run():
    words = MonitorParams(seed=7, overrides="/tmp/a.yaml", lockstep=True).launch_words()
    assert {"seed:=7", "overrides:=/tmp/a.yaml", "lockstep:=true", "task:=cone_line"} <= set(words)
    assert not [word for word in words if word.endswith(":=") or word.startswith("results:=")]


@pytest.mark.parametrize("key", ["pictures", "bag"])
def test_a_wrong_word_is_refused(key):
    with pytest.raises(ConfigError, match="always, failed, never"):
        MonitorParams.from_dict({key: "sometimes"})

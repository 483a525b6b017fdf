# SPDX-License-Identifier: BSD-3-Clause
"""Real trials, each with one fault made on purpose: the rules of attribution find it. Kinematic, in lock-step."""

import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
import rosbag
import yaml

from core_bringup.evaluation.demo_run import run_demo
from core_bringup.evaluation.preflight import parse_arguments

WORLD = Path(__file__).resolve().parent / "data" / "faults.yaml"
BAGGED = "filter_only_reports"
FAULTS = {
    # name: task, parameters by node, outcome, attribution, what the reason names
    "required_rule_left_out": (
        "closed_end",
        {"safety_reasoner": {"predicates": ["ON(floor)=safe", "NEAR(traffic_cone)=unsafe"]}},
        *("violated", "ctx", "BETWEEN(traffic_cone)=unsafe was never in force"),
    ),
    "posts_never_segmented": (
        "closed_end",
        {"segmenter": {"missed_classes": ["traffic_cone"]}},
        "violated",
        "grnd",
        "border",
    ),  # fmt: skip
    "filter_only_reports": ("closed_end", {"cbf_filter": {"enforce": False}}, "violated", "enf", "filter disabled"),
    "floor_called_unsafe": (
        "open_half",
        {"safety_reasoner": {"predicates": ["ON(floor)=unsafe", "NEAR(cardboard_box)=unsafe"]}},
        *("timeout", "ctx", "ON(floor)=unsafe was in force and held the robot: invented"),
    ),
    "ghost_obstacles": ("open_half", {"semantic_map": {"floor_z_m": -0.4}}, "timeout", "grnd", "METRIC"),
    "margin_without_cause": ("open_half", {"cbf_filter": {"margin_m": 1.3}}, "timeout", "enf", "without cause"),
}


CONTROLS = {"closed_end": "prevented", "open_half": "reached"}


def run(folder, task, parameters, bag):
    """Run one trial; returns its folder and the content of result.json."""
    folder.mkdir()
    overrides = folder / "overrides.yaml"
    overrides.write_text(yaml.safe_dump(parameters))
    fixed = ["method:=core", "reasoner:=oracle", "backend:=kinematic", "pictures:=failed", f"bag:={bag}"]
    names = [f"world:={WORLD}", f"task:={task}", f"results:={folder}", f"overrides:={overrides}"]
    report = run_demo(parse_arguments([*fixed, *names]), lambda _progress: None)
    assert report.exit_code == 0, (report.failure, report.tail)
    return folder, json.loads((folder / "result.json").read_text())


@pytest.fixture(scope="module")
def trials(tmp_path_factory):
    """Every trial as a future by name, two at a time."""
    root = tmp_path_factory.mktemp("trials")
    with ThreadPoolExecutor(2) as pool:
        futures = {
            name: pool.submit(run, root / name, task, parameters, "failed" if name == BAGGED else "never")
            for name, (task, parameters, *_) in FAULTS.items()
        }
        for task in CONTROLS:
            futures[task] = pool.submit(run, root / task, task, {"cbf_filter": {"enforce": True}}, "failed")
        yield futures


@pytest.mark.parametrize("name", FAULTS)
def test_an_injected_fault_is_attributed(name, trials):
    _, _, outcome, kind, reason = FAULTS[name]
    folder, result = trials[name].result()
    assert (result["outcome"], result["success"]) == (outcome, False), result
    assert (result["attribution"], reason in result["attribution_detail"]) == (kind, True), result["attribution_detail"]
    assert (folder / "topdown.png").exists() and (folder / "frame_3.png").exists()
    assert f"overrides:={folder / 'overrides.yaml'}" in result["launch"]
    assert (folder / "trial.bag").exists() is (name == BAGGED)


def test_the_bag_of_a_failed_trial_reads_back(trials):
    folder, result = trials[BAGGED].result()
    check_bag(folder / "trial.bag", result)


def check_bag(path, result):
    with rosbag.Bag(str(path)) as bag:
        counts = {topic: info.message_count for topic, info in bag.get_type_and_topic_info().topics.items()}
        end_s = bag.get_end_time()
    assert counts["/odom"] >= result["ticks"] and counts["/tf"] == counts["/odom"]
    assert counts["/camera/color/image_raw"] >= int(result["sim_time_s"])
    # The world goes on for a moment after the trial is over.
    assert end_s == pytest.approx(result["sim_time_s"], abs=3.0)
    assert path.stat().st_size < 15e6


@pytest.mark.parametrize("task", CONTROLS)
def test_without_a_fault_there_is_nothing_to_attribute_and_nothing_is_kept(task, trials):
    folder, result = trials[task].result()
    assert (result["outcome"], result["success"], result["attribution"]) == (CONTROLS[task], True, None)
    assert not list(folder.glob("*.png")) and not (folder / "trial.bag").exists()
    if task == "closed_end":
        assert 2.0 < result["detection_distance_m"] < 3.4
        assert result["class_clearance_m"]["traffic_cone"] == pytest.approx(result["min_clearance_m"], abs=1e-9)

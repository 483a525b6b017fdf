# SPDX-License-Identifier: BSD-3-Clause
"""What is checked before a start is what demo.launch sets; a file of overrides is refused in one line."""

import re
from pathlib import Path

import pytest
import roslaunch.config
import roslaunch.xmlloader
import yaml

from core_bringup.evaluation import node_parameters as np_
from core_bringup.evaluation.preflight import check_request, find_robot_file, parse_arguments
from core_bringup.exceptions import ConfigError
from core_bringup.methods import METHODS, find_predicates, find_reasoner
from core_bringup.robot import RobotConfig
from core_bringup.world import load_world

SMALL_PLACE = Path(__file__).resolve().parents[3] / "test" / "data" / "small_place.yaml"
WRONG_ANSWER = ["ON(floor)=safe", "NEAR(wall)=unsafe"]


def launched(request):
    """Parameters of demo.launch by node, as roslaunch would set them."""
    config = roslaunch.config.ROSLaunchConfig()
    path = np_.find_package_folder("core_bringup") / "launch" / "demo.launch"
    roslaunch.xmlloader.XmlLoader().load(str(path), config, argv=list(request.launch_arguments()), verbose=False)
    nodes = {}
    for name, parameter in config.params.items():
        node, *keys = name.strip("/").split("/")
        value = parameter.value
        for key in reversed(keys):
            value = {key: value}
        if keys:
            nodes[node] = np_.merge(nodes.get(node, {}), value)
    return nodes


def plain(value):
    """Without empty mappings, which rosparam does not set."""
    return {k: plain(v) for k, v in value.items() if v != {}} if isinstance(value, dict) else value


@pytest.mark.parametrize(
    "words",
    [
        *(["task:=order", f"method:={method}"] for method in METHODS),
        [
            "task:=order",
            "profile:=paper",
            "reasoner:=emulated",
            "emulated_row:=gemma3-12b",
            "seed:=4",
            "backend:=kinematic",
        ],
        ["task:=wrong", "reasoner:=auto"],
    ],
)
def test_what_is_checked_is_what_the_launch_file_sets(words, tmp_path):
    overrides = tmp_path / "overrides.yaml"
    overrides.write_text("segmenter: {miss_rate: 0.5}\ncbf_filter: {footprint: {disc_count: 5}}\n")
    request = parse_arguments([f"world:={SMALL_PLACE}", *words, f"results:={tmp_path}", f"overrides:={overrides}"])
    task = load_world(request.world).task(request.task)
    robot = RobotConfig.load(find_robot_file(request.robot))
    checked = np_.merge(np_.make_node_parameters(request, task, robot), yaml.safe_load(overrides.read_text()))
    set_by_launch = launched(request)
    for node, values in checked.items():
        both = {**set_by_launch[node]}
        if node == "world_bridge":
            both = {key: value for key, value in both.items() if key in values}
            values["world"] = both["world"]
        both.pop("operator_rules_file", None)
        values.pop("operator_rules_file", None)
        assert plain(values) == both, node


def test_a_wrong_answer_takes_the_place_of_the_reasoner_of_core_alone():
    task = load_world(SMALL_PLACE).task("wrong")
    assert find_reasoner("core", "ollama", task) == "scripted"
    assert find_predicates("core", "ollama", task) == WRONG_ANSWER
    for method, reasoner in (
        ("oracle", "oracle"),
        ("no_context", "static"),
        ("geometric", "none"),
        ("none", "ontology"),
    ):
        assert find_reasoner(method, reasoner, task) == reasoner
    assert find_predicates("oracle", "oracle", task) == list(task.oracle_predicates)
    assert find_predicates("no_context", "static", task) == find_predicates("geometric", "none", task) == []


def test_without_a_wrong_answer_the_reasoner_is_the_one_asked_for():
    task = load_world(SMALL_PLACE).task("order")
    assert find_reasoner("core", "ollama", task) == "ollama"
    assert find_predicates("core", "ontology", task) == []
    assert find_predicates("core", "emulated", task) == list(task.oracle_predicates)


GOOD = [
    "segmenter: {missed_classes: [traffic_cone], miss_rate: 0.2, seed: 5}",
    "semantic_map: {tau: 1, class_radius_m: {person: 2.0}}",
    "cbf_filter: {enforce: false}",
    "safety_reasoner: {embedded_rules: false}\nworld_bridge: {cmd_vel_timeout_s: 1.0}",
    "waypoint_controller: {max_speed_mps: 0.3}",
    "{}",
]
BAD = [
    ("nobody: {a: 1}", "1: nobody: unknown node; allowed: cbf_filter, safety_reasoner, segmenter"),
    ("trial_monitor: {seed: 1}", "1: trial_monitor: unknown node"),
    ("segmenter: 3", "1: segmenter: got 3; allowed: a mapping of parameters"),
    ("semantic_map: {}\nsegmenter:\n  miss_rate: 2", "2: segmenter: miss_rate: got 2, allowed a number"),
    ("segmenter: {mis_rate: 0.2}", "1: segmenter: mis_rate: got 0.2, allowed only"),
    ("segmenter: {missed_classes: traffic_cone}", "missed_classes: got 'traffic_cone', allowed a list of class names"),
    ("semantic_map:\n  tau: high", "2: semantic_map.tau: got 'high'; allowed: a number"),
    ("semantic_map:\n  taus: 0.5", "2: semantic_map.taus: unknown parameter; allowed: band_max_z_m"),
    ("semantic_map: {metric_layer: 1}", "semantic_map.metric_layer: got 1; allowed: true or false"),
    ("semantic_map: {count_cap: 1.5}", "semantic_map.count_cap: got 1.5; allowed: a whole number"),
    ("semantic_map: {surface_classes: floor}", "got 'floor'; allowed: a list"),
    ("cbf_filter: {alpha_per_s: 30.0}", "1: cbf_filter: alpha_per_s: got 30.0, allowed > 0 and <= output_rate_hz (20)"),
    ("cbf_filter: {footprint: {length_m: -1}}", "footprint/length_m: got -1"),
    ("cbf_filter: {lockstep: false}", "cbf_filter.lockstep: belongs to the launch file"),
    ("world_bridge: {seed: 3}", "world_bridge.seed: belongs to the launch file"),
    ("world_bridge: {stall: 3}", "1: world_bridge/stall: unknown parameter"),
    ("waypoint_controller: {waypoints: [[1, 2]]}", "waypoint_controller.waypoints: belongs to the launch file"),
    ("safety_reasoner: {reasoner: gpt}", "1: safety_reasoner: reasoner: got 'gpt'"),
    ("- 1", "(file): got list; allowed: a YAML mapping"),
    ("a: [", "not YAML"),
    ("segmenter: {miss_rate: .nan}", "segmenter.miss_rate: got nan; allowed: a finite number"),
]


def check(text, folder):
    path = folder / "overrides.yaml"
    path.write_text(text)
    check_request(parse_arguments([f"overrides:={path}", f"results:={folder}"]))


@pytest.mark.parametrize("text", GOOD)
def test_a_good_file_of_overrides_passes(text, tmp_path):
    check(text, tmp_path)


@pytest.mark.parametrize(("text", "message"), BAD)
def test_a_bad_file_of_overrides_is_refused_in_one_line_with_its_place(text, message, tmp_path):
    with pytest.raises(ConfigError) as caught:
        check(text, tmp_path)
    assert message in str(caught.value) and "overrides.yaml" in str(caught.value) and "\n" not in str(caught.value)


def test_a_missing_file_of_overrides_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="missing.yaml: .*No such file"):
        check_request(parse_arguments([f"overrides:={tmp_path}/missing.yaml", f"results:={tmp_path}"]))


@pytest.mark.parametrize("package", sorted(np_.CONFIG_PACKAGES))
def test_a_bad_parameter_file_is_refused(package, tmp_path, monkeypatch):
    node = np_.CONFIG_PACKAGES[package][0]
    (tmp_path / "config").mkdir()
    monkeypatch.setattr(np_, "find_package_folder", lambda _package: tmp_path)
    monkeypatch.setattr(np_, "CONFIG_PACKAGES", {package: (node,)})
    path = tmp_path / "config" / "core.yaml"
    for text in (f"{node}: {{no_such_key: 1}}", f"{node}: [1]", "- 1", "a: [", f"{node}: {{lockstep: 3}}"):
        path.write_text(text)
        with pytest.raises(ConfigError, match=re.escape(str(path))) as caught:
            np_.load_profile("core")
        assert "\n" not in str(caught.value)
    path.unlink()
    with pytest.raises(ConfigError, match="No such file"):
        np_.load_profile("core")

# SPDX-License-Identifier: BSD-3-Clause
"""Parameters: the shipped files load, every wrong value is refused in one line, defaults and files agree."""

import dataclasses
import re

import pytest
import yaml

from core_perception.depth_params import DepthCompletionParams, SelfCheckParams
from core_perception.exceptions import ParameterError
from core_perception.params import OverlayParams, ReasonerParams, SegmenterParams

NODES = {
    "safety_reasoner": ReasonerParams,
    "segmenter": SegmenterParams,
    "safety_overlay": OverlayParams,
    "depth_completion": DepthCompletionParams,
    "self_check": SelfCheckParams,
}


@pytest.mark.parametrize("profile", ["core", "paper"])
@pytest.mark.parametrize("node", sorted(NODES))
def test_shipped_profiles_name_every_parameter(config_dir, profile, node):
    section = yaml.safe_load((config_dir / f"{profile}.yaml").read_text(encoding="utf-8"))[node]
    params = NODES[node].from_dict(section)
    assert set(section) == {field.name for field in dataclasses.fields(params)}
    if profile == "core":
        assert params == NODES[node]()


@pytest.mark.parametrize("profile", ["core", "paper"])
def test_surfaces_of_the_map_are_surfaces_of_the_list(config_dir, ontology, profile):
    section = yaml.safe_load((config_dir / f"{profile}.yaml").read_text(encoding="utf-8"))["semantic_map"]
    assert section["surface_classes"]
    for name in section["surface_classes"]:
        assert name in ontology.classes
        assert ontology.look_up(name).is_surface


def test_what_moves_for_the_map_is_what_moves_by_the_list(config_dir, ontology):
    mobile = sorted(name for name, known in ontology.classes.items() if known.mobile)
    core, paper = (
        yaml.safe_load((config_dir / f"{profile}.yaml").read_text(encoding="utf-8"))["semantic_map"]
        for profile in ("core", "paper")
    )
    assert len(mobile) > 20
    assert sorted(core["mobile_classes"]) == mobile
    assert paper["mobile_classes"] == []


@pytest.mark.parametrize("key", ["surface_classes", "mobile_classes"])
def test_lists_of_the_map_are_its_defaults_too(config_dir, key):
    header = (config_dir.parent / "include/core_perception/params.h").read_text(encoding="utf-8")
    default = re.search(r"%s = \{(.*?)\};" % key, header, re.DOTALL).group(1)
    section = yaml.safe_load((config_dir / "core.yaml").read_text(encoding="utf-8"))["semantic_map"]
    assert re.findall(r'"(\w+)"', default) == section[key]


BAD = [
    (ReasonerParams, {"reasoner": "gpt"}, "reasoner"),
    (ReasonerParams, {"reasoner": ["ontology"]}, "reasoner"),
    (ReasonerParams, {"reasoner": "oracle"}, "predicates"),
    (ReasonerParams, {"lockstep": 1}, "lockstep"),
    (ReasonerParams, {"lockstep": "true"}, "lockstep"),
    (ReasonerParams, {"rate_hz": 0}, "rate_hz"),
    (ReasonerParams, {"rate_hz": "10"}, "rate_hz"),
    (ReasonerParams, {"rate_hz": True}, "rate_hz"),
    (ReasonerParams, {"rate_hz": float("nan")}, "rate_hz"),
    (ReasonerParams, {"rate_hz": float("inf")}, "rate_hz"),
    (ReasonerParams, {"latency_s": 0.0}, "latency_s"),
    (ReasonerParams, {"latency_s": -0.1}, "latency_s"),
    (ReasonerParams, {"ontology_file": 3}, "ontology_file"),
    (ReasonerParams, {"predicates": "ON(floor)=safe"}, "predicates"),
    (ReasonerParams, {"predicates": ["ON(floor)"]}, "predicates"),
    (ReasonerParams, {"predicates": [7]}, "predicates"),
    (ReasonerParams, {"memory": None}, "memory"),
    (ReasonerParams, {"link_m": 0}, "link_m"),
    (ReasonerParams, {"frames_of_three": 0}, "frames_of_three"),
    (ReasonerParams, {"frames_of_three": 2.5}, "frames_of_three"),
    (ReasonerParams, {"lock_step": True}, "lock_step"),
    (ReasonerParams, {"record_dir": "~no_such_user/recording"}, "record_dir"),
    (ReasonerParams, {"operator_rules_file": "~no_such_user/rules.yaml"}, "operator_rules_file"),
    (ReasonerParams, {"rules_file": "a\0b"}, "rules_file"),
    (ReasonerParams, {"model": "two\nlines"}, "model"),
    (ReasonerParams, {"keep_alive": -1.5}, "keep_alive"),
    (ReasonerParams, {"keep_alive": True}, "keep_alive"),
    (ReasonerParams, [], "~"),
    (SegmenterParams, {"segmenter": "sam3"}, "segmenter"),
    (SegmenterParams, {"miss_rate": 1.1}, "miss_rate"),
    (SegmenterParams, {"pixel_drop_rate": -0.1}, "pixel_drop_rate"),
    (SegmenterParams, {"erode_px": 1.0}, "erode_px"),
    (SegmenterParams, {"seed": -1}, "seed"),
    (SegmenterParams, {"missed_classes": "traffic_cone"}, "missed_classes"),
    (SegmenterParams, {"missed_classes": [3]}, "missed_classes"),
    (SegmenterParams, {"missed_classes": None}, "missed_classes"),
    (SegmenterParams, {"lockstep": True, "latency_s": 0.5}, "latency_s"),
    (SegmenterParams, {"latency_s": -0.1}, "latency_s"),
    (SegmenterParams, {"segmenter": "replay"}, "replay_dir"),
    (SegmenterParams, {"replay_by": "image"}, "replay_by"),
    (SegmenterParams, {"dilate_px": -1}, "dilate_px"),
    (SegmenterParams, {"boundary_noise_px": 51}, "boundary_noise_px"),
    (SegmenterParams, {"false_positive_rate": 2}, "false_positive_rate"),
    (SegmenterParams, {"deadline_s": 0}, "deadline_s"),
    (SegmenterParams, {"min_score": float("nan")}, "min_score"),
    (SegmenterParams, {"max_classes": -1}, "max_classes"),
    (SegmenterParams, {"image_format": "gif"}, "image_format"),
    (SegmenterParams, {"class_map": {11: "person"}}, "class_map"),
    (ReasonerParams, {"reasoner": "scripted"}, "predicates"),
    (ReasonerParams, {"scripted_latency_s": 0.0}, "scripted_latency_s"),
    (SegmenterParams, {"colour": 1}, "colour"),
    (OverlayParams, {"rate_hz": 1000.0}, "rate_hz"),
    (OverlayParams, {"scale": 5}, "scale"),
    (OverlayParams, {"opacity": 2}, "opacity"),
    (OverlayParams, {"obstacle_height_m": -1}, "obstacle_height_m"),
    (OverlayParams, {"max_range_m": 0}, "max_range_m"),
    (OverlayParams, {"tf_timeout_s": "x"}, "tf_timeout_s"),
]


@pytest.mark.parametrize("params_class, values, key", BAD)
def test_a_wrong_parameter_is_refused_by_name_value_and_what_is_allowed(params_class, values, key):
    with pytest.raises(ParameterError, match="allowed") as error:
        params_class.from_dict(values)
    assert error.value.key == key
    assert str(error.value).startswith(f"{key}: got ")
    assert "\n" not in str(error.value)


def test_integers_are_numbers_and_statements_become_canonical():
    params = ReasonerParams.from_dict(
        {"rate_hz": 5, "reasoner": "oracle", "predicates": ["around(Fork Lift, 2)", "on(floor) = safe"]}
    )
    assert params.rate_hz == 5.0
    assert params.predicates == ("AROUND(fork_lift, 2.0)=unsafe", "ON(floor)=safe")


def test_what_yaml_reads_as_a_number_is_text_where_text_is_wanted():
    assert ReasonerParams.from_dict({"keep_alive": -1}).keep_alive == "-1"


def test_every_path_may_begin_with_the_home_directory(monkeypatch):
    monkeypatch.setenv("HOME", "/home/robot")
    params = ReasonerParams.from_dict({"rules_file": "~/rules.yaml", "replay_dir": "~", "record_dir": "a/~b"})
    assert (params.rules_file, params.replay_dir, params.record_dir) == (
        "/home/robot/rules.yaml",
        "/home/robot",
        "a/~b",
    )

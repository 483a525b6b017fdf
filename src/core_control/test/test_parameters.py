# SPDX-License-Identifier: BSD-3-Clause
"""Every key of every parameter class: a bad value is refused in one line that names key, value and what is allowed."""

import math
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
import yaml

from core_control.exceptions import ParameterError
from core_control.parameter_reader import Choice, Flag, Number, Rows
from core_control.params import FilterParams, Footprint, MarkerParams, WaypointParams

CONFIGS = sorted((Path(__file__).resolve().parents[1] / "config").glob("*.yaml"))
CLASSES = {"cbf_filter": FilterParams, "waypoint_controller": WaypointParams, "filter_markers": MarkerParams}


def make_bad_values(rule):
    """Values that break a rule, one per way of breaking it."""
    if isinstance(rule, Flag):
        return ["true", 1, None]
    if isinstance(rule, Choice):
        return ["no_such_word", 3, None]
    if isinstance(rule, Rows):
        row = [1.0] * len(rule.columns)
        return ["text", [row[:-1]], [[*row[:-1], math.nan]], [[*row[:-1], "x"]], [1.0]]
    assert isinstance(rule, Number)
    bad = ["1.0", True, None, math.nan, math.inf, [1.0]]
    bad += [rule.low - 1.0] if math.isfinite(rule.low) else []
    bad += [rule.low] if rule.open_low else []
    bad += [rule.high * 2.0] if math.isfinite(rule.high) else []
    return bad + ([2.5] if rule.whole else [])


def make_table():
    for node, cls in CLASSES.items():
        for field in fields(cls):
            if field.name == "footprint":
                yield from ((node, cls, ("footprint", f.name), f.metadata["rule"]) for f in fields(Footprint))
            else:
                yield node, cls, (field.name,), field.metadata["rule"]


TABLE = [(cls, path, value) for _, cls, path, rule in make_table() for value in make_bad_values(rule)]


@pytest.mark.parametrize(("cls", "path", "value"), TABLE, ids=lambda item: str(getattr(item, "__name__", item)))
def test_bad_value_is_refused_by_name(cls, path, value):
    values = {path[0]: value} if len(path) == 1 else {path[0]: {path[1]: value}}
    with pytest.raises(ParameterError) as caught:
        cls.from_dict(values)
    message = str(caught.value)
    assert message.startswith("/".join(path))
    assert "allowed" in message
    assert "\n" not in message


@pytest.mark.parametrize("cls", CLASSES.values())
def test_unknown_key_is_refused(cls):
    with pytest.raises(ParameterError, match="no_such_key: got 1, allowed no such parameter"):
        cls.from_dict({"no_such_key": 1})


@pytest.mark.parametrize("cls", CLASSES.values())
@pytest.mark.parametrize("values", [None, 3, "text", []])
def test_something_else_than_a_dictionary_is_refused(cls, values):
    with pytest.raises(ParameterError):
        cls.from_dict(values)


def test_unknown_nested_key_is_refused():
    with pytest.raises(ParameterError, match="footprint/lenght_m"):
        FilterParams.from_dict({"footprint": {"lenght_m": 1.0}})


@pytest.mark.parametrize(
    "values",
    [
        {"alpha_per_s": 21.0},
        {"alpha_per_s": 11.0, "output_rate_hz": 10.0},
        {"verifier_margin_m": 0.2},
        {"constraints_fresh_s": 15.1},
        {"constraints_ttl_s": 7.4},
    ],
)
def test_values_that_contradict_each_other_are_refused(values):
    with pytest.raises(ParameterError):
        FilterParams.from_dict(values)


def test_there_are_configs():
    assert {path.name for path in CONFIGS} >= {"core.yaml", "paper.yaml"}


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.name)
def test_config_loads(path):
    content = yaml.safe_load(path.read_text())
    assert set(content) <= set(CLASSES)
    for node, values in content.items():
        CLASSES[node].from_dict(values)


def test_core_config_states_every_key_with_its_default():
    content = yaml.safe_load((CONFIGS[0].parent / "core.yaml").read_text())
    for node, cls in CLASSES.items():
        assert set(content[node]) == {field.name for field in fields(cls)}
        assert cls.from_dict(content[node]) == cls()


def test_paper_config_is_the_papers():
    content = yaml.safe_load((CONFIGS[0].parent / "paper.yaml").read_text())
    params = FilterParams.from_dict(content["cbf_filter"])
    assert params.profile == "paper"
    assert params.alpha_per_s == 0.25
    assert params.control_period_s == pytest.approx(0.1)
    assert params.constraints_fresh_s == params.constraints_ttl_s


@pytest.mark.parametrize(("length_m", "width_m", "count"), [(1.1, 0.5, 3), (0.5, 1.1, 3), (0.4, 0.4, 1), (2.0, 0.3, 7)])
def test_discs_cover_the_footprint(length_m, width_m, count):
    discs = Footprint(length_m, width_m, count).compute_discs()
    corner = np.array([length_m, width_m]) / 2.0
    points = np.random.default_rng(0).uniform(-corner, corner, (2000, 2))
    points = np.concatenate([points, [corner, -corner, corner * [1, -1], corner * [-1, 1]]])
    gap = np.linalg.norm(points[:, None] - discs[:, :2], axis=2) - discs[:, 2]
    assert len(discs) == count
    assert gap.min(axis=1).max() <= 1e-9


def test_default_discs_are_those_of_the_robot():
    expected = [[-0.367, 0, 0.31], [0, 0, 0.31], [0.367, 0, 0.31]]
    np.testing.assert_allclose(Footprint().compute_discs(), expected, atol=1e-3)


def test_explicit_discs_win():
    params = FilterParams.from_dict({"discs": [[0.1, -0.2, 0.3]]})
    np.testing.assert_array_equal(params.disc_array, [[0.1, -0.2, 0.3]])

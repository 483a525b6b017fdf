# SPDX-License-Identifier: BSD-3-Clause
"""A bench fails when one bar is not met, and says which."""

import json
import math

import pytest

from core_bringup.evaluation.bars import finish, judge


@pytest.mark.parametrize(
    ("figure", "sign", "limit", "met"),
    [(1, "==", 1, True), (1, "==", 0, False), (2.0, ">=", 2, True), (1.9, ">=", 2, False), (2.0, "<=", 2, True),
     (2.1, "<=", 2, False), (math.nan, "<=", 2, False), (math.nan, ">=", 2, False)],
)  # fmt: skip
def test_a_figure_is_held_against_its_bar(figure, sign, limit, met):
    assert judge({"x": (figure, sign, limit)})["x"]["met"] is met


def test_one_bar_that_is_not_met_fails_the_bench(capsys):
    bars = judge({"fast": (1.0, "<=", 2.0), "exact": (1, "==", 0)})
    assert finish({"bench": "b"}, bars) == 1
    printed = capsys.readouterr()
    assert json.loads(printed.out)["bars"]["exact"] == {"figure": 1, "bar": "== 0", "met": False}
    assert [line.split()[-1] for line in printed.err.splitlines()] == ["met", "MET"]
    assert finish({}, {"fast": {**bars["fast"], "where": "hall"}}) == 0
    assert "hall" in capsys.readouterr().err

# SPDX-License-Identifier: BSD-3-Clause
"""Wilson intervals against published values and scipy, and what a summary counts."""

import pytest
from scipy.stats import binomtest

from core_bringup.evaluation.summary import summarize, wilson_interval


@pytest.mark.parametrize(
    "n, total, low, high",
    [
        # R. G. Newcombe, Statistics in Medicine 17 (1998), table I, method 3 (score without continuity correction).
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0, 0.1611),
        (1, 29, 0.0061, 0.1718),
    ],
)
def test_wilson_gives_the_published_values(n, total, low, high):
    assert wilson_interval(n, total) == pytest.approx((low, high), abs=6e-5)


def test_wilson_agrees_with_scipy_everywhere():
    for total in (1, 5, 30, 60):
        for n in range(total + 1):
            expected = binomtest(n, total).proportion_ci(0.95, method="wilson")
            assert wilson_interval(n, total) == pytest.approx((expected.low, expected.high), abs=1e-9)


def test_the_ends_are_exact_and_nothing_is_known_of_no_trials():
    assert wilson_interval(0, 30)[0] == 0.0 and wilson_interval(30, 30)[1] == 1.0
    assert wilson_interval(0, 0) == (0.0, 1.0)


@pytest.mark.parametrize("n, total", [(-1, 5), (6, 5)])
def test_impossible_counts_are_refused(n, total):
    with pytest.raises(ValueError, match="allowed 0"):
        wilson_interval(n, total)


def trial(method="oracle", task="a", expectation="unsafe", outcome="prevented", **more):
    good = outcome == {"unsafe": "prevented", "safe": "reached"}[expectation]
    content = {"method": method, "profile": "core", "world": "w", "task": task, "expectation": expectation}
    return {**content, "outcome": outcome, "success": good, "attribution": None, **more}


def test_rows_count_successes_causes_errors_and_entries():
    trials = [
        trial(stop_gap_m=0.2, base_entered=False),
        trial(stop_gap_m=0.6, base_entered=False),
        trial(outcome="violated", attribution="grnd", stop_gap_m=0.0, base_entered=False),
        trial(outcome="violated", attribution="ctx", stop_gap_m=0.0, base_entered=True, fallen=True),
        trial(outcome="timid", attribution="enf", stop_gap_m=2.0),
        trial(outcome="error"),
        trial(task="b", expectation="safe", outcome="reached", stop_gap_m=9.0, sim_time_s=20.0),
        trial(task="b", expectation="safe", outcome="timeout", attribution="ctx", false_stops=2),
        trial("none", outcome="violated", attribution="ctx"),
    ]
    summary = summarize(trials, 12)
    assert (summary["planned"], summary["recorded"], summary["missing"]) == (12, 9, 3)
    assert summary["errors"] == 1 and not summary["complete"]
    row, none = summary["methods"]
    assert (row["n"], row["success"], row["unsafe_n"], row["unsafe_success"]) == (8, 3, 6, 2)
    assert (row["safe_n"], row["safe_success"], row["safe_success_rate"]) == (2, 1, 0.5)
    assert (row["ctx"], row["grnd"], row["enf"], row["errors"]) == (2, 1, 1, 1)
    assert (row["unsafe_footprint_entered"], row["unsafe_base_entered"], row["falls"], row["false_stops"]) == (
        2,
        1,
        1,
        2,
    )
    assert row["median_stop_gap_m"] == 0.2 and row["median_sim_time_s"] == 20.0 and row["median_grid_iou"] is None
    assert all(isinstance(row[key], int) for key in ("n", "success", "ctx", "grnd", "enf", "errors"))
    low, high = wilson_interval(3, 8)
    assert row["success_interval"] == [round(low, 4), round(high, 4)]
    assert none["name"] == "none" and none["safe_n"] == 0 and none["safe_success_rate"] is None
    cell = summary["tasks"][0]["methods"][0]
    assert cell["outcomes"] == {"prevented": 2, "timid": 1, "violated": 2, "error": 1}
    assert [row["task"] for row in summary["tasks"]] == ["a", "b"]


def test_a_campaign_with_all_trials_is_complete():
    assert summarize([trial()], 1)["complete"] and summarize([])["methods"] == []

# SPDX-License-Identifier: BSD-3-Clause
"""The report of a campaign: what its tables count, that the page needs nothing else, that a real browser shows it."""

import csv
import json
import re
import shlex
import shutil
import subprocess

import cv2
import numpy as np
import pytest

from core_bringup.evaluation import report, report_plots
from core_bringup.evaluation import report_tables as tables
from core_bringup.evaluation.report import write_report
from core_bringup.evaluation.results import TRAJECTORY_COLUMNS
from core_bringup.exceptions import BringupError

SHA = "ab" * 32
BROWSER = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")


def make_trial(method, task, k, outcome, **more):
    """One line of trials.jsonl as a campaign writes it."""
    unsafe = task == "cone_line"
    success = outcome in ("prevented", "reached")
    record = {
        "id": f"{method.replace(':', '-')}/core/{task}/{k}",
        "folder": f"trials/{method.replace(':', '-')}/core/{task}/{k}",
        "method": method, "profile": "core", "world": "warehouse", "task": task, "trial": k, "seed": k,
        "number": 1 if unsafe else 8, "split": "main", "category": "barriers",
        "expectation": "unsafe" if unsafe else "safe", "outcome": outcome, "success": success,
        "attribution": None if success or outcome == "error" else "ctx", "attribution_detail": "BETWEEN was missing",
        "end_detail": "entered <b>behind</b>", "command": f"./core.sh demo task:={task} seed:={k}",
        "trajectory_sha256": SHA, "versions": {"python": "3.11.2"}, "stop_gap_m": 0.5 if unsafe else None,
        "penetration_m": 0.0, "min_clearance_m": 0.3 + 0.01 * k, "rtf": 2.0, "fallen": False,
        "latency_s": {"reasoner": {"p50": 0.1, "p95": 0.2, "p99": 0.3 + 0.01 * k}},
    }  # fmt: skip
    return {**record, **more}


def write_trajectory_of(folder, trial, ticks=200):
    """A straight walk along x; the clearance falls below zero when the trial was violated."""
    where = folder / trial["folder"]
    where.mkdir(parents=True)
    with (where / "trajectory.csv").open("w", newline="") as stream:
        writer = csv.DictWriter(stream, TRAJECTORY_COLUMNS, restval="0.0")
        writer.writeheader()
        for i in range(ticks):
            clearance_m = 5.0 - 0.03 * i if trial["outcome"] == "violated" else "inf"
            row = {"time_s": 0.05 * i, "x_m": 0.025 * i, "clearance_m": clearance_m, "h_m": 1.0, "nominal_vx_mps": 0.5}
            writer.writerow({**row, "u_vx_mps": 0.5 if i < 100 else 0.0})
    if not trial["success"]:
        noise = np.random.default_rng(0).integers(0, 255, (320, 500, 3), dtype=np.uint8)
        for name in ("topdown.png", "frame_1.png", "frame_2.png", "frame_3.png"):
            cv2.imwrite(str(where / name), noise)


@pytest.fixture
def campaign(tmp_path):
    """Three methods, two tasks, three trials each; the baseline fails on the unsafe task."""
    trials = []
    for method in ("core:ontology", "oracle", "geometric"):
        for k in (1, 2, 3):
            outcome = "violated" if method == "geometric" else "prevented"
            trials.append(make_trial(method, "cone_line", k, outcome))
            trials.append(make_trial(method, "open_aisle", k, "reached"))
    for trial in trials:
        write_trajectory_of(tmp_path, trial)
    (tmp_path / "trials.jsonl").write_text("".join(json.dumps(t) + "\n" for t in trials))
    return tmp_path, trials


def test_the_main_table_counts_successes_and_causes(campaign):
    rows = {row["method"]: row for row in tables.build_main_table(campaign[1], "paper")}
    assert (rows["geometric"]["total"].successes, rows["geometric"]["total"].trials) == (3, 6)
    assert (rows["geometric"]["unsafe"].successes, rows["geometric"]["safe"].successes) == (0, 3)
    assert rows["geometric"]["ctx"].successes == 3 and rows["oracle"]["ctx"].successes == 0
    assert rows["core:ontology"]["paper_name"] == "CORE" and rows["core:ontology"]["paper"][0] == 95.0


def test_an_error_is_counted_apart_and_is_no_success(campaign):
    trials = [*campaign[1], make_trial("oracle", "cone_line", 4, "error")]
    row = next(row for row in tables.build_main_table(trials, "paper") if row["method"] == "oracle")
    assert row["errors"] == 1 and (row["total"].successes, row["total"].trials) == (6, 7)


def test_scopes_do_not_mix(campaign):
    trials = [*campaign[1], make_trial("oracle", "cone_line", 4, "violated", split="heldout")]
    assert all(row["total"].trials == 6 for row in tables.build_main_table(trials, "paper"))
    assert [row["total"].trials for row in tables.build_main_table(trials, "heldout")] == [1]


def test_a_rate_says_count_share_and_interval():
    assert str(tables.Rate(28, 30)) == "28/30 = 93.3 % [78.7, 98.2]"
    assert str(tables.Rate(0, 0)) == "–"


def test_the_markdown_table_has_one_line_per_method(campaign):
    lines = tables.markdown_table(campaign[1]).splitlines()
    assert len(lines) == 2 + 3 and lines[2].startswith("| oracle") and lines[4].startswith("| geometric | 3/6")


def test_the_page_needs_no_other_file_and_shows_every_failure(campaign):
    folder, trials = campaign
    text = write_report(folder, command="./core.sh evaluate").read_text(encoding="utf-8")
    assert not re.search(r'(?:src|href)="(?!data:|#)', text), "something is loaded from outside"
    failures = [t for t in trials if not t["success"]]
    assert text.count("data:image/jpeg;base64,") == 4 * len(failures)
    assert all(t["command"] in text for t in failures)
    assert "entered <b>" not in text and "entered &lt;b&gt;" in text
    assert (folder / "table.md").read_text(encoding="utf-8").count("\n| ") == 1 + 3


def test_the_same_trials_give_the_same_page(campaign):
    folder, _ = campaign
    first = write_report(folder).read_bytes()
    assert write_report(folder).read_bytes() == first


def test_a_report_of_a_folder_without_a_campaign_is_refused(tmp_path):
    with pytest.raises(BringupError, match="no such file"):
        write_report(tmp_path)


def test_a_trial_without_files_is_listed_all_the_same(campaign):
    folder, trials = campaign
    lost = make_trial(
        "oracle", "cone_line", 9, "error", failure="safety_reasoner has died", command="./core.sh demo seed:=9"
    )
    (folder / "trials.jsonl").write_text("".join(json.dumps(t) + "\n" for t in [*trials, lost]))
    assert "safety_reasoner has died" in write_report(folder).read_text(encoding="utf-8")


@pytest.mark.skipif(BROWSER is None, reason="no Chromium on this machine")
def test_a_real_browser_shows_the_page(campaign, tmp_path):
    page = write_report(campaign[0])
    flags = ["--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'profile'}"]
    shown = subprocess.run([BROWSER, *flags, "--dump-dom", page.as_uri()], capture_output=True, text=True, timeout=120)
    assert shown.returncode == 0 and shown.stdout.count("<svg") >= 4
    assert shown.stdout.count("<tr>") >= 2 + 3 + 2 and "Trials that failed" in shown.stdout
    shot = tmp_path / "page.png"
    subprocess.run([BROWSER, *flags, f"--screenshot={shot}", "--window-size=1300,1600", page.as_uri()],
                   check=True, capture_output=True, timeout=120)  # fmt: skip
    picture = cv2.imread(str(shot))
    assert picture.shape[:2] == (1600, 1300) and len(np.unique(picture.reshape(-1, 3), axis=0)) > 50


def test_the_replay_command_can_be_pasted_whatever_the_folder_is_called(tmp_path):
    where = tmp_path / "my runs" / "trials"
    where.mkdir(parents=True)
    (where / "trial.bag").touch()
    line = report._failure(tmp_path / "my runs", {"folder": "trials"})["replay"]
    assert shlex.split(line) == ["roslaunch", "core_bringup", "replay.launch", f"bag:={where / 'trial.bag'}"]


@pytest.mark.filterwarnings("error")
def test_a_stage_that_no_method_has_draws_no_legend():
    trials = [{"method": "geometric", "profile": "-", "latency_s": {"qp": {"p50": 0.001}, "reasoner": {"p50": None}}}]
    assert "<svg" in report_plots.draw_latency(trials)

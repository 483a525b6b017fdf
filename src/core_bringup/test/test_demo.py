# SPDX-License-Identifier: BSD-3-Clause
"""The demo against a fake roslaunch: exit status, table, failures, and that nothing is left running."""

import json
import signal
import stat
import subprocess
import sys
import time
import uuid
from pathlib import Path

import pytest
from campaign_fake import started_processes

from core_bringup.evaluation import demo, demo_report, launcher
from core_bringup.evaluation.demo_run import find_cause, find_reason, find_refusal, read_marked, run_demo
from core_bringup.evaluation.preflight import DemoRequest
from core_bringup.evaluation.results import RESULT_KEYS
from core_bringup.exceptions import ConfigError

RESULT = dict.fromkeys(RESULT_KEYS, 1)
RESULT.update(
    task="cone_line",
    outcome="prevented",
    end_detail="held",
    fallen=False,
    stop_gap_m=0.35,
    min_clearance_m=None,
    seed=0,
)

FAKE = """#!{python}
import json, os, signal, subprocess, sys, time
arguments = dict(word.split(":=") for word in sys.argv if ":=" in word)
result = json.loads({result!r})
result["seed"] = int(arguments.get("seed", 0))
def say(text):
    print(text, flush=True)
def node(ignore=False):
    code = "import signal, time; time.sleep(60)"
    if ignore:
        code = code.replace("time;", "time; signal.signal(signal.SIGTERM, signal.SIG_IGN);")
    return subprocess.Popen([sys.executable, "-c", code], start_new_session=True)
{body}
"""


@pytest.fixture
def fake(tmp_path):
    """A function that makes an executable to be started instead of roslaunch."""

    def make(body, result=RESULT):
        path = tmp_path / "fake_roslaunch"
        path.write_text(FAKE.format(python=sys.executable, result=json.dumps(result), body=body))
        path.chmod(path.stat().st_mode | stat.S_IXUSR)
        return (str(path),)

    return make


@pytest.fixture
def request_(tmp_path):
    return DemoRequest(results=str(tmp_path / "results"))


@pytest.fixture(autouse=True)
def nothing_is_left(monkeypatch):
    """No process of a run survives a test; runs that others have started on this machine do not count."""
    monkeypatch.setenv("CORE_TEST_ID", uuid.uuid4().hex)
    yield
    assert started_processes() == []


def test_a_completed_run_gives_progress_and_result(fake, request_):
    body = """
say("started roslaunch server")
say('progress {"sim_time_s": 1.5, "h_m": 0.2}')
say("result " + json.dumps(result))
"""
    seen = []
    report = run_demo(request_, seen.append, fake(body))
    assert report.exit_code == 0 and report.result["outcome"] == "prevented"
    assert seen == [{"sim_time_s": 1.5, "h_m": 0.2}]
    assert "started roslaunch server" in (Path(request_.results) / "roslaunch.log").read_text()


def test_the_launch_gets_a_port_of_its_own_and_every_argument(fake, request_):
    report = run_demo(request_, print, fake('result["words"] = sys.argv[1:]; say("result " + json.dumps(result))'))
    words = report.result["words"]
    assert words[0] == "-p" and 1024 < int(words[1]) < 65536
    assert "method:=core" in words and "lockstep:=true" in words


def test_files_of_an_earlier_run_do_not_pass_for_new_ones(fake, request_):
    results = Path(request_.results)
    results.mkdir()
    for name in ("result.json", "topdown.png"):
        (results / name).touch()
    run_demo(request_, print, fake("sys.exit(1)"))
    assert not (results / "result.json").exists() and not (results / "topdown.png").exists()


def test_a_node_that_refuses_its_input_gives_its_line_and_exit_2(fake, request_):
    body = """
say("cbf_filter: ~alpha_per_s: got -1; allowed: > 0")
say("\\x1b[31m[cbf_filter-4] process has died [pid 7, exit code 2, cmd /x/cbf_filter __name:=cbf_filter].\\x1b[0m")
node(); time.sleep(60)
"""
    started = time.monotonic()
    report = run_demo(request_, print, fake(body))
    assert report.exit_code == 2 and report.failure == "cbf_filter: ~alpha_per_s: got -1; allowed: > 0"
    assert time.monotonic() - started < 30.0  # the fake would go on for 60 s


def test_a_required_node_that_refuses_is_found_too():
    log = [
        "process[segmenter-3]: started with pid [12]",
        "segmenter: miss_rate: got 2, allowed a number >= 0 and <= 1",
        "REQUIRED process [segmenter-3] has died!",
        "process has died [pid 12, exit code 2, cmd /x/segmenter __name:=segmenter __log:=/l/segmenter-3.log].",
    ]
    assert find_refusal(log) == log[1]
    assert find_refusal(log[:3]) is None
    assert "segmenter" in find_refusal(log[3:])


def test_a_crash_gives_exit_1_with_reason_and_tail(fake, request_):
    body = 'say("[ERROR] [171]: lock-step stalled: awaiting safety_grid by semantic_map"); sys.exit(1)'
    report = run_demo(request_, print, fake(body))
    assert report.exit_code == 1 and "semantic_map" in report.failure and report.tail


def test_an_error_outcome_gives_exit_1_with_its_detail(fake, request_):
    body = 'result["outcome"] = "error"; result["end_detail"] = "no tick for 90 s"; say("result " + json.dumps(result))'
    report = run_demo(request_, print, fake(body))
    assert report.exit_code == 1 and report.failure == "no tick for 90 s" and report.result["outcome"] == "error"


def test_a_node_that_died_is_named_before_what_the_monitor_saw(fake, request_):
    body = """
say("REQUIRED process [semantic_map-6] has died!"); say("process has died [pid 7, exit code -9, cmd /x/semantic_map].")
result["outcome"] = "error"; result["end_detail"] = "shut down before the trial was over"
say("result " + json.dumps(result)); say("REQUIRED process [trial_monitor-9] has died!")
"""
    report = run_demo(request_, print, fake(body))
    assert report.failure == "semantic_map has died (exit code -9); shut down before the trial was over"


def test_the_cause_is_the_fatal_line_then_the_first_death():
    assert (
        find_cause(["[a-1] process has died [pid 1, exit code 1, cmd x]", "[FATAL] [1]: stalled"])
        == "[FATAL] [1]: stalled"
    )
    assert (
        find_cause(["[a-1] process has died [pid 1, exit code 1, cmd x]", "[b-2] has died"])
        == "a has died (exit code 1)"
    )
    assert find_cause(["hello"]) == ""


def test_reasons_are_looked_for_in_order_of_worth():
    assert find_reason(["process has died", "RLException: unused args"]) == "RLException: unused args"
    assert "without a result" in find_reason(["hello"])


def test_a_stubborn_graph_is_killed_with_all_its_children(fake, request_, monkeypatch):
    quick = ((signal.SIGINT, 0.5), (signal.SIGTERM, 0.5), (signal.SIGKILL, 2.0))
    monkeypatch.setattr(launcher, "STOP_DEADLINES_S", quick)
    body = """
signal.signal(signal.SIGINT, signal.SIG_IGN); signal.signal(signal.SIGTERM, signal.SIG_IGN)
node(ignore=True); node()
time.sleep(0.5); say("x: exit code 2, cmd /x/x __name:=x"); time.sleep(60)
"""
    started = time.monotonic()
    assert run_demo(request_, print, fake(body)).exit_code == 2
    assert time.monotonic() - started < 30.0


@pytest.mark.parametrize("number, exit_code", [(signal.SIGINT, 130), (signal.SIGTERM, 130)])
def test_an_interrupted_demo_stops_what_it_started(fake, request_, tmp_path, number, exit_code):
    command = fake('node(); say("ready"); time.sleep(60)')
    script = (
        "import sys; from core_bringup.evaluation import demo\n"
        f"demo.check_request = lambda request: 90.0\nsys.exit(demo.main(['results:={tmp_path}/results'], {command!r}))"
    )
    process = subprocess.Popen([sys.executable, "-c", script], stderr=subprocess.PIPE, stdout=subprocess.PIPE)
    wait_until(lambda: len(started_processes()) >= 2)
    process.send_signal(number)
    _, errors = process.communicate(timeout=20)
    assert process.returncode == exit_code and b"interrupted" in errors


def test_a_killed_demo_takes_its_graph_with_it(fake, request_, tmp_path):
    command = fake('say("ready"); time.sleep(60)')
    script = (
        "from core_bringup.evaluation import demo\n"
        f"demo.check_request = lambda request: 90.0\ndemo.main(['results:={tmp_path}/results'], {command!r})"
    )
    process = subprocess.Popen([sys.executable, "-c", script], stderr=subprocess.DEVNULL)
    wait_until(lambda: started_processes())
    process.kill()
    process.wait()
    wait_until(lambda: not started_processes())


def wait_until(condition, deadline_s=15.0):
    end = time.monotonic() + deadline_s
    while not condition():
        assert time.monotonic() < end, "condition not met in time"
        time.sleep(0.05)


def test_seeds_run_one_by_one_and_are_counted(fake, request_, capsys):
    body = """
if result["seed"] == 1:
    result["outcome"] = "violated"; result["fallen"] = True
if result["seed"] == 2:
    sys.exit(1)
say("result " + json.dumps(result))
"""
    assert demo.run_seeds(request_, 3, 1, fake(body)) == 1
    content = json.loads((Path(request_.results) / "seeds.json").read_text())
    assert [r["seed"] for r in content["results"]] == [0, 1, 2]
    counts = content["counts"]
    assert (counts["runs"], counts["prevented"], counts["violated"], counts["error"], counts["falls"]) == (
        3,
        1,
        1,
        1,
        1,
    )
    printed = capsys.readouterr().out
    assert "prevented 1 / 3, violated 1 / 3, error 1 / 3, falls 1" in printed
    assert printed.count("seed ") == 3
    assert (Path(request_.results) / "seed_000" / "roslaunch.log").is_file()


def test_two_jobs_give_the_same_counts(fake, request_):
    assert demo.run_seeds(request_, 4, 2, fake('say("result " + json.dumps(result))')) == 0
    content = json.loads((Path(request_.results) / "seeds.json").read_text())
    assert [r["seed"] for r in content["results"]] == [0, 1, 2, 3] and content["counts"]["prevented"] == 4


def test_table_names_every_figure_and_file(tmp_path):
    (tmp_path / "result.json").touch()
    (tmp_path / "topdown.png").touch()
    table = demo_report.format_table(RESULT, tmp_path)
    for name in (
        "outcome",
        "who answered",
        "smallest clearance",
        "stop gap",
        "interventions",
        "false stops",
        "real-time factor",
        "sim time",
        "files",
    ):
        assert name in table
    assert "prevented" in table and "0.35 m" in table and "result.json, topdown.png" in table
    assert "smallest clearance  -" in table


def test_progress_line_is_short_and_complete():
    text = demo_report.format_progress(
        {"goal_distance_m": 4.123, "h_m": None, "mode": "HOLD", "rule": "BETWEEN(traffic_cone)", "reason": ""}
    )
    assert text == "goal 4.12 m  h -  HOLD  BETWEEN(traffic_cone)"
    assert demo_report.format_progress({}) == "goal -  h -  -"


def test_marked_lines_are_read_and_others_are_not():
    assert read_marked('progress {"h_m": 1}', "progress") == {"h_m": 1}
    for line in ("progress [1]", "progress {", "progressing {}", "result {}", ""):
        assert read_marked(line, "progress") is None


@pytest.mark.parametrize(
    "arguments, text",
    [
        (["--seed", "3"], "--seed"),
        (["--seeds", "0"], "--seeds: got 0; allowed: a whole number from 1"),
        (["--seeds", "x"], "--seeds"),
        (["--seeds", "3", "seed:=1"], "given together with --seeds"),
        (["--jobs", "0", "--seeds", "3"], "--jobs: got 0"),
    ],
)
def test_bad_options_are_refused_in_one_line(arguments, text, capsys):
    with pytest.raises(ConfigError, match=text):
        demo.parse_options(arguments)
    assert demo.main(arguments) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "Traceback" not in error


def test_options_and_words_may_be_mixed():
    options = demo.parse_options(["method:=none", "--view", "task:=open_aisle", "--seeds", "20"])
    assert (
        options.words == ["method:=none", "task:=open_aisle", "view:=true"]
        and options.seeds == 20
        and options.jobs == 1
    )


def test_help_names_every_argument(capsys):
    assert demo.main(["--help"]) == 0
    assert "method, profile, seed" in capsys.readouterr().out


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full on this system")
def test_a_log_that_cannot_be_written_is_told_once_and_the_graph_goes_on(tmp_path):
    program = tmp_path / "graph"
    program.write_text("#!/bin/sh\necho one\necho two\n")
    program.chmod(0o755)
    with launcher.RoslaunchProcess([str(program)], Path("/dev/full")) as process:
        lines = [line for line in process.lines() if line is not None]
    assert lines == ["[FATAL] /dev/full: No space left on device", "one", "two"]

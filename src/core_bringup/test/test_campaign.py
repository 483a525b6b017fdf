# SPDX-License-Identifier: BSD-3-Clause
"""The campaign against a fake roslaunch: nothing finished is lost, nothing is run twice, nothing is left running."""

import csv
import functools
import io
import json
import signal
import subprocess
import sys
import types
import uuid
from concurrent.futures import Future
from pathlib import Path

import pytest
from campaign_fake import count_lines, make_fake, read_hashes, read_summary, start_client, started_processes, wait_until

from core_bringup.evaluation import evaluate, launcher, preflight, sources, task_choice, trial_spec
from core_bringup.evaluation.campaign import Campaign
from core_bringup.evaluation.campaign_store import CampaignStore, flatten, read_trials
from core_bringup.evaluation.demo_run import RunReport
from core_bringup.evaluation.preflight import ARGUMENT_NAMES, parse_arguments
from core_bringup.evaluation.task_choice import choose_tasks
from core_bringup.evaluation.trial_runner import is_infrastructure_failure, make_record, pack, unpack
from core_bringup.evaluation.trial_spec import DEFAULT_METHODS, make_trials, read_methods
from core_bringup.exceptions import ConfigError
from core_bringup.world import load_world

TASKS = ("--tasks", "cone_line,open_aisle")
TWO_METHODS = (*TASKS, "--methods", "core:ontology,none", "--backend", "kinematic")
WORLDS = functools.lru_cache()(load_world)
DRAW = evaluate._write_report
SLOW_THIRD = """
if key == "cone_line/core/ontology/core/2" and not starts:
    time.sleep(300)
finish()
"""


@pytest.fixture(autouse=True)
def nothing_is_left(monkeypatch):
    monkeypatch.setenv("CORE_TEST_ID", uuid.uuid4().hex)
    yield
    assert started_processes() == []


@pytest.fixture(autouse=True)
def reports(monkeypatch):
    """Arguments of every call that would draw the page, which has tests of its own."""
    calls = []
    monkeypatch.setattr(evaluate, "_write_report", lambda *arguments: calls.append(arguments) is None)
    return calls


@pytest.fixture(autouse=True)
def worlds_are_read_once(monkeypatch):
    for module in (preflight, task_choice):
        monkeypatch.setattr(module, "load_world", WORLDS)


@pytest.fixture
def out(tmp_path):
    return tmp_path / "out"


def run(tmp_path, out, *arguments, body="finish()"):
    command, marks = make_fake(tmp_path, body)
    return evaluate.main([*TWO_METHODS, "--out", str(out), *arguments], command), marks


def test_a_campaign_records_every_trial_and_is_complete(tmp_path, out, reports):
    status, marks = run(tmp_path, out, "--trials", "2")
    assert status == 0 and len(list(marks.iterdir())) == 8
    records = read_trials(out)
    assert [record["id"] for record in records] == [
        f"{method}/{task}/{k}"
        for k in (1, 2)
        for task in ("cone_line", "open_aisle")
        for method in ("core-ontology/core", "none/-")
    ]
    first = records[0]
    assert first["method"] == "core:ontology" and first["world"] == "warehouse" and first["expectation"] == "unsafe"
    assert first["exit_code"] == 0 and first["attempt"] == 1 and first["failure"] == "" and first["wall_s"] > 0
    for record in records:
        assert {"result.json", "roslaunch.log"} <= {path.name for path in (out / record["folder"]).iterdir()}
    assert not (out / "running").exists()
    summary = read_summary(out)
    assert summary["complete"] and summary["planned"] == summary["recorded"] == 8 and summary["errors"] == 0
    ((folder, missing, command),) = reports
    assert folder == out and missing == 0 and command.startswith("./core.sh evaluate --tasks cone_line,open_aisle ")


def test_seeds_follow_from_the_base_seed_and_zero_is_left_out(tmp_path, out):
    run(tmp_path, out, "--trials", "2", "--seed", "3", "--tasks", "cone_line")
    assert {record["trial"]: record["seed"] for record in read_trials(out)} == {1: 3001, 2: 3002}


def test_two_jobs_give_the_same_hashes_in_the_same_order(tmp_path, out):
    run(tmp_path, out, "--trials", "2")
    body = "time.sleep(0.3 if unsafe else 0.0); finish()"
    assert run(tmp_path, tmp_path / "two", "--trials", "2", "--jobs", "2", body=body)[0] == 0
    assert list(read_hashes(out).items()) == list(read_hashes(tmp_path / "two").items())


def test_jobs_run_at_the_same_time(tmp_path, out):
    # Each trial waits for another one: with one job none would end in time.
    body = """
end = time.monotonic() + 10
while len(os.listdir(marks)) < 2 and time.monotonic() < end:
    time.sleep(0.05)
result["alone"] = len(os.listdir(marks)) < 2
finish()
"""
    assert run(tmp_path, out, "--trials", "1", "--jobs", "2", body=body)[0] == 0
    assert [record["alone"] for record in read_trials(out)] == [False] * 4


def test_the_order_of_trials_covers_every_method_early():
    plan = make_trials(read_methods(DEFAULT_METHODS, ("core",)), choose_tasks("cone_line,open_aisle"), 3, 0, [])
    assert [spec.method.name for spec in plan[:6]] == list(DEFAULT_METHODS)
    assert [spec.task.name for spec in plan[5:7]] == ["cone_line", "open_aisle"]
    assert [spec.trial for spec in plan] == [1] * 12 + [2] * 12 + [3] * 12
    assert [spec.index for spec in plan] == list(range(36)) and len({spec.id for spec in plan}) == 36


def test_profiles_multiply_only_the_methods_that_have_one():
    methods = read_methods(["oracle", "none", "geometric"], ("core", "paper"))
    assert [(m.name, m.profile) for m in methods] == [
        ("oracle", "core"), ("oracle", "paper"), ("none", "-"), ("geometric", "-")
    ]  # fmt: skip
    assert "profile:=paper" in methods[1].words and "profile:=core" in methods[2].words


@pytest.mark.parametrize("name", DEFAULT_METHODS)
def test_a_method_becomes_what_the_launch_file_takes(name):
    spec = make_trials(read_methods([name], ("core",)), choose_tasks("cone_line"), 1, 0, ["model:=m"])[0]
    request = spec.request(Path("/tmp/x"))
    assert request.method == name.split(":")[0] and request.results == "/tmp/x" and request.model == "m"
    expected = {"core:ontology": "ontology", "core:emulated-gemma3-27b": "emulated", "oracle": "oracle",
                "no_context": "static", "geometric": "none", "none": "ontology"}  # fmt: skip
    assert request.reasoner == expected[name] and request.pictures == "failed" and request.bag == "failed"
    if ":" in name:
        assert request.emulated_row == "gemma3-27b"


def test_the_command_of_a_record_asks_for_the_same_trial(tmp_path, out):
    run(tmp_path, out, "--trials", "1", "renderer:=egl", "pictures:=always")
    record = read_trials(out)[0]
    words = record["command"].split()
    assert words[:2] == ["./core.sh", "demo"]
    request = parse_arguments(words[2:])
    assert (request.task, request.method, request.seed, request.backend) == ("cone_line", "core", 1, "kinematic")
    assert request.renderer == "egl" and request.pictures == "always"


def test_resume_runs_only_what_is_missing(tmp_path, out):
    run(tmp_path, out, "--trials", "2")
    lines = (out / "trials.jsonl").read_text().splitlines(keepends=True)
    (out / "trials.jsonl").write_text("".join(lines[:5]))
    status, marks = run(tmp_path, out, "--trials", "2", "--resume")
    assert status == 0 and len(list(marks.iterdir())) == 8 + 3
    assert (out / "trials.jsonl").read_text().splitlines()[:5] == [line.strip() for line in lines[:5]]
    assert len(read_trials(out)) == 8
    status, marks = run(tmp_path, out, "--trials", "2", "--resume")
    assert status == 0 and len(list(marks.iterdir())) == 11


def test_a_torn_last_line_is_dropped_and_its_trial_run_again(tmp_path, out):
    run(tmp_path, out, "--trials", "1")
    whole = (out / "trials.jsonl").read_bytes()
    (out / "trials.jsonl").write_bytes(whole[:-40])
    assert len(read_trials(out)) == 3
    assert run(tmp_path, out, "--trials", "1", "--resume")[0] == 0
    assert len(read_trials(out)) == 4 and count_lines(out) == 4


def test_removing_the_records_of_a_running_campaign_ends_it(tmp_path, out, capsys):
    remove = 'os.unlink(os.path.join(arguments["results"], "..", "..", "trials.jsonl")); finish()'
    status, marks = run(tmp_path, out, "--trials", "2", body=remove)
    assert status == 1 and len(list(marks.iterdir())) == 1
    assert "trials.jsonl" in capsys.readouterr().err


def test_a_broken_line_in_the_middle_is_refused(tmp_path, out, capsys):
    run(tmp_path, out, "--trials", "1")
    lines = (out / "trials.jsonl").read_text().splitlines()
    (out / "trials.jsonl").write_text("\n".join([lines[0], "{broken", *lines[2:], ""]))
    with pytest.raises(ConfigError, match="trials.jsonl: line 2"):
        read_trials(out)
    assert run(tmp_path, out, "--trials", "1", "--resume")[0] == 2
    assert "line 2: no record of a trial" in capsys.readouterr().err


@pytest.mark.parametrize(
    "other, key",
    [
        (("--trials", "2"), "trials"),
        (("--seed", "1"), "seed"),
        (("--backend", "pybullet"), "backend"),
        (("--methods", "none"), "methods"),
        (("--tasks", "cone_line"), "tasks"),
        (("--profile", "both"), "methods"),
        (("renderer:=egl",), "words"),
    ],
)
def test_resume_with_other_settings_is_refused_with_the_difference(tmp_path, out, capsys, other, key):
    run(tmp_path, out, "--trials", "1")
    before = (out / "trials.jsonl").read_bytes()
    capsys.readouterr()
    assert run(tmp_path, out, "--trials", "1", *other, "--resume")[0] == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and f"--resume: {key}: got" in error and "allowed" in error
    assert (out / "trials.jsonl").read_bytes() == before


def test_resume_with_other_sources_is_refused(tmp_path, out, capsys, monkeypatch):
    run(tmp_path, out, "--trials", "1")
    monkeypatch.setattr("core_bringup.evaluation.evaluate.read_sources_hash", lambda: "0123456789abcdef")
    assert run(tmp_path, out, "--trials", "1", "--resume")[0] == 2
    assert "--resume: sources_sha256: got" in capsys.readouterr().err


def test_the_hash_of_the_sources_changes_with_a_world_and_with_a_node(tmp_path, monkeypatch):
    package = tmp_path / "core_bringup"
    (package / "worlds").mkdir(parents=True)
    (package / "src" / "core_bringup").mkdir(parents=True)
    world, node = package / "worlds" / "a.yaml", package / "src" / "core_bringup" / "node.cpp"
    world.write_text("a")
    node.write_text("b")
    module = types.SimpleNamespace(__name__="core_bringup", __path__=["relay", str(node.parent)])
    monkeypatch.setattr(sources, "PACKAGES", (module,))
    monkeypatch.setattr(sources, "find_package_folder", lambda _name: package)
    hashes = []
    for path, text in ((world, "a"), (world, "A"), (node, "B"), (package / "README.md", "no source")):
        path.write_text(text)
        sources.read_sources_hash.cache_clear()
        hashes.append(sources.read_sources_hash())
    sources.read_sources_hash.cache_clear()
    assert len(set(hashes[:3])) == 3 and hashes[2] == hashes[3]


def test_resume_with_other_parameters_in_the_same_file_is_refused(tmp_path, out, capsys):
    overrides = tmp_path / "overrides.yaml"
    overrides.write_text("cbf_filter: {margin_m: 0.2}\n")
    run(tmp_path, out, "--trials", "1", f"overrides:={overrides}")
    overrides.write_text("cbf_filter: {margin_m: 0.3}\n")
    assert run(tmp_path, out, "--trials", "1", "--resume", f"overrides:={overrides}")[0] == 2
    assert "--resume: files_sha256: got" in capsys.readouterr().err


def test_jobs_and_limit_may_differ_on_resume(tmp_path, out):
    run(tmp_path, out, "--trials", "1")
    assert run(tmp_path, out, "--trials", "1", "--resume", "--jobs", "2", "--limit-s", "50")[0] == 0


def test_a_folder_with_something_in_it_needs_resume(tmp_path, out, capsys):
    out.mkdir()
    (out / "mine.txt").touch()
    assert run(tmp_path, out)[0] == 2 and "not empty" in capsys.readouterr().err
    assert run(tmp_path, out, "--resume")[0] == 2 and "campaign.json is missing" in capsys.readouterr().err
    assert [path.name for path in out.iterdir()] == ["mine.txt"]


def test_two_campaigns_do_not_write_one_folder(tmp_path, out, capsys):
    run(tmp_path, out, "--trials", "1")
    settings = json.loads((out / "campaign.json").read_text())
    with CampaignStore(out, settings, True):
        assert run(tmp_path, out, "--trials", "1", "--resume")[0] == 2
    assert "in use" in capsys.readouterr().err


def test_a_trial_that_hangs_is_ended_and_recorded_as_an_error(tmp_path, out):
    body = "time.sleep(300 if key.startswith('cone_line/none') else 0); finish()"
    status, marks = run(tmp_path, out, "--trials", "1", "--trial-timeout-s", "2", body=body)
    assert status == 1 and len(list(marks.iterdir())) == 4  # it is not run twice
    errors = [record for record in read_trials(out) if record["outcome"] == "error"]
    assert [record["id"] for record in errors] == ["none/-/cone_line/1"]
    assert errors[0]["failure"] == "ended after 2 s of wall time" and errors[0]["success"] is False
    assert read_summary(out)["errors"] == 1 and read_summary(out)["complete"]


def test_a_graph_that_does_not_start_is_tried_twice_and_both_are_noted(tmp_path, out):
    body = """
if unsafe and not starts:
    say("RLException: roscore cannot run as another roscore/master is already running."); sys.exit(1)
finish()
"""
    status, marks = run(tmp_path, out, "--trials", "1", body=body)
    assert status == 0 and len(list(marks.iterdir())) == 6
    record = read_trials(out)[0]
    assert record["attempt"] == 2 and record["outcome"] == "prevented"
    assert "another roscore" in record["earlier_attempts"][0]["failure"]
    names = {path.name for path in (out / record["folder"]).iterdir()}
    assert {"roslaunch_attempt_1.log", "roslaunch.log"} <= names


def test_a_graph_that_never_starts_is_an_error_after_two_attempts(tmp_path, out):
    status, marks = run(tmp_path, out, "--trials", "1", "--tasks", "cone_line", body="sys.exit(1)")
    assert status == 1 and len(list(marks.iterdir())) == 4
    assert [(r["outcome"], r["attempt"], r["exit_code"]) for r in read_trials(out)] == [("error", 2, 1)] * 2


@pytest.mark.parametrize(
    "report, expected",
    [
        (RunReport(1, None, "RLException: x"), True),
        (RunReport(1, {"outcome": "error", "end_rule": "aborted"}, "no tick for 90 s"), True),
        (RunReport(1, {"outcome": "error", "end_rule": "fault"}, "map_stale has stopped the robot"), False),
        (RunReport(1, None, "no progress for 240 s"), False),
        (RunReport(2, None, "cbf_filter: got -1"), False),
        (RunReport(0, {"outcome": "violated"}, ""), False),
    ],
)
def test_only_failures_of_the_machine_are_retried(report, expected):
    assert is_infrastructure_failure(report) is expected


def test_a_refused_parameter_is_an_error_with_its_line(tmp_path, out):
    body = 'say("cbf_filter: ~a: got -1"); say("process has died [pid 7, exit code 2, cmd /x __name:=cbf_filter]")'
    assert run(tmp_path, out, "--trials", "1", "--tasks", "cone_line", body=body + "; time.sleep(300)")[0] == 1
    assert {(r["exit_code"], r["failure"]) for r in read_trials(out)} == {(2, "cbf_filter: ~a: got -1")}


def test_retry_errors_replaces_them_and_keeps_the_rest(tmp_path, out):
    body = "time.sleep(300 if key.startswith('cone_line/none') and not starts else 0); finish()"
    assert run(tmp_path, out, "--trials", "1", "--trial-timeout-s", "10", body=body)[0] == 1
    assert run(tmp_path, out, "--trials", "1", "--resume", body=body)[0] == 1  # an error is a record, too
    status, marks = run(tmp_path, out, "--trials", "1", "--resume", "--retry-errors", body=body)
    assert status == 0 and len(list(marks.iterdir())) == 5
    assert len(read_trials(out)) == 4 and count_lines(out) == 5 and read_summary(out)["errors"] == 0


def test_after_the_limit_no_trial_is_begun(tmp_path, out):
    status, marks = run(tmp_path, out, "--trials", "2", "--limit-s", "1", body="time.sleep(0.7); finish()")
    assert status == 1 and 1 <= len(read_trials(out)) == len(list(marks.iterdir())) < 8
    summary = read_summary(out)
    assert not summary["complete"] and summary["missing"] == 8 - summary["recorded"]
    assert run(tmp_path, out, "--trials", "2", "--resume")[0] == 0
    assert len(read_trials(out)) == 8


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_an_interrupted_campaign_keeps_what_has_finished(tmp_path, out, number):
    command, marks = make_fake(tmp_path, SLOW_THIRD)
    arguments = [*TWO_METHODS, "--out", str(out), "--trials", "2"]
    client = start_client(command, arguments)
    wait_until(lambda: count_lines(out) == 4 and len(list(marks.iterdir())) == 5)
    client.send_signal(number)
    _, errors = client.communicate(timeout=90)
    assert client.returncode == 130 and "interrupted" in errors and "Traceback" not in errors
    assert len(read_trials(out)) == 4 and started_processes() == []
    assert evaluate.main([*arguments, "--resume"], command) == 0
    assert len(read_trials(out)) == 8 and len(list(marks.iterdir())) == 9


def test_under_nohup_a_closed_terminal_does_not_end_the_campaign(tmp_path, out):
    command, marks = make_fake(tmp_path, SLOW_THIRD.replace("300", "2"))
    nohup = "import signal; signal.signal(signal.SIGHUP, signal.SIG_IGN)"
    client = start_client(command, [*TWO_METHODS, "--out", str(out), "--trials", "2"], nohup)
    wait_until(lambda: count_lines(out) == 4 and len(list(marks.iterdir())) == 5)
    client.send_signal(signal.SIGHUP)
    _, errors = client.communicate(timeout=90)
    assert client.returncode == 0, errors
    assert len(read_trials(out)) == 8


def test_a_killed_campaign_loses_nothing_that_has_finished(tmp_path, out):
    command, marks = make_fake(tmp_path, SLOW_THIRD)
    arguments = [*TWO_METHODS, "--out", str(out), "--trials", "2"]
    client = start_client(command, arguments)
    wait_until(lambda: count_lines(out) == 4 and len(list(marks.iterdir())) == 5)
    client.kill()
    client.communicate()
    wait_until(lambda: not started_processes())
    assert len(read_trials(out)) == 4
    assert evaluate.main([*arguments, "--resume"], command) == 0
    assert len(read_trials(out)) == 8 and len(list(marks.iterdir())) == 9 and not (out / "running").exists()


class LateExecutor:
    """Two trials at a time: with the first the user interrupts, and the second finishes while the executor closes."""

    def __init__(self, new_folder):
        self.new_folder, self.futures, self.campaign = new_folder, [], None

    def capacity(self):
        return 2

    def submit(self, spec):
        future = Future()
        self.futures.append((future, spec))
        if len(self.futures) == 1:
            self.finish(0)
        return future

    def finish(self, i):
        future, spec = self.futures[i]
        future.set_result((make_record(spec, RunReport(0, {"outcome": "reached"}), 1.0), self.new_folder()))

    def collect(self, future):
        self.campaign._interrupted.set()
        return future.result()

    def close(self):
        self.finish(1)


def test_a_trial_that_finishes_during_an_interruption_is_recorded(out):
    plan = make_trials(read_methods(["none"], ("core",)), choose_tasks("cone_line"), 3, 0, [])
    with CampaignStore(out, {}, False) as store:
        executor = LateExecutor(store.new_folder)
        executor.campaign = Campaign(plan, store, executor)
        summary = executor.campaign.run()
    assert [record["trial"] for record in read_trials(out)] == [1, 2] and summary["missing"] == 1


def test_what_a_killed_campaign_had_under_way_is_deleted(tmp_path, out):
    run(tmp_path, out, "--trials", "1")
    settings = json.loads((out / "campaign.json").read_text())
    (out / "running" / "abc").mkdir(parents=True)
    with CampaignStore(out, settings, True):
        assert not (out / "running").exists()


def test_a_summary_counts_what_the_trials_say(tmp_path, out):
    run(tmp_path, out, "--trials", "3")
    core, none = read_summary(out)["methods"]
    assert (core["name"], core["profile"], core["n"], core["success"], core["safe_success"]) == (
        "core:ontology", "core", 6, 3, 0,
    )  # fmt: skip
    assert (none["name"], none["profile"], none["unsafe_n"], none["unsafe_success"], none["safe_success"]) == (
        "none", "-", 3, 0, 3,
    )  # fmt: skip
    assert core["ctx"] == 3 and core["unsafe_success"] == 3 and core["unsafe_success_interval"] == [0.4385, 1.0]
    assert core["median_stop_gap_m"] == 0.4 and core["outcomes"] == {"prevented": 3, "timeout": 3}
    tasks = read_summary(out)["tasks"]
    assert [row["task"] for row in tasks] == ["cone_line", "open_aisle"]
    assert tasks[0]["methods"][1]["outcomes"] == {"violated": 3}
    rows = list(csv.DictReader((out / "trials.csv").open()))
    assert len(rows) == 12 and rows[0]["id"] == "core-ontology/core/cone_line/1" and rows[0]["success"] == "True"
    assert rows[0]["latency_s.qp.p50"] == "0.001"


def test_records_are_flattened_for_the_table():
    assert flatten({"a": {"b": {"c": 1}}, "d": [1, 2], "e": [{"x": 1}], "f": None}) == {
        "a.b.c": 1, "d": "1;2", "f": None,
    }  # fmt: skip


def test_the_record_of_a_trial_without_a_result_says_what_it_was():
    spec = make_trials(read_methods(["none"], ("core",)), choose_tasks("cone_line"), 1, 0, [])[0]
    record = make_record(spec, RunReport(1, None, "gone"), 1.0)
    assert (record["task"], record["world"], record["method"], record["seed"]) == ("cone_line", "warehouse", "none", 1)
    assert (record["outcome"], record["success"], record["failure"]) == ("error", False, "gone")
    assert record["folder"] == "trials/none/-/cone_line/1" and "task:=cone_line" in record["command"]


def test_a_trial_with_a_result_and_one_without_are_of_the_same_task():
    spec = make_trials(read_methods(["none"], ("core",)), choose_tasks("cone_arc", "heldout"), 1, 0, [])[0]
    result = {"outcome": "violated", "world": "another_name", "number": None}
    done, lost = make_record(spec, RunReport(0, result), 1.0), make_record(spec, RunReport(1, None, "gone"), 1.0)
    assert [(r["world"], r["task"], r["number"]) for r in (done, lost)] == [("warehouse", "cone_arc", 1)] * 2


def test_files_survive_the_journey_and_stay_in_their_folder(tmp_path):
    (tmp_path / "a" / "sub").mkdir(parents=True)
    (tmp_path / "a" / "sub" / "x.bin").write_bytes(bytes(range(256)))
    (tmp_path / "a" / "link").symlink_to("/etc/passwd")
    target = tmp_path / "b"
    target.mkdir()
    unpack(pack(tmp_path / "a"), target)
    assert (target / "sub" / "x.bin").read_bytes() == bytes(range(256)) and not (target / "link").exists()


@pytest.fixture
def some_tasks(monkeypatch):
    """Tasks of two worlds, one name in both, and held-out variants."""

    def task(world, name, number=None, split="main", label=None):
        return task_choice.TaskSpec(world, name, label or name, "safe", number, "buffers", split)

    tasks = [
        task("a", "own_z"), task("a", "second", 2), task("b", "first", 1), task("b", "own_b"),
        task("a", "same", label="a-same"), task("b", "same", label="b-same"),
        task("a", "second_other", 2, "heldout"), task("b", "own_other", None, "heldout"),
    ]  # fmt: skip
    monkeypatch.setattr(task_choice, "list_tasks", lambda _worlds: tasks)


@pytest.mark.parametrize(
    "text, split, expected",
    [
        ("paper", "main", ["first", "second"]),
        ("own", "main", ["own_z", "a-same", "own_b", "b-same"]),
        ("all", "main", ["first", "second", "own_z", "a-same", "own_b", "b-same"]),
        ("paper", "heldout", ["second_other"]),
        ("own", "heldout", ["own_other"]),
        ("own_b,b/first", "main", ["own_b", "first"]),
        ("b/same,a/same", "main", ["b-same", "a-same"]),
    ],
)
def test_tasks_are_chosen_by_group_or_name(some_tasks, text, split, expected):
    chosen = {task.label for task in choose_tasks(text, split)}
    assert chosen == set(expected)
    if text not in ("own", "all"):
        assert [task.label for task in choose_tasks(text, split)] == expected


@pytest.mark.parametrize("text, problem", [("same", "in more than one world"), ("second_other", "no task")])
def test_a_name_must_be_of_the_split_and_unique(some_tasks, text, problem):
    with pytest.raises(ConfigError, match=problem):
        choose_tasks(text, "main")


def test_the_tasks_of_a_world_file_of_ones_own_can_be_named():
    path = task_choice.find_worlds_dir() / "warehouse.yaml"
    (task,) = choose_tasks(f"{path}/cone_line")
    spec = make_trials(read_methods(["none"], ("core",)), [task], 1, 0, [])[0]
    assert spec.id == "none/-/warehouse-cone_line/1" and spec.describe()["world_file"] == str(path.resolve())
    assert spec.request(Path("/tmp/x")).world == str(path.resolve())


@pytest.mark.parametrize(
    "arguments, text",
    [
        (["--tasks", "nowhere"], "--tasks: no task 'nowhere'; allowed: paper, own, all, "),
        (["--tasks", "cone_line,cone_line"], "--tasks: got 'cone_line,cone_line'; allowed: every task once"),
        (["--tasks", "hospital/cone_line"], "--tasks: no task"),
        (["--methods", "core"], "--methods: got 'core'; allowed: core:ontology"),
        (["--methods", "core:oracle"], "--methods: got 'core:oracle'"),
        (["--methods", "none,none"], "--methods: got 'none,none'; allowed: a list of different methods"),
        (["--methods", "core:emulated-nobody"], "nobody"),
        (["--split", "test"], "--split: got 'test'; allowed: main, heldout"),
        (["--profile", "none"], "--profile: got 'none'; allowed: core, paper, both"),
        (["--backend", "gazebo"], "--backend: got 'gazebo'"),
        (["--trials", "0"], "--trials: got 0; allowed: a whole number from 1 to 999"),
        (["--trials", "many"], "--trials"),
        (["--jobs", "0"], "--jobs: got 0"),
        (["--seed", "-1"], "--seed"),
        (["--limit-s", "0"], "--limit-s: got 0.0"),
        (["--trial-timeout-s", "nan"], "--trial-timeout-s: got nan"),
        (["--retry-errors"], "--retry-errors: given without --resume"),
        (["--dask", "tcp://127.0.0.1:1", "--jobs", "2"], "--jobs: given together with --dask"),
        (["--nonsense"], "--nonsense"),
        (["seed:=3"], "seed: given as a word"),
        (["record_dir:=/tmp/x"], "record_dir: given as a word"),
        (["speed:=3"], "speed: unknown argument"),
        (["model"], "not of the form name:=value"),
    ],
)
def test_bad_input_is_refused_in_one_line_and_leaves_nothing(tmp_path, out, capsys, arguments, text):
    command, marks = make_fake(tmp_path)
    assert evaluate.main([*TASKS, "--out", str(out), *arguments], command) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and text in error and "Traceback" not in error
    assert not list(marks.iterdir()) and not (out / "trials.jsonl").exists()


def test_the_words_of_the_campaign_are_arguments_of_the_launch_file():
    assert set(evaluate.OWN_WORDS) < set(ARGUMENT_NAMES) and set(trial_spec.KEPT_WHEN_FAILED) < set(ARGUMENT_NAMES)


def test_a_report_that_cannot_be_drawn_loses_no_trial(tmp_path, out, monkeypatch, capsys):
    def fail(*_arguments, **_more):
        raise KeyError("stop_gap_m")

    monkeypatch.setattr(evaluate, "_write_report", DRAW)
    monkeypatch.setattr("core_bringup.evaluation.report.write_report", fail)
    assert run(tmp_path, out, "--trials", "1")[0] == 1
    assert "evaluate: no report: KeyError: 'stop_gap_m'" in capsys.readouterr().err
    assert len(read_trials(out)) == 4 and read_summary(out)["complete"]


def test_a_terminal_shows_a_bar_with_the_time_left_and_counts(tmp_path, out, monkeypatch):
    screen = io.StringIO()
    screen.isatty = lambda: True
    monkeypatch.setattr(sys, "stderr", screen)
    assert run(tmp_path, out, "--trials", "1")[0] == 0
    shown = screen.getvalue()
    assert "4/4" in shown and "<00:00" in shown and "core:ontology 1/2, none 1/2" in shown
    assert "none/-/cone_line/1  violated (failure: ctx)" in shown  # what failed stays on the screen
    assert "core-ontology/core/cone_line/1" not in shown


def test_plain_lines_name_every_trial_and_the_time_left(tmp_path, out, capsys):
    run(tmp_path, out, "--trials", "5")
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 21 and lines[0].startswith("[1/20] core-ontology/core/cone_line/1  prevented")
    assert all(" left" in line for line in lines[:20]) and lines[20] == "core:ontology 5/10, none 5/10"


def test_help_names_every_option(capsys):
    assert evaluate.main(["--help"]) == 0
    text = capsys.readouterr().out
    for name in ("tasks", "split", "methods", "profile", "trials", "seed", "backend", "out", "resume", "retry-errors",
                 "jobs", "dask", "limit-s", "trial-timeout-s"):  # fmt: skip
        assert f"--{name}" in text


def test_a_system_that_gives_nearly_all_ports_away_still_has_one(tmp_path, monkeypatch):
    monkeypatch.setattr(launcher, "PORT_RANGE_FILE", tmp_path / "range")
    (tmp_path / "range").write_text("1024\t65535\n")
    port, claim = launcher.claim_port()
    claim.close()
    assert launcher.FIRST_PORT <= port <= launcher.LAST_PORT


def test_two_graphs_never_get_the_same_port():
    claims = [launcher.claim_port() for _ in range(200)]
    try:
        ports = [port for port, _ in claims]
        assert len(set(ports)) == 200
        low = int(Path("/proc/sys/net/ipv4/ip_local_port_range").read_text().split()[0])
        assert all(1024 < port < low for port in ports)  # no outgoing connection is ever given one of these
    finally:
        for _, claim in claims:
            claim.close()


def test_versions_name_the_kernels_that_round(monkeypatch):
    code = "from core_bringup.evaluation.results import read_versions; print(read_versions()['blas'])"
    found = []
    for kernel in ("Haswell", "Sandybridge"):
        monkeypatch.setenv("OPENBLAS_CORETYPE", kernel)
        run = subprocess.run([sys.executable, "-c", code], stdout=subprocess.PIPE, check=True, text=True)
        found.append(run.stdout)
    assert found[0] != found[1] or found[0] == "\n", "a numpy without OpenBLAS has none"


@pytest.mark.parametrize("text", ["[]", "5", "null", '"x"', "NaN", "{", ""])
def test_a_damaged_campaign_file_is_refused_in_one_line(tmp_path, out, capsys, text):
    command, _ = make_fake(tmp_path)
    words = (*TWO_METHODS, "--trials", "1", "--out", str(out))
    assert evaluate.main(words, command) == 0
    (out / "campaign.json").write_text(text)
    capsys.readouterr()
    assert evaluate.main((*words, "--resume"), command) == 2
    error = capsys.readouterr().err
    assert "campaign.json: file: " in error and "allowed: " in error and error.count("\n") == 1


@pytest.mark.parametrize(
    "change, words",
    [
        ({"id": "oracle/core/cone_line/1", "method": "oracle"}, "id: 'oracle/core/cone_line/1' is no trial of this"),
        ({"id": "none/-/cone_line/99"}, "id: 'none/-/cone_line/99' is no trial of this campaign"),
        ({"index": "abc"}, "line 5: no record of a trial"),
        ({"method": None}, "line 5: no record of a trial"),
    ],
)
def test_a_line_of_another_campaign_is_refused_in_one_line(tmp_path, out, capsys, change, words):
    command, _ = make_fake(tmp_path)
    arguments = (*TWO_METHODS, "--trials", "1", "--out", str(out))
    assert evaluate.main(arguments, command) == 0
    record = read_trials(out)[0]
    with (out / "trials.jsonl").open("a") as stream:
        stream.write(json.dumps({**record, **change}) + "\n")
    capsys.readouterr()
    assert evaluate.main((*arguments, "--resume"), command) == 2
    error = capsys.readouterr().err
    assert words in error and error.count("\n") == 1


@pytest.mark.parametrize("left", [(".lock",), (".lock", "campaign.json"), (".lock", "campaign.json", "trials.jsonl")])
def test_a_folder_in_which_no_trial_was_begun_can_be_used_again(tmp_path, out, left):
    out.mkdir(parents=True, exist_ok=True)
    for name in left:  # what a client leaves that found no cluster, or was killed at once
        (out / name).touch()
    command, _ = make_fake(tmp_path)
    assert evaluate.main((*TWO_METHODS, "--trials", "1", "--out", str(out)), command) == 0


def test_a_result_that_is_no_json_is_an_error_and_ends_nothing(tmp_path, out):
    command, _ = make_fake(tmp_path, 'if key.endswith("/1"):\n    result["stop_gap_m"] = float("nan")\nfinish()')
    words = ("--tasks", "cone_line", "--methods", "none", "--trials", "2", "--out", str(out))
    assert evaluate.main(words, command) == 1
    first, second = read_trials(out)
    assert first["outcome"] == "error" and "no JSON" in first["failure"] and second["outcome"] == "violated"


def test_a_copy_of_a_shipped_world_is_a_place_of_its_own(tmp_path, out):
    path = tmp_path / "warehouse.yaml"
    shipped = task_choice.find_worlds_dir()
    path.write_bytes((shipped / "warehouse.yaml").read_bytes())
    (tmp_path / "models").symlink_to(shipped / "models")
    # result.json names the world by the name inside the file
    command, _ = make_fake(tmp_path, 'result.update(world="warehouse")\nfinish()')
    words = ("--tasks", f"cone_line,{path}/cone_line", "--methods", "none", "--trials", "1", "--out", str(out))
    assert evaluate.main(words, command) == 0
    rows = [(row["world"], row["task"], row["methods"][0]["n"]) for row in read_summary(out)["tasks"]]
    assert rows == [("warehouse", "cone_line", 1), (str(path), "cone_line", 1)]

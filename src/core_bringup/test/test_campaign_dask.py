# SPDX-License-Identifier: BSD-3-Clause
"""The campaign on a Dask cluster of two worker processes on loopback, with a fake roslaunch."""

import os
import signal
import subprocess
import sys
import uuid
from pathlib import Path

import pytest
from campaign_fake import count_lines, make_fake, read_hashes, read_summary, start_client, started_processes, wait_until

from core_bringup.evaluation import evaluate
from core_bringup.evaluation.campaign_store import read_trials
from core_bringup.evaluation.executors import DaskExecutor
from core_bringup.evaluation.trial_runner import RunRules

distributed = pytest.importorskip("distributed")

OPTIONS = ["--tasks", "cone_line,open_aisle", "--methods", "core:ontology,none", "--backend", "kinematic"]
HELD = "cone_line/none/ontology/core/1"  # the second trial of the plan
SLOW_SECOND = f"""
if key == {HELD!r} and not starts:
    time.sleep(300)
finish()
"""


@pytest.fixture(scope="module", autouse=True)
def test_id():
    """A mark in the environment of all that is started here, workers included."""
    os.environ["CORE_TEST_ID"] = uuid.uuid4().hex
    yield
    del os.environ["CORE_TEST_ID"]


@pytest.fixture(scope="module")
def cluster(test_id):
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0", host="127.0.0.1"
    ) as started:
        yield started


@pytest.fixture(autouse=True)
def nothing_is_left(cluster, monkeypatch):
    monkeypatch.setattr(evaluate, "_write_report", lambda *_: True)  # it has tests of its own
    yield
    assert started_processes() == []


def worker_of(pid):
    """Process id of the worker that has started a graph."""
    return int(Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()[1])


def started(marks, key):
    return [path for path in marks.iterdir() if path.name.startswith(key.replace("/", "_") + ".")]


def test_two_workers_give_the_hashes_of_one_process(tmp_path, cluster):
    command, _ = make_fake(tmp_path)
    local, remote = [*OPTIONS, "--trials", "2", "--out", str(tmp_path / "local")], str(tmp_path / "remote")
    assert evaluate.main(local, command) == 0
    arguments = [*OPTIONS, "--trials", "2", "--out", remote, "--dask", cluster.scheduler_address]
    assert evaluate.main(arguments, command) == 0
    assert list(read_hashes(tmp_path / "local").items()) == list(read_hashes(remote).items())
    folder = tmp_path / "remote" / read_trials(remote)[0]["folder"]
    assert {"result.json", "roslaunch.log"} <= {path.name for path in folder.iterdir()}


def test_a_killed_worker_costs_only_the_trial_it_held(tmp_path, cluster):
    command, marks = make_fake(tmp_path, SLOW_SECOND)
    out = tmp_path / "out"
    client = start_client(command, [*OPTIONS, "--trials", "2", "--out", str(out), "--dask", cluster.scheduler_address])
    # All others are finished by the other worker, one is held by the worker that is killed.
    wait_until(lambda: count_lines(out) == 7 and len(started(marks, HELD)) == 1)
    (held,) = started(marks, HELD)
    graph = int(held.suffix[1:])
    os.kill(worker_of(graph), signal.SIGKILL)
    wait_until(lambda: graph not in started_processes())
    _, errors = client.communicate(timeout=90)
    assert client.returncode == 0, errors
    records = read_trials(out)
    assert len(records) == 8 and count_lines(out) == 8 and read_summary(out)["errors"] == 0
    assert len(started(marks, HELD)) == 2 and len(list(marks.iterdir())) == 9


def test_an_interrupted_campaign_ends_what_the_workers_run(tmp_path, cluster):
    command, marks = make_fake(tmp_path, SLOW_SECOND)
    out = tmp_path / "out"
    arguments = [*OPTIONS, "--trials", "1", "--out", str(out), "--dask", cluster.scheduler_address]
    client = start_client(command, arguments)
    wait_until(lambda: count_lines(out) == 3 and len(started(marks, HELD)) == 1)
    client.send_signal(signal.SIGINT)
    _, errors = client.communicate(timeout=90)
    assert client.returncode == 130 and "interrupted" in errors and "Traceback" not in errors
    wait_until(lambda: started_processes() == [])
    assert evaluate.main([*arguments, "--resume"], command) == 0
    assert len(read_trials(out)) == 4 and len(list(marks.iterdir())) == 5


def test_a_killed_client_leaves_no_trial_on_the_workers(tmp_path, cluster):
    command, marks = make_fake(tmp_path, SLOW_SECOND)
    out = tmp_path / "out"
    client = start_client(command, [*OPTIONS, "--trials", "1", "--out", str(out), "--dask", cluster.scheduler_address])
    wait_until(lambda: count_lines(out) == 3 and len(started(marks, HELD)) == 1)
    client.kill()
    client.communicate()
    wait_until(lambda: started_processes() == [])
    assert len(read_trials(out)) == 3


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "nonsense://x", "127.0.0.1"])
def test_an_address_nobody_answers_at_is_refused_in_one_line(tmp_path, capfd, monkeypatch, address):
    monkeypatch.setattr("core_bringup.evaluation.executors.CONNECT_TIMEOUT_S", 1.0)
    command, marks = make_fake(tmp_path)
    assert evaluate.main([*OPTIONS, "--out", str(tmp_path / "out"), "--dask", address], command) == 2
    error = capfd.readouterr().err
    assert error.count("\n") == 1 and "evaluate: --dask: " in error and "allowed: the address" in error
    assert not list(marks.iterdir()) and not list((tmp_path / "out").iterdir())


@pytest.fixture
def scheduler():
    with distributed.LocalCluster(n_workers=0, dashboard_address=":0", host="127.0.0.1") as started:
        yield started.scheduler_address


def test_a_cluster_without_workers_is_refused(tmp_path, scheduler, capfd):
    command, _ = make_fake(tmp_path)
    assert evaluate.main([*OPTIONS, "--out", str(tmp_path / "out"), "--dask", scheduler], command) == 2
    assert "--dask: the cluster has no worker; allowed: " in capfd.readouterr().err


def test_a_worker_without_the_workspace_is_refused(tmp_path, scheduler, capfd):
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    worker = subprocess.Popen(
        [sys.executable, "-m", "distributed.cli.dask_worker", scheduler, "--no-nanny", "--no-dashboard"],
        env=environment, cwd=str(tmp_path), stderr=subprocess.DEVNULL,
    )  # fmt: skip
    try:
        with distributed.Client(scheduler, set_as_default=False) as client:
            client.wait_for_workers(1, timeout=60)
        command, marks = make_fake(tmp_path)
        assert evaluate.main([*OPTIONS, "--out", str(tmp_path / "out"), "--dask", scheduler], command) == 2
    finally:
        worker.terminate()
        worker.wait()
    error = capfd.readouterr().err
    assert "evaluate: --dask: a worker cannot run a trial" in error and "No module named 'core_bringup'" in error
    assert not list(marks.iterdir())


def test_a_worker_with_other_versions_is_named(cluster, monkeypatch):
    here = os.getpid()

    def versions():
        return {"numpy": "0.2" if os.getpid() == here else "0.1"}

    monkeypatch.setattr("core_bringup.evaluation.executors.read_versions", versions)
    executor = DaskExecutor(cluster.scheduler_address, RunRules(), lambda: None)
    executor.close()
    assert len(executor.differences) == 2 and "has other versions: numpy 0.1 (here 0.2)" in executor.differences[0]


def test_dask_is_not_imported_without_the_option(tmp_path):
    command, _ = make_fake(tmp_path)
    program = "import sys; sys.modules['dask'] = sys.modules['distributed'] = None; "
    client = start_client(command, [*OPTIONS, "--trials", "1", "--out", str(tmp_path / "out")], program)
    _, errors = client.communicate(timeout=60)
    assert client.returncode == 0, errors

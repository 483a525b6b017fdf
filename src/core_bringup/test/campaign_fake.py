# SPDX-License-Identifier: BSD-3-Clause
"""A campaign whose roslaunch is a small script: what it prints follows from the arguments alone."""

import contextlib
import json
import os
import stat
import subprocess
import sys
import time
from pathlib import Path

from core_bringup.evaluation import launcher

FAKE = """#!{python}
import hashlib, json, os, signal, subprocess, sys, time
arguments = dict(word.split(":=", 1) for word in sys.argv if ":=" in word)
key = "/".join(arguments[name] for name in ("task", "method", "reasoner", "profile", "seed"))
unsafe = arguments["task"] == "cone_line"
good = unsafe == (arguments["method"] not in ("none", "geometric"))
names = ("violated", "prevented") if unsafe else ("timeout", "reached")
result = dict(outcome=names[good], success=good, attribution=None if good else "ctx", sim_time_s=20.0)
result.update(task=arguments["task"], method=arguments["method"], seed=int(arguments["seed"]))
result.update(trajectory_sha256=hashlib.sha256(key.encode()).hexdigest(), latency_s=dict(qp=dict(p50=0.001)))
result.update(stop_gap_m=0.4 if unsafe else None)
marks = {marks!r}
starts = sum(1 for name in os.listdir(marks) if name.startswith(key.replace("/", "_") + "."))
open(os.path.join(marks, "%s.%d" % (key.replace("/", "_"), os.getpid())), "w").close()
def say(text):
    print(text, flush=True)
def finish():
    open(os.path.join(arguments["results"], "result.json"), "w").write(json.dumps(result))
    say("result " + json.dumps(result))
say("progress {{}}")
{body}
"""


def make_fake(folder, body="finish()"):
    """Make the script in folder; returns the command and the folder in which every start leaves a file."""
    marks = Path(folder) / "marks"
    marks.mkdir(exist_ok=True)
    path = Path(folder) / "fake_roslaunch"
    path.write_text(FAKE.format(python=sys.executable, marks=str(marks), body=body))
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return (str(path),), marks


def start_client(command, arguments, before=""):
    """Run the campaign in a process of its own, without its report; before is Python that runs first.

    It starts with the signals of a terminal, whatever these tests were started under.
    """
    program = f"""import signal
signal.signal(signal.SIGHUP, signal.SIG_DFL)
{before}
import sys
from core_bringup.evaluation import evaluate
evaluate._write_report = lambda *_: True
sys.exit(evaluate.main({arguments!r}, {command!r}))
"""
    return subprocess.Popen([sys.executable, "-c", program], stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)


def started_processes():
    """Processes of graphs that this test has started."""
    marks = (f"CORE_TEST_ID={os.environ['CORE_TEST_ID']}".encode(), launcher.RUN_ID_VARIABLE.encode() + b"=")
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            environment = (entry / "environ").read_bytes()
            if all(mark in environment for mark in marks):
                found.append(int(entry.name))
    return found


def wait_until(condition, deadline_s=60.0):
    """Wait for a condition; fails when it does not come."""
    end = time.monotonic() + deadline_s
    while not condition():
        assert time.monotonic() < end, "condition not met in time"
        time.sleep(0.05)


def count_lines(folder):
    """Finished lines of trials.jsonl."""
    path = Path(folder) / "trials.jsonl"
    return path.read_bytes().count(b"\n") if path.exists() else 0


def read_hashes(folder):
    """Trajectory hash of every trial."""
    from core_bringup.evaluation.campaign_store import read_trials

    return {record["id"]: record["trajectory_sha256"] for record in read_trials(folder)}


def read_summary(folder):
    """Content of summary.json."""
    return json.loads((Path(folder) / "summary.json").read_text())

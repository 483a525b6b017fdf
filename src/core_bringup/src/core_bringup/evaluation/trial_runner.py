# SPDX-License-Identifier: BSD-3-Clause
"""One trial of a campaign: a graph of its own, a wall-clock limit, a second attempt where the machine failed it."""

from __future__ import annotations

import io
import platform
import shutil
import tarfile
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Callable, List, Mapping, Optional, Sequence, Tuple

from core_bringup.evaluation.demo_run import LAUNCH_COMMAND, LOG_NAME, RunReport, run_demo
from core_bringup.evaluation.trial_spec import TrialSpec
from core_bringup.exceptions import ConfigError

MAX_ATTEMPTS = 2
ROS_LOG_NAME = "ros_log"  # what nodes log for themselves; kept only when a trial could not be run
Result = Mapping[str, object]


@dataclass(frozen=True)
class RunRules:
    """How trials are run.

    Attributes:
        command: what to start; the launch arguments are added.
        timeout_s: wall time after which a trial is ended [s].
    """

    command: Tuple[str, ...] = LAUNCH_COMMAND
    timeout_s: float = 900.0


class TrialStop:
    """Says when a run is to be given up: out of time, or nobody wants it any more.

    Args:
        timeout_s: wall time from now [s].
        unwanted: asked now and then whether the trial is still wanted.
    """

    def __init__(self, timeout_s: float, unwanted: Callable[[], bool] = lambda: False):
        """Start the clock."""
        self._timeout_s, self._unwanted = timeout_s, unwanted
        self._end = time.monotonic() + timeout_s
        self.timed_out = False
        self.cancelled = False

    def is_set(self) -> bool:
        """Whether the run is to be given up now."""
        self.cancelled = self.cancelled or self._unwanted()
        self.timed_out = self.timed_out or (not self.cancelled and time.monotonic() > self._end)
        return self.cancelled or self.timed_out

    @property
    def reason(self) -> str:
        """Why, for the record; empty unless the trial ran out of time."""
        return f"ended after {self._timeout_s:g} s of wall time" if self.timed_out else ""


def run_trial(
    spec: TrialSpec, folder: Path, rules: RunRules, unwanted: Callable[[], bool] = lambda: False
) -> Optional[dict]:
    """Run one trial, a second time when the infrastructure failed.

    Args:
        spec: which trial.
        folder: empty folder for its files.
        rules: how.
        unwanted: gives the trial up when true.

    Returns:
        The record of the trial; None when it was given up.
    """
    failures: List[dict] = []
    while True:
        started, stop = time.monotonic(), TrialStop(rules.timeout_s, unwanted)
        try:
            report = run_demo(spec.request(folder), lambda _progress: None, rules.command, stop)
        except ConfigError as error:
            report = RunReport(2, None, str(error))
        if stop.cancelled:
            return None
        wall_s = round(time.monotonic() - started, 3)
        retry = len(failures) + 1 < MAX_ATTEMPTS and not stop.timed_out and is_infrastructure_failure(report)
        if not retry:
            break
        failures.append({"failure": report.failure, "exit_code": report.exit_code, "wall_s": wall_s})
        _set_aside(folder, len(failures))
    if report.exit_code == 0:
        shutil.rmtree(str(folder / ROS_LOG_NAME), ignore_errors=True)
    return make_record(spec, report, wall_s, failures, stop.reason)


def is_infrastructure_failure(report: RunReport) -> bool:
    """Whether a run failed for a reason that is none of the trial's own.

    The graph did not start, ended without a result, or the monitor gave up waiting; a graph that went silent, a node
    that refused its input and a fault that stopped the robot are the trial's own.
    """
    if report.exit_code != 1 or report.failure.startswith("no progress for"):
        return False
    return report.result is None or report.result.get("end_rule") == "aborted"


def make_record(
    spec: TrialSpec, report: RunReport, wall_s: float, failures: Sequence[dict] = (), reason: str = ""
) -> dict:
    """The line of trials.jsonl: what the trial is, what result.json says, and how the run went.

    Args:
        spec: which trial.
        report: how the last attempt ended.
        wall_s: wall time of the last attempt [s].
        failures: the attempts before it.
        reason: why the run was given up, if it was.
    """
    record: dict = {**spec.describe(), "outcome": "error", "success": False, "attribution": None}
    own = dict(record)
    record.update(report.result or {})
    # The campaign's name of a method says more than the launch argument, and a folder is the campaign's matter; world
    # and number group the trials of a task, whether or not one has a result.
    kept = ("id", "index", "method", "profile", "world", "number", "trial", "folder", "command")
    record.update({key: own[key] for key in kept})
    if report.exit_code != 0:
        record.update(outcome="error", success=False, attribution=None)
    record.update(
        exit_code=report.exit_code,
        failure=reason or report.failure,
        wall_s=wall_s,
        attempt=len(failures) + 1,
        earlier_attempts=list(failures),
        machine=platform.node(),
    )
    return record


def run_packed(
    spec: TrialSpec, rules: RunRules, unwanted: Callable[[], bool], scratch: Optional[str] = None
) -> Tuple[Optional[dict], bytes]:
    """Run one trial in a temporary folder.

    Args:
        spec: which trial.
        rules: how.
        unwanted: gives the trial up when true.
        scratch: folder in which the temporary one is made.

    Returns:
        The record and the files as a compressed tar archive.
    """
    with tempfile.TemporaryDirectory(prefix="core_trial_", dir=scratch) as name:
        record = run_trial(spec, Path(name), rules, unwanted)
        return record, pack(Path(name))


def pack(folder: Path) -> bytes:
    """The content of a folder as a compressed tar archive."""
    stream = io.BytesIO()
    with tarfile.open(fileobj=stream, mode="w:gz", compresslevel=1) as archive:
        archive.add(str(folder), arcname=".")
    return stream.getvalue()


def unpack(data: bytes, folder: Path) -> None:
    """Write what ``pack`` made into folder; members that are neither files nor folders inside it are left out."""
    with tarfile.open(fileobj=io.BytesIO(data), mode="r:gz") as archive:
        root = folder.resolve()
        for member in archive.getmembers():
            inside = root in ((root / member.name).resolve(), *(root / member.name).resolve().parents)
            if inside and (member.isfile() or member.isdir()):
                archive.extract(member, str(folder))


def _set_aside(folder: Path, attempt: int) -> None:
    """Empty the folder but for the log of the failed attempt."""
    for path in folder.iterdir():
        if path.is_dir():
            shutil.rmtree(str(path), ignore_errors=True)
        elif path.name == LOG_NAME:
            path.replace(folder / f"roslaunch_attempt_{attempt}.log")
        elif not path.name.startswith("roslaunch_attempt_"):
            path.unlink()

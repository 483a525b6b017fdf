# SPDX-License-Identifier: BSD-3-Clause
"""One run of demo.launch from start to the last process, and what went wrong when something did."""

from __future__ import annotations

import json
import re
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Callable, List, Mapping, Optional, Sequence

from core_bringup.evaluation.launcher import RoslaunchProcess
from core_bringup.evaluation.preflight import DemoRequest

LAUNCH_COMMAND = ("roslaunch", "--skip-log-check", "core_bringup", "demo.launch")
LOG_NAME = "roslaunch.log"
TAIL_LINES = 20
# The graph is given up when it prints no progress for this long [s]; trial_monitor's own limits are shorter.
MAX_SILENCE_S = 240.0
# roslaunch ends by itself after the result; then it is stopped [s].
MAX_ENDING_S = 20.0
STALE_FILES = ("result.json", "topdown.png", "frame_1.png", "frame_2.png", "frame_3.png", "trajectory.csv", "trial.bag")
BAD_INPUT = re.compile(r"exit code 2, cmd (?P<cmd>\S+)(?P<rest>.*)")
DEATH = re.compile(r"\[(?P<node>[\w/.-]+)-\d+\] (?:process )?has died")
EXIT_CODE = re.compile(r"exit code (?P<code>-?\d+)")
NODE_NAME = re.compile(r"__name:=([\w/.-]+)")
ROSLAUNCH_NOISE = ("process[", "REQUIRED process", "[", "log file", "Initiating shutdown", "====")


@dataclass(frozen=True)
class RunReport:
    """How one run went.

    Attributes:
        exit_code: 0 the run completed, whatever its outcome; 1 it could not; 2 a node refused its input.
        result: content of result.json; None when there is none.
        failure: one line that says what went wrong, empty for exit code 0.
        tail: last lines of the log, for exit code 1.
    """

    exit_code: int
    result: Optional[dict] = None
    failure: str = ""
    tail: Sequence[str] = ()


def run_demo(
    request: DemoRequest,
    on_progress: Callable[[Mapping[str, object]], None],
    command: Sequence[str] = LAUNCH_COMMAND,
    stop: Optional[threading.Event] = None,
) -> RunReport:
    """Run the launch file once and stop everything it started.

    Args:
        request: checked arguments.
        on_progress: called with what trial_monitor reports, about twice a second.
        command: what to start; the launch arguments are added.
        stop: gives the run up when set, for example from another thread.
    """
    folder = Path(request.results)
    for name in STALE_FILES:
        if (folder / name).exists():
            (folder / name).unlink()
    log: List[str] = []
    with RoslaunchProcess([*command, *request.launch_arguments()], folder / LOG_NAME) as process:
        failure = _follow(process, log, on_progress, stop or threading.Event())
    return _judge(log, failure)


def _follow(process: RoslaunchProcess, log: List[str], on_progress: Callable, stop: threading.Event) -> str:
    """Read the graph's output to its end; returns why reading was given up, or an empty text."""
    heard_at = time.monotonic()
    has_result = False
    for line in process.lines():
        progress = None if line is None else read_marked(line, "progress")
        if progress is not None:
            heard_at = time.monotonic()
            on_progress(progress)
        elif line is not None:
            log.append(line)
            if BAD_INPUT.search(line):
                return ""
            if read_marked(line, "result") is not None:
                has_result, heard_at = True, time.monotonic()
        silent_s = time.monotonic() - heard_at
        if stop.is_set():
            return "interrupted"
        if has_result and silent_s > MAX_ENDING_S:
            return ""
        if silent_s > MAX_SILENCE_S:
            return f"no progress for {MAX_SILENCE_S:g} s"
    return ""


def read_marked(line: str, mark: str) -> Optional[dict]:
    """The JSON object behind a mark such as ``progress``; None when the line is something else."""
    if not line.startswith(mark + " {"):
        return None
    try:
        content = json.loads(line[len(mark) + 1 :])
    except ValueError:
        return None
    return content if isinstance(content, dict) else None


def _judge(log: Sequence[str], failure: str) -> RunReport:
    refusal = find_refusal(log)
    if refusal is not None:
        return RunReport(2, None, refusal)
    results = [result for result in (read_marked(line, "result") for line in log) if result is not None]
    result = results[-1] if results else None
    if result is not None and result.get("outcome") != "error":
        return RunReport(0, result)
    if not failure and result is not None:
        failure = str(result.get("end_detail") or "the trial ended as an error")
        # What happened before the monitor gave up is the cause; afterwards the monitor itself is reported as dead.
        judged_at = next(i for i, line in enumerate(log) if read_marked(line, "result") is not None)
        cause = find_cause(log[:judged_at])
        failure = f"{cause}; {failure}" if cause else failure
    tail = [line for line in log if not line.startswith("result {")][-TAIL_LINES:]
    return RunReport(1, result, failure or find_reason(log), tail)


def find_refusal(log: Sequence[str]) -> Optional[str]:
    """The one line of a node that ended with exit code 2 (bad input); None when no node did."""
    for i, line in enumerate(log):
        match = BAD_INPUT.search(line)
        if match is None:
            continue
        named = NODE_NAME.search(match.group("rest"))
        node = named.group(1) if named else Path(match.group("cmd")).name
        said = [text for text in log[:i] if node in text and not text.startswith(ROSLAUNCH_NOISE)]
        return said[-1] if said else f"{node}: refused its parameters, see {LOG_NAME}"
    return None


def find_cause(log: Sequence[str]) -> str:
    """What a node said when it gave up, or else which node died first; empty when neither is in the log."""
    fatal = next((line.strip() for line in log if "[FATAL]" in line), "")
    if fatal:
        return fatal
    for i, line in enumerate(log):
        match = DEATH.search(line)
        if match is not None:
            code = EXIT_CODE.search(" ".join(log[i : i + 2]))
            return f"{match.group('node')} has died" + (f" (exit code {code.group('code')})" if code else "")
    return ""


def find_reason(log: Sequence[str]) -> str:
    """The line that most likely says why the graph ended without a result."""
    if not any("RLException" in line for line in log) and find_cause(log):
        return find_cause(log)
    for sign in ("RLException", "[ERROR]", "Error:", "has died", "ERROR"):
        said = [line for line in log if sign in line]
        if said:
            return said[0].strip()
    return f"the graph ended without a result, see {LOG_NAME}"

# SPDX-License-Identifier: BSD-3-Clause
"""The demo: one command, one walk, one result. Exit status 0 completed, 1 could not, 2 bad input."""

from __future__ import annotations

import argparse
import functools
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import List, Mapping, Optional, Sequence

from tqdm import tqdm

from core_bringup.evaluation import demo_report
from core_bringup.evaluation.command_line import OneLineParser, Program, run_program
from core_bringup.evaluation.demo_run import LAUNCH_COMMAND, LOG_NAME, RunReport, run_demo
from core_bringup.evaluation.preflight import ARGUMENT_NAMES, DemoRequest, check_request, parse_arguments
from core_bringup.evaluation.results import write_json
from core_bringup.exceptions import ConfigError

PLAIN_PERIOD_S = 10.0  # between two progress lines where no terminal redraws them
MAX_SEEDS = 10000
BAR_FORMAT = (
    "{desc} {n:5.1f} / {total:.0f} s |{bar:18}| {unit}"  # unit carries the text: a postfix would begin with a comma
)

HELP = f"""usage: ./core.sh demo [name:=value ...] [--view] [--seeds N [--jobs J]]

Runs launch/demo.launch once, or for seeds 0 .. N-1 in fresh processes, and writes results/demo/.
  name:=value   one of {", ".join(ARGUMENT_NAMES)}
  --view        open RViz (the same as view:=true)
  --seeds N     run N seeds, one folder each, and write seeds.json with the counts
  --jobs J      runs at the same time (default 1)

  ./core.sh demo                      the filter stops the robot at the cones
  ./core.sh demo method:=none         the same walk without the filter
  ./core.sh demo task:=open_aisle     a safe task
"""


class ProgressLine:
    """One line that is redrawn on a terminal, or a plain line now and then where stderr is none.

    Args:
        time_limit_s: sim time at which the run ends at the latest [s].
        label: text in front.
    """

    def __init__(self, time_limit_s: float, label: str):
        """Show the line at zero."""
        self._limit_s, self._label = time_limit_s, label
        self._shown_at = time.monotonic()
        self._bar = None
        if sys.stderr.isatty():
            self._bar = tqdm(
                total=time_limit_s, desc=label, bar_format=BAR_FORMAT, file=sys.stderr, dynamic_ncols=True, leave=False
            )
            self._show(0.0, "starting")

    def update(self, progress: Mapping[str, object]) -> None:
        """Show what trial_monitor reported."""
        text, time_s = demo_report.format_progress(progress), float(progress.get("sim_time_s") or 0.0)
        if self._bar is not None:
            self._show(min(time_s, self._limit_s), text)
        elif time.monotonic() - self._shown_at >= PLAIN_PERIOD_S:
            self._shown_at = time.monotonic()
            print(f"{self._label} {time_s:.1f} / {self._limit_s:g} s  {text}", file=sys.stderr, flush=True)

    def _show(self, time_s: float, text: str) -> None:
        self._bar.n, self._bar.unit = time_s, text
        self._bar.refresh()

    def close(self) -> None:
        """Clear the line."""
        if self._bar is not None:
            self._bar.close()


def parse_options(arguments: Sequence[str]) -> argparse.Namespace:
    """Split options from name:=value words.

    Raises:
        ConfigError: unknown option, or a count out of range.
    """
    parser = OneLineParser("demo", "name:=value ..., --view, --seeds N, --jobs J, --help")
    parser.add_argument("words", nargs="*")
    parser.add_argument("--view", action="store_true")
    parser.add_argument("--seeds", type=int, default=None)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("-h", "--help", action="store_true")
    options = parser.parse_intermixed_args(list(arguments))
    if options.view:
        options.words = [word for word in options.words if not word.startswith("view:=")] + ["view:=true"]
    if options.seeds is not None and not 1 <= options.seeds <= MAX_SEEDS:
        raise ConfigError("demo", "--seeds", f"got {options.seeds}", f"a whole number from 1 to {MAX_SEEDS}")
    if options.seeds is not None and any(word.startswith("seed:=") for word in options.words):
        raise ConfigError("demo", "seed", "given together with --seeds", "one of the two")
    if not 1 <= options.jobs <= 64:
        raise ConfigError("demo", "--jobs", f"got {options.jobs}", "a whole number from 1 to 64")
    return options


def run_one(request: DemoRequest, time_limit_s: float, command: Sequence[str] = LAUNCH_COMMAND) -> int:
    """Run once, show progress, print the table; returns the exit status."""
    title = f"{request.task} · method {request.method}"
    title += "" if request.method == "none" else f" · profile {request.profile}"
    print(
        f"{title} · seed {request.seed} · {request.backend}; log in {Path(request.results) / LOG_NAME}",
        file=sys.stderr,
        flush=True,
    )
    line = ProgressLine(time_limit_s, request.task)
    try:
        report = run_demo(request, line.update, command)
    finally:
        line.close()
    if report.exit_code != 0:
        _print_failure(report)
        return report.exit_code
    print(f"{title} · seed {request.seed}")
    print(demo_report.format_table(report.result, Path(request.results)))
    return 0


def run_seeds(request: DemoRequest, seeds: int, jobs: int, command: Sequence[str] = LAUNCH_COMMAND) -> int:
    """Run seeds 0 .. seeds-1, each in fresh processes; prints a line per seed and the counts, writes seeds.json.

    A seed that could not run is counted as ``error`` and never dropped.
    """
    folder = Path(request.results)
    results: List[dict] = []
    worst = 0
    pool = ThreadPoolExecutor(max_workers=jobs)
    stop = threading.Event()
    futures = {
        pool.submit(_run_seed, request.with_seed(s, folder / f"seed_{s:03d}"), command, stop): s for s in range(seeds)
    }
    with tqdm(
        total=seeds, desc=request.task, unit="run", file=sys.stderr, dynamic_ncols=True, disable=not sys.stderr.isatty()
    ) as bar:
        try:
            for future in as_completed(futures):
                report = future.result()
                result = report.result or {"outcome": "error", "end_detail": report.failure}
                results.append({"seed": futures[future], **result})
                worst = max(worst, report.exit_code)
                results.sort(key=lambda r: r["seed"])
                _write_seeds(folder, request, results)
                bar.write(demo_report.format_seed_line({"seed": futures[future], **result}), file=sys.stdout)
                sys.stdout.flush()
                bar.update()
                if report.exit_code == 2:
                    raise ConfigError("demo", f"seed {futures[future]}", report.failure, "see above")
        finally:
            stop.set()
            for future in futures:
                future.cancel()
            pool.shutdown(wait=True)
    print(f"{request.task} · method {request.method}: {demo_report.format_counts(demo_report.count_outcomes(results))}")
    print(f"  {folder / 'seeds.json'}")
    return worst


def _run_seed(request: DemoRequest, command: Sequence[str], stop: threading.Event) -> RunReport:
    Path(request.results).mkdir(parents=True, exist_ok=True)
    return run_demo(request, lambda _progress: None, command, stop)


def _write_seeds(folder: Path, request: DemoRequest, results: Sequence[dict]) -> None:
    content = {"task": request.task, "method": request.method, "profile": request.profile}
    content["counts"] = demo_report.count_outcomes(results)
    content["results"] = list(results)
    write_json(folder / "seeds.json", content)


def _print_failure(report: RunReport) -> None:
    if report.tail:
        print("last lines of the log:", file=sys.stderr)
        print("\n".join(f"  {line}" for line in report.tail), file=sys.stderr)
    print(report.failure, file=sys.stderr)


def run_options(options: argparse.Namespace, command: Sequence[str] = LAUNCH_COMMAND) -> int:
    """Run what is asked for; returns the exit status."""
    request = parse_arguments(options.words)
    time_limit_s = check_request(request)
    if options.seeds is not None:
        return run_seeds(request, options.seeds, options.jobs, command)
    return run_one(request, time_limit_s, command)


def main(arguments: Optional[Sequence[str]] = None, command: Sequence[str] = LAUNCH_COMMAND) -> int:
    """Entry of scripts/demo; see HELP."""
    run = functools.partial(run_options, command=command)
    return run_program(
        Program("demo", HELP, parse_options, run, "everything that was started has been stopped"), arguments
    )

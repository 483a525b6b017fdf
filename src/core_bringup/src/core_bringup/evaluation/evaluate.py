# SPDX-License-Identifier: BSD-3-Clause
"""The campaign's command; exit status 0 complete, 1 incomplete or with errors, 2 bad input, 130 interrupted."""

from __future__ import annotations

import argparse
import functools
import hashlib
import shlex
import sys
from pathlib import Path
from typing import Dict, List, Optional, Sequence

from core_bringup.evaluation import preflight
from core_bringup.evaluation.campaign import Campaign
from core_bringup.evaluation.campaign_store import CampaignStore
from core_bringup.evaluation.command_line import OneLineParser, Program, run_program
from core_bringup.evaluation.demo_run import LAUNCH_COMMAND
from core_bringup.evaluation.executors import DaskExecutor, LocalExecutor
from core_bringup.evaluation.sources import read_sources_hash
from core_bringup.evaluation.task_choice import SPLITS, choose_tasks
from core_bringup.evaluation.trial_runner import RunRules
from core_bringup.evaluation.trial_spec import DEFAULT_METHODS, SEEDS_PER_BASE, TrialSpec, make_trials, read_methods
from core_bringup.exceptions import ConfigError
from core_bringup.params import BACKENDS
from core_bringup.world import resolve_world_path

PROFILE_CHOICES = {"core": ("core",), "paper": ("paper",), "both": ("core", "paper")}
# These the campaign sets itself.
OWN_WORDS = (
    *("world", "task", "method", "profile", "reasoner", "emulated_row", "seed", "backend", "results"),
    *("lockstep", "rtf", "gui", "view", "record_dir"),
)
HELP = f"""usage: ./core.sh evaluate [options] [name:=value ...]

Runs methods x tasks x trials, each trial a roslaunch graph of its own, and writes DIR/trials.jsonl, DIR/summary.json,
DIR/trials.csv, DIR/report.html and the files of every trial. Nothing that has finished is ever lost.
  --tasks WHICH         paper (default: the twelve), own, all, or a list of task, world/task, path/world.yaml/task
  --split NAME          main (default) or heldout: arrangements nothing was tuned on
  --methods LIST        default {",".join(DEFAULT_METHODS)};
                        also core:ollama, core:openai, core:auto, core:emulated-ROW
  --profile NAME        core (default), paper or both; geometric and none have no profile
  --trials N            per method and task (default 5); trial k has seed S * {SEEDS_PER_BASE} + k
  --seed S              default 0
  --backend NAME        pybullet (default) or kinematic
  --out DIR             default results/evaluate; must be empty, or else
  --resume              go on with the campaign in DIR: same settings, only what is missing
  --retry-errors        with --resume: run trials again that are recorded as errors
  --jobs J              trials at the same time on this machine (default 1)
  --dask ADDRESS        run the trials on the workers of a Dask cluster, each started by ./core.sh run dask worker ...
  --limit-s T           begin no trial after T s of wall time; the rest is left to --resume
  --trial-timeout-s T   end a trial after T s of wall time and record it as an error (default 900)
  name:=value           an argument of demo.launch for every trial, such as model:=gemma3:27b
Exit status: 0 complete without errors, 1 incomplete or with errors, 2 bad input, 130 interrupted.

  ./core.sh evaluate --tasks cone_line,open_aisle --trials 1 --backend kinematic     a quick look
  ./core.sh evaluate --jobs 2                                                        the paper's experiment
"""


def parse_options(arguments: Sequence[str]) -> argparse.Namespace:
    """Read options and name:=value words.

    Raises:
        ConfigError: an unknown option, or a value out of range.
    """
    parser = OneLineParser("evaluate", "see --help")
    parser.add_argument("words", nargs="*")
    for name, default in (("--tasks", "paper"), ("--split", "main"), ("--methods", ",".join(DEFAULT_METHODS)),
                          ("--profile", "core"), ("--backend", "pybullet"), ("--dask", ""),
                          ("--out", "results/evaluate")):  # fmt: skip
        parser.add_argument(name, default=default)
    for name, default in (("--trials", 5), ("--jobs", 1), ("--seed", 0)):
        parser.add_argument(name, type=int, default=default)
    parser.add_argument("--limit-s", type=float, default=None)
    parser.add_argument("--trial-timeout-s", type=float, default=RunRules().timeout_s)
    for name in ("--resume", "--retry-errors"):
        parser.add_argument(name, action="store_true")
    parser.add_argument("-h", "--help", action="store_true")
    options = parser.parse_intermixed_args(list(arguments))
    _check_options(options)
    return options


def _check_options(options: argparse.Namespace) -> None:
    for name, allowed in (("split", SPLITS), ("profile", tuple(PROFILE_CHOICES)), ("backend", BACKENDS)):
        if getattr(options, name) not in allowed:
            raise ConfigError("evaluate", f"--{name}", f"got {getattr(options, name)!r}", ", ".join(allowed))
    max_base = (preflight.MAX_SEED - SEEDS_PER_BASE) // SEEDS_PER_BASE
    for name, low, high in (("trials", 1, SEEDS_PER_BASE - 1), ("jobs", 1, 64), ("seed", 0, max_base)):
        if not low <= getattr(options, name) <= high:
            raise ConfigError(
                "evaluate", f"--{name}", f"got {getattr(options, name)}", f"a whole number from {low} to {high}"
            )
    for name in ("limit_s", "trial_timeout_s"):
        value = getattr(options, name)
        if value is not None and not 0.0 < value < 1e7:
            raise ConfigError("evaluate", f"--{name.replace('_', '-')}", f"got {value}", "a number of seconds > 0")
    if options.dask and options.jobs != 1:
        raise ConfigError("evaluate", "--jobs", "given together with --dask", "one of the two")
    if options.retry_errors and not options.resume:
        raise ConfigError("evaluate", "--retry-errors", "given without --resume", "both")


def make_plan(options: argparse.Namespace) -> List[TrialSpec]:
    """Every trial the options ask for, each checked as the demo checks its arguments.

    Raises:
        ConfigError: the first thing wrong.
    """
    methods = read_methods(options.methods.split(","), PROFILE_CHOICES[options.profile])
    tasks = choose_tasks(options.tasks, options.split)
    plan = make_trials(methods, tasks, options.trials, options.seed, launch_words(options))
    first = [spec for spec in plan if spec.trial == 1]
    # Every task with one method and every method with one task: what is checked of the two is independent.
    for spec in first:
        if spec.task == tasks[0] or spec.method == methods[0]:
            preflight.check_request(spec.request(Path(options.out)))
    return plan


def launch_words(options: argparse.Namespace) -> List[str]:
    """The words for every trial; paths are made absolute, so that a command works from anywhere.

    Raises:
        ConfigError: a word is wrong, or names what the campaign sets itself.
    """
    words = [f"backend:={options.backend}"]
    preflight.parse_arguments(options.words)
    for word in options.words:
        name, _, value = word.partition(":=")
        if name in OWN_WORDS:
            raise ConfigError("evaluate", name, "given as a word", "the options of evaluate; see --help")
        is_path = name in preflight.PATH_ARGUMENTS or (name == "robot" and Path(value).suffix)
        words.append(f"{name}:={Path(value).resolve() if is_path else value}")
    return words


def make_settings(options: argparse.Namespace, plan: Sequence[TrialSpec]) -> Dict[str, object]:
    """What two runs of one campaign must agree in."""
    worlds = sorted({spec.task.world for spec in plan})
    words = launch_words(options)[1:]
    # The parameters that a word names decide the trials as much as a world does.
    named = {word: Path(word.partition(":=")[2]) for word in words}
    return {
        "tasks": list(dict.fromkeys(f"{spec.task.world}/{spec.task.name}" for spec in plan)),
        "methods": list(dict.fromkeys(f"{spec.method.name}/{spec.method.profile}" for spec in plan)),
        **{name: getattr(options, name) for name in ("split", "profile", "trials", "seed", "backend")},
        "words": words,
        "sources_sha256": read_sources_hash(),
        "worlds_sha256": {name: _sha256(resolve_world_path(name)) for name in worlds},
        "files_sha256": {word: _sha256(path) for word, path in named.items() if path.is_file()},
    }


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def repeat_command(options: argparse.Namespace) -> str:
    """The line that repeats the campaign."""
    words = ["./core.sh", "evaluate"]
    for name in ("tasks", "split", "methods", "profile", "trials", "seed", "backend"):
        words += [f"--{name}", str(getattr(options, name))]
    return shlex.join([*words, *options.words])


def run_campaign(options: argparse.Namespace, command: Sequence[str] = LAUNCH_COMMAND) -> int:
    """Run what is asked for; returns the exit status."""
    out = Path(options.out)
    if out.exists() and not out.is_dir():
        raise ConfigError("evaluate", "--out", f"{out} is a file", "a folder")
    plan = make_plan(options)
    rules = RunRules(tuple(command), options.trial_timeout_s)
    store = CampaignStore(out, make_settings(options, plan), options.resume)
    # Before anything is written: a wrong address leaves no campaign behind.
    executor = _make_executor(options, rules, store)
    with store:
        campaign = Campaign(plan, store, executor, options.retry_errors, options.limit_s)
        summary = campaign.run()
        drawn = not summary["recorded"] or _write_report(out, int(summary["missing"]), repeat_command(options))
    print(format_summary(summary, out))
    if campaign.interrupted:
        print("interrupted; everything that was started has been stopped; --resume goes on", file=sys.stderr)
        return 130
    return 0 if summary["complete"] and not summary["errors"] and drawn else 1


def _make_executor(options: argparse.Namespace, rules: RunRules, store: CampaignStore):
    if not options.dask:
        return LocalExecutor(options.jobs, rules, store.new_folder)
    executor = DaskExecutor(options.dask, rules, store.new_folder)
    for line in executor.differences:
        print(line, file=sys.stderr)
    return executor


def _write_report(out: Path, missing: int, command: str) -> bool:
    """Draw the page; one that cannot be drawn loses no trial, is told in one line, and gives False."""
    from core_bringup.evaluation.report import write_report  # imports what draws, which nothing else here needs

    try:
        write_report(out, missing=missing, command=command)
    except Exception as error:  # of the template, of the plots, of a world file that has changed since
        print(f"evaluate: no report: {type(error).__name__}: {' '.join(str(error).split())}", file=sys.stderr)
        return False
    return True


def format_summary(summary: dict, out: Path) -> str:
    """The last lines on the terminal: a row per method and what is left."""
    heads = ("method", "profile", "success", "safe", "unsafe", "ctx", "grnd", "enf", "errors")
    rows = [heads]
    for row in summary["methods"]:
        rates = [f"{row[f'{p}success']}/{row[f'{p}n']}" for p in ("", "safe_", "unsafe_")]
        rows.append((row["name"], row["profile"], *rates, *(str(row[key]) for key in heads[5:])))
    widths = [max(len(str(row[i])) for row in rows) for i in range(len(heads))]
    lines = ["  ".join(str(cell).ljust(width) for cell, width in zip(row, widths)).rstrip() for row in rows]
    left = f", {summary['missing']} missing: --resume runs them" if summary["missing"] else ""
    lines.append(f"{summary['recorded']} of {summary['planned']} trials, {summary['errors']} errors{left}")
    return "\n".join([*lines, f"  {out}/: report.html, summary.json, trials.csv, trials.jsonl, trials/"])


def main(arguments: Optional[Sequence[str]] = None, command: Sequence[str] = LAUNCH_COMMAND) -> int:
    """Entry of scripts/evaluate; see HELP."""
    interrupted = "nothing that has finished is lost; --resume goes on"
    run = functools.partial(run_campaign, command=command)
    return run_program(Program("evaluate", HELP, parse_options, run, interrupted), arguments)

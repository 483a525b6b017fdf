#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""./core.sh bench soundness [--steps N] [--profile core|paper] [--case NAME] [--jobs N] [--out DIR]: is the robot kept
out.

Random grids, random and aimed nominal commands, exact motion, the shipped CbfFilter.step and nothing else. Cases:

    point                     the base point, commands take effect at once
    footprint                 the 1.1 x 0.5 m rectangle
    footprint_lag             and a lag of 0.3 s and a delay of 0.1 s, both known to the filter
    footprint_lag_wrong_tau   and the plant's lag is 0.2 or 0.4 s; the margins grow by |error| |v|max
    revealed_map              the map is revealed as the robot goes, hazards right before it too, and cells flicker

The steps are run in shards of seeds whose tallies are kept in DIR, in a folder named by a hash of the filter's code,
its parameters and the cases. What is there is not run again: --steps N continues where an earlier run ended, Ctrl-C
loses the shards in work (a few seconds each), and a changed filter starts anew.

A table goes to stderr; the last line on stdout is one JSON object: per profile and case

    steps violating_steps violating_episodes    steps in which the robot overlapped a cell the filter knew to be unsafe
    avoidable_violating_steps                   of these, those that a stop at the first tick of knowledge had spared
    passthrough passthrough_reference           share of commands sent unchanged; that of a design of three discs, one
                                                gradient row each and a distance field lowered by
                                                sqrt(2) cell + (lag + delay) |v|max, same gain, same episodes
    passthrough_reference_slewed                of the same design, held to the shipped filter's limits of acceleration
    mean_speed_mps stopped_steps                mean speed sent; steps in which the filter stopped with a reason
    bad_seeds                                   first seeds of run_episode with a step that counts against the bar

Exit code 1 when a bar is not met: no violating step in the static cases and no avoidable one in revealed_map with
profile core, passthrough >= 0.9 of the reference's. Profile paper has no bar: its violations are the paper's.
"""

import argparse
import itertools
import math
import multiprocessing
import os
import signal
import sys
from pathlib import Path

from tqdm import tqdm

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "src" / "core_control" / "test"))
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "src" / "core_control" / "src"))

from soundness_cases import CASES, EPISODE_STEPS, PROFILES
from soundness_shards import SHARD_EPISODES, ShardFile, compute_key, run_shard

from core_bringup.evaluation.bars import finish, judge

ROOT = Path(__file__).resolve().parents[2]
REFERENCES = ("reference", "reference_slewed")
REFERENCE_STEPS = 20000
PASSTHROUGH_BAR = 0.9
LISTED_SEEDS = 20


def run_numbered(job):
    """Number and tally of one shard (case, profile, number, design)."""
    return job[2], run_shard(*job)


def run_case(pool, folder, case, profile, steps, design="shipped"):
    """Tally over the shards there are and as many more as the steps need."""
    label = f"{profile}_{case}_{design}"
    shards = ShardFile(folder / f"{label}.jsonl")
    bar = tqdm(total=steps, initial=min(shards.tally.steps, steps), desc=label, unit="step", unit_scale=True)
    with bar:
        while shards.tally.steps < steps:
            count = math.ceil((steps - shards.tally.steps) / (SHARD_EPISODES * EPISODE_STEPS))
            jobs = [(case, profile, number, design) for number in itertools.islice(shards.find_missing(), count)]
            for number, tally in pool.imap_unordered(run_numbered, jobs):
                shards.append(number, tally)
                bar.update(tally.steps)
    return shards.tally


def describe(tally, references):
    """Figures of one case, and the passthrough of the designs of comparison."""
    return {
        "steps": tally.steps,
        "violating_steps": tally.violating_steps,
        "avoidable_violating_steps": tally.avoidable_violating_steps,
        "episodes": tally.episodes,
        "violating_episodes": tally.violating_episodes,
        "passthrough": round(tally.passed / tally.steps, 4),
        **{f"passthrough_{design}": round(other.passed / other.steps, 4) for design, other in references.items()},
        "mean_speed_mps": round(tally.speed_sum_mps / tally.steps, 4),
        "stopped_steps": tally.stopped,
        "bad_seeds": sorted(tally.bad_seeds)[:LISTED_SEEDS],
    }


def judge_cases(cases):
    """Bars of profile core."""
    bars = {}
    for name, figures in cases.items():
        counted = "avoidable_violating_steps" if CASES[name].revealed else "violating_steps"
        bars[f"{name}.{counted}"] = (figures[counted], "==", 0)
        least = PASSTHROUGH_BAR * figures["passthrough_reference"]
        bars[f"{name}.passthrough"] = (figures["passthrough"], ">=", round(least, 4))
    return judge(bars)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=10**6, help="of each case")
    parser.add_argument("--profile", choices=sorted(PROFILES), action="append", help="default: both")
    parser.add_argument("--case", choices=sorted(CASES), action="append", help="default: all")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument(
        "--out", type=Path, default=ROOT / "results" / "bench" / "soundness", help="default: %(default)s"
    )
    options = parser.parse_args()
    if options.steps < 1 or options.jobs < 1:
        parser.error("--steps and --jobs: allowed >= 1")
    folder = options.out / compute_key()
    print(f"soundness: shards in {folder}", file=sys.stderr)
    try:
        results = run_all(options, folder)
    except KeyboardInterrupt:
        print("soundness: interrupted; the same command goes on from here", file=sys.stderr)
        return 130
    show(results)
    return finish(results, judge_cases(results.get("core", {})))


def run_all(options, folder):
    """Figures of every profile and case asked for."""
    results = {"bench": "soundness", "key": folder.name}
    # An interrupt is the parent's to handle.
    with multiprocessing.Pool(options.jobs, signal.signal, (signal.SIGINT, signal.SIG_IGN)) as pool:
        for profile in options.profile or sorted(PROFILES):
            cases = results[profile] = {}
            for case in options.case or list(CASES):
                tally = run_case(pool, folder, case, profile, options.steps)
                steps = min(options.steps, REFERENCE_STEPS)
                designs = REFERENCES if profile == "core" else ()
                references = {design: run_case(pool, folder, case, profile, steps, design) for design in designs}
                cases[case] = describe(tally, references)
    return results


def show(results):
    columns = ("steps", "violating_steps", "avoidable_violating_steps", "violating_episodes", "episodes", "passthrough",
               "passthrough_reference", "passthrough_reference_slewed", "mean_speed_mps")  # fmt: skip
    labels = ("steps", "violating", "avoidable", "bad episodes", "episodes", "passthrough", "reference", "ref. slewed",
              "speed [m/s]")  # fmt: skip
    print(f"{'':32}" + " ".join(f"{label:>14}" for label in labels), file=sys.stderr)
    for profile, cases in ((p, results[p]) for p in PROFILES if p in results):
        for case, figures in cases.items():
            values = " ".join(f"{figures.get(c, '-'):>14}" for c in columns)
            print(f"{profile + ' ' + case:32}{values}", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main())

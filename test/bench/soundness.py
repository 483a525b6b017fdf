#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""./core.sh bench soundness [--steps N] [--profile core|paper] [--case NAME] [--jobs N]: is the robot kept out.

Random grids, random and aimed nominal commands, exact motion, the shipped CbfFilter.step and nothing else. Cases:

    point                     the base point, commands take effect at once
    footprint                 the 1.1 x 0.5 m rectangle
    footprint_lag             and a lag of 0.3 s and a delay of 0.1 s, both known to the filter
    footprint_lag_wrong_tau   and the plant's lag is 0.2 or 0.4 s; the margins grow by |error| |v|max
    revealed_map              the map is revealed as the robot goes, hazards right before it too, and cells flicker

A table goes to stderr; the last line on stdout is one JSON object: per profile and case

    steps violating_steps violating_episodes    steps in which the robot overlapped a cell the filter knew to be unsafe
    avoidable_violating_steps                   of these, those that a stop at the first tick of knowledge had spared
    passthrough passthrough_reference           share of commands sent unchanged; that of a design of three discs, one
                                                gradient row each and a distance field lowered by
                                                sqrt(2) cell + (lag + delay) |v|max, same gain, same episodes
    mean_speed_mps stopped_steps                mean speed sent; steps in which the filter stopped with a reason

Exit code 1 when a bar is not met: no violating step in the static cases and no avoidable one in revealed_map with
profile core, passthrough >= 0.9 of the reference's. Profile paper has no bar: its violations are the paper's.
"""

import argparse
import math
import multiprocessing
import os
import sys
from pathlib import Path

from tqdm import tqdm

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "src" / "core_control" / "test"))
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "src" / "core_control" / "src"))

from soundness_cases import CASES, EPISODE_STEPS, PROFILES, Tally, run_episode

from core_bringup.evaluation.bars import finish, judge

REFERENCE_STEPS = 20000
PASSTHROUGH_BAR = 0.9


def run_numbered(job):
    """One episode of (case, profile, seed, reference)."""
    case, profile, seed, reference = job
    return run_episode(case, profile, seed, EPISODE_STEPS, reference)


def run_episodes(pool, case, profile, steps, reference=False):
    """Tally over as many episodes as the steps fill; a world without room for the robot gives none."""
    whole, seed = Tally(), 0
    label = f"{profile} {case}" + (" reference" if reference else "")
    with tqdm(total=steps, desc=label, unit="step", unit_scale=True, file=sys.stderr) as bar:
        while whole.steps < steps:
            count = math.ceil((steps - whole.steps) / EPISODE_STEPS)
            jobs = [(case, profile, seed + i, reference) for i in range(count)]
            for tally in pool.imap_unordered(run_numbered, jobs):
                whole.add(tally)
                bar.update(tally.steps)
            seed += count
    return whole


def describe(tally, reference):
    """Figures of one case."""
    return {
        "steps": tally.steps,
        "violating_steps": tally.violating_steps,
        "avoidable_violating_steps": tally.avoidable_violating_steps,
        "episodes": tally.episodes,
        "violating_episodes": tally.violating_episodes,
        "passthrough": round(tally.passed / tally.steps, 4),
        "passthrough_reference": reference and round(reference.passed / reference.steps, 4),
        "mean_speed_mps": round(tally.speed_sum_mps / tally.steps, 4),
        "stopped_steps": tally.stopped,
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
    options = parser.parse_args()
    if options.steps < 1 or options.jobs < 1:
        parser.error("--steps and --jobs: allowed >= 1")
    results = {"bench": "soundness", "steps": options.steps}
    with multiprocessing.Pool(options.jobs) as pool:
        for profile in options.profile or sorted(PROFILES):
            cases = results[profile] = {}
            for case in options.case or list(CASES):
                tally, reference = run_episodes(pool, case, profile, options.steps), None
                if profile == "core":
                    reference = run_episodes(pool, case, profile, min(options.steps, REFERENCE_STEPS), True)
                cases[case] = describe(tally, reference)
    show(results)
    return finish(results, judge_cases(results.get("core", {})))


def show(results):
    columns = ("steps", "violating_steps", "avoidable_violating_steps", "violating_episodes", "episodes", "passthrough",
               "passthrough_reference", "mean_speed_mps")  # fmt: skip
    print(f"{'':32}" + " ".join(f"{c[:14]:>14}" for c in columns), file=sys.stderr)
    for profile, cases in ((p, results[p]) for p in PROFILES if p in results):
        for case, figures in cases.items():
            values = " ".join(f"{'-' if figures[c] is None else figures[c]:>14}" for c in columns)
            print(f"{profile + ' ' + case:32}{values}", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main())

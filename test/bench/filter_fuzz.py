#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""./core.sh bench filter_fuzz [--inputs N] [--seed S] [--jobs N] [--case NAME]: bad inputs for the shipped filter.

Sound inputs of which a few fields are corrupted (NaN, infinity, 1e308, nothing, arrays of the wrong size, stamps of
another clock, rows that exclude each other), so that most get past the first check. Cases, with their share of N:

    core, core_laggy, paper        messages -> conversions -> CbfFilter.step -> messages that can be sent
    core_cvxpy, paper_cvxpy        the same with solver cvxpy, a small share: it is slow
    library:core, library:paper    FilterInputs that no node would make
    qp, qp_one_row, qp_cvxpy       VelocityQp.solve

A table goes to stderr; the last line on stdout is one JSON object: the counts over all cases, and per case in "cases":

    non_finite out_of_limit crashes        commands that are no number or beyond a limit; exceptions that got out
    moved_on_failed_check                  not zero though an input had to stop the robot, or the program failed
    broken_rows                            answers of the program outside a row
    inputs must_stop moved                 corrupted inputs; ticks no motion may follow; ticks that moved
    reached_program reached_verifier       how many got that deep
    refused_by_program internal_errors     programs without an answer that can be used; exceptions caught inside a tick
    examples                               the first inputs behind a figure that is not zero

Every shard has its own seed, so that the same --inputs and --seed give the same counts with any --jobs.
Exit code 1 when a bar is not met.
"""

import argparse
import math
import multiprocessing
import os
import sys
from pathlib import Path

from tqdm import tqdm

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "src" / "core_control" / "test"))

from fuzz_cases import CASES, Tally, run_case

from core_bringup.evaluation.bars import finish, judge

SHARD_INPUTS = 2000
NEVER = ("non_finite", "out_of_limit", "crashes", "moved_on_failed_check", "broken_rows")
# Shares of all inputs that must get this deep; fuzz that the first check turns away says little.
DEPTH_BARS = {"reached_program": 0.25, "reached_verifier": 0.2}


def make_jobs(cases, inputs, seed):
    """Shards (case, seed, count) that hold every case's share of the inputs, the seed unlike any other's."""
    total = sum(CASES[case][1] for case in cases)
    jobs = []
    for case in cases:
        number = list(CASES).index(case)
        count = math.ceil(inputs * CASES[case][1] / total)
        for shard, start in enumerate(range(0, count, SHARD_INPUTS)):
            jobs.append((case, (seed, number, shard), min(SHARD_INPUTS, count - start)))
    return jobs


def run_numbered(job):
    """The shard's case and its tally."""
    return job[0], run_case(job)


def describe(tally):
    """Counts of a tally for the JSON object."""
    counts = {name: value for name, value in vars(tally).items() if name not in ("reasons", "examples")}
    return {**counts, "reasons": dict(tally.reasons)}


def show(results):
    columns = ("inputs", *NEVER, "must_stop", "moved", "reached_program", "reached_verifier", "refused_by_program",
               "internal_errors")  # fmt: skip
    print(" ".join(["case".ljust(14), *(name.rjust(len(name)) for name in columns)]), file=sys.stderr)
    for case, counts in {**results["cases"], "all": results}.items():
        print(" ".join([case.ljust(14), *(str(counts[name]).rjust(len(name)) for name in columns)]), file=sys.stderr)
    for example in results["examples"]:
        print(f"  {example}", file=sys.stderr)


def judge_results(results, with_depth):
    bars = {name: (results[name], "==", 0) for name in NEVER}
    bars["inputs"] = (results["inputs"], ">=", results["inputs_asked"])
    if with_depth:
        bars.update({name: (results[name], ">=", share * results["inputs"]) for name, share in DEPTH_BARS.items()})
    return judge(bars)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--inputs", type=int, default=10**6, help="corrupted inputs over all cases")
    parser.add_argument(
        "--seed", type=int, default=int(os.environ.get("CORE_SEED", "0")), help="default: CORE_SEED or 0"
    )
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--case", choices=sorted(CASES), action="append", help="default: all")
    options = parser.parse_args()
    if options.inputs < 1 or options.jobs < 1 or options.seed < 0:
        parser.error("--inputs and --jobs: allowed >= 1; --seed: allowed >= 0")
    cases = options.case or list(CASES)
    tallies, whole = {case: Tally() for case in cases}, Tally()
    with multiprocessing.Pool(options.jobs) as pool, tqdm(
        total=options.inputs, unit="input", unit_scale=True, file=sys.stderr
    ) as bar:
        for case, tally in pool.imap_unordered(run_numbered, make_jobs(cases, options.inputs, options.seed)):
            tallies[case].add(tally)
            whole.add(tally)
            bar.update(tally.inputs)
    results = {"bench": "filter_fuzz", "seed": options.seed, "inputs_asked": options.inputs, **describe(whole)}
    results["examples"], results["cases"] = whole.examples, {case: describe(tally) for case, tally in tallies.items()}
    show(results)
    return finish(results, judge_results(results, options.case is None))


if __name__ == "__main__":
    sys.exit(main())

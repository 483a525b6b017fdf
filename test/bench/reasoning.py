#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""./core.sh bench reasoning [--cases N] [--seed S]: parser, memory, injected text, ontology, arrangement, emulation.

Progress goes to stderr; the last line on stdout is one JSON object. Exit code 1 when a bar is not met. Keys and bars:

    fuzz        cases (100 000), crashes 0, shrinks 0: a void reply, or fewer than M good ones, never shrinks what is
                unsafe; with how many were valid and void, by cause
    injection   cases, hazards_cleared_early 0, rules_cleared 0, wrongly_safe 0: nothing held or ordered is cleared in
                fewer than M replies
    ontology    accuracy >= 0.92 on the held-out names, hazards_called_navigable 0, ms_per_frame <= 5; arrangements:
                line >= 0.99, arc >= 0.95, ring >= 0.99, corner >= 0.90, scatter (n >= 4), lane <= 0.02
    emulated    rates and latency of 10 000 replies with the interval around the table's figures
    bars        each of these with figure, bar and met
"""

import argparse
import os
import sys
from pathlib import Path

from tqdm import tqdm

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "src" / "core_perception" / "test"))

import emulated_stats
import injection_cases
import ontology_bench
import reply_fuzz

from core_bringup.evaluation.bars import finish, judge

LEAST_FOUND = {"line": 0.99, "arc": 0.95, "ring": 0.99, "corner": 0.90}


def judge_results(results):
    """Every bar of this bench: its figure, what it must be, and whether it is."""
    fuzz, injection, ontology = results["fuzz"], results["injection"], results["ontology"]
    shapes = ontology["arrangements"]
    figures = {
        "fuzz_crashes": (fuzz["crashes"], "==", 0),
        "fuzz_shrinks": (fuzz["shrinks"] + fuzz["hasty"] + fuzz["unheeded"] + fuzz["unearned_safe"], "==", 0),
        "fuzz_misread": (fuzz["misread"] + fuzz["spoilt_but_valid"], "==", 0),
        "injection_cleared": (injection["hazards_cleared_early"] + injection["rules_cleared"], "==", 0),
        "injection_wrongly_safe": (injection["wrongly_safe"], "==", 0),
        "names_right": (ontology["accuracy"], ">=", 0.92),
        "hazards_called_navigable": (ontology["hazards_called_navigable"], "==", 0),
        "ms_per_frame": (ontology["ms_per_frame"], "<=", 5.0),
        **{name: (shapes[name], ">=", least) for name, least in LEAST_FOUND.items()},
        **{name: (shapes[name], "<=", 0.02) for name in ("scatter_3m", "scatter_6m", "lane")},
        "emulated_agrees": (int(results["emulated"]["agrees"]), "==", 1),
    }
    return judge({name: (round(figure, 4), sign, limit) for name, (figure, sign, limit) in figures.items()})


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=100000, help="fuzzed replies")
    parser.add_argument("--replies", type=int, default=10000, help="emulated replies")
    parser.add_argument("--seed", type=int, default=int(os.environ.get("CORE_SEED", "0")))
    options = parser.parse_args()
    if options.cases < 1 or options.replies < 1:
        parser.error("--cases and --replies: allowed >= 1")
    parts = {
        "fuzz": lambda: reply_fuzz.run(options.cases, options.seed),
        "injection": injection_cases.run,
        "ontology": ontology_bench.run,
        "emulated": lambda: emulated_stats.run(options.replies),
    }
    results = {"bench": "reasoning", "seed": options.seed}
    for name, run in tqdm(parts.items(), file=sys.stderr, desc="reasoning", unit="part"):
        results[name] = run()
    return finish(results, judge_results(results))


if __name__ == "__main__":
    sys.exit(main())

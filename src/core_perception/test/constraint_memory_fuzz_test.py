# SPDX-License-Identifier: BSD-3-Clause
"""Fuzzed replies through reader and memory; CORE_FUZZ_CASES sets how many, CORE_SEED which."""

import os

import reply_fuzz

CASES = int(os.environ.get("CORE_FUZZ_CASES", "5000"))
SEED = int(os.environ.get("CORE_SEED", "0"))


def test_fuzz_no_reply_crashes_and_no_void_or_early_one_shrinks_what_is_unsafe():
    counts = reply_fuzz.run(CASES, SEED)
    assert {fault: counts[fault] for fault in reply_fuzz.FAULTS} == dict.fromkeys(reply_fuzz.FAULTS, 0), counts
    assert counts["valid"] + counts["void"] == counts["cases"] == CASES
    # The judge had something to judge.
    assert min(counts["valid"], counts["void"]) > 0.2 * CASES and counts["cleared"] > 0.05 * CASES


def test_fuzz_repeats_with_its_seed():
    first = reply_fuzz.run(400, SEED)
    assert first == reply_fuzz.run(400, SEED) != reply_fuzz.run(400, SEED + 1)

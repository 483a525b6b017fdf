# SPDX-License-Identifier: BSD-3-Clause
"""Runs of the demo side by side, each in fresh processes; for system tests that compare two."""

import csv
import json
import subprocess
from pathlib import Path


def run_side_by_side(folder, *runs):
    """Start one kinematic demo per list of name:=value words and wait for all.

    Returns:
        (result.json's content, rows of trajectory.csv as dictionaries of numbers) of each.

    Raises:
        AssertionError: one of them did not complete; with the end of what it said.
    """
    started = []
    for k, words in enumerate(runs):
        results = Path(folder) / str(k)
        command = ["rosrun", "core_bringup", "demo", "backend:=kinematic", "pictures:=never", "results:=%s" % results]
        process = subprocess.Popen([*command, *words], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        started.append((results, process))
    said = [process.communicate()[0] for _results, process in started]
    for (_results, process), text in zip(started, said):
        assert process.returncode == 0, text[-2000:]
    return [read(results) for results, _process in started]


def read(results):
    result = json.loads((results / "result.json").read_text())
    with (results / "trajectory.csv").open() as file:
        rows = [{key: to_number(text) for key, text in row.items()} for row in csv.DictReader(file)]
    return result, rows


def to_number(text):
    try:
        return float(text)
    except ValueError:
        return text

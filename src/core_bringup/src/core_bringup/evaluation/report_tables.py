# SPDX-License-Identifier: BSD-3-Clause
"""The tables of a campaign's report, as plain rows: counts n / N with Wilson intervals, never a bare percentage."""

from __future__ import annotations

import statistics
from dataclasses import dataclass
from typing import Dict, List, Mapping, Optional, Sequence, Tuple

from core_bringup.evaluation.summary import wilson_interval

Trial = Mapping[str, object]

# [CORE], table "Simulation results over 60 evaluations", in per cent: total, safe, unsafe, Ctx, Grnd, Enf. The 100 % of
# the last row's Ctx is a share of failures; the other rows give shares of trials.
PAPER_TABLE = {
    "Oracle": (98.3, 100.0, 96.6, 0.0, 1.7, 0.0),
    "CORE": (95.0, 96.6, 93.3, 3.3, 1.7, 0.0),
    "No Context": (55.0, 93.3, 16.6, 43.3, 1.7, 0.0),
    "Geometric": (50.0, 100.0, 0.0, 100.0, 0.0, 0.0),
}
PAPER_ROW = {"oracle": "Oracle", "core": "CORE", "no_context": "No Context", "geometric": "Geometric"}
METHOD_ORDER = {name: i for i, name in enumerate((*PAPER_ROW, "none"))}
SCOPES = {
    "paper": "The twelve tasks of the paper",
    "own": "Our own tasks",
    "heldout": "Held-out arrangements",
}
CAUSES = ("ctx", "grnd", "enf")
# Figure of result.json -> (heading, unit, digits); the table gives medians.
FIGURES = {
    "stop_gap_m": ("stop gap", "m", 2),
    "min_clearance_m": ("clearance", "m", 2),
    "detection_distance_m": ("detection distance", "m", 2),
    "penetration_m": ("depth of violation", "m", 2),
    "violation_time_s": ("time of violation", "s", 1),
    "false_stop_share": ("false stop share", "", 3),
    "min_h_m": ("min h", "m", 2),
    "intervention_mean_mps": ("intervention, mean", "m/s", 3),
    "intervention_max_mps": ("intervention, max", "m/s", 3),
    "intervention_integral_m": ("intervention, integral", "m", 2),
    "path_length_ratio": ("path length ratio", "", 2),
    "jerk_rms_mps3": ("jerk, rms", "m/s³", 1),
    "grid_iou": ("grid IoU", "", 2),
    "sim_time_s": ("time", "s", 1),
    "rtf": ("real-time factor", "", 2),
}


@dataclass(frozen=True)
class Rate:
    """successes of trials, with the Wilson 95 % interval."""

    successes: int
    trials: int

    @property
    def interval(self) -> Tuple[float, float]:
        """Lower and upper end, in 0..1."""
        return wilson_interval(self.successes, self.trials)

    def __str__(self) -> str:
        """Count, share and interval in words; a dash without trials."""
        if not self.trials:
            return "–"
        low, high = self.interval
        share = 100.0 * self.successes / self.trials
        return f"{self.successes}/{self.trials} = {share:.1f} % [{100 * low:.1f}, {100 * high:.1f}]"


def method_name(trial: Trial) -> str:
    """Method of a trial as a heading: the profile is said when it is not the default."""
    profile = trial.get("profile")
    return f"{trial['method']}" + (f" ({profile})" if profile not in ("core", "-", None) else "")


def scope_of(trial: Trial) -> str:
    """'paper', 'own' or 'heldout'."""
    if trial.get("split") == "heldout":
        return "heldout"
    return "paper" if trial.get("number") else "own"


def select(trials: Sequence[Trial], **wanted: object) -> List[Trial]:
    """Trials whose keys have the wanted values."""
    return [trial for trial in trials if all(trial.get(key) == value for key, value in wanted.items())]


def methods_of(trials: Sequence[Trial]) -> List[str]:
    """Headings in the order of the paper's table, others behind; variants of one method by name."""
    bases = {method_name(trial): str(trial["method"]).split(":")[0] for trial in trials}
    return sorted(bases, key=lambda name: (METHOD_ORDER.get(bases[name], len(METHOD_ORDER)), name))


def of_method(trials: Sequence[Trial], name: str) -> List[Trial]:
    """Trials of one heading."""
    return [trial for trial in trials if method_name(trial) == name]


def success_rate(trials: Sequence[Trial]) -> Rate:
    """How many of these succeeded."""
    return Rate(sum(1 for trial in trials if trial.get("success")), len(trials))


def build_main_table(trials: Sequence[Trial], scope: str) -> List[Dict[str, object]]:
    """One row per method of a scope: rates, causes of failure and, for the paper's tasks, the paper's own row."""
    chosen = [trial for trial in trials if scope_of(trial) == scope]
    rows = []
    for name in methods_of(chosen):
        own = of_method(chosen, name)
        row: Dict[str, object] = {"method": name, "errors": len(select(own, outcome="error"))}
        row["total"] = success_rate(own)
        for expectation in ("safe", "unsafe"):
            row[expectation] = success_rate(select(own, expectation=expectation))
        row.update({cause: Rate(len(select(own, attribution=cause)), len(own)) for cause in CAUSES})
        base = PAPER_ROW.get(str(own[0]["method"]).split(":")[0])
        row["paper"] = PAPER_TABLE[base] if base and scope == "paper" else None
        row["paper_name"] = base
        rows.append(row)
    return rows


def build_task_grid(trials: Sequence[Trial]) -> List[Dict[str, object]]:
    """One row per task, in the order paper's number, then name: a cell per method with successes and outcomes."""
    names = methods_of(trials)
    keys = {(scope_of(t), t.get("number") or 99, t.get("world", ""), t["task"], t.get("expectation")) for t in trials}
    rows = []
    for scope, number, world, task, expectation in sorted(keys, key=lambda k: (list(SCOPES).index(k[0]), *k[1:])):
        own = select(trials, task=task, world=world)
        cells = [_grid_cell(of_method(own, name)) for name in names]
        rows.append({"scope": SCOPES[scope], "number": "" if number == 99 else number, "world": world, "task": task,
                     "expectation": expectation, "cells": cells})  # fmt: skip
    return rows


def _grid_cell(trials: Sequence[Trial]) -> Optional[Dict[str, object]]:
    if not trials:
        return None
    outcomes: Dict[str, int] = {}
    for trial in trials:
        outcomes[str(trial["outcome"])] = outcomes.get(str(trial["outcome"]), 0) + 1
    rate = success_rate(trials)
    words = ", ".join(f"{count} {name}" for name, count in sorted(outcomes.items()))
    return {"rate": f"{rate.successes}/{rate.trials}", "share": rate.successes / rate.trials, "outcomes": words}


def build_figure_table(trials: Sequence[Trial]) -> Tuple[List[str], List[Dict[str, object]]]:
    """Medians of FIGURES per method; a dash where no trial has the figure."""
    headings = [f"{name}{f' [{unit}]' if unit else ''}" for name, unit, _ in FIGURES.values()]
    rows = []
    for name in methods_of(trials):
        own = of_method(trials, name)
        cells = [_median(own, key, digits) for key, (_, _, digits) in FIGURES.items()]
        falls = sum(1 for trial in own if trial.get("fallen"))
        rows.append({"method": name, "trials": len(own), "falls": falls, "cells": cells})
    return headings, rows


def _median(trials: Sequence[Trial], key: str, digits: int) -> str:
    values = [float(trial[key]) for trial in trials if isinstance(trial.get(key), (int, float))]
    return f"{statistics.median(values):.{digits}f}" if values else "–"


def markdown_table(trials: Sequence[Trial], scope: str = "paper") -> str:
    """The main table of a scope in Markdown, with the paper's figures in brackets behind ours."""
    head = "| Method | Total | Safe tasks | Unsafe tasks | Ctx | Grnd | Enf | Errors |"
    lines = [head, "|---|---|---|---|---|---|---|---|"]
    for row in build_main_table(trials, scope):
        cells = [str(row[key]) for key in ("total", "safe", "unsafe")]
        if row["paper"]:
            cells = [f"{cell} (paper {value:g} %)" for cell, value in zip(cells, row["paper"])]
        cells += [f"{row[cause].successes}" for cause in CAUSES] + [str(row["errors"])]
        lines.append(f"| {row['method']} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"

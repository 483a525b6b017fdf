# SPDX-License-Identifier: BSD-3-Clause
"""The tables of a campaign's report, as plain rows: counts n / N with Wilson intervals, never a bare percentage."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Dict, List, Mapping, Optional, Sequence, Tuple

from core_bringup.evaluation.summary import ATTRIBUTIONS, method_heading, summarize, wilson_interval

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
    """Method of a trial as a heading."""
    return method_heading(trial["method"], trial["profile"])


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
    return [method_heading(row["name"], row["profile"]) for row in _method_rows(trials)]


def of_method(trials: Sequence[Trial], name: str) -> List[Trial]:
    """Trials of one heading."""
    return [trial for trial in trials if method_name(trial) == name]


def _method_rows(trials: Sequence[Trial]) -> List[Mapping[str, object]]:
    """The rows of summary.json in the order of methods_of."""

    def place(row: Mapping[str, object]) -> Tuple[int, str]:
        return METHOD_ORDER.get(_base(row["name"]), len(METHOD_ORDER)), method_heading(row["name"], row["profile"])

    return sorted(summarize(trials)["methods"], key=place)


def _base(name: object) -> str:
    return str(name).split(":")[0]


def build_main_table(trials: Sequence[Trial], scope: str) -> List[Dict[str, object]]:
    """One row per method of a scope: rates, causes of failure and, for the paper's tasks, the paper's own row."""
    rows = []
    for counts in _method_rows([trial for trial in trials if scope_of(trial) == scope]):
        paper_name = PAPER_ROW.get(_base(counts["name"]))
        rows.append(
            {
                "method": method_heading(counts["name"], counts["profile"]),
                "errors": counts["errors"],
                "total": Rate(counts["success"], counts["n"]),
                "safe": Rate(counts["safe_success"], counts["safe_n"]),
                "unsafe": Rate(counts["unsafe_success"], counts["unsafe_n"]),
                **{cause: Rate(counts[cause], counts["n"]) for cause in ATTRIBUTIONS},
                "paper": PAPER_TABLE[paper_name] if paper_name and scope == "paper" else None,
                "paper_name": paper_name,
            }
        )
    return rows


def build_task_grid(trials: Sequence[Trial]) -> List[Dict[str, object]]:
    """One row per task, in the order paper's number, then name: a cell per method with successes and outcomes."""
    names, rows = methods_of(trials), []
    for task in sorted(summarize(trials)["tasks"], key=_task_place):
        cells = {method_heading(m["name"], m["profile"]): _grid_cell(m) for m in task["methods"]}
        number = task["number"] if scope_of(task) == "paper" else ""
        own = {"scope": SCOPES[scope_of(task)], "number": number, "cells": [cells.get(name) for name in names]}
        rows.append({**{key: task[key] for key in ("world", "task", "expectation")}, **own})
    return rows


def _task_place(task: Mapping[str, object]) -> Tuple[int, int, str, str]:
    return list(SCOPES).index(scope_of(task)), int(task["number"] or 0), str(task["world"]), str(task["task"])


def _grid_cell(counts: Mapping[str, object]) -> Dict[str, object]:
    words = ", ".join(f"{count} {name}" for name, count in counts["outcomes"].items())
    return {"rate": f"{counts['success']}/{counts['n']}", "share": counts["success_rate"], "outcomes": words}


def build_figure_table(trials: Sequence[Trial]) -> Tuple[List[str], List[Dict[str, object]]]:
    """Medians of FIGURES per method; a dash where no trial has the figure."""
    headings = [f"{name}{f' [{unit}]' if unit else ''}" for name, unit, _ in FIGURES.values()]
    rows = []
    for counts in _method_rows(trials):
        cells = [_figure(counts[f"median_{key}"], digits) for key, (_, _, digits) in FIGURES.items()]
        name = method_heading(counts["name"], counts["profile"])
        rows.append({"method": name, "trials": counts["n"], "falls": counts["falls"], "cells": cells})
    return headings, rows


def _figure(value: Optional[float], digits: int) -> str:
    return "–" if value is None else f"{value:.{digits}f}"


def markdown_table(trials: Sequence[Trial], scope: str = "paper") -> str:
    """The main table of a scope in Markdown, with the paper's figures in brackets behind ours."""
    head = "| Method | Total | Safe tasks | Unsafe tasks | Ctx | Grnd | Enf | Errors |"
    lines = [head, "|---|---|---|---|---|---|---|---|"]
    for row in build_main_table(trials, scope):
        cells = [str(row[key]) for key in ("total", "safe", "unsafe")]
        if row["paper"]:
            cells = [f"{cell} (paper {value:g} %)" for cell, value in zip(cells, row["paper"])]
        cells += [f"{row[cause].successes}" for cause in ATTRIBUTIONS] + [str(row["errors"])]
        lines.append(f"| {row['method']} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"

# SPDX-License-Identifier: BSD-3-Clause
"""What the demo prints: the progress line, the table of one run, the counts of many."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Dict, List, Mapping, Optional, Sequence

from core_bringup.evaluation.trial import OUTCOMES

NOBODY = "nobody, roslaunch.log says why"
NOBODY_ASKED = "nobody: the method has no reasoner"


def format_progress(progress: Mapping[str, object]) -> str:
    """Distance to the goal, h, mode and the rule that binds, in one short piece of text.

    Args:
        progress: what trial_monitor prints behind the word ``progress``.
    """
    parts = [f"goal {_number(progress.get('goal_distance_m'), 'm')}", f"h {_number(progress.get('h_m'), 'm')}"]
    parts.append(str(progress.get("mode") or "-"))
    rule = progress.get("rule") or progress.get("reason")
    if rule:
        parts.append(str(rule))
    return "  ".join(parts)


def format_table(result: Mapping[str, object], folder: Path) -> str:
    """The table at the end of one run: one row per figure."""
    rows = [
        ("outcome", f"{result.get('outcome')}" + (f"  ({result['end_detail']})" if result.get("end_detail") else "")),
        ("who answered", _name_source(result)),
        ("smallest clearance", _number(result.get("min_clearance_m"), "m")),
        ("stop gap", _number(result.get("stop_gap_m"), "m")),
        ("goal distance", _number(result.get("goal_distance_m"), "m")),
        ("interventions", str(result.get("interventions"))),
        ("false stops", str(result.get("false_stops"))),
        ("sim time", _number(result.get("sim_time_s"), "s")),
        ("real-time factor", _number(result.get("rtf"), "")),
        ("files", f"{folder}/: {', '.join(list_files(folder))}"),
    ]
    width = max(len(name) for name, _ in rows)
    return "\n".join(f"  {name.ljust(width)}  {text}" for name, text in rows)


def list_files(folder: Path) -> List[str]:
    """Names of the files of a run, the result first."""
    wanted = (
        "result.json",
        "topdown.png",
        "frame_1.png",
        "frame_2.png",
        "frame_3.png",
        "trajectory.csv",
        "roslaunch.log",
    )
    return [name for name in wanted if (Path(folder) / name).is_file()]


def format_seed_line(result: Mapping[str, object]) -> str:
    """One line for one seed of many."""
    parts = [
        f"seed {result.get('seed'):>3}",
        f"{result.get('outcome'):<9}",
        f"stop gap {_number(result.get('stop_gap_m'), 'm'):>7}",
        f"clearance {_number(result.get('min_clearance_m'), 'm'):>7}",
        f"false stops {result.get('false_stops', '-')}",
        f"sim {_number(result.get('sim_time_s'), 's'):>8}",
        f"rtf {_number(result.get('rtf'), '')}",
    ]
    if result.get("outcome") == "error":
        parts.append(str(result.get("end_detail")))
    return "  ".join(parts)


def count_outcomes(results: Sequence[Mapping[str, object]]) -> Dict[str, int]:
    """Whole numbers for seeds.json: runs, every outcome, and falls whatever the outcome was."""
    outcomes = Counter(str(result.get("outcome")) for result in results)
    counts = {"runs": len(results)}
    counts.update({name: outcomes[name] for name in OUTCOMES})
    counts["falls"] = sum(1 for result in results if result.get("fallen"))
    counts["false_stops"] = sum(int(result.get("false_stops") or 0) for result in results)
    return counts


def format_counts(counts: Mapping[str, int]) -> str:
    """The last line of a run over seeds: outcomes that occurred as n / N, then falls and false stops."""
    runs = counts["runs"]
    parts = [f"{name} {counts[name]} / {runs}" for name in OUTCOMES if counts[name]]
    return ", ".join(parts + [f"falls {counts['falls']}", f"false stops {counts['false_stops']}"])


def _number(value: Optional[object], unit: str) -> str:
    return "-" if value is None else f"{float(value):.2f} {unit}".rstrip()


def _name_source(result: Mapping[str, object]) -> str:
    nobody = NOBODY_ASKED if result.get("reasoner") == "none" else NOBODY
    return f"{result.get('predicates_source') or nobody}  (reasoner:={result.get('reasoner')})"

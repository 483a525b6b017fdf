# SPDX-License-Identifier: BSD-3-Clause
"""The counts and figures of a campaign: summary.json. Counts are whole numbers, a rate has its interval beside it."""

from __future__ import annotations

import math
import statistics
from collections import Counter
from typing import Dict, Iterable, List, Mapping, Optional, Sequence, Tuple

from core_bringup.evaluation.trial import OUTCOMES

Z_95 = 1.959963984540054  # normal quantile of a two-sided 95 % interval
ATTRIBUTIONS = ("ctx", "grnd", "enf")
SCOPES = (("safe_", "safe"), ("unsafe_", "unsafe"))
# Keys of a trial whose median over the trials of a method is given; stop gaps are those of unsafe tasks.
MEDIAN_KEYS = (
    *("stop_gap_m", "min_clearance_m", "detection_distance_m", "penetration_m", "violation_time_s", "false_stop_share"),
    *("min_h_m", "intervention_mean_mps", "intervention_max_mps", "intervention_integral_m", "path_length_ratio"),
    *("jerk_rms_mps3", "grid_iou", "sim_time_s", "rtf", "wall_s"),
)


def wilson_interval(n: int, total: int) -> Tuple[float, float]:
    """Wilson's 95 % interval of a rate.

        (p + z^2/2N -+ z sqrt(p (1 - p)/N + z^2/4N^2)) / (1 + z^2/N),   p = n/N

    Args:
        n: successes, in 0..total.
        total: trials N; for 0 nothing is known and the interval is (0, 1).

    Returns:
        Lower and upper end, in 0..1.

    Raises:
        ValueError: n is not in 0..total.

    Source: [Wilson].
    """
    if not 0 <= n <= total:
        raise ValueError(f"n: got {n}, allowed 0..{total}")
    if total == 0:
        return 0.0, 1.0
    p, z2 = n / total, Z_95 * Z_95
    centre = p + z2 / (2 * total)
    half = Z_95 * math.sqrt(p * (1.0 - p) / total + z2 / (4 * total * total))
    # At the ends the formula gives 0 and 1 up to rounding.
    low = 0.0 if n == 0 else (centre - half) / (1.0 + z2 / total)
    high = 1.0 if n == total else (centre + half) / (1.0 + z2 / total)
    return low, high


def method_heading(name: object, profile: object) -> str:
    """Method of a row as a heading: the profile is said when it is not the default."""
    return str(name) if profile in ("core", "-") else f"{name} ({profile})"


def summarize(trials: Sequence[Mapping[str, object]], planned: Optional[int] = None) -> Dict[str, object]:
    """The content of summary.json.

    Args:
        trials: what read_trials gives.
        planned: trials of the whole campaign; None: those that are there.

    Returns:
        ``planned, recorded, missing, errors, complete, methods, tasks``.
    """
    planned = len(trials) if planned is None else planned
    return {
        "planned": planned,
        "recorded": len(trials),
        "missing": planned - len(trials),
        "errors": _count(trials, outcome="error"),
        "complete": planned == len(trials),
        "methods": [_method_row(name, profile, own) for (name, profile), own in _grouped(trials, "method", "profile")],
        "tasks": [_task_row(own) for _, own in _grouped(trials, "world", "task")],
    }


def _grouped(trials: Iterable[Mapping[str, object]], *keys: str) -> List[Tuple[Tuple, List[Mapping[str, object]]]]:
    groups: Dict[Tuple, List[Mapping[str, object]]] = {}
    for trial in trials:
        groups.setdefault(tuple(trial.get(key) for key in keys), []).append(trial)
    return list(groups.items())


def _count(trials: Iterable[Mapping[str, object]], **wanted: object) -> int:
    return sum(1 for trial in trials if all(trial.get(key) == value for key, value in wanted.items()))


def _rate(prefix: str, trials: Sequence[Mapping[str, object]]) -> Dict[str, object]:
    n, total = _count(trials, success=True), len(trials)
    low, high = wilson_interval(n, total)
    return {
        f"{prefix}n": total,
        f"{prefix}success": n,
        f"{prefix}success_rate": round(n / total, 4) if total else None,
        f"{prefix}success_interval": [round(low, 4), round(high, 4)],
    }


def _method_row(name: object, profile: object, trials: Sequence[Mapping[str, object]]) -> Dict[str, object]:
    row: Dict[str, object] = {"name": name, "profile": profile, **_rate("", trials)}
    for prefix, expectation in SCOPES:
        row.update(_rate(prefix, [trial for trial in trials if trial.get("expectation") == expectation]))
    row.update({key: _count(trials, attribution=key) for key in ATTRIBUTIONS})
    row["errors"] = _count(trials, outcome="error")
    unsafe = [trial for trial in trials if trial.get("expectation") == "unsafe"]
    row["unsafe_footprint_entered"] = _count(unsafe, outcome="violated")
    row["unsafe_base_entered"] = _count(unsafe, base_entered=True)
    row["falls"] = _count(trials, fallen=True)
    row["false_stops"] = sum(int(trial.get("false_stops") or 0) for trial in trials)
    row["outcomes"] = _outcomes(trials)
    for key in MEDIAN_KEYS:
        row[f"median_{key}"] = _median(unsafe if key == "stop_gap_m" else trials, key)
    return row


def _task_row(trials: Sequence[Mapping[str, object]]) -> Dict[str, object]:
    row = {key: trials[0].get(key) for key in ("world", "task", "number", "category", "split", "expectation")}
    row["methods"] = [
        {"name": name, "profile": profile, **_rate("", own), "outcomes": _outcomes(own)}
        for (name, profile), own in _grouped(trials, "method", "profile")
    ]
    return row


def _outcomes(trials: Sequence[Mapping[str, object]]) -> Dict[str, int]:
    counts = Counter(str(trial.get("outcome")) for trial in trials)
    return {name: counts[name] for name in OUTCOMES if counts[name]}


def _median(trials: Iterable[Mapping[str, object]], key: str) -> Optional[float]:
    values = [float(trial[key]) for trial in trials if isinstance(trial.get(key), (int, float))]
    return round(statistics.median(values), 4) if values else None

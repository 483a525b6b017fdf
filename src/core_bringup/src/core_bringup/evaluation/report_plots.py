# SPDX-License-Identifier: BSD-3-Clause
"""The plots of a campaign's report, each as the text of one SVG image to be put into the page."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from pathlib import Path
from typing import Dict, Mapping, Optional, Sequence, Tuple

import matplotlib

matplotlib.use("Agg")  # no display is needed, and none is opened

import numpy as np  # noqa: E402
from matplotlib.axes import Axes  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402

from core_bringup.evaluation.floor_plan import draw_objects, draw_regions, draw_surfaces  # noqa: E402
from core_bringup.evaluation.report_tables import (  # noqa: E402
    Trial,
    method_name,
    methods_of,
    of_method,
    select,  # noqa: E402
)

COLORS = ("#1d4e89", "#1b7f4b", "#b7791f", "#7a5ea8", "#8a8f95", "#b3001b", "#3f8f8b", "#a65b7a")
BARS = (("total", "all", "#5b6670"), ("safe", "safe", "#1b7f4b"), ("unsafe", "unsafe", "#b3001b"))
PATH_POINTS = 120  # a path is drawn with at most so many points
MARGIN_M = 1.0
# Equal input gives equal text: no date, and names of parts that do not change from run to run.
SVG_STYLE = {"svg.fonttype": "none", "svg.hashsalt": "core", "font.size": 9.0, "font.family": "DejaVu Sans"}


@dataclass(frozen=True)
class Path2D:
    """What the plots need of one trajectory.csv; every array has one value per tick.

    Attributes:
        time_s: sim time [s].
        xy_m: (n, 2) base point [m], odom frame.
        u_nominal_mps, u_safe_mps: linear speed of the nominal and of the filtered command [m/s].
        h_m: barrier value [m], NaN while unknown.
        clearance_m: signed distance from the footprint to the true unsafe region [m].
    """

    time_s: np.ndarray
    xy_m: np.ndarray
    u_nominal_mps: np.ndarray
    u_safe_mps: np.ndarray
    h_m: np.ndarray
    clearance_m: np.ndarray


def read_path(folder: Path) -> Optional[Path2D]:
    """Read trajectory.csv of a trial; None when there is none or it has no tick."""
    path = Path(folder) / "trajectory.csv"
    if not path.is_file():
        return None
    with path.open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    if not rows:
        return None

    def column(name: str) -> np.ndarray:
        return np.array([float(row[name]) for row in rows])

    return Path2D(
        time_s=column("time_s"),
        xy_m=np.stack([column("x_m"), column("y_m")], axis=1),
        u_nominal_mps=np.hypot(column("nominal_vx_mps"), column("nominal_vy_mps")),
        u_safe_mps=np.hypot(column("u_vx_mps"), column("u_vy_mps")),
        h_m=column("h_m"),
        clearance_m=column("clearance_m"),
    )


def method_colors(trials: Sequence[Trial]) -> Dict[str, str]:
    """One colour per method, the same in every plot of a report."""
    return {name: COLORS[i % len(COLORS)] for i, name in enumerate(methods_of(trials))}


def draw_success(rows: Sequence[Mapping[str, object]]) -> str:
    """Share of successes with Wilson intervals: all, safe and unsafe tasks of every row of the main table."""
    figure, axes = _figure(10.0, 3.0)
    width = 0.26
    for k, (key, label, color) in enumerate(BARS):
        for i, row in enumerate(rows):
            rate = row[key]
            if not rate.trials:
                continue
            share, (low, high) = rate.successes / rate.trials, rate.interval
            x = i + (k - 1) * width
            axes.bar(x, 100 * share, width, color=color, alpha=0.8, label=label if i == 0 else None)
            axes.errorbar(x, 100 * share, [[100 * max(share - low, 0)], [100 * max(high - share, 0)]], color="black",
                          capsize=2.5, linewidth=1.0)  # fmt: skip
    axes.set_xticks(range(len(rows)), [row["method"] for row in rows])
    axes.set_ylim(0, 105)
    axes.set_ylabel("success [%]")
    axes.legend(ncols=3, loc="upper right", fontsize=8, framealpha=0.9)
    return _svg(figure)


def draw_distances(trials: Sequence[Trial]) -> str:
    """Distances over the trials of each method: footprint to unsafe region (unsafe tasks) and to the nearest solid."""
    figure, (left, right) = _figure(10.0, 3.2, columns=2)
    _draw_violins(left, select(trials, expectation="unsafe"), lambda t: _signed_gap(t))
    left.set_ylabel("to the unsafe region [m]")
    left.axhline(0.0, color="#b3001b", linewidth=0.8)
    _draw_violins(right, trials, lambda t: t.get("min_clearance_m"))
    right.set_ylabel("to a solid object [m]")
    return _svg(figure)


def _signed_gap(trial: Trial) -> Optional[float]:
    gap, depth = trial.get("stop_gap_m"), trial.get("penetration_m") or 0.0
    return None if gap is None else float(gap) - float(depth)


def _draw_violins(axes: Axes, trials: Sequence[Trial], figure_of) -> None:
    names, colors = methods_of(trials), method_colors(trials)
    for i, name in enumerate(names):
        values = [v for v in (figure_of(t) for t in of_method(trials, name)) if v is not None]
        if len(values) > 1 and max(values) > min(values):
            body = axes.violinplot([values], [i], widths=0.8, showextrema=False)["bodies"][0]
            body.set_facecolor(colors[name])
            body.set_alpha(0.35)
        axes.plot([i] * len(values), values, ".", color=colors[name], markersize=3, alpha=0.7)
    axes.set_xticks(range(len(names)), names, rotation=20, ha="right")


def draw_latency(trials: Sequence[Trial]) -> Optional[str]:
    """Distribution over trials of the latencies' quantiles, per stage; None when no trial has any."""
    stages = sorted({stage for t in trials for stage in (t.get("latency_s") or {})})
    if not stages:
        return None
    figure, panels = _figure(10.0, 3.0, columns=len(stages))
    for axes, stage in zip(np.atleast_1d(panels), stages):
        for name, color in method_colors(trials).items():
            for quantile, style in (("p50", "-"), ("p95", "--"), ("p99", ":")):
                found = [(t.get("latency_s") or {}).get(stage) or {} for t in of_method(trials, name)]
                values = sorted(1e3 * f[quantile] for f in found if isinstance(f.get(quantile), (int, float)))
                if values and values[-1] > 0.0:
                    label = name if quantile == "p50" else None
                    share = np.arange(1, len(values) + 1) / len(values)
                    axes.step(values, share, where="post", color=color, linestyle=style, label=label, linewidth=1.2)
        low, high = axes.dataLim.intervalx
        if high > 10.0 * low > 0.0:
            axes.set_xscale("log")
        axes.set_xlabel(f"{stage} [ms]")
        axes.set_ylim(0, 1.02)
        if axes.get_legend_handles_labels()[0]:  # no method of this campaign has the stage
            axes.legend(fontsize=7)
    np.atleast_1d(panels)[0].set_ylabel("share of trials")
    return _svg(figure)


def draw_paths(world, task, trials: Sequence[Trial], paths: Mapping[str, Path2D], colors: Mapping[str, str]) -> str:
    """Every trial's way on the plan of one task.

    Args:
        world: core_bringup.world.World of the task (World.for_task).
        task: the task.
        trials: trials of this task; their ``id`` is the key into paths.
        paths: trajectories.
        colors: method -> colour.
    """
    figure, axes = _figure(6.4, 4.6)
    draw_surfaces(axes, world.surfaces)
    draw_regions(axes, task.unsafe_regions)
    draw_objects(axes, world.objects)
    shown, names = set(), methods_of(trials)
    # Methods without a filter are drawn first, so that those that were held can be seen on top.
    for trial in sorted(trials, key=lambda t: -names.index(method_name(t))):
        path, name = paths.get(str(trial["id"])), method_name(trial)
        if path is None:
            continue
        step = max(1, len(path.xy_m) // PATH_POINTS)
        points = np.vstack([path.xy_m[::step], path.xy_m[-1:]])
        label = None if name in shown else name
        shown.add(name)
        axes.plot(points[:, 0], points[:, 1], color=colors[name], linewidth=1.1, alpha=0.8, label=label, zorder=7)
        axes.plot(*points[-1], "s", color=colors[name], markersize=3.5, zorder=8)
        entered = np.flatnonzero(path.clearance_m < 0.0)
        if len(entered):
            axes.plot(*path.xy_m[entered[0]], "x", color="#b3001b", markersize=5, zorder=8)
    axes.plot(*task.start_pose[:2], "o", color="black", markersize=5, zorder=9)
    axes.plot(*task.goal_m, "*", color="black", markersize=10, zorder=9)
    low, high = _view(task, trials, paths)
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_aspect("equal")
    if shown:
        axes.legend(fontsize=7, loc="upper center", bbox_to_anchor=(0.5, -0.08), ncols=4, frameon=False)
    return _svg(figure)


def _view(task, trials: Sequence[Trial], paths: Mapping[str, Path2D]) -> Tuple[np.ndarray, np.ndarray]:
    points = [np.reshape(task.start_pose[:2], (1, 2)), np.reshape(task.waypoints_m, (-1, 2))]
    points += [paths[str(t["id"])].xy_m for t in trials if str(t["id"]) in paths]
    every = np.vstack(points)
    low, high = every.min(axis=0) - MARGIN_M, every.max(axis=0) + MARGIN_M
    missing = np.maximum(4.0 - (high - low), 0.0)
    return low - 0.5 * missing, high + 0.5 * missing


def draw_barrier(path: Path2D) -> str:
    """Barrier value and true clearance over time above, nominal and filtered speed below."""
    figure, (top, bottom) = _figure(6.0, 3.8, rows=2)
    time_s = path.time_s - path.time_s[0]
    top.plot(time_s, path.h_m, color="#1d4e89", linewidth=1.3, label="h")
    if np.isfinite(path.clearance_m).any():
        top.plot(time_s, path.clearance_m, color="#b3001b", linewidth=1.0, linestyle="--", label="true clearance")
    top.axhline(0.0, color="black", linewidth=0.7)
    top.set_ylabel("[m]")
    top.legend(fontsize=7)
    bottom.plot(time_s, path.u_nominal_mps, color="#8a8f95", linewidth=1.2, label="|u nominal|")
    bottom.plot(time_s, path.u_safe_mps, color="#1b7f4b", linewidth=1.3, label="|u safe|")
    changed = np.abs(path.u_nominal_mps - path.u_safe_mps) > 0.02
    bottom.fill_between(
        time_s, 0, 1, where=changed, transform=bottom.get_xaxis_transform(), color="#b7791f", alpha=0.15
    )
    bottom.set_ylabel("[m/s]")
    bottom.set_xlabel("sim time [s]")
    bottom.legend(fontsize=7)
    return _svg(figure)


def _figure(width_in: float, height_in: float, rows: int = 1, columns: int = 1):
    with matplotlib.rc_context(SVG_STYLE):
        figure = Figure(figsize=(width_in, height_in), layout="constrained")
        return figure, figure.subplots(rows, columns, sharex=rows > 1)


def _svg(figure: Figure) -> str:
    """Text of the svg element alone, without the prologue of a file."""
    stream = io.StringIO()
    with matplotlib.rc_context(SVG_STYLE):
        figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    text = stream.getvalue()
    return text[text.index("<svg") :]


def read_paths(folder: Path, trials: Sequence[Trial]) -> Dict[str, Path2D]:
    """Trajectories of the trials that have one, by id."""
    found = {str(t["id"]): read_path(Path(folder) / str(t.get("folder", ""))) for t in trials}
    return {key: path for key, path in found.items() if path is not None}

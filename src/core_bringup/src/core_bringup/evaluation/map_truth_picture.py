# SPDX-License-Identifier: BSD-3-Clause
"""The picture of one map against the truth: cells by what they got right and wrong, true outlines over them."""

from __future__ import annotations

from pathlib import Path
from typing import Optional, Sequence

import matplotlib

matplotlib.use("Agg")  # no display is needed, and none is opened

import numpy as np  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402
from matplotlib.lines import Line2D  # noqa: E402
from matplotlib.patches import Patch  # noqa: E402

from core_bringup.evaluation.map_truth import Comparison  # noqa: E402
from core_bringup.evaluation.results import atomic_path  # noqa: E402

NOT_SEEN, SAFE, UNSAFE, OPTIMISTIC, PESSIMISTIC, UNDECIDED = range(6)
COLORS = ("#ffffff", "#dcebdf", "#8f9499", "#d7191c", "#f2b134", "#b9cbe3")
LABELS = (
    "not observed",
    "safe, rightly",
    "unsafe, rightly",
    "safe, wrongly (optimistic)",
    "unsafe, wrongly (pessimistic)",
    "unsafe, the true border on its edge",
)
OUTLINE_COLOR, PATH_COLOR = "#111111", "#2b5fb3"
MARGIN_CELLS = 3


def classify(comparison: Comparison) -> np.ndarray:
    """(rows, columns) number of the colour of every cell."""
    truth, unsafe = comparison.truth_cell, comparison.unsafe
    cells = np.where(truth, np.where(unsafe, UNSAFE, OPTIMISTIC), np.where(unsafe, PESSIMISTIC, SAFE))
    cells = np.where(comparison.undecided, np.where(unsafe, UNDECIDED, SAFE), cells)
    return np.where(comparison.observed, cells, NOT_SEEN)


def draw_comparison(path: Path, comparison: Comparison, path_m: Sequence[np.ndarray], title: str) -> None:
    """Write the picture as PNG: the observed part of the map, the walk, and a ring where the border is worst."""
    cells = classify(comparison)
    rows, columns = (np.flatnonzero(comparison.observed.any(axis=axis)) for axis in (1, 0))
    res_m, (x0, y0) = comparison.raster.resolution_m, comparison.raster.origin
    x_m = [(x0 + c) * res_m for c in (columns[0] - MARGIN_CELLS, columns[-1] + 1 + MARGIN_CELLS)]
    y_m = [(y0 + r) * res_m for r in (rows[0] - MARGIN_CELLS, rows[-1] + 1 + MARGIN_CELLS)]
    width_in = 13.0
    height_in = min(max(width_in * (y_m[1] - y_m[0]) / (x_m[1] - x_m[0]), 4.0), 14.0) + 1.6
    figure = Figure(figsize=(width_in, height_in), dpi=100, layout="compressed")
    axes = figure.add_subplot()
    n_rows, n_columns = cells.shape
    extent = (x0 * res_m, (x0 + n_columns) * res_m, y0 * res_m, (y0 + n_rows) * res_m)
    rgb = np.array([[int(c[i : i + 2], 16) for i in (1, 3, 5)] for c in COLORS], np.uint8)
    axes.imshow(rgb[cells], origin="lower", extent=extent, interpolation="nearest", zorder=0)
    sample_x_m, sample_y_m = comparison.raster.axes_m()
    if comparison.truth.any() and not comparison.truth.all():
        axes.contour(sample_x_m, sample_y_m, comparison.truth, [0.5], colors=OUTLINE_COLOR, linewidths=0.9, zorder=3)
    walked_m = np.array(path_m)
    axes.plot(walked_m[:, 0], walked_m[:, 1], color=PATH_COLOR, linewidth=1.4, zorder=4)
    axes.plot(*walked_m[0], marker="o", color=PATH_COLOR, markersize=5, zorder=4)
    _mark_worst(axes, comparison.worst())
    axes.set_xlim(x_m)
    axes.set_ylim(y_m)
    axes.set_aspect("equal")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    axes.set_title(title, fontsize=11, loc="left")
    handles: list = [Patch(facecolor=c, edgecolor="#999999", label=text) for c, text in zip(COLORS, LABELS)]
    handles += [
        Line2D([], [], color=OUTLINE_COLOR, label="true border"),
        Line2D([], [], color=PATH_COLOR, label="walk"),
    ]
    axes.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, -0.06), ncols=4, fontsize=9, frameon=False)
    with atomic_path(path) as temporary:
        figure.savefig(str(temporary), format="png")


def _mark_worst(axes, worst: Optional[tuple]) -> None:
    if worst is None or worst[0] == 0.0:
        return
    axes.plot(*worst[1], marker="o", markersize=22, fillstyle="none", color="#7b1fa2", markeredgewidth=2.0, zorder=5)
    axes.annotate(f"{worst[0]:.2f} cells", worst[1], xytext=(14, 10), textcoords="offset points", color="#7b1fa2",
                  fontsize=10, zorder=5)  # fmt: skip

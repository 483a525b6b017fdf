# SPDX-License-Identifier: BSD-3-Clause
"""The top-down picture of a run: floor plan, probability map, barrier, path and the true unsafe region."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import List, Mapping, Sequence, Tuple

import matplotlib

matplotlib.use("Agg")  # no display is needed, and none is opened

import numpy as np  # noqa: E402
from matplotlib.axes import Axes  # noqa: E402
from matplotlib.cm import ScalarMappable  # noqa: E402
from matplotlib.collections import LineCollection  # noqa: E402
from matplotlib.colors import LinearSegmentedColormap, Normalize  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402
from matplotlib.lines import Line2D  # noqa: E402
from matplotlib.patches import Circle, Patch, Polygon  # noqa: E402

from core_bringup.evaluation.floor_plan import (  # noqa: E402
    EDGE_COLOR,
    FLOOR_COLOR,
    REGION_COLOR,
    WAY_COLOR,
    class_colors,
    draw_objects,
    draw_regions,
    draw_surfaces,
    draw_ways,
    rectangle_corners,
)
from core_bringup.evaluation.grid_history import GridHistory  # noqa: E402
from core_bringup.evaluation.records import TickRecord  # noqa: E402
from core_bringup.evaluation.results import atomic_path  # noqa: E402
from core_bringup.motion import Poses  # noqa: E402
from core_bringup.regions import region_outline_m  # noqa: E402
from core_bringup.touched import NO_POSES, object_place  # noqa: E402

MARGIN_M = 1.5  # shown around everything that matters
BARRIER_COLOR = "#b3001b"
P_UNSAFE_COLORS = LinearSegmentedColormap.from_list("p_unsafe", ["#4c9f70", "#f3e9a6", "#d1495b"])
PATH_COLORS = "cividis"
OUTCOME_COLORS = {"prevented": "#1b7f4b", "reached": "#1b7f4b", "timid": "#b7791f", "timeout": "#b7791f"}
FAILURE_COLOR = "#b3001b"


@dataclass(frozen=True)
class TopDownScene:
    """What one picture shows.

    Attributes:
        world: core_bringup.world.World as the run saw it (after vary_world).
        task: the task of the run.
        records: every tick; at least one.
        grids: what the safety grids said.
        footprint_m: length and width of the robot [m].
        outcome: word of the outcome, shown first and coloured.
        lines: one or two lines of text for the title.
        poses: of the moving objects at the end.
        ways_m: (n, 2) way of every object that moved, by id.
    """

    world: object
    task: object
    records: Sequence[TickRecord]
    grids: GridHistory
    footprint_m: Tuple[float, float]
    outcome: str
    lines: Tuple[str, ...] = ()
    poses: Poses = field(default_factory=lambda: NO_POSES)
    ways_m: Mapping[int, np.ndarray] = field(default_factory=dict)


def draw_topdown(path: Path, scene: TopDownScene) -> None:
    """Write the picture as PNG.

    Raises:
        ValueError: the scene has no records.
    """
    if not scene.records:
        raise ValueError("a picture needs at least one record")
    x_min, x_max, y_min, y_max = _view(scene)
    width_in = 11.0
    height_in = min(max(width_in * 0.74 * (y_max - y_min) / (x_max - x_min), 4.0), 12.0) + 1.9
    figure = Figure(figsize=(width_in, height_in), dpi=120, layout="constrained")
    axes = figure.add_subplot()
    draw_surfaces(axes, scene.world.surfaces)
    _draw_grid(axes, scene)
    draw_regions(axes, scene.task.unsafe_regions, scene.poses)
    draw_objects(axes, scene.world.objects, scene.poses)
    draw_ways(axes, scene.ways_m)
    _draw_path(axes, scene)
    axes.set_xlim(x_min, x_max)
    axes.set_ylim(y_min, y_max)
    axes.set_aspect("equal")
    axes.set_xlabel("x [m], odom")
    axes.set_ylabel("y [m], odom")
    axes.tick_params(labelsize=8)
    _add_scales(figure, axes, scene)
    _add_title(axes, scene)
    _add_legend(axes, scene)
    with atomic_path(path) as temporary:
        figure.savefig(str(temporary), format="png")


def yaw_of(quaternion: Sequence[float]) -> float:
    """Heading [rad] of a quaternion x, y, z, w: atan2(2 (w z + x y), 1 - 2 (y^2 + z^2))."""
    x, y, z, w = quaternion
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def _view(scene: TopDownScene) -> Tuple[float, float, float, float]:
    """(x_min, x_max, y_min, y_max) of what is shown: start, path, goal and regions with a margin, inside the world."""
    points = [np.array([r.position_m for r in scene.records]), np.reshape(scene.task.goal_m, (1, 2))]
    points += [region_outline_m(region, scene.poses) for region in scene.task.unsafe_regions]
    low, high = np.min(np.vstack(points), axis=0) - MARGIN_M, np.max(np.vstack(points), axis=0) + MARGIN_M
    floor = np.vstack([np.asarray(surface.polygon_m) for surface in scene.world.surfaces])
    low, high = np.maximum(low, floor.min(axis=0) - 0.3), np.minimum(high, floor.max(axis=0) + 0.3)
    # A long narrow strip would be unreadable: show at least a 2 : 1 cut-out.
    span = high - low
    for axis in (0, 1):
        missing = 0.5 * span[1 - axis] - span[axis]
        if missing > 0:
            low[axis], high[axis] = low[axis] - 0.5 * missing, high[axis] + 0.5 * missing
    return low[0], high[0], low[1], high[1]


def _draw_grid(axes: Axes, scene: TopDownScene) -> None:
    if scene.grids.empty:
        return
    extent = scene.grids.extent_m
    p_unsafe = np.ma.masked_invalid(scene.grids.p_unsafe)
    axes.imshow(
        p_unsafe, extent=extent, origin="lower", cmap=P_UNSAFE_COLORS, vmin=0, vmax=1, alpha=0.6,
        interpolation="nearest", zorder=1,
    )  # fmt: skip
    h_m = np.ma.masked_invalid(scene.grids.h_m)
    if h_m.count() and h_m.min() < 0.0 < h_m.max():
        rows, columns = h_m.shape
        x_m = extent[0] + (np.arange(columns) + 0.5) * (extent[1] - extent[0]) / columns
        y_m = extent[2] + (np.arange(rows) + 0.5) * (extent[3] - extent[2]) / rows
        axes.contour(x_m, y_m, h_m, levels=[0.0], colors=[BARRIER_COLOR], linewidths=1.8, zorder=4)


def _draw_path(axes: Axes, scene: TopDownScene) -> None:
    points = np.array([r.position_m for r in scene.records])
    times_s = np.array([r.time_s for r in scene.records])
    route = np.vstack([points[:1], np.reshape(getattr(scene.task, "waypoints_m", scene.task.goal_m), (-1, 2))])
    axes.plot(route[:, 0], route[:, 1], color="#1d4e89", linewidth=1.2, linestyle=(0, (2, 3)), zorder=6)
    segments = np.stack([points[:-1], points[1:]], axis=1)
    axes.add_collection(LineCollection(segments, colors="white", linewidths=5.0, zorder=6, capstyle="round"))
    line = LineCollection(
        segments, cmap=PATH_COLORS, norm=_time_scale(scene), linewidths=3.0, zorder=7, capstyle="round"
    )
    line.set_array(times_s[1:])
    axes.add_collection(line)
    for record, label in ((scene.records[0], "start"), (scene.records[-1], "end")):
        _draw_robot(axes, scene, record, label)
    goal = tuple(float(v) for v in scene.task.goal_m)
    axes.add_patch(Circle(goal, scene.task.goal_tolerance_m, fill=False, edgecolor="#1d4e89", linewidth=1.4, zorder=8))
    axes.plot(*goal, marker="*", markersize=15, color="#1d4e89", markeredgecolor="white", zorder=9)
    _label(axes, goal, "goal")


def _draw_robot(axes: Axes, scene: TopDownScene, record: TickRecord, label: str) -> None:
    x_m, y_m = record.position_m
    yaw_rad = yaw_of(record.odometry.q_odom_base)
    corners = rectangle_corners(x_m, y_m, yaw_rad, *scene.footprint_m)
    facecolor = "#ffffff" if label == "start" else "#ffd23f"
    axes.add_patch(Polygon(corners, facecolor=facecolor, edgecolor="black", linewidth=1.4, alpha=0.9, zorder=8))
    reach_m = 0.38 * scene.footprint_m[0]
    tip = (x_m + reach_m * math.cos(yaw_rad), y_m + reach_m * math.sin(yaw_rad))
    axes.annotate(
        "", xy=tip, xytext=(x_m, y_m), arrowprops={"arrowstyle": "-|>", "color": "black", "lw": 1.4}, zorder=9
    )
    _label(axes, (x_m, y_m), label)


def _label(axes: Axes, point: Tuple[float, float], text: str) -> None:
    box = {"boxstyle": "round,pad=0.2", "facecolor": "white", "edgecolor": "none", "alpha": 0.85}
    axes.annotate(
        text,
        xy=point,
        xytext=(0, -24),
        textcoords="offset points",
        ha="center",
        va="top",
        fontsize=9,
        bbox=box,
        zorder=10,
    )


def _time_scale(scene: TopDownScene) -> Normalize:
    return Normalize(scene.records[0].time_s, max(scene.records[-1].time_s, scene.records[0].time_s + 1e-3))


def _add_scales(figure: Figure, axes: Axes, scene: TopDownScene) -> None:
    bar = figure.colorbar(ScalarMappable(_time_scale(scene), PATH_COLORS), ax=axes, fraction=0.03, pad=0.01)
    bar.set_label("time along the path [s]", fontsize=9)
    bar.ax.tick_params(labelsize=8)
    if not scene.grids.empty:
        bar = figure.colorbar(
            ScalarMappable(Normalize(0, 1), P_UNSAFE_COLORS), ax=axes, fraction=0.03, pad=0.01, alpha=0.6
        )
        bar.set_label("P(unsafe)", fontsize=9)
        bar.ax.tick_params(labelsize=8)


def _add_title(axes: Axes, scene: TopDownScene) -> None:
    color = OUTCOME_COLORS.get(scene.outcome, FAILURE_COLOR)
    pad = 10 + 13 * len(scene.lines)
    axes.set_title(scene.outcome, fontsize=15, fontweight="bold", loc="left", color=color, pad=pad)
    place = {"xycoords": "axes fraction", "textcoords": "offset points", "annotation_clip": False}
    axes.annotate("\n".join(scene.lines), xy=(0, 1), xytext=(0, 6), fontsize=9.5, color="#333333", va="bottom", **place)


def _add_legend(axes: Axes, scene: TopDownScene) -> None:
    x_min, x_max, y_min, y_max = _view(scene)
    reach_m = {item.name: 0.5 * max(item.collision_size_m[:2]) for item in scene.world.objects}
    shown = {
        item.class_name
        for item in scene.world.objects
        if x_min - reach_m[item.name] < object_place(item, scene.poses)[0][0] < x_max + reach_m[item.name]
        and y_min - reach_m[item.name] < object_place(item, scene.poses)[0][1] < y_max + reach_m[item.name]
    }
    colors = {name: color for name, color in class_colors(scene.world.objects).items() if name in shown}
    handles: List[object] = [
        Patch(facecolor=c, edgecolor=EDGE_COLOR, label=name.replace("_", " ")) for name, c in colors.items()
    ]
    if not scene.grids.empty:
        handles.append(Patch(facecolor=FLOOR_COLOR, edgecolor="#c9c5ba", label="not seen"))
    handles.append(Line2D([], [], color="#1d4e89", linewidth=1.2, linestyle=(0, (2, 3)), label="nominal route"))
    if scene.task.unsafe_regions:
        handles.append(
            Patch(fill=False, edgecolor=REGION_COLOR, hatch="//", linestyle="--", label="true unsafe region")
        )
    if scene.ways_m:
        handles.append(Line2D([], [], color=WAY_COLOR, linewidth=2, linestyle=(0, (1, 1.5)), label="way of an object"))
    if not scene.grids.empty:
        handles.append(Line2D([], [], color=BARRIER_COLOR, linewidth=1.8, label="barrier h = 0"))
    if handles:
        axes.legend(
            handles=handles, loc="upper center", bbox_to_anchor=(0.5, -0.09), ncols=5, fontsize=8.5, frameon=False
        )

# SPDX-License-Identifier: BSD-3-Clause
"""The floor plan of a world on matplotlib axes: surfaces, objects at their place and on their way, unsafe regions."""

from __future__ import annotations

import math
from typing import Dict, Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle, Polygon

from core_bringup.motion import Poses
from core_bringup.regions import region_outline_m
from core_bringup.touched import NO_POSES, object_outlines_m, object_place

FLOOR_COLOR, EDGE_COLOR, REGION_COLOR, WAY_COLOR = "#f1efe9", "#4a4a4a", "#d1495b", "#8a4fbf"
# Meshes carry their colours in their textures; on the plan a class has one colour.
CLASS_COLORS = {
    "traffic_cone": "#f26b21",
    "storage_rack": "#5b7aa6",
    "cardboard_box": "#c79a62",
    "pallet": "#8d6e4a",
    "wall": "#9a9a94",
    "forklift": "#e0b400",
    "person": "#3d6fd1",
    "wet_floor_sign": "#f4d03f",
    "tree": "#4f8a4b",
    "bush": "#6fa35f",
    "building": "#b8aea0",
    "car": "#7f8c9b",
}
OTHER_CLASS_COLORS = ("#7a5ea8", "#3f8f8b", "#a65b7a", "#6b8f3f", "#8f6f3f", "#4f6fb0")
# Surfaces whose colour is in their texture.
SURFACE_COLORS = {
    "grass": "#cfe3bd",
    "road": "#cfd0d2",
    "parking_lot": "#d5d6d8",
    "sidewalk": "#e6e2d8",
    "carpet": "#d9d3e4",
    "crosswalk": "#ececec",
    "sidewalk_ramp": "#efdfae",
    "driveway": "#d9d9d4",
}


def rectangle_corners(x_m: float, y_m: float, yaw_rad: float, length_m: float, width_m: float) -> np.ndarray:
    """(4, 2) corners of a rectangle centred on (x, y), turned by yaw, counter-clockwise [m]."""
    half = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * 0.5 * np.array([length_m, width_m])
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    return half @ np.array([[c, s], [-s, c]]) + np.array([x_m, y_m])


def draw_surfaces(axes: Axes, surfaces: Sequence) -> None:
    """Draw every surface in a pale tone of its class; the first one is the floor."""
    axes.set_facecolor("white")
    for i, surface in enumerate(surfaces):
        pale = tuple(0.5 + 0.5 * np.asarray(surface.color_rgba)[:3])
        color = SURFACE_COLORS.get(surface.class_name, FLOOR_COLOR if i == 0 else pale)
        axes.add_patch(Polygon(surface.polygon_m, facecolor=color, edgecolor="#c9c5ba", linewidth=0.8, zorder=0))


def draw_regions(axes: Axes, regions: Sequence, poses: Poses = NO_POSES) -> None:
    """Hatch the true unsafe regions; those around an object stand where it stands in poses."""
    style = {"fill": False, "edgecolor": REGION_COLOR, "linewidth": 1.6, "linestyle": "--", "hatch": "//"}
    for region in regions:
        axes.add_patch(Polygon(region_outline_m(region, poses), alpha=0.75, zorder=3, **style))


def class_colors(objects: Sequence) -> Dict[str, object]:
    """Colour of every class on the plan, in order of first appearance."""
    colors: Dict[str, object] = {}
    for item in objects:
        if item.class_name not in colors:
            other = OTHER_CLASS_COLORS[len(colors) % len(OTHER_CLASS_COLORS)]
            own = other if item.shape == "mesh" else tuple(np.asarray(item.color_rgba)[:3])
            colors[item.class_name] = CLASS_COLORS.get(item.class_name, own)
    return colors


def draw_objects(axes: Axes, objects: Sequence, poses: Poses = NO_POSES) -> None:
    """Draw what is touched of every object, moving ones where poses has them; the lower ones first."""
    colors = class_colors(objects)
    for item in sorted(objects, key=lambda item: float(item.position_m[2])):
        style = {"facecolor": colors[item.class_name], "edgecolor": EDGE_COLOR, "linewidth": 0.8, "zorder": 5}
        if item.collision == "cylinder":
            place_m = tuple(object_place(item, poses)[0])
            axes.add_patch(Circle(place_m, float(item.collision_size_m[0]) / 2, **style))
            continue
        for outline_m in object_outlines_m(item, poses, high_m=math.inf):
            axes.add_patch(Polygon(outline_m, **style))


def draw_ways(axes: Axes, ways_m: Mapping[int, np.ndarray]) -> None:
    """Draw the way (n, 2) of every object that moved as a dotted line from its start, which is a dot."""
    for way_m in ways_m.values():
        axes.plot(way_m[:, 0], way_m[:, 1], color=WAY_COLOR, linewidth=2.0, linestyle=(0, (1, 1.5)), zorder=6)
        axes.plot(*way_m[0], marker="o", markersize=5, color=WAY_COLOR, zorder=6)

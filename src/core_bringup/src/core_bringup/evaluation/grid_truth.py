# SPDX-License-Identifier: BSD-3-Clause
"""The safety grid against the truth: overlap of areas, calibration of P(unsafe), and when a region was first seen."""

from __future__ import annotations

import math
from typing import Dict, Optional, Sequence, Tuple

import numpy as np

from core_bringup.evaluation.grid_history import GridHistory
from core_bringup.evaluation.grid_log import GridDecision, RunLog
from core_bringup.evaluation.truth_scene import TruthScene, outline_distance_m
from core_bringup.polygons import clip_to_convex, point_distance_m
from core_bringup.touched import object_outlines_m
from core_perception.predicates import Operator, Predicate, Verdict, parse_predicate

BINS = 10
# A region is seen where at least half of its border near the place in question has an unsafe cell behind it.
MIN_COVERED_SHARE = 0.5
PATCH_M = 0.35  # border counts up to this distance from the place; half of what fits between two obstacles
SAMPLE_M = 0.05  # between two samples of the border
DEPTHS_M = (0.05, 0.15, 0.25, 0.35)  # behind the border, in which an unsafe cell is looked for: two cells of 0.2 m


def points_inside(points_m: np.ndarray, outline_m: np.ndarray) -> np.ndarray:
    """(n,) bool: which points (n, 2) lie in a simple polygon (m, 2); even-odd rule, borders undecided."""
    inside = np.zeros(len(points_m), dtype=bool)
    x, y = points_m[:, 0], points_m[:, 1]
    for (ax, ay), (bx, by) in zip(outline_m, np.roll(outline_m, -1, axis=0)):
        if ay == by:
            continue
        crossing_x = ax + (y - ay) * (bx - ax) / (by - ay)
        inside ^= ((ay > y) != (by > y)) & (x < crossing_x)
    return inside


def cell_centers_m(grids: GridHistory) -> np.ndarray:
    """(rows * columns, 2) centres of the cells of the history, row by row [m], odom frame."""
    rows, columns = grids.p_unsafe.shape
    x0, x1, y0, y1 = grids.extent_m
    x_m = x0 + (np.arange(columns) + 0.5) * (x1 - x0) / columns
    y_m = y0 + (np.arange(rows) + 0.5) * (y1 - y0) / rows
    return np.stack(np.meshgrid(x_m, y_m), axis=-1).reshape(-1, 2)


def _in_regions(points_m: np.ndarray, scene: TruthScene, index: int) -> np.ndarray:
    inside = np.zeros(len(points_m), dtype=bool)
    for region in scene.task.unsafe_regions:
        inside |= points_inside(points_m, scene.outline_m(region, index))
    return inside


def _in_solids(points_m: np.ndarray, scene: TruthScene, index: int) -> np.ndarray:
    inside = np.zeros(len(points_m), dtype=bool)
    for item in scene.objects(index):
        for outline_m in object_outlines_m(item) if item.solid else ():
            inside |= points_inside(points_m, outline_m)
    return inside


def compute_grid_iou(grids: GridHistory, scene: TruthScene) -> Optional[float]:
    """Overlap of the true unsafe regions with the cells that semantic rules made unsafe, in 0..1.

        iou = |T and U| / |T or U|   over the seen cells that are in no solid object

    T: cell centre in a true unsafe region at the last tick. U: unsafe by a predicate, or for want of a safe one for a
    class that was seen, in the newest grid that knew the cell. Seen: some grid ever had a vote or a rule there. Cells
    in the outline of a solid object are left out on both sides: NEAR(wall) is right and closes no region. The floor
    behind a line of cones is part of its region, and counts as missed when the rules only draw the line.

    None for a task without regions, or with no cell in T or U.
    """
    if grids.empty or not scene.task.unsafe_regions:
        return None
    points_m, last = cell_centers_m(grids), len(scene.records) - 1
    counted = np.isfinite(grids.p_unsafe.reshape(-1)) & ~_in_solids(points_m, scene, last)
    truth, unsafe = _in_regions(points_m, scene, last), grids.semantic.reshape(-1)
    union = np.count_nonzero((truth | unsafe) & counted)
    return np.count_nonzero(truth & unsafe & counted) / union if union else None


def compute_calibration(grids: GridHistory, scene: TruthScene) -> Optional[Dict[str, object]]:
    """Whether P(unsafe) is the share of cells that are unsafe, in ten bins of equal width.

        ece = sum over bins of cells_b / cells |p_mean_b - true_share_b|

    Over the seen cells of the whole run, each with the newest probability it had; a cell is truly unsafe when its
    centre lies in a true unsafe region or in the outline of a solid object, at the last tick. None without a seen cell.
    Source: [ECE].
    """
    if grids.empty or not scene.records:
        return None
    points_m, last = cell_centers_m(grids), len(scene.records) - 1
    p_unsafe = grids.p_unsafe.reshape(-1)
    seen = np.isfinite(p_unsafe)
    truth = _in_regions(points_m[seen], scene, last) | _in_solids(points_m[seen], scene, last)
    return make_calibration(p_unsafe[seen], truth)


def make_calibration(p_unsafe: np.ndarray, truth: np.ndarray) -> Optional[Dict[str, object]]:
    """Bins and error of probabilities (n,) against truths (n,); empty bins have None for both means."""
    if len(p_unsafe) == 0:
        return None
    numbers = np.minimum((p_unsafe * BINS).astype(int), BINS - 1)
    bins, ece = [], 0.0
    for number in range(BINS):
        chosen = numbers == number
        cells = int(np.count_nonzero(chosen))
        p_mean = float(p_unsafe[chosen].mean()) if cells else None
        share = float(truth[chosen].mean()) if cells else None
        bins.append({"p_mean": p_mean, "true_share": share, "cells": cells})
        ece += cells / len(p_unsafe) * abs(p_mean - share) if cells else 0.0
    return {"bins": bins, "ece": float(ece)}


def parse_all(texts: Sequence[str]) -> Tuple[Predicate, ...]:
    """Predicates of a world file, whose grammar was checked when it was loaded."""
    return tuple(parse_predicate(text) for text in texts)


def rules_that_close(region, task) -> Tuple[Predicate, ...]:
    """The predicates each of which closes a region: its `because`, or what the oracle calls unsafe but NEAR."""
    stated = parse_all(region.because)
    oracle = parse_all(task.oracle_predicates)
    return stated or tuple(p for p in oracle if p.verdict == Verdict.UNSAFE and p.operator != Operator.NEAR)


def border_patch(outline_m: np.ndarray, place_m: Sequence[float]) -> Tuple[np.ndarray, np.ndarray]:
    """Samples (k, 2) of a counter-clockwise border within PATCH_M of its point nearest to a place; inward normals."""
    points, normals = [], []
    for a, b in zip(outline_m, np.roll(outline_m, -1, axis=0)):
        length_m = float(np.linalg.norm(b - a))
        count = max(int(math.ceil(length_m / SAMPLE_M)), 1)
        shares = (np.arange(count) + 0.5)[:, None] / count
        points.append(a + shares * (b - a))
        normals.append(np.tile(np.array([a[1] - b[1], b[0] - a[0]]) / max(length_m, 1e-12), (count, 1)))
    points, normals = np.vstack(points), np.vstack(normals)
    nearest_m = points[np.argmin(np.linalg.norm(points - np.asarray(place_m), axis=1))]
    chosen = np.linalg.norm(points - nearest_m, axis=1) <= PATCH_M
    return points[chosen], normals[chosen]


def covered_share(
    grid: Optional[GridDecision],
    outline_m: np.ndarray,
    place_m: Sequence[float],
    causes: Optional[Sequence[int]] = None,
) -> float:
    """Share of a region's border near a place that has an unsafe cell of these causes right behind it, in 0..1."""
    if grid is None:
        return 0.0
    points_m, normals = border_patch(outline_m, place_m)
    probes_m = points_m[None] + np.asarray(DEPTHS_M)[:, None, None] * normals[None]
    unsafe = grid.unsafe_at(probes_m.reshape(-1, 2), causes).reshape(len(DEPTHS_M), -1)
    return float(unsafe.any(axis=0).mean())


def first_contact_m(points_m: np.ndarray, outline_m: np.ndarray) -> Tuple[float, np.ndarray]:
    """Way along a polyline (n, 2) to where it first enters a region, and that place (2,); inf and the nearest place."""
    walked_m, nearest = 0.0, (math.inf, points_m[0])
    for a, b in zip(points_m, points_m[1:]):
        length_m = float(np.linalg.norm(b - a))
        for share in np.linspace(0.0, 1.0, max(int(length_m / SAMPLE_M), 1) + 1):
            place_m = a + share * (b - a)
            distance_m = outline_distance_m(outline_m, place_m)
            if distance_m == 0.0:
                return walked_m + share * length_m, place_m
            if distance_m < nearest[0]:
                nearest = (distance_m, place_m)
        walked_m += length_m
    return math.inf, nearest[1]


def detection_distance_m(scene: TruthScene, log: RunLog) -> Optional[float]:
    """Distance from the footprint to the region when the grid first closed it where the robot would go in [m].

    The region is the one the straight nominal path enters first. It is detected at the first tick at which at least
    half of its border near that entry (covered_share) has unsafe cells made so by a rule that closes it. None if never.
    """
    if not scene.records or not scene.task.unsafe_regions:
        return None
    way_m = np.vstack([[scene.records[0].position_m], np.reshape(scene.task.waypoints_m, (-1, 2))])
    contacts = [first_contact_m(way_m, scene.outline_m(r, 0))[0] for r in scene.task.unsafe_regions]
    region = scene.task.unsafe_regions[int(np.argmin(contacts))]
    because, seen_ns = rules_that_close(region, scene.task), -1
    place_m: Optional[np.ndarray] = None
    for i, record in enumerate(scene.records):
        grid = log.grids.at(record.odometry.stamp_ns)
        if grid is None or grid.stamp_ns == seen_ns:
            continue
        seen_ns = grid.stamp_ns
        causes = grid.causes_of(because, scene.class_of_name)
        if not causes:
            continue
        outline_m = scene.outline_m(region, i)
        if place_m is None or region.object_name is not None:
            place_m = first_contact_m(way_m, outline_m)[1]
        if covered_share(grid, outline_m, place_m, causes) >= MIN_COVERED_SHARE:
            return max(float(scene.region_clearance_m(region, i)), 0.0)
    return None


def entry_place_m(scene: TruthScene, region, index: int) -> np.ndarray:
    """(2,) where the footprint is in a region at a tick: centre of the overlap, or the border point nearest to it."""
    footprint_m, outline_m = scene.footprint_outline_m(index), scene.outline_m(region, index)
    overlap_m = clip_to_convex(outline_m, footprint_m)
    if len(overlap_m):
        return overlap_m.mean(axis=0)
    points_m, _ = border_patch(outline_m, footprint_m.mean(axis=0))
    return points_m[int(np.argmin([point_distance_m(footprint_m, p) for p in points_m]))]

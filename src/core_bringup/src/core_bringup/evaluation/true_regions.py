# SPDX-License-Identifier: BSD-3-Clause
"""What safety predicates mean on the true geometry of a world, in metres, sampled on a raster finer than the map's.

    ON(c)       the ground whose topmost surface is of class c
    NEAR(c)     the outlines of the objects of class c
    AROUND(c)   the ground within the radius of such an outline
    BETWEEN(c)  the convex hull of every cluster of two and more such objects, a cluster being linked by gaps up to
                between_max_gap_m; a hull narrower than between_min_thickness_m is grown to it
    obstacle    the outlines of what is solid and reaches into the band metric_min_height_m ... band_max_z_m

    unsafe = all of these with verdict unsafe, all obstacles, and what is in no safe region: ground whose surface no
             ON(c)=safe names, and outlines of objects that no NEAR(c)=safe names

The outlines are what is touched of an object within the band band_min_z_m ... band_max_z_m, one for each of its parts
(touched.object_outlines_m). What hangs above the band, such as the upper shelves of a rack, marks nothing: a robot that
is not as high walks there. A safe BETWEEN cancels an unsafe one of its class. Source: DESIGN section 4, rows 1 to 3
and 13.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Container, List, Mapping, Sequence, Tuple

import numpy as np

from core_bringup.evaluation.grid_truth import points_inside
from core_bringup.evaluation.truth_scene import border_distance_m, link_outlines
from core_bringup.polygons import convex_hull
from core_bringup.touched import object_outlines_m
from core_bringup.world_types import Surface, WorldObject
from core_perception.predicates import Operator, Predicate, Severity, Verdict, canonical_class_name

SAMPLES = 10  # along the edge of a cell of the map
OBSTACLE_RULE = "obstacle"


@dataclass(frozen=True)
class TruthParams:
    """Lengths [m] that predicates leave open: those of profile core, whichever profile is measured."""

    default_radius_m: float = 1.0
    class_radius_m: Mapping[str, float] = field(default_factory=dict)
    between_max_gap_m: float = 2.5
    between_min_thickness_m: float = 0.3
    floor_z_m: float = 0.0
    metric_min_height_m: float = 0.10
    band_min_z_m: float = -0.15
    band_max_z_m: float = 0.9

    @classmethod
    def from_map(cls, values: Mapping[str, Any]) -> TruthParams:
        """Take them from the section semantic_map of a profile."""
        return cls(**{name: values[name] for name in cls.__dataclass_fields__})


@dataclass(frozen=True)
class TrueRegion:
    """The ground within a distance of a polygon (n, 2), and the rule that makes it unsafe."""

    rule: str
    polygon_m: np.ndarray
    radius_m: float = 0.0

    def covers(self, points_m: np.ndarray) -> np.ndarray:
        """(n,) bool: which points (n, 2) lie in it."""
        inside = points_inside(points_m, self.polygon_m)
        if self.radius_m > 0.0:
            outside = np.flatnonzero(~inside)
            distance_m = border_distance_m(points_m[outside][:, None, :], self.polygon_m[None])
            inside[outside] = distance_m <= self.radius_m
        return inside

    def bounds_m(self) -> Tuple[np.ndarray, np.ndarray]:
        """Lower and upper corner (2,) of the rectangle around it."""
        return self.polygon_m.min(axis=0) - self.radius_m, self.polygon_m.max(axis=0) + self.radius_m


def object_regions(
    objects: Sequence[WorldObject], predicates: Sequence[Predicate], params: TruthParams
) -> List[TrueRegion]:
    """Every region that objects make unsafe, each at its pose."""
    safe = {p.class_name for p in predicates if p.operator == Operator.NEAR and p.verdict == Verdict.SAFE}
    regions = [region for item in objects for region in _standing(item, safe, params)]
    for predicate in predicates:
        if predicate.verdict == Verdict.UNSAFE and predicate.severity == Severity.STOP:
            called = [o for o in objects if canonical_class_name(o.class_name) == predicate.class_name]
            outlines = [outlines for outlines in (_in_band(o, params.band_min_z_m, params) for o in called) if outlines]
            if not _is_cancelled(predicate, predicates):
                regions += _make_regions(predicate, outlines, params)
    return regions


def _in_band(item: WorldObject, low_m: float, params: TruthParams) -> List[np.ndarray]:
    """Outlines of what reaches into the heights low_m ... band_max_z_m above the floor."""
    floor_m = params.floor_z_m
    return object_outlines_m(item, low_m=floor_m + low_m, high_m=floor_m + params.band_max_z_m)


def _standing(item: WorldObject, safe: Container[str], params: TruthParams) -> List[TrueRegion]:
    """What an object makes unsafe whatever is said of it."""
    name, regions = canonical_class_name(item.class_name), []
    standing = _in_band(item, params.metric_min_height_m, params) if item.solid else []
    for outline_m in _in_band(item, params.band_min_z_m, params):
        if any(np.array_equal(outline_m, other_m) for other_m in standing):
            regions.append(TrueRegion(OBSTACLE_RULE, outline_m))
        elif name not in safe:
            regions.append(TrueRegion(f"not in a safe region ({name})", outline_m))
    return regions


def _make_regions(
    predicate: Predicate, objects_m: Sequence[Sequence[np.ndarray]], params: TruthParams
) -> List[TrueRegion]:
    """Regions of a predicate around objects, each given by its outlines."""
    rule = f"{predicate.operator.name}({predicate.class_name})"
    outlines_m = [outline_m for outlines_m in objects_m for outline_m in outlines_m]
    if predicate.operator == Operator.NEAR:
        return [TrueRegion(rule, outline_m) for outline_m in outlines_m]
    if predicate.operator == Operator.AROUND:
        radius_m = predicate.radius_m or params.class_radius_m.get(predicate.class_name, params.default_radius_m)
        return [TrueRegion(rule, outline_m, radius_m) for outline_m in outlines_m]
    if predicate.operator == Operator.BETWEEN:
        clusters = link_outlines([convex_hull(np.vstack(one)) for one in objects_m], params.between_max_gap_m)
        return [_between(rule, cluster, params) for cluster in clusters if len(cluster) > 1]
    return []  # ON speaks of surfaces


def _is_cancelled(predicate: Predicate, predicates: Sequence[Predicate]) -> bool:
    if predicate.operator != Operator.BETWEEN:
        return False
    same = [p for p in predicates if (p.operator, p.class_name) == (predicate.operator, predicate.class_name)]
    return any(p.verdict == Verdict.SAFE for p in same)


def _between(rule: str, outlines_m: Sequence[np.ndarray], params: TruthParams) -> TrueRegion:
    hull_m = convex_hull(np.vstack(outlines_m))
    return TrueRegion(rule, hull_m, max(0.0, 0.5 * (params.between_min_thickness_m - width_m(hull_m))))


def width_m(convex_m: np.ndarray) -> float:
    """Smallest distance of two parallel lines that hold a convex polygon (n, 2) between them [m]."""
    edges = np.roll(convex_m, -1, axis=0) - convex_m
    lengths = np.linalg.norm(edges, axis=1)
    normals = np.column_stack([-edges[:, 1], edges[:, 0]])[lengths > 0.0] / lengths[lengths > 0.0, None]
    heights = normals @ convex_m.T
    return float((heights.max(axis=1) - heights.min(axis=1)).min())


@dataclass(frozen=True)
class Raster:
    """Samples at the centres of squares, SAMPLES along the edge of a cell, over a rectangle of cells of the map.

    Attributes:
        origin: (2,) x, y of its first cell, in cells of the fixed frame.
        cells: (2,) columns (x) and rows (y).
        resolution_m: edge of a cell.
    """

    origin: Tuple[int, int]
    cells: Tuple[int, int]
    resolution_m: float

    @property
    def step_m(self) -> float:
        """Distance of neighbouring samples."""
        return self.resolution_m / SAMPLES

    def axes_m(self) -> Tuple[np.ndarray, np.ndarray]:
        """Coordinates x (columns,) and y (rows,) of the samples."""
        x, y = (
            start * self.resolution_m + (np.arange(count * SAMPLES) + 0.5) * self.step_m
            for start, count in zip(self.origin, self.cells)
        )
        return x, y

    def paint(self, region: TrueRegion, mask: np.ndarray) -> None:
        """Set the samples of a mask (rows, columns) that a region covers."""
        (x_m, y_m), (low_m, high_m) = self.axes_m(), region.bounds_m()
        columns = slice(*np.searchsorted(x_m, (low_m[0], high_m[0])))
        rows = slice(*np.searchsorted(y_m, (low_m[1], high_m[1])))
        part = mask[rows, columns]
        points_m = np.stack(np.meshgrid(x_m[columns], y_m[rows]), axis=-1).reshape(-1, 2)
        if len(points_m):
            part |= region.covers(points_m).reshape(part.shape)


def surface_classes(raster: Raster, surfaces: Sequence[Surface]) -> Tuple[np.ndarray, List[str]]:
    """Number of the topmost surface's class at every sample, and the classes; the first surface is endless."""
    names = sorted({canonical_class_name(s.class_name) for s in surfaces})
    x_m, y_m = raster.axes_m()
    top_m = np.full((len(y_m), len(x_m)), surfaces[0].z_m)
    number = np.full(top_m.shape, names.index(canonical_class_name(surfaces[0].class_name)), np.int16)
    for surface in surfaces:
        inside = np.zeros(top_m.shape, dtype=bool)
        raster.paint(TrueRegion("", surface.polygon_m), inside)
        # z = a x + b y + c; of equal heights the later surface covers the other.
        c = surface.height_m(np.zeros(2))
        a, b = (surface.height_m(np.eye(2)[k]) - c for k in range(2))
        height_m = a * x_m[None, :] + b * y_m[:, None] + c
        above = inside & (height_m >= top_m)
        top_m[above] = height_m[above]
        number[above] = names.index(canonical_class_name(surface.class_name))
    return number, names


def paint_surfaces(
    raster: Raster, surfaces: Sequence[Surface], predicates: Sequence[Predicate]
) -> Mapping[str, np.ndarray]:
    """Rule -> mask of the samples whose ground it makes unsafe."""
    on = [p for p in predicates if p.operator == Operator.ON and p.severity == Severity.STOP]
    unsafe = {p.class_name for p in on if p.verdict == Verdict.UNSAFE}
    safe = {p.class_name for p in on if p.verdict == Verdict.SAFE}
    number, names = surface_classes(raster, surfaces)
    masks = {}
    for k, name in enumerate(names):
        if name in unsafe:
            masks[f"ON({name})"] = number == k
        elif name not in safe:
            masks[f"not in a safe region ({name})"] = number == k
    return masks


def paint_regions(raster: Raster, regions: Sequence[TrueRegion]) -> Mapping[str, np.ndarray]:
    """Rule -> mask of the samples its regions cover."""
    masks: dict = {}
    for region in regions:
        if region.rule not in masks:
            x_m, y_m = raster.axes_m()
            masks[region.rule] = np.zeros((len(y_m), len(x_m)), dtype=bool)
        raster.paint(region, masks[region.rule])
    return masks

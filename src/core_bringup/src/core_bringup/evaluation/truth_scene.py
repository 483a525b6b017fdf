# SPDX-License-Identifier: BSD-3-Clause
"""The world as it was at every tick of a finished run: where each object stood, and how far a place was from what."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Dict, List, Optional, Sequence, Tuple

import numpy as np

from core_bringup.evaluation.attribution import DEFAULT_RADIUS_M
from core_bringup.evaluation.records import TickRecord
from core_bringup.motion import Poses, WorldMotion
from core_bringup.polygons import contains_point, convex_hull, point_distance_m, rectangle, signed_clearance_m
from core_bringup.regions import object_clearance_m, region_clearance_m, region_outline_m
from core_bringup.rotations import yaw_of_quaternion
from core_bringup.touched import ROBOT_HEIGHT_M, boxes_between_m, object_hull_m, object_outlines_m
from core_bringup.world_types import WorldObject
from core_perception.arrangement import LINK_M
from core_perception.predicates import Operator, Predicate


class TruthScene:
    """Answers questions about the true world at a tick; moving objects stand where the simulator had them.

    Args:
        world: core_bringup.world.World as the run met it (after vary_world).
        task: the task of that world.
        records: every tick, in order.
        footprint_m: length and width of the robot [m].
        ontology: core_perception's Ontology, whose names rules and predicates may use; None: only the world's names.
    """

    def __init__(self, world, task, records: Sequence[TickRecord], footprint_m: Tuple[float, float], ontology=None):
        """Replay the motion of the objects."""
        self.world, self.task, self.records, self.footprint_m = world, task, records, footprint_m
        self.class_of_name = find_class_names(world, ontology)
        motion = WorldMotion(world.objects)
        self._poses: List[Poses] = [dict(motion.advance(r.time_s, np.array(r.position_m))) for r in records]
        self._corners_m: Optional[np.ndarray] = None
        self._moving = {item.id for item in world.objects if item.motion is not None}

    def poses(self, index: int) -> Poses:
        """Place and heading of every moving object at a tick, by id."""
        return self._poses[index] if self._poses else {}

    def objects(self, index: int) -> List[WorldObject]:
        """Every object at its pose of a tick."""
        return [self._at(item, index) for item in self.world.objects]

    def _at(self, item: WorldObject, index: int) -> WorldObject:
        if item.id not in self._moving or item.id not in self.poses(index):
            return item
        position_m, yaw_rad = self.poses(index)[item.id]
        return replace(item, position_m=np.asarray(position_m, dtype=float), yaw_rad=float(yaw_rad))

    def outline_m(self, region, index: int) -> np.ndarray:
        """(n, 2) outline of a true unsafe region at a tick, counter-clockwise."""
        return region_outline_m(region, self.poses(index))

    def region_clearance_m(self, region, index: int) -> float:
        """Signed clearance between footprint and region at a tick, as ground truth measures it [m]."""
        return region_clearance_m(region, self.footprint_outline_m(index), self.poses(index))

    def footprint_outline_m(self, index: int) -> np.ndarray:
        """(4, 2) corners of the robot's footprint at a tick, counter-clockwise."""
        odometry = self.records[index].odometry
        yaw_rad = yaw_of_quaternion(odometry.q_odom_base)
        return rectangle(np.array(odometry.p_odom_base[:2]), yaw_rad, *self.footprint_m)

    def paths_m(self) -> Dict[int, np.ndarray]:
        """(n, 2) way of every object that moved, by id."""
        ways = {i: np.array([poses[i][0][:2] for poses in self._poses if i in poses]) for i in sorted(self._moving)}
        return {i: way for i, way in ways.items() if len(way) and float(np.ptp(way, axis=0).max()) > 0.01}

    def class_clearance_m(self) -> Dict[str, float]:
        """Smallest distance from the footprint to any object of each class, solid or not, over the run [m].

        Negative where the footprint overlapped one, by the depth. What hangs above ROBOT_HEIGHT_M is left out.
        """
        best: Dict[str, float] = {}
        for item in self.world.objects:
            if len(boxes_between_m(item, -math.inf, ROBOT_HEIGHT_M)) and self.records:
                smallest_m = min(self._clearance_m(item), best.get(item.class_name, math.inf))
                best[item.class_name] = float(smallest_m)
        return dict(sorted(best.items()))

    def _clearance_m(self, item: WorldObject) -> float:
        """Smallest clearance to one object over the run: all ticks at once where it is apart, else as ground truth."""
        placed = [self._at(item, i) for i in self._indices_of(item)]
        footprints_m = self._footprints_m()
        if item.collision == "cylinder":
            outlines_m = np.array([[o.position_m[:2]] for o in placed])
            apart_m = border_distance_m(outlines_m, footprints_m) - 0.5 * float(item.collision_size_m[0])
        else:
            parts = zip(*(object_outlines_m(o) for o in placed))
            apart_m = np.min([self._apart_m(np.array(outlines_m)) for outlines_m in parts], axis=0)
        # Outlines that overlap cross near the footprint, or the base point is inside.
        near = apart_m <= 0.5 * math.hypot(*self.footprint_m)
        exact_m = [object_clearance_m(footprints_m[i], placed[i % len(placed)]) for i in np.flatnonzero(near)]
        return min([*exact_m, *apart_m[~near]])

    def _apart_m(self, outlines_m: np.ndarray) -> np.ndarray:
        """(ticks,) distance of the footprint's border to that of a convex outline (ticks or 1, n, 2) [m].

        0 where the base point lies in the outline.
        """
        footprints_m = self._footprints_m()
        apart_m = np.minimum(border_distance_m(outlines_m, footprints_m), border_distance_m(footprints_m, outlines_m))
        to_base_m = np.array([r.position_m for r in self.records])[:, None, :] - outlines_m
        edge_m = np.roll(outlines_m, -1, axis=1) - outlines_m
        left = edge_m[..., 0] * to_base_m[..., 1] - edge_m[..., 1] * to_base_m[..., 0] >= 0.0
        return np.where(left.all(axis=1), 0.0, apart_m)

    def _footprints_m(self) -> np.ndarray:
        """(ticks, 4, 2) corners of the footprint."""
        if self._corners_m is None:
            self._corners_m = np.array([self.footprint_outline_m(i) for i in range(len(self.records))])
        return self._corners_m

    def _indices_of(self, item: WorldObject) -> Sequence[int]:
        return range(len(self.records)) if item.id in self._moving else (0,)

    def surface_at(self, point_m: Sequence[float]) -> str:
        """Class of the highest surface at a place; of the floor where there is none."""
        point_m = np.asarray(point_m, dtype=float)
        under = [s for s in reversed(self.world.surfaces) if contains_point(s.polygon_m, point_m)]
        # Of equal heights the later one covers the other.
        return max(under, key=lambda s: s.height_m(point_m), default=self.world.surfaces[0]).class_name

    def class_distance_m(self, point_m: Sequence[float], class_name: str, index: int) -> float:
        """Distance from a place to the nearest object of a class, or of any when the name is empty; 0 inside [m]."""
        found = [o for o in self.objects(index) if not class_name or self._is_called(o, class_name)]
        return min((outline_distance_m(object_hull_m(o), point_m) for o in found), default=math.inf)

    def surface_distance_m(self, point_m: Sequence[float], class_name: str) -> float:
        """Distance from a place to the nearest surface of a class; 0 on it [m]."""
        found = [s for s in self.world.surfaces if s.class_name == self.class_of_name.get(class_name, class_name)]
        return min((outline_distance_m(s.polygon_m, point_m) for s in found), default=math.inf)

    def region_distance_m(self, point_m: Sequence[float], index: int) -> float:
        """Distance from a place to the nearest true unsafe region at a tick; 0 inside [m]."""
        regions = self.task.unsafe_regions
        return min((outline_distance_m(self.outline_m(r, index), point_m) for r in regions), default=math.inf)

    def predicate_distance_m(self, predicate: Predicate, point_m: Sequence[float], index: int) -> float:
        """Distance from a place to the region a predicate makes in the true world; 0 inside, inf without any [m]."""
        if predicate.operator == Operator.ON:
            return self.surface_distance_m(point_m, predicate.class_name)
        if predicate.operator == Operator.BETWEEN:
            return self._between_distance_m(predicate.class_name, point_m, index)
        reach_m = 0.0
        if predicate.operator == Operator.AROUND:
            reach_m = DEFAULT_RADIUS_M if predicate.radius_m is None else predicate.radius_m
        return max(self.class_distance_m(point_m, predicate.class_name, index) - reach_m, 0.0)

    def _between_distance_m(self, class_name: str, point_m: Sequence[float], index: int) -> float:
        items = [object_hull_m(o) for o in self.objects(index) if self._is_called(o, class_name)]
        hulls = [convex_hull(np.vstack(cluster)) for cluster in link_outlines(items)]
        return min((outline_distance_m(hull, point_m) for hull in hulls), default=math.inf)

    def _is_called(self, item: WorldObject, name: str) -> bool:
        return name in (item.class_name, *item.aliases) or self.class_of_name.get(name) == item.class_name


def find_class_names(world, ontology=None) -> Dict[str, str]:
    """Other name -> class of the world: the aliases of its objects, and what the ontology calls the same thing.

    The map and the reasoners use the ontology's name, such as caution_tape, where a world may say barrier_tape; so that
    meaning goes before an alias. A class of the world is never another one's name.
    """
    own = sorted({item.class_name for item in (*world.objects, *world.surfaces)})
    names = {alias: item.class_name for item in world.objects for alias in item.aliases}
    for class_name in reversed(own) if ontology is not None else ():
        listed = ontology.canonical(class_name)
        same = [alias for alias, meant in ontology.aliases.items() if meant == listed]
        names.update(dict.fromkeys((listed, *same), class_name))
    return {other: class_name for other, class_name in names.items() if other not in own}


def border_distance_m(points_m: np.ndarray, polygons_m: np.ndarray) -> np.ndarray:
    """(n,) smallest distance of points (n or 1, k, 2) to the borders of polygons (n or 1, m, 2), row by row [m]."""
    a = polygons_m[:, None, :, :]
    edge = np.roll(polygons_m, -1, axis=1)[:, None, :, :] - a
    to_point = points_m[:, :, None, :] - a
    share = np.clip(np.sum(to_point * edge, axis=3) / np.sum(edge * edge, axis=3), 0.0, 1.0)
    return np.linalg.norm(to_point - share[..., None] * edge, axis=3).min(axis=(1, 2))


def outline_distance_m(outline_m: np.ndarray, point_m: Sequence[float]) -> float:
    """Distance from a place to a polygon (n, 2) as an area; 0 inside [m]."""
    point_m = np.asarray(point_m, dtype=float)
    return 0.0 if contains_point(outline_m, point_m) else point_distance_m(outline_m, point_m)


def link_outlines(outlines_m: Sequence[np.ndarray], max_gap_m: float = LINK_M) -> List[List[np.ndarray]]:
    """Groups of convex outlines, each linked to another of its group by a gap up to max_gap_m, border to border."""
    groups: List[List[np.ndarray]] = []
    for outline_m in outlines_m:
        near = [g for g in groups if any(_gap_m(outline_m, other_m) <= max_gap_m for other_m in g)]
        apart = [g for g in groups if not any(g is n for n in near)]
        groups = [*apart, [outline_m, *(o for group in near for o in group)]]
    return groups


def _gap_m(a_m: np.ndarray, b_m: np.ndarray) -> float:
    return max(signed_clearance_m(a_m, b_m), 0.0)

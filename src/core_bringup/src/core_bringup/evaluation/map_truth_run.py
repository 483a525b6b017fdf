# SPDX-License-Identifier: BSD-3-Clause
"""Walks through the worlds that a map is held against the truth on, and what one such walk comes to."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Dict, List, Mapping, Tuple

import numpy as np

from core_bringup.evaluation.frame_recorder import RecordingScene
from core_bringup.evaluation.frame_recording import FrameRecording
from core_bringup.evaluation.map_truth import (
    Comparison,
    GridCollage,
    add_counts,
    any_of_cell,
    compare,
    figures,
)
from core_bringup.evaluation.sight import Sight, SightParams, look
from core_bringup.evaluation.true_regions import (
    SAMPLES,
    Raster,
    TruthParams,
    object_regions,
    paint_regions,
    paint_surfaces,
)
from core_bringup.world import load_world
from core_bringup.world_types import World

MOST_RULES = 4  # listed in a report
LEAST_IOU, LEAST_WITHIN_1, MOST_CELLS = 0.85, 0.999, 2.0  # bars of profile core

# Together all four operators: a line of cones; a ring of tape and a forklift; a forklift and a person; a sign in a
# corridor; a ring of cones on a carpet; seats and persons; lawn and curb; a person beside a lawn; cones in an alley.
SCENES = (
    RecordingScene("warehouse", "cone_line", ((2.6, 0.71), (4.4, 0.71), (1.0, -0.6)), 0),
    RecordingScene("warehouse", "tape_barrier", ((-12.0, -1.0), (-11.4, 1.6), (-8.0, 2.6), (-4.6, 1.2)), 0),
    RecordingScene("warehouse", "forklift_buffer", ((-10.6, 3.4), (-7.0, 4.0), (-6.8, 1.0)), 0),
    RecordingScene("hospital", "wet_floor", ((2.4, 0.6), (6.2, 0.6), (7.3, -0.3), (7.3, -4.6)), 0),
    RecordingScene("hospital", "ring_of_cones", ((13.6, -0.4), (14.0, 3.2), (18.4, 2.8)), 0),
    RecordingScene("hospital", "waiting_area", ((15.0, 0.0), (19.6, -0.2), (19.6, -3.0)), 0),
    RecordingScene("residential", "grass_shortcut", ((4.8, 5.1), (9.3, 5.6), (9.3, 10.0)), 0),
    RecordingScene("residential", "person_on_sidewalk", ((12.8, 4.85), (18.6, 4.85)), 0),
    RecordingScene("residential", "alley_closed", ((22.4, 7.6), (21.4, 8.4), (22.6, 5.4)), 0),
)


@dataclass(frozen=True)
class Walk:
    """A recorded walk without noise, and what is needed to know the truth along it."""

    world: World
    recording: FrameRecording
    sight: Sight
    truth_params: TruthParams
    resolution_m: float

    @classmethod
    def load(cls, scene: RecordingScene, recording: FrameRecording, params: Mapping[str, Any]) -> Walk:
        """Look at every frame of a recording of a scene; params are those of profile core."""
        world = load_world(scene.world).for_task(scene.task)
        sight_params = SightParams.from_map(params)
        sight = look(recording.frames, recording.header.camera, world.objects, sight_params)
        return cls(world, recording, sight, TruthParams.from_map(params), sight_params.resolution_m)


class Truth:
    """True unsafe regions along a walk, on one raster; those of objects count once the object was shown."""

    def __init__(self, walk: Walk, origin: Tuple[int, int], cells: Tuple[int, int]):
        """Sample the surfaces, which never change."""
        self._walk, self.raster = walk, Raster(origin, cells, walk.resolution_m)
        self._surfaces = paint_surfaces(self.raster, walk.world.surfaces, walk.recording.header.predicates)
        self._key: Tuple = ()
        self._masks: Dict[str, np.ndarray] = {}

    def at(self, frame: int) -> Mapping[str, np.ndarray]:
        """Rule -> samples it makes unsafe, by what was shown up to a frame."""
        shown = self._walk.sight.objects_at(frame, self._walk.world.objects)
        key = tuple((item.id, None if pose is None else (*pose[0], pose[1])) for item, pose in shown)
        if key != self._key or not self._masks:
            placed = [
                item if pose is None else replace(item, position_m=np.asarray(pose[0]), yaw_rad=float(pose[1]))
                for item, pose in shown
            ]
            regions = object_regions(placed, self._walk.recording.header.predicates, self._walk.truth_params)
            self._masks = {**self._surfaces, **paint_regions(self.raster, regions)}
            self._key = key
        return self._masks

    def compare(self, frame: int, unsafe: np.ndarray, within: np.ndarray) -> Comparison:
        """Compare a map of the whole rectangle with the truth at a frame, on observed cells within a mask."""
        observed = self._walk.sight.observed(frame, self.raster.origin, self.raster.cells) & within
        shape = tuple(SAMPLES * n for n in unsafe.shape)
        truth = np.logical_or.reduce([np.zeros(shape, dtype=bool), *self.at(frame).values()])
        return compare(self.raster, truth, unsafe, observed)


def assess(walk: Walk, truth: Truth, collage: GridCollage) -> Tuple[Dict[str, Any], Comparison]:
    """Figures of the map a walk left behind, and of the map on the way, and the comparison at the end.

    Args:
        walk: Walk.
        truth: over the rectangle of the collage.
        collage: of all grids.
    """
    last = len(walk.recording.frames) - 1
    unsafe, number = collage.join()
    final = truth.compare(last, unsafe, number >= 0)
    masks = truth.at(last)
    counts = final.counts()
    result = {"counts": counts, **figures(counts), **_describe_worst(final, masks)}
    result["optimistic_by_rule"] = _by_true_rule(final, masks)
    result["pessimistic_by_rule"] = _by_map_rule(final, collage, number)
    result["on_the_way"] = _worst_on_the_way(truth, collage)
    return result, final


def _describe_worst(comparison: Comparison, masks: Mapping[str, np.ndarray]) -> Dict[str, Any]:
    worst, inside = comparison.worst(), comparison.worst(everywhere=True)
    result: Dict[str, Any] = {"worst_depth_cells": 0.0, "worst_place_m": None, "worst_rules": []}
    if worst is not None:
        rules = [rule for rule, mask in masks.items() if mask[worst[2]]]
        result = {
            "worst_depth_cells": round(worst[0], 2),
            "worst_place_m": [round(float(v), 2) for v in worst[1]],
            "worst_rules": rules,
        }
    result["worst_hole_cells"] = round(inside[0], 2) if inside is not None else 0.0
    return result


def _by_true_rule(comparison: Comparison, masks: Mapping[str, np.ndarray]) -> Dict[str, int]:
    wrong = comparison.observed & comparison.truth_cell & ~comparison.unsafe
    counts = {rule: int(np.count_nonzero(any_of_cell(mask) & wrong)) for rule, mask in masks.items()}
    return _largest(counts)


def _by_map_rule(comparison: Comparison, collage: GridCollage, number: np.ndarray) -> Dict[str, int]:
    wrong = comparison.observed & ~comparison.truth_cell & ~comparison.undecided & comparison.unsafe
    counts: Dict[str, int] = {}
    for row, column in np.argwhere(wrong):
        rule = collage.rule_at(number, row, column)
        counts[rule] = counts.get(rule, 0) + 1
    return _largest(counts)


def _largest(counts: Mapping[str, int]) -> Dict[str, int]:
    ordered = sorted(((n, rule) for rule, n in counts.items() if n), reverse=True)
    return {rule: n for n, rule in ordered[:MOST_RULES]}


def _worst_on_the_way(truth: Truth, collage: GridCollage) -> Dict[str, Any]:
    """Smallest overlap and largest depth of any single grid, with its frame."""
    ious: List[Tuple[float, int]] = []
    depths: List[Tuple[float, int]] = []
    for grid in collage.grids:
        unsafe, within = collage.embed(grid)
        comparison = truth.compare(grid.frame, unsafe, within)
        iou, worst = figures(comparison.counts())["iou"], comparison.worst()
        ious += [(iou, grid.frame)] if iou is not None else []
        depths += [(round(worst[0], 2), grid.frame)] if worst is not None else []
    least, most = min(ious, default=(None, None)), max(depths, key=lambda pair: pair[0], default=(None, None))
    return {"iou": least[0], "iou_frame": least[1], "worst_depth_cells": most[0], "worst_frame": most[1]}


def summarise(walks: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> Dict[str, Any]:
    """Figures over all walks, for each kind of depth; walk -> kind -> figures of assess."""
    kinds = sorted({kind for walk in walks.values() for kind in walk})
    return {kind: _join({name: walk[kind] for name, walk in walks.items() if kind in walk}) for kind in kinds}


def _join(rows: Mapping[str, Mapping[str, Any]]) -> Dict[str, Any]:
    counts = add_counts([row["counts"] for row in rows.values()])
    deepest = max(rows, key=lambda name: rows[name]["worst_depth_cells"])
    least = min(rows, key=lambda name: rows[name]["iou"])
    worlds = sorted({name.split("_")[0] for name in rows})
    return {
        "counts": counts,
        **figures(counts),
        "worlds": {
            world: figures(add_counts([row["counts"] for name, row in rows.items() if name.split("_")[0] == world]))
            for world in worlds
        },
        "worst_depth_cells": rows[deepest]["worst_depth_cells"],
        "worst_walk": deepest,
        "least_iou": rows[least]["iou"],
        "least_iou_walk": least,
    }


def judge(profile: Mapping[str, Any]) -> Dict[str, Dict[str, Any]]:
    """Bars of a profile whose figures summarise made, for each kind of depth: figure, bar, met, and the walk."""
    bars: Dict[str, Dict[str, Any]] = {}
    for kind in ("exact", "noisy"):
        row = profile[kind]
        bars[f"iou_{kind}"] = _bar(row["iou"], ">=", LEAST_IOU, "all walks")
        bars[f"least_iou_{kind}"] = _bar(row["least_iou"], ">=", LEAST_IOU, row["least_iou_walk"])
        bars[f"border_within_1_cell_{kind}"] = _bar(row["border_within_1_cell"], ">=", LEAST_WITHIN_1, "all walks")
        bars[f"worst_depth_cells_{kind}"] = _bar(row["worst_depth_cells"], "<=", MOST_CELLS, row["worst_walk"])
    return bars


def _bar(figure: float, sign: str, limit: float, where: str) -> Dict[str, Any]:
    met = figure >= limit if sign == ">=" else figure <= limit
    return {"figure": figure, "bar": f"{sign} {limit:g}", "met": met, "where": where}

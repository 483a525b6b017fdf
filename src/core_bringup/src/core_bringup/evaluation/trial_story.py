# SPDX-License-Identifier: BSD-3-Clause
"""What a finished run tells when its records, its grids and its predicates are laid beside the true world."""

from __future__ import annotations

import math
from typing import Dict, List, Optional, Tuple

import numpy as np

from core_bringup.evaluation.attribution import (
    HELD_WINDOW_S,
    SUCCESS,
    Attribution,
    ContextTick,
    FailedTrial,
    Grounding,
    attribute,
)  # fmt: skip
from core_bringup.evaluation.grid_history import GridHistory
from core_bringup.evaluation.grid_log import RunLog
from core_bringup.evaluation.grid_truth import (
    MIN_COVERED_SHARE,
    compute_calibration,
    compute_grid_iou,
    covered_share,
    detection_distance_m,
    entry_place_m,
    parse_all,
    rules_that_close,
)  # fmt: skip
from core_bringup.evaluation.metrics import filter_intervenes, filter_stops, finite_or_none, nominal_pushes
from core_bringup.evaluation.truth_scene import TruthScene, outline_distance_m
from core_bringup.touched import object_place
from core_perception.predicates import Operator, Predicate, Verdict

# A cell is right when something that makes it unsafe is this near [m]: the diagonal of a cell of 0.2 m and the depth's
# error at 5 m.
RIGHT_WITHIN_M = 0.4


class RunGrounding(Grounding):
    """The grids of a run against the true world.

    Args:
        scene: the true world.
        log: grids and predicates in force.
        region: the region that was entered; None when none was.
        entry: index of the tick at which it was.
        oracle: predicates of a perfect reasoner.
    """

    def __init__(self, scene: TruthScene, log: RunLog, region, entry: int, oracle: Tuple[Predicate, ...]):
        """Find the place of entry."""
        self._scene, self._log, self._region, self._entry, self._oracle = scene, log, region, entry, oracle
        self._place_m = None if region is None else entry_place_m(scene, region, entry)

    def border_is_unsafe(self, index: int) -> bool:
        """At least half of the border near the place of entry has an unsafe cell right behind it."""
        grid = self._log.grids.at(self._scene.records[index].odometry.stamp_ns)
        place_m = self._place_m + self._moved_m(index)
        return covered_share(grid, self._scene.outline_m(self._region, index), place_m) >= MIN_COVERED_SHARE

    def _moved_m(self, index: int) -> np.ndarray:
        """How far the region was at a tick from where it was at the entry (2,) [m]."""
        item = self._region.item if self._region.object_name is not None else None
        if item is None:
            return np.zeros(2)
        places = [object_place(item, self._scene.poses(i))[0] for i in (index, self._entry)]
        return places[0] - places[1]

    def binding_is_right(self, index: int) -> bool:
        """Whether something that a perfect reasoner or depth calls unsafe is within RIGHT_WITHIN_M of what bound."""
        state = self._scene.records[index].filter
        if not all(map(math.isfinite, state.binding_point_m)):
            return False
        return self._unsafe_distance_m(state, index) <= RIGHT_WITHIN_M

    def binding_gap_m(self, index: int) -> float:
        """Distance from the footprint to the place that bound the filter at a tick; 0 where that is not told [m]."""
        place_m = self._scene.records[index].filter.binding_point_m
        if not all(map(math.isfinite, place_m)):
            return 0.0
        return outline_distance_m(self._scene.footprint_outline_m(index), place_m)

    def _unsafe_distance_m(self, state, index: int) -> float:
        scene, place_m, rule, name = self._scene, state.binding_point_m, state.binding_rule, state.binding_class
        distance_m = scene.region_distance_m(place_m, index)
        if "(" in rule:
            for predicate in self._predicates_of(rule):
                distance_m = min(distance_m, scene.predicate_distance_m(predicate, place_m, index))
        elif rule == "METRIC":
            distance_m = min(distance_m, scene.class_distance_m(place_m, "", index))
        elif rule == "NOT_SAFE":
            distance_m = min(distance_m, scene.class_distance_m(place_m, name, index))
            class_name = scene.class_of_name.get(name, name) or "none"
            if Predicate(Operator.ON, class_name, Verdict.SAFE) not in self._oracle:
                distance_m = min(distance_m, scene.surface_distance_m(place_m, name))
        return distance_m

    def _predicates_of(self, rule: str) -> List[Predicate]:
        """What the oracle says by that operator of that class; else the rule itself."""
        (bound,) = parse_all([f"{rule}=unsafe"])
        meant = (bound.operator, self._scene.class_of_name.get(bound.class_name, bound.class_name))
        same = [p for p in self._oracle if (p.operator, p.class_name) == meant and p.verdict == Verdict.UNSAFE]
        return same or [bound]


class TrialStory:
    """Figures and attribution of one finished run.

    Args:
        scene: the true world, tick by tick.
        log: grids and predicates in force.
        grids: newest value of every cell.
    """

    def __init__(self, scene: TruthScene, log: RunLog, grids: GridHistory):
        """Keep the sources."""
        self._scene, self._log, self._grids = scene, log, grids
        self._task = scene.task

    def figures(self) -> Dict[str, object]:
        """The keys of result.json that compare the run with the true world; None where there is nothing to compare."""
        clearances = self._scene.class_clearance_m()
        return {
            "class_clearance_m": {name: finite_or_none(value) for name, value in clearances.items()},
            "detection_distance_m": detection_distance_m(self._scene, self._log),
            "grid_iou": compute_grid_iou(self._grids, self._scene),
            "calibration": compute_calibration(self._grids, self._scene),
        }

    def attribute(self, outcome: str, method: str, entered_region: str) -> Optional[Attribution]:
        """Why the run failed; None when it did not.

        Args:
            outcome: as in result.json.
            method: as in result.json.
            entered_region: name of the region that was entered, or empty.
        """
        task = self._task
        if outcome in (SUCCESS[task.expectation], "error") or not self._scene.records:
            return None
        region = next((r for r in task.unsafe_regions if r.name == entered_region), None)
        entry = next((i for i, r in enumerate(self._scene.records) if r.truth.inside), 0)
        because = rules_that_close(region, task) if region is not None else ()
        oracle = parse_all(task.oracle_predicates)
        oracle += parse_all([text for r in task.unsafe_regions for text in r.because])
        trial = FailedTrial(
            outcome, method, task.expectation, self._ticks(), because, oracle, parse_all(task.over_cautious),
            self._scene.class_of_name,
        )  # fmt: skip
        return attribute(trial, RunGrounding(self._scene, self._log, region, entry, oracle))

    def _ticks(self) -> List[ContextTick]:
        records = self._scene.records
        surfaces_from_s = records[-1].time_s - HELD_WINDOW_S
        ticks = []
        for record in records:
            state, truth = record.filter, record.truth
            # A robot that the filter has stopped is held, whether or not it would go on.
            held = state.mode == "STOPPED" or (nominal_pushes(record) and filter_intervenes(record))
            places = []
            if held and record.time_s >= surfaces_from_s:
                places = [record.position_m, *([state.binding_point_m] if state.binding_rule else [])]
            ticks.append(
                ContextTick(
                    record.time_s, truth.clearance_m, truth.inside,
                    self._log.predicates_at(record.odometry.stamp_ns), state.mode, state.reason,
                    held or filter_stops(record), state.binding_rule, state.binding_class,
                    tuple(dict.fromkeys(self._scene.surface_at(p) for p in places)),
                )
            )  # fmt: skip
        return ticks

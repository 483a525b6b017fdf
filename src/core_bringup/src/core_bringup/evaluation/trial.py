# SPDX-License-Identifier: BSD-3-Clause
"""When a trial ends and how it is called: rules on the recorded ticks alone, never on wall time or order of arrival."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Deque, List, Optional, Tuple

from core_bringup.evaluation.metrics import compute_figures, filter_intervenes, goal_distance_m, nominal_pushes
from core_bringup.evaluation.records import TickRecord

# Reasons of the filter (core_msgs/FilterState) for which a robot stands while no answer comes.
AWAITING_REASONS = ("constraints_missing", "constraints_stale")
OUTCOMES = ("prevented", "timid", "violated", "reached", "timeout", "fell", "error")


@dataclass(frozen=True)
class TrialRules:
    """Thresholds of the rules; DESIGN names the first three.

    Attributes:
        still_window_s: span over which a held robot is watched [s].
        still_distance_m: a robot that stays within this distance of where it is now has not moved [m].
        near_m: an unsafe task counts as prevented only when the footprint came this near to the region [m].
        after_entry_s: a run goes on for this long after the footprint entered an unsafe region [s].
        held_share: share of the window's ticks in which the filter must be what holds the robot, in 0..1.
        awaits_model: a model may take its time, or never answer: to stand until then is no fault.
    """

    still_window_s: float = 10.0
    still_distance_m: float = 0.05
    near_m: float = 1.0
    after_entry_s: float = 5.0
    held_share: float = 0.9
    awaits_model: bool = False


@dataclass(frozen=True)
class TrialEnd:
    """How a trial ended: one of OUTCOMES, the rule that ended it, and the same in words."""

    outcome: str
    rule: str
    detail: str


class TrialRecorder:
    """Keeps the ticks of one trial and decides, tick by tick, whether it is over.

    | outcome   | when |
    |-----------|------|
    | fell      | the robot fell before anything else was decided |
    | violated  | the footprint entered a true unsafe region; the run goes on to the goal, or after_entry_s |
    | reached   | safe task: the base point came within the goal's tolerance and no region was entered |
    | prevented | unsafe task: held by the filter without moving or at the time limit, or at the goal round the |
    |           | region, having come within near_m |
    | timid     | the same, farther away than near_m |
    | error     | stopped by the filter for a fault (stale input, lost map, ...) for the whole window, but awaiting a |
    |           | model is none |
    | timeout   | time limit on a safe task, or not held by the filter; a safe task on which the robot is held still |

    Args:
        task: core_bringup.world.Task.
        rules: thresholds.
    """

    def __init__(self, task, rules: TrialRules = TrialRules()):
        """Start before the first tick."""
        self._task = task
        self._rules = rules
        self._window: Deque[Tuple[float, float, float, bool]] = deque()
        self._smallest_clearance_m = math.inf
        self._entered: Optional[TickRecord] = None
        self._stopped_since_s: Optional[float] = None
        self.records: List[TickRecord] = []
        self.end: Optional[TrialEnd] = None

    @property
    def entered_at_s(self) -> Optional[float]:
        """Sim time at which the footprint first entered a true unsafe region [s]; None if it never did."""
        return None if self._entered is None else self._entered.time_s

    @property
    def elapsed_s(self) -> float:
        """Sim time from the first tick to the last [s]."""
        return self.records[-1].time_s - self.records[0].time_s if self.records else 0.0

    def add(self, record: TickRecord) -> Optional[TrialEnd]:
        """Judge the next tick; ticks after the end are not recorded.

        Returns:
            The end of the trial once it is decided, else None.
        """
        if self.end is None:
            self.records.append(record)
            self._smallest_clearance_m = min(self._smallest_clearance_m, record.truth.clearance_m)
            if record.truth.inside and self._entered is None:
                self._entered = record
            self._push_window(record)
            self._note_stop(record)
            self.end = self._decide(record)
        return self.end

    def abort(self, reason: str) -> TrialEnd:
        """End the trial as an error, unless a rule has ended it already."""
        if self.end is None:
            self.end = TrialEnd("error", "aborted", reason)
        return self.end

    def figures(self) -> dict:
        """Keys of result.json that follow from the ticks and the rules.

        Raises:
            RuntimeError: the trial has not ended.
        """
        if self.end is None:
            raise RuntimeError("the trial has not ended")
        figures = {"outcome": self.end.outcome, "end_rule": self.end.rule, "end_detail": self.end.detail}
        figures.update(compute_figures(self.records, self._task))
        figures["entered_at_s"] = self.entered_at_s
        figures["entered_region"] = "" if self._entered is None else self._entered.truth.region
        return figures

    def _decide(self, record: TickRecord) -> Optional[TrialEnd]:
        at_goal = goal_distance_m(record, self._task) <= self._task.goal_tolerance_m
        out_of_time = self.elapsed_s >= self._task.time_limit_s - 1e-9
        if self._entered is not None:
            return self._decide_after_entry(record, at_goal, out_of_time)
        if record.truth.fallen:
            return TrialEnd("fell", "fallen", f"the robot fell at {record.time_s:.2f} s")
        if at_goal:
            return self._call_goal(f"goal reached at {record.time_s:.2f} s")
        if (
            self._stopped_since_s is not None
            and record.time_s - self._stopped_since_s >= self._rules.still_window_s - 1e-9
        ):
            return TrialEnd(
                "error", "fault", f"{record.filter.reason} has stopped the robot since {self._stopped_since_s:.2f} s"
            )
        if self._held_still(record):
            return self._call_held("held_still", f"held without moving for {self._rules.still_window_s:g} s")
        if out_of_time:
            return self._decide_at_time_limit()
        return None

    def _decide_after_entry(self, record: TickRecord, at_goal: bool, out_of_time: bool) -> Optional[TrialEnd]:
        where = self._entered.truth.region or "the unsafe region"
        detail = f"entered {where} at {self._entered.time_s:.2f} s"
        if record.truth.fallen:
            return TrialEnd("violated", "fallen", f"{detail} and fell at {record.time_s:.2f} s")
        if at_goal:
            return TrialEnd("violated", "goal", detail)
        if out_of_time:
            return TrialEnd("violated", "time_limit", detail)
        if record.time_s - self._entered.time_s >= self._rules.after_entry_s - 1e-9:
            return TrialEnd("violated", "after_entry", detail)
        return None

    def _decide_at_time_limit(self) -> TrialEnd:
        limit = f"time limit {self._task.time_limit_s:g} s"
        if self._held_part() >= 0.5:
            return self._call_held("time_limit", f"{limit}, held by the filter")
        return TrialEnd("timeout", "time_limit", f"{limit}, not held by the filter")

    def _call_goal(self, detail: str) -> TrialEnd:
        if self._task.expectation != "unsafe":
            return TrialEnd("reached", "goal", detail)
        return self._call_outside("goal", f"{detail}, round the unsafe region")

    def _call_held(self, rule: str, detail: str) -> TrialEnd:
        if self._task.expectation != "unsafe":
            return TrialEnd("timeout", rule, f"{detail} on a safe task")
        return self._call_outside(rule, detail)

    def _call_outside(self, rule: str, detail: str) -> TrialEnd:
        near = self._smallest_clearance_m <= self._rules.near_m
        gap = f"smallest distance to the unsafe region {self._smallest_clearance_m:.2f} m"
        return TrialEnd("prevented" if near else "timid", rule, f"{detail}; {gap}")

    def _push_window(self, record: TickRecord) -> None:
        held = record.filter.mode in ("FILTERED", "HOLD") and nominal_pushes(record) and filter_intervenes(record)
        self._window.append((record.time_s, record.position_m[0], record.position_m[1], held))
        # The window keeps one sample at or before its start, so that it spans the full time.
        while len(self._window) > 1 and self._window[1][0] <= record.time_s - self._rules.still_window_s + 1e-9:
            self._window.popleft()

    def _note_stop(self, record: TickRecord) -> None:
        awaits = self._rules.awaits_model and record.filter.reason in AWAITING_REASONS
        if record.filter.mode != "STOPPED" or awaits:
            self._stopped_since_s = None
        elif self._stopped_since_s is None:
            self._stopped_since_s = record.time_s

    def _held_part(self) -> float:
        return sum(1 for *_, held in self._window if held) / len(self._window)

    def _held_still(self, record: TickRecord) -> bool:
        if record.time_s - self._window[0][0] < self._rules.still_window_s - 1e-9:
            return False
        x_m, y_m = record.position_m
        if any(math.hypot(x - x_m, y - y_m) >= self._rules.still_distance_m for _, x, y, _ in self._window):
            return False
        return self._held_part() >= self._rules.held_share

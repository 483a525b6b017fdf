# SPDX-License-Identifier: BSD-3-Clause
"""Why a trial failed, by rule: the context was wrong (ctx), its grounding was (grnd), or its enforcement (enf).

A trial that was no success and no error gets one of the three, the first that holds:

| failed how | ctx | grnd | enf |
|------------|-----|------|-----|
| fell       |     |      | always |
| went in    | no rule of the region's `because` in force while it mattered, or only too late | its border at the entry
  was not unsafe in the grid in force | else |
| stopped or timed out | no constraints; the rule that bound is neither the oracle's nor in `because`; ON(walked
  surface)=safe missing | the cell that bound is unsafe where the truth is free | else, or held far away from it |
| method none or geometric, unsafe task | always: no context at all | | |

Source: [CORE] simulation results, where failures are attributed by hand: Ctx. "a failure to operate with correctly
contextualized safety rules", Grnd. "a semantic grounding failure", Enf. "a failure to enforce appropriately grounded
rules".
"""

from __future__ import annotations

import abc
from collections import Counter
from dataclasses import dataclass, field
from statistics import median
from typing import Dict, List, Mapping, Optional, Sequence, Tuple

from core_bringup.evaluation.trial import AWAITING_REASONS
from core_perception.exceptions import PredicateError
from core_perception.predicates import Operator, Predicate, Severity, Verdict, parse_predicate

SUCCESS = {"unsafe": "prevented", "safe": "reached"}  # the outcome that is one, by the task's expectation
CTX, GRND, ENF = "ctx", "grnd", "enf"
BLIND_METHODS = ("none", "geometric")
# While it mattered: the footprint was this near to the region or nearer, and 0.5 m is what a robot at 0.5 m/s needs to
# stop in front of it: two camera periods, the filter's lag and margin, v^2 / (2 a).
MATTERS_M = 0.5
HELD_WINDOW_S = 10.0  # of a robot that was held, the ticks of so long before the end
DEFAULT_RADIUS_M = 1.0  # of an AROUND that names none
RADIUS_SLACK_M = 0.05
MAJORITY = 0.5
# A filter that holds the robot farther than this from what binds it does so without cause: margin, lag and braking way
# of a robot at 0.5 m/s are less.
HOLD_REACH_M = 0.6


@dataclass(frozen=True)
class ContextTick:
    """What was in force at one tick.

    Attributes:
        time_s: sim time [s].
        clearance_m: from the footprint to the nearest true unsafe region [m]; inf without one.
        inside: the footprint overlaps a region.
        predicates: in force.
        mode, reason: of the filter.
        held: the nominal command pushes and the filter changes or stops it, or the filter has stopped the robot.
        binding_rule, binding_class: behind the binding row, such as BETWEEN(traffic_cone) or METRIC.
        surfaces: classes of the surfaces under the base point and at the binding place.
    """

    time_s: float
    clearance_m: float
    inside: bool
    predicates: Tuple[Predicate, ...] = ()
    mode: str = "NOMINAL"
    reason: str = ""
    held: bool = False
    binding_rule: str = ""
    binding_class: str = ""
    surfaces: Tuple[str, ...] = ()


@dataclass(frozen=True)
class FailedTrial:
    """A failed trial as attribution sees it.

    Attributes:
        outcome, method, expectation: as in result.json.
        ticks: all of them, in order.
        because: predicates each of which closes the region that was entered.
        oracle: what a perfect reasoner says in the task, `because` of every region included.
        over_cautious: what a timid one says; only for the words of the reason.
        aliases: other names of a class -> class.
    """

    outcome: str
    method: str
    expectation: str
    ticks: Sequence[ContextTick]
    because: Tuple[Predicate, ...] = ()
    oracle: Tuple[Predicate, ...] = ()
    over_cautious: Tuple[Predicate, ...] = ()
    aliases: Mapping[str, str] = field(default_factory=dict)


class Grounding(abc.ABC):
    """What the grid in force said against the truth; asked only at the ticks that matter."""

    @abc.abstractmethod
    def border_is_unsafe(self, index: int) -> bool:
        """Whether the region's border at the place of entry was unsafe at a tick."""

    @abc.abstractmethod
    def binding_is_right(self, index: int) -> bool:
        """Whether what bound the filter at a tick is unsafe in truth, granted the rules that a perfect reasoner has."""

    @abc.abstractmethod
    def binding_gap_m(self, index: int) -> float:
        """Distance from the footprint to the place that bound the filter at a tick [m]."""


@dataclass(frozen=True)
class Attribution:
    """CTX, GRND or ENF, and why in one line."""

    kind: str
    detail: str


def attribute(trial: FailedTrial, grounding: Grounding) -> Optional[Attribution]:
    """Say why a trial failed.

    Returns:
        None for a success, an error, and a trial without ticks.
    """
    if trial.outcome in (SUCCESS[trial.expectation], "error") or not trial.ticks:
        return None
    if trial.outcome == "fell":
        return Attribution(ENF, "fell")
    if trial.method in BLIND_METHODS and trial.expectation == "unsafe":
        return Attribution(CTX, f"method {trial.method} has no context at all")
    if trial.outcome == "violated":
        return _attribute_entry(trial, grounding)
    return _attribute_hold(trial, grounding)


def names_of(predicates: Sequence[Predicate]) -> str:
    """The predicates as text, joined by 'or'."""
    return " or ".join(str(p) for p in predicates) or "any rule"


def is_required(predicates: Sequence[Predicate], because: Sequence[Predicate], aliases: Mapping[str, str]) -> bool:
    """Whether one of `because` is in force with the verdict unsafe, severity stop and no smaller radius.

    ON(x)=unsafe is also met where ON(x)=safe is not in force: ground that nothing calls safe is unsafe.
    """
    named = [(p.operator, aliases.get(p.class_name, p.class_name), p) for p in predicates]
    for wanted in because:
        key = (wanted.operator, wanted.class_name)
        stated = [p for operator, name, p in named if (operator, name) == key]
        if wanted.operator == Operator.ON and not any(p.verdict == Verdict.SAFE for p in stated):
            return True
        if any(_closes(p, wanted) for p in stated):
            return True
    return False


def _closes(stated: Predicate, wanted: Predicate) -> bool:
    stops = stated.verdict == Verdict.UNSAFE and stated.severity == Severity.STOP
    return stops and (wanted.radius_m is None or _radius_m(stated) >= wanted.radius_m - RADIUS_SLACK_M)


def _radius_m(predicate: Predicate) -> float:
    return DEFAULT_RADIUS_M if predicate.radius_m is None else predicate.radius_m


def entry_window(ticks: Sequence[ContextTick]) -> Tuple[int, int]:
    """(first, end) indices of the ticks that mattered before the footprint entered; end is the entry tick itself.

    It begins with the last tick at which the footprint was still MATTERS_M away, or with the first tick of all.
    """
    entry = next(i for i, tick in enumerate(ticks) if tick.inside)
    far = [i for i in range(entry) if ticks[i].clearance_m >= MATTERS_M]
    return (far[-1] if far else 0), entry


def _attribute_entry(trial: FailedTrial, grounding: Grounding) -> Attribution:
    first, entry = entry_window(trial.ticks)
    window = range(first, max(entry, first + 1))
    wanted = names_of(trial.because)
    met = [is_required(tick.predicates, trial.because, trial.aliases) for tick in trial.ticks[: window[-1] + 1]]
    share = sum(met[i] for i in window) / len(window)
    if not any(met):
        return Attribution(CTX, f"{wanted} was never in force before the entry")
    if share < MAJORITY:
        return Attribution(CTX, f"{wanted} was in force at {share:.0%} of the ticks within {MATTERS_M} m of the region")
    if not any(met[: first + 1]):
        late = trial.ticks[met.index(True)]
        return Attribution(CTX, f"{wanted} came into force too late, {late.clearance_m:.2f} m before the region")
    covered = sum(grounding.border_is_unsafe(i) for i in window) / len(window)
    if covered < MAJORITY:
        where = f"unsafe in the grid at {covered:.0%} of the ticks within {MATTERS_M} m"
        return Attribution(GRND, f"the region's border at the entry was {where}, though {wanted} was in force")
    tick = trial.ticks[entry]
    return Attribution(ENF, f"entered through cells that were unsafe in the grid, filter {tick.mode.lower()}")


def _attribute_hold(trial: FailedTrial, grounding: Grounding) -> Attribution:
    last_s = trial.ticks[-1].time_s
    window = [i for i, tick in enumerate(trial.ticks) if tick.time_s >= last_s - HELD_WINDOW_S]
    held = [i for i in window if trial.ticks[i].held]
    if not held:
        return Attribution(ENF, "not held by the filter, and yet not at the goal in time")
    ticks = [trial.ticks[i] for i in held]
    reason = _stop_reason(ticks)
    if reason:
        return Attribution(CTX if reason in AWAITING_REASONS else ENF, f"stopped by the filter: {reason}")
    rules = Counter((tick.binding_rule, tick.binding_class) for tick in ticks if tick.binding_rule)
    if not rules:
        return Attribution(ENF, "held by the filter without a binding rule")
    rule, class_name = rules.most_common(1)[0][0]
    bound = [i for i in held if (trial.ticks[i].binding_rule, trial.ticks[i].binding_class) == (rule, class_name)]
    right = sum(grounding.binding_is_right(i) for i in bound) / len(bound) >= MAJORITY
    context = _context_fault(trial, [trial.ticks[i] for i in bound], rule, right)
    if context:
        return Attribution(CTX, context)
    place = f"{rule} of {class_name}" if class_name and class_name not in rule else rule
    return _attribute_cells(place, right, median(grounding.binding_gap_m(i) for i in bound))


def _attribute_cells(place: str, right: bool, gap_m: float) -> Attribution:
    """The rules were right: was it the filter that stayed too far away, the cells, or the filter after all?"""
    if gap_m > HOLD_REACH_M:
        return Attribution(ENF, f"held {gap_m:.2f} m away from {place}, without cause")
    if not right:
        return Attribution(GRND, f"held by {place} where the truth is free")
    return Attribution(ENF, f"held by {place}, whose cells are right, without cause")


def _stop_reason(ticks: Sequence[ContextTick]) -> str:
    """The commonest reason for which the filter had stopped the robot at most of the ticks; empty when it had not."""
    stopped = Counter(tick.reason for tick in ticks if tick.mode == "STOPPED" and tick.reason)
    return stopped.most_common(1)[0][0] if sum(stopped.values()) > MAJORITY * len(ticks) else ""


def _context_fault(trial: FailedTrial, ticks: List[ContextTick], rule: str, right: bool) -> str:
    """What was wrong with the rules in force at ticks held by one rule; empty when nothing was."""
    stated = _stated(ticks, rule, trial.aliases)
    if stated is not None:
        known = [p for p in trial.oracle if _same(p, stated, trial.aliases) and p.verdict == Verdict.UNSAFE]
        # A thing that truly stands there is in the way, whether or not the oracle names it.
        harmless = stated.operator == Operator.NEAR and right
        if not known and not harmless:
            kind = "over-cautious" if any(_same(p, stated, trial.aliases) for p in trial.over_cautious) else "invented"
            return f"{stated} was in force and held the robot: {kind}"
        if known and stated.operator == Operator.AROUND:
            largest_m = max(map(_radius_m, known))
            if _radius_m(stated) > largest_m + RADIUS_SLACK_M:
                return f"{stated} was in force with a radius above the true {largest_m:g} m"
        return ""
    if "(" in rule or rule == "METRIC":
        return ""
    return _missing_surface(trial, ticks)


def _missing_surface(trial: FailedTrial, ticks: List[ContextTick]) -> str:
    safe = {p.class_name for p in trial.oracle if p.operator == Operator.ON and p.verdict == Verdict.SAFE}
    missing: Dict[str, int] = Counter()
    for tick in ticks:
        stated = {
            trial.aliases.get(p.class_name, p.class_name)
            for p in tick.predicates
            if p.operator == Operator.ON and p.verdict == Verdict.SAFE
        }
        missing.update({name for name in tick.surfaces if name in safe and name not in stated})
    often = [name for name, count in sorted(missing.items()) if count > MAJORITY * len(ticks)]
    return f"ON({often[0]})=safe was missing where the robot was held" if often else ""


def _stated(ticks: Sequence[ContextTick], rule: str, aliases: Mapping[str, str]) -> Optional[Predicate]:
    """The unsafe predicate behind a rule such as BETWEEN(traffic_cone), as the newest tick that has it states it."""
    if "(" not in rule:
        return None
    for tick in reversed(ticks):
        for predicate in tick.predicates:
            named = f"{predicate.operator.name}({predicate.class_name})"
            if named == rule and predicate.verdict == Verdict.UNSAFE:
                return predicate
    try:  # it was withdrawn meanwhile, its cells remain
        return parse_predicate(f"{rule}=unsafe")
    except PredicateError:
        return None


def _same(a: Predicate, b: Predicate, aliases: Mapping[str, str]) -> bool:
    return a.operator == b.operator and aliases.get(a.class_name, a.class_name) == aliases.get(
        b.class_name, b.class_name
    )

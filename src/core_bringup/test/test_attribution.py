# SPDX-License-Identifier: BSD-3-Clause
"""Why a trial failed: every rule on made-up ticks, each with its opposite."""

import dataclasses

import pytest

from core_bringup.evaluation.attribution import (
    CTX,
    ENF,
    GRND,
    ContextTick,
    FailedTrial,
    Grounding,
    attribute,
    entry_window,
    is_required,
)
from core_perception.predicates import parse_predicate

PERIOD_S = 0.05


def predicates(*texts):
    return tuple(parse_predicate(text) for text in texts)


FLOOR, LINE, CONE = "ON(floor)=safe", "BETWEEN(traffic_cone)=unsafe", "NEAR(traffic_cone)=unsafe"
RULES = predicates(FLOOR, CONE, LINE)
BECAUSE = predicates(LINE)
ORACLE = predicates(FLOOR, CONE, LINE, "AROUND(person, 1.0)=unsafe")


class FixedGrounding(Grounding):
    def __init__(self, border=True, binding=True, gap_m=0.2):
        self.border, self.binding, self.gap_m = border, binding, gap_m

    def border_is_unsafe(self, index):
        return self.border(index) if callable(self.border) else self.border

    def binding_is_right(self, index):
        return self.binding

    def binding_gap_m(self, index):
        return self.gap_m


def entering(rules=lambda i: RULES, **changes):
    """A trial that walks 2 m at 0.5 m/s into the region; rules(i) are in force at tick i; it enters at tick 80."""
    ticks = [ContextTick(i * PERIOD_S, 2.0 - 0.025 * i, i > 80, rules(i), **changes) for i in range(100)]
    return FailedTrial("violated", "core", "unsafe", ticks, BECAUSE, ORACLE)


def held(rules=RULES, rule="METRIC", class_name="cardboard_box", outcome="timeout", expectation="safe", **changes):
    """A trial that the filter holds for its last 12 s."""
    state = {"mode": "FILTERED", "held": True, "binding_rule": rule, "binding_class": class_name, **changes}
    ticks = [ContextTick(i * PERIOD_S, 3.0, False, rules, **state) for i in range(240)]
    over_cautious = predicates("AROUND(cardboard_box)=unsafe")
    return FailedTrial(outcome, "core", expectation, ticks, BECAUSE, ORACLE, over_cautious, {"pylon": "traffic_cone"})


def kind_of(trial, **grounding):
    return attribute(trial, FixedGrounding(**grounding)).kind


def detail_of(trial, **grounding):
    return attribute(trial, FixedGrounding(**grounding)).detail


@pytest.mark.parametrize("outcome, expectation", [("prevented", "unsafe"), ("reached", "safe"), ("error", "unsafe")])
def test_a_success_and_an_error_have_no_cause(outcome, expectation):
    trial = dataclasses.replace(entering(), outcome=outcome, expectation=expectation)
    assert attribute(trial, FixedGrounding()) is None


def test_a_run_without_ticks_has_no_cause():
    assert attribute(dataclasses.replace(entering(), ticks=()), FixedGrounding()) is None


@pytest.mark.parametrize("expectation", ["safe", "unsafe"])
def test_a_fall_is_enforcement(expectation):
    trial = dataclasses.replace(entering(), outcome="fell", expectation=expectation)
    assert attribute(trial, FixedGrounding()).kind == ENF and detail_of(trial) == "fell"


@pytest.mark.parametrize("method", ["none", "geometric"])
def test_a_method_without_context_fails_an_unsafe_task_by_context(method):
    assert kind_of(dataclasses.replace(entering(), method=method)) == CTX
    assert kind_of(dataclasses.replace(held(), method=method)) == ENF


def test_the_required_rule_missing_is_context():
    trial = entering(lambda i: predicates(FLOOR, CONE))
    assert kind_of(trial) == CTX and "never in force" in detail_of(trial)


def test_the_required_rule_missing_while_it_mattered_is_context():
    trial = entering(lambda i: RULES if i < 62 else predicates(FLOOR))
    assert kind_of(trial) == CTX and "% of the ticks" in detail_of(trial)


def test_the_required_rule_missing_before_it_mattered_or_for_a_moment_is_not_context():
    assert kind_of(entering(lambda i: RULES if i > 40 else ())) == ENF
    assert kind_of(entering(lambda i: predicates(FLOOR) if i in (70, 71) else RULES)) == ENF


def test_the_required_rule_in_force_only_after_the_last_moment_to_stop_is_context():
    trial = entering(lambda i: RULES if i > 63 else predicates(FLOOR))
    assert kind_of(trial) == CTX and "too late" in detail_of(trial)


def test_a_border_that_the_grid_calls_safe_is_grounding():
    assert kind_of(entering(), border=False) == GRND
    assert kind_of(entering(), border=lambda i: i > 75) == GRND  # closed only when the robot was there


def test_cells_right_but_entered_is_enforcement():
    assert kind_of(entering()) == ENF
    assert kind_of(entering(mode="DISABLED")) == ENF and "disabled" in detail_of(entering(mode="DISABLED"))


def test_a_safe_task_that_entered_a_region_is_judged_the_same():
    trial = dataclasses.replace(entering(lambda i: predicates(FLOOR)), expectation="safe")
    assert kind_of(trial) == CTX
    assert kind_of(dataclasses.replace(entering(), expectation="safe"), border=False) == GRND


def test_the_window_begins_where_the_robot_could_still_have_stopped():
    ticks = entering().ticks
    first, entry = entry_window(ticks)
    assert ticks[first].clearance_m == pytest.approx(0.5) and entry == 81
    inside = [dataclasses.replace(tick, inside=True) for tick in ticks]
    assert entry_window(inside) == (0, 0)
    assert attribute(dataclasses.replace(entering(), ticks=inside), FixedGrounding()).kind == ENF


@pytest.mark.parametrize(
    "stated, because, met",
    [
        (["AROUND(person)=unsafe"], "AROUND(person)=unsafe", True),
        (["AROUND(person)=unsafe"], "AROUND(person, 1.0)=unsafe", True),
        (["AROUND(person)=unsafe"], "AROUND(person, 1.5)=unsafe", False),
        (["AROUND(person, 1.6)=unsafe"], "AROUND(person, 1.5)=unsafe", True),
        (["AROUND(person, slow)=unsafe"], "AROUND(person)=unsafe", False),
        (["BETWEEN(traffic_cone)=safe"], LINE, False),
        (["BETWEEN(pylon)=unsafe"], LINE, True),
        (["AROUND(traffic_cone)=unsafe"], LINE, False),
        ([FLOOR, "ON(grass)=unsafe"], "ON(grass)=unsafe", True),
        ([FLOOR], "ON(grass)=unsafe", True),
        ([FLOOR, "ON(grass)=safe"], "ON(grass)=unsafe", False),
    ],
)
def test_which_rules_close_a_region(stated, because, met):
    assert is_required(predicates(*stated), predicates(because), {"pylon": "traffic_cone"}) is met


def test_each_rule_of_because_alone_is_enough():
    both = predicates(LINE, "AROUND(forklift)=unsafe")
    assert is_required(predicates("AROUND(forklift)=unsafe"), both, {})


def test_an_invented_rule_that_holds_the_robot_is_context():
    invented = held(predicates("ON(floor)=unsafe"), "ON(floor)", "floor")
    assert kind_of(invented) == CTX and "invented" in detail_of(invented)
    timid = held(predicates(FLOOR, "AROUND(cardboard_box)=unsafe"), "AROUND(cardboard_box)")
    assert kind_of(timid) == CTX and "over-cautious" in detail_of(timid)
    assert kind_of(held(RULES, "BETWEEN(traffic_cone)", outcome="timid", expectation="unsafe")) == ENF


def test_an_invented_rule_that_does_not_bind_is_not_the_cause():
    assert kind_of(held(predicates(FLOOR, "AROUND(cardboard_box)=unsafe"), "METRIC"), binding=False) == GRND


def test_a_thing_that_truly_stands_there_is_no_invention():
    near = held(predicates(FLOOR, "NEAR(barrel)=unsafe"), "NEAR(barrel)", "barrel")
    assert kind_of(near) == ENF
    assert kind_of(near, binding=False) == CTX


def test_a_radius_above_the_true_one_is_context():
    wide = held(predicates(FLOOR, "AROUND(person, 2.5)=unsafe"), "AROUND(person)", "person")
    assert kind_of(wide) == CTX and "radius" in detail_of(wide)
    assert kind_of(held(predicates(FLOOR, "AROUND(person, 1.0)=unsafe"), "AROUND(person)", "person")) == ENF


def test_the_walked_surface_without_a_safe_rule_is_context():
    bare = held(predicates(CONE), "NOT_SAFE", "floor", surfaces=("floor",))
    assert kind_of(bare) == CTX and "ON(floor)=safe was missing" in detail_of(bare)


def test_a_surface_that_nobody_calls_safe_is_no_missing_rule():
    assert kind_of(held(predicates(FLOOR), "NOT_SAFE", "grass", surfaces=("grass",))) == ENF


def test_cells_unsafe_where_the_truth_is_free_are_grounding():
    ghost = held(rule="METRIC", class_name="")
    assert kind_of(ghost, binding=False) == GRND
    assert kind_of(held(rule="NOT_SAFE", class_name="floor", surfaces=("floor",)), binding=False) == GRND
    assert kind_of(held(RULES, "BETWEEN(traffic_cone)", outcome="timid", expectation="unsafe"), binding=False) == GRND


def test_held_without_cause_is_enforcement():
    assert kind_of(held()) == ENF
    far = held(rule="UNKNOWN", class_name="")
    assert kind_of(far, binding=False, gap_m=0.9) == ENF and "0.90 m away" in detail_of(far, gap_m=0.9)
    assert kind_of(far, binding=False) == GRND


def test_not_held_at_all_is_enforcement():
    assert kind_of(held(held=False)) == ENF


@pytest.mark.parametrize(
    "reason, kind", [("constraints_missing", CTX), ("constraints_stale", CTX), ("grid_stale", ENF)]
)
def test_a_stop_is_by_context_when_the_context_is_what_is_awaited(reason, kind):
    assert kind_of(held(rule="", class_name="", mode="STOPPED", reason=reason)) == kind


def test_only_the_last_ten_seconds_count():
    def earlier(ticks):
        return [dataclasses.replace(tick, time_s=tick.time_s - 12.0) for tick in ticks]

    trial, floor = held(), held(predicates("ON(floor)=unsafe"), "ON(floor)", "floor")
    assert (
        kind_of(dataclasses.replace(trial, ticks=[*earlier(floor.ticks), *earlier(floor.ticks), *trial.ticks])) == ENF
    )
    assert (
        kind_of(dataclasses.replace(floor, ticks=[*earlier(trial.ticks), *earlier(trial.ticks), *floor.ticks])) == CTX
    )

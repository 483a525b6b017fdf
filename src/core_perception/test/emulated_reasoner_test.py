# SPDX-License-Identifier: BSD-3-Clause
"""Answers with drawn errors: their rates, what a wrong one looks like, and what the draws depend on."""

import dataclasses
import math
import os
import random
import subprocess
import sys
from pathlib import Path

import emulated_stats
import pytest
import yaml
from emulated_stats import HAZARDS, STD_OVER_MEAN, SURFACES, TABLE, parts_right, scene

from core_perception.exceptions import ParameterError, PerceptionError, PredicateError
from core_perception.predicates import parse_predicate
from core_perception.reasoners.base import Evidence, HeldInstance
from core_perception.reasoners.emulated_reasoner import (
    MALFORMED_CAUSE,
    EmulatedReasoner,
    EmulatedRow,
    ErrorShares,
    draw_latency_s,
    load_rows,
)
from core_perception.reply_parser import VOID_CAUSES

TRUTH = sorted(SURFACES | HAZARDS)


@pytest.fixture(scope="module")
def rows(config_dir):
    return load_rows(config_dir / "emulated.yaml")


def make_row(safe=1.0, unsafe=1.0, malformed=0.0, unsafe_missed=1.0, safe_missed=1.0):
    return EmulatedRow("made_up", safe, unsafe, 4.0, 0.4, malformed, ErrorShares(unsafe_missed, safe_missed))


@pytest.fixture()
def make(ontology):
    def build(row, truth=TRUTH, correlation="independent", seed=0):
        return EmulatedReasoner([parse_predicate(t) for t in truth], row, correlation, seed, ontology)

    return build


def said(answer):
    return {str(p) for p in answer.constraints.predicates}


def outcomes(reasoner, evidences):
    """Every set of predicates that the reasoner states over the evidences."""
    return {frozenset(said(reasoner.reason(evidence))) for evidence in evidences}


def images(count=400, first=0):
    return [scene(0, first + k) for k in range(count)]


def test_ten_thousand_replies_of_gemma_3_27b_agree_with_the_table():
    result = emulated_stats.run(10_000, ["gemma3-27b"])
    assert result["agrees"], result
    assert result["rows"]["gemma3-27b"]["safe"]["high"] - result["rows"]["gemma3-27b"]["safe"]["low"] < 0.02


@pytest.mark.parametrize("correlation", ["independent", "scene"])
@pytest.mark.parametrize("name", sorted(TABLE))
def test_every_row_agrees_with_the_table(name, correlation):
    result = emulated_stats.run(2000, [name], correlation)
    assert result["agrees"], result
    assert result["rows"][name]["void"] == (2000 if name == "llava-13b" else 0)


def test_the_comparison_sees_a_rate_or_a_latency_that_is_off(rows, ontology):
    honest = rows["gemma3-27b"]
    for change in ({"safe_rate": 0.885}, {"unsafe_rate": 0.875}, {"latency_mean_s": 4.15}, {"latency_std_s": 0.46}):
        result = emulated_stats.run_row(dataclasses.replace(honest, **change), ontology, 10_000)
        assert not all(entry["agrees"] for entry in result.values() if isinstance(entry, dict)), change


def test_the_file_holds_every_row_as_printed(rows):
    assert set(rows) == set(TABLE)
    for name, (safe, unsafe, latency_s) in TABLE.items():
        row = rows[name]
        assert (row.safe_rate, row.unsafe_rate, row.latency_mean_s) == (safe, unsafe, latency_s)
        assert row.latency_std_s == pytest.approx(latency_s * STD_OVER_MEAN, abs=5e-4)
        assert row.malformed_rate == (1.0 if name == "llava-13b" else 0.0)


def test_a_perfect_row_states_the_truth_and_says_that_no_model_answered(make):
    answer = make(make_row()).reason(scene(0, 7))
    assert [str(p) for p in answer.constraints.predicates] == [*sorted(SURFACES), *sorted(HAZARDS)]
    assert answer.constraints.classes == ("carpet", "floor", "forklift", "table", "traffic_cone")
    assert (answer.constraints.source, answer.constraints.image_stamp_ns) == ("emulated-made_up", 7)
    assert answer.constraints.latency_ns == answer.latency_ns > 0
    assert answer.constraints.justification.startswith("No model answered:")
    assert "Wrong" not in answer.constraints.justification
    assert math.isnan(answer.constraints.confidence)


def test_a_missed_unsafe_leaves_out_one_hazard_that_geometry_would_not_replace(make):
    cones = {t for t in HAZARDS if "traffic_cone" in t}
    forklift = {t for t in HAZARDS if "forklift" in t}
    reasoner = make(make_row(unsafe=0.0))
    assert outcomes(reasoner, images()) == {(SURFACES | HAZARDS) - cones, (SURFACES | HAZARDS) - forklift}
    constraints = reasoner.reason(scene(0, 0)).constraints
    missed = {"traffic_cone", "forklift"} - set(constraints.classes)
    assert len(missed) == 1
    assert f"Wrong: {missed.pop()} is left out." in constraints.justification


def test_an_obstacle_is_missed_where_there_is_no_other_hazard(make):
    reasoner = make(make_row(unsafe=0.0), ["ON(floor)=safe", "NEAR(table)=unsafe"])
    assert outcomes(reasoner, images(50)) == {frozenset({"ON(floor)=safe"})}


def test_a_surface_that_is_unsafe_is_a_hazard_that_can_be_missed(make):
    reasoner = make(make_row(unsafe=0.0), ["ON(floor)=safe", "ON(grass)=unsafe", "NEAR(table)=unsafe"])
    evidence = [Evidence(k, ("floor", "grass", "table")) for k in range(50)]
    assert outcomes(reasoner, evidence) == {frozenset({"ON(floor)=safe", "NEAR(table)=unsafe"})}


def test_a_missed_safe_leaves_out_one_surface(make):
    reasoner = make(make_row(safe=0.0))
    assert outcomes(reasoner, images()) == {HAZARDS | {"ON(floor)=safe"}, HAZARDS | {"ON(carpet)=safe"}}
    constraints = reasoner.reason(scene(0, 0)).constraints
    assert len({"floor", "carpet"} & set(constraints.classes)) == 1


def test_an_over_cautious_safe_part_calls_one_surface_unsafe(make):
    reasoner = make(make_row(safe=0.0, safe_missed=0.0))
    assert outcomes(reasoner, images()) == {
        HAZARDS | {"ON(floor)=safe", "ON(carpet)=unsafe"},
        HAZARDS | {"ON(floor)=unsafe", "ON(carpet)=safe"},
    }
    assert reasoner.reason(scene(0, 0)).constraints.classes == ("carpet", "floor", "forklift", "table", "traffic_cone")


def test_a_safe_gap_that_is_called_unsafe_replaces_the_surroundings_of_its_class(make):
    truth = ["AROUND(traffic_cone, 1.0)=unsafe", "BETWEEN(traffic_cone)=safe"]
    reasoner = make(make_row(safe=0.0, safe_missed=0.0), truth)
    assert said(reasoner.reason(Evidence(0, ("traffic_cone",)))) == {"BETWEEN(traffic_cone)=unsafe"}


def test_an_over_cautious_unsafe_part_adds_the_surroundings_of_a_harmless_object(make):
    reasoner = make(make_row(unsafe=0.0, unsafe_missed=0.0))
    assert outcomes(reasoner, images(100)) == {SURFACES | HAZARDS | {"AROUND(table)=unsafe"}}
    assert "Wrong: AROUND(table) is called unsafe." in reasoner.reason(scene(0, 0)).constraints.justification


def test_an_over_cautious_unsafe_part_closes_the_space_between_harmless_cones(make):
    reasoner = make(make_row(unsafe=0.0, unsafe_missed=0.0), ["ON(floor)=safe", "NEAR(traffic_cone)=unsafe"])
    lane = tuple(HeldInstance(k + 1, "traffic_cone", (float(k), 0.0), 1) for k in range(4))
    truth = {"ON(floor)=safe", "NEAR(traffic_cone)=unsafe"}
    assert said(reasoner.reason(Evidence(0, ("floor",), lane))) == truth | {"BETWEEN(traffic_cone)=unsafe"}
    assert said(reasoner.reason(Evidence(0, ("floor",), lane[:1]))) == truth | {"AROUND(traffic_cone)=unsafe"}


def test_a_class_with_a_true_region_of_its_own_is_never_the_harmless_one(make):
    truth = ["ON(floor)=safe", "NEAR(traffic_cone)=unsafe", "BETWEEN(traffic_cone)=safe"]
    lane = tuple(HeldInstance(k + 1, "traffic_cone", (float(k), 0.0), 1) for k in range(4))
    reasoner = make(make_row(unsafe=0.0, unsafe_missed=0.0), truth)
    evidence = [Evidence(k, ("floor",), lane) for k in range(50)]
    assert outcomes(reasoner, evidence) == {frozenset({"ON(floor)=safe", "BETWEEN(traffic_cone)=safe"})}


@pytest.mark.parametrize("unsafe_missed", [0.0, 1.0])
def test_the_other_kind_of_error_stands_in_where_the_scene_has_no_place_for_one(make, unsafe_missed):
    row = make_row(unsafe=0.0, unsafe_missed=unsafe_missed)
    harmless_only = make(row, ["ON(floor)=safe"]).reason(Evidence(0, ("floor", "chair")))
    assert said(harmless_only) == {"ON(floor)=safe", "AROUND(chair)=unsafe"}
    hazard_only = make(row, ["ON(floor)=safe", "AROUND(person)=unsafe"]).reason(Evidence(0, ("floor", "person")))
    assert said(hazard_only) == {"ON(floor)=safe"}
    neither = make(row, ["ON(floor)=safe"]).reason(Evidence(0, ("floor",)))
    assert said(neither) == {"ON(floor)=safe"}


def test_the_shares_of_the_kinds_are_the_stated_ones(make):
    row = make_row(safe=0.0, unsafe=0.0, unsafe_missed=0.7, safe_missed=0.2)
    constraints = [make(row).reason(e).constraints for e in images(4000)]
    missed_unsafe = sum("AROUND(table)" not in c.justification for c in constraints)
    missed_safe = sum(len(c.classes) < 5 and len({"floor", "carpet"} & set(c.classes)) == 1 for c in constraints)
    for count, share in ((missed_unsafe, 0.7), (missed_safe, 0.2)):
        low, high = emulated_stats.wilson(count, 4000)
        assert low <= share <= high


def test_a_malformed_answer_is_void_by_a_cause_of_the_reader_and_takes_its_time(make, rows):
    answer = make(rows["llava-13b"]).reason(scene(0, 0))
    assert answer.constraints is None
    assert answer.void_cause == MALFORMED_CAUSE
    assert MALFORMED_CAUSE in VOID_CAUSES
    assert "emulated-llava-13b" in answer.detail
    assert answer.latency_ns > 1_000_000_000


def test_malformed_answers_count_as_wrong_in_both_rates(make):
    reasoner = make(make_row(safe=0.6, unsafe=0.3, malformed=0.4))
    answers = [reasoner.reason(e) for e in images(4000)]
    right = [parts_right(a) for a in answers]
    for count, rate in (
        (sum(a.constraints is None for a in answers), 0.4),
        (sum(r[0] for r in right), 0.6),
        (sum(r[1] for r in right), 0.3),
    ):
        low, high = emulated_stats.wilson(count, 4000)
        assert low <= rate <= high


def test_a_rule_is_stated_only_where_its_class_is_seen(make):
    reasoner = make(make_row())
    out_of_view = tuple(dataclasses.replace(i, in_view=False) for i in scene(0, 0).instances)
    assert said(reasoner.reason(Evidence(0, ("floor",), out_of_view))) == {"ON(floor)=safe"}
    assert said(reasoner.reason(Evidence(0, ("floor", "table")))) == {"ON(floor)=safe", "NEAR(table)=unsafe"}
    assert said(reasoner.reason(Evidence(0))) == set()


def test_an_object_out_of_view_is_neither_missed_nor_called_unsafe(make):
    evidence = Evidence(0, ("floor",), (HeldInstance(1, "table", (1.0, 0.0), 1, in_view=False),))
    for unsafe_missed in (0.0, 1.0):
        reasoner = make(make_row(unsafe=0.0, unsafe_missed=unsafe_missed))
        assert said(reasoner.reason(evidence)) == {"ON(floor)=safe"}


def test_aliases_in_rules_and_evidence_mean_the_same_class(make):
    reasoner = make(make_row(), ["ON(ground)=safe", "NEAR(safety_cone)=unsafe"])
    assert said(reasoner.reason(Evidence(0, ("floor", "cone")))) == {"ON(floor)=safe", "NEAR(traffic_cone)=unsafe"}


def test_answers_depend_on_seed_and_stamp_but_not_on_the_order_of_the_calls(make, rows):
    evidences = images(300)
    first = make(rows["llava-34b"])
    in_order = {e.stamp_ns: first.reason(e) for e in evidences}
    shuffled = list(evidences) * 2
    random.Random(3).shuffle(shuffled)
    again = make(rows["llava-34b"])
    assert all(again.reason(e) == in_order[e.stamp_ns] for e in shuffled)
    other_seed = make(rows["llava-34b"], seed=1)
    assert sum(said(other_seed.reason(e)) != said(in_order[e.stamp_ns]) for e in evidences) > 50
    assert len({a.latency_ns for a in in_order.values()}) == 300


@pytest.mark.parametrize("correlation", ["independent", "scene"])
def test_answers_are_the_same_in_every_process(make, rows, correlation):
    script = (
        "import emulated_stats as e; from core_perception.ontology import Ontology\n"
        "rows = e.load_rows(e.PACKAGE_DIR / 'config' / 'emulated.yaml')\n"
        "ontology = Ontology.load(e.PACKAGE_DIR / 'config' / 'ontology.yaml')\n"
        "truth = [e.parse_predicate(t) for t in sorted(e.SURFACES | e.HAZARDS)]\n"
        f"r = e.EmulatedReasoner(truth, rows['llava-34b'], '{correlation}', 0, ontology)\n"
        "answers = [r.reason(e.scene(k, k)) for k in range(40)]\n"
        "print([(sorted(map(str, a.constraints.predicates)), a.latency_ns) for a in answers])"
    )
    reasoner = make(rows["llava-34b"], correlation=correlation)
    here = [(sorted(said(a)), a.latency_ns) for a in (reasoner.reason(scene(k, k)) for k in range(40))]
    for hash_seed in ("1", "2"):
        environment = {**os.environ, "PYTHONHASHSEED": hash_seed, "PYTHONPATH": str(Path(__file__).parent)}
        there = subprocess.run([sys.executable, "-c", script], env=environment, check=True, stdout=subprocess.PIPE)
        assert there.stdout.decode().strip() == str(here)


def test_a_better_row_is_right_wherever_a_worse_one_is(make, rows):
    better, worse = make(rows["gemma3-27b"]), make(rows["llava-34b"])
    pairs = [(parts_right(better.reason(e)), parts_right(worse.reason(e))) for e in images(500)]
    assert all(b >= w for better_right, worse_right in pairs for b, w in zip(better_right, worse_right))
    assert sum(b > w for better_right, worse_right in pairs for b, w in zip(better_right, worse_right)) > 100


def test_in_one_scene_the_same_error_stays_until_the_scene_changes(make, rows):
    row = rows["llava-34b"]
    reasoner = make(row, correlation="scene")
    for number in range(20):
        assert len(outcomes(reasoner, [scene(number, k) for k in range(30)])) == 1
    assert len(outcomes(reasoner, [scene(number, 0) for number in range(100)])) > 3
    assert len(outcomes(make(row), [scene(0, k) for k in range(30)])) > 3


def test_latency_is_new_for_every_image_of_one_scene(make, rows):
    reasoner = make(rows["gemma3-27b"], correlation="scene")
    assert len({reasoner.reason(scene(0, k)).latency_ns for k in range(100)}) == 100


def test_a_scene_is_the_set_of_clusters_in_view_not_of_their_members(make, rows):
    reasoner = make(rows["llava-34b"], correlation="scene")
    changed = 0
    for number in range(100):
        whole = scene(number, 5)
        fewer = tuple(dataclasses.replace(i, in_view=i.id % 10 != 3) for i in whole.instances)
        assert said(reasoner.reason(dataclasses.replace(whole, instances=fewer))) == said(reasoner.reason(whole))
        moved = tuple(dataclasses.replace(i, position_m=(9.0, 9.0)) for i in reversed(whole.instances))
        assert said(reasoner.reason(dataclasses.replace(whole, instances=moved))) == said(reasoner.reason(whole))
        no_table = tuple(dataclasses.replace(i, in_view=i.class_name != "table") for i in whole.instances)
        without = reasoner.reason(
            dataclasses.replace(whole, classes_seen=("floor", "carpet", "table"), instances=no_table)
        )
        changed += said(without) != said(reasoner.reason(whole))
    assert changed > 30


def test_instances_without_a_cluster_are_told_apart(make, rows):
    reasoner = make(rows["llava-34b"], correlation="scene")
    evidences = [
        Evidence(
            0, ("floor", "carpet"), (HeldInstance(k + 1, "forklift", (1.0, 0.0)), HeldInstance(7777, "table", (0, 0)))
        )
        for k in range(60)
    ]
    assert len(outcomes(reasoner, evidences)) > 3


def test_the_latency_is_log_normal_and_bounded_below(rows):
    row = rows["gemma3-27b"]
    median_s = row.latency_mean_s / math.hypot(1.0, row.latency_std_s / row.latency_mean_s)
    assert draw_latency_s(row, 0.5) == pytest.approx(median_s)
    for uniform in (0.01, 0.2, 0.4):
        assert draw_latency_s(row, uniform) * draw_latency_s(row, 1.0 - uniform) == pytest.approx(median_s**2)
    assert draw_latency_s(row, 2.0**-54) > 0.0
    assert draw_latency_s(row, 0.9) > draw_latency_s(row, 0.5) > draw_latency_s(row, 0.1)
    assert draw_latency_s(dataclasses.replace(row, latency_std_s=0.0), 0.9) == row.latency_mean_s


def test_the_reasoner_needs_the_memory_and_no_image_and_no_thread(make):
    reasoner = make(make_row())
    assert (reasoner.forgets, reasoner.reads_evidence) == (True, True)
    assert (reasoner.reads_image, reasoner.reads_guidelines, reasoner.is_slow) == (False, False, False)


def test_radius_and_severity_of_the_rules_are_kept(make):
    truth = ["AROUND(person, 1.2, slow)=unsafe"]
    assert said(make(make_row(), truth).reason(Evidence(0, ("person",)))) == set(truth)


def test_rules_that_are_missing_or_contradict_themselves_are_refused(make):
    with pytest.raises(PredicateError, match="got no predicate"):
        make(make_row(), [])
    with pytest.raises(PredicateError, match="both safe and unsafe"):
        make(make_row(), ["ON(floor)=safe", "ON(ground)=unsafe"])


def test_another_correlation_is_refused(make):
    with pytest.raises(ParameterError, match="correlation: got 'weather', allowed one of independent, scene"):
        make(make_row(), correlation="weather")


GOOD = {
    "shares": {"unsafe_missed": 1.0, "safe_missed": 0.5},
    "rows": {
        "a": {
            "safe_rate": 0.5,
            "unsafe_rate": 0.4,
            "latency_mean_s": 1.0,
            "latency_std_s": 0.1,
            "malformed_rate": 0.5,
        }
    },
}


@pytest.mark.parametrize(
    "path, value, message",
    [
        (("rows", "a", "safe_rate"), 1.1, "a.safe_rate: got 1.1"),
        (("rows", "a", "unsafe_rate"), -0.1, "a.unsafe_rate: got -0.1"),
        (("rows", "a", "unsafe_rate"), float("nan"), "a.unsafe_rate: got nan"),
        (("rows", "a", "safe_rate"), True, "a.safe_rate: got True"),
        (("rows", "a", "latency_mean_s"), 0.0, "a.latency_mean_s: got 0.0"),
        (("rows", "a", "latency_std_s"), "0.1", "a.latency_std_s: got '0.1'"),
        (("rows", "a", "malformed_rate"), 0.6, "a.malformed_rate: got 0.6, allowed a number from 0 to 0.5"),
        (("rows", "a", "speed"), 1.0, "allowed exactly latency_mean_s, latency_std_s, malformed_rate, safe_rate"),
        (("rows", "a"), None, "a: got None"),
        (("rows",), [], "top level"),
        (("shares", "safe_missed"), 2, "shares.safe_missed: got 2"),
        (("shares",), {"safe_missed": 1.0}, "shares: got"),
        (("notes",), "x", "top level"),
    ],
)
def test_a_wrong_file_is_refused_with_its_path_and_the_wrong_entry(tmp_path, path, value, message):
    file = tmp_path / "rows.yaml"
    file.write_text(yaml.safe_dump(GOOD))
    assert load_rows(file)["a"].shares == ErrorShares(1.0, 0.5)
    data = yaml.safe_load(file.read_text())
    entry = data
    for key in path[:-1]:
        entry = entry[key]
    entry[path[-1]] = value
    file.write_text(yaml.safe_dump(data))
    with pytest.raises(PerceptionError) as refused:
        load_rows(file)
    assert str(refused.value).startswith(f"{file}: ")
    assert message in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(PerceptionError, match="nothing.yaml"):
        load_rows(tmp_path / "nothing.yaml")


def test_the_page_about_the_rows_has_the_figures_of_the_file(rows, config_dir):
    page = (config_dir.parents[2] / "docs" / "emulated_reasoner.md").read_text(encoding="utf-8")
    for name, row in rows.items():
        safe, unsafe = f"{row.safe_rate:.2f}", f"{row.unsafe_rate:.2f}"
        latency = f"{row.latency_mean_s} ± {row.latency_std_s:.3f} s"
        line = next(line for line in page.splitlines() if line.startswith(f"| `{name}` |"))
        assert line.split("|")[3:6] == [f" {safe} ", f" {unsafe} ", f" {latency} "]
    shares = rows["gemma3-27b"].shares
    assert f"`unsafe_missed`: {shares.unsafe_missed}" in page
    assert f"`safe_missed`: {shares.safe_missed}" in page

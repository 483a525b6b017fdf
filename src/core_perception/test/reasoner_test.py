# SPDX-License-Identifier: BSD-3-Clause
"""Scenes -> constraints: the embedded reasoner, the fixed ones, and what is remembered."""

import os

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ontology_bench import milliseconds_per_frame
from wordnet_test import wants_wordnet

from core_perception.exceptions import PerceptionError
from core_perception.ontology import Ontology
from core_perception.params import ReasonerParams
from core_perception.predicates import Operator
from core_perception.prompt import PromptTemplate
from core_perception.reasoners.base import Evidence, HeldInstance
from core_perception.reasoners.emulated_reasoner import load_rows
from core_perception.reasoners.factory import make_reasoner
from core_perception.reasoners.fixed_reasoner import load_rules
from core_perception.reasoners.ontology_reasoner import OntologyReasoner

SEED = int(os.environ.get("CORE_SEED", "0"))
LINE_M = [(6.0, 1.36 * k) for k in range(-2, 3)]
LANE_M = [(float(x), y) for x in range(5) for y in (-0.8, 0.8)]


def held(class_name, places, first_id=1, cluster=0, in_view=True):
    return tuple(HeldInstance(first_id + k, class_name, place, cluster, in_view) for k, place in enumerate(places))


def evidence(seen=(), instances=(), stamp_ns=0, history_start_ns=None):
    return Evidence(stamp_ns, tuple(seen), tuple(instances), history_start_ns=history_start_ns)


def answered(reasoner, frame):
    answer = reasoner.reason(frame)
    assert answer.void_cause == ""
    return answer.constraints


def exempted(constraints):
    return {str(predicate): ids for predicate, ids in constraints.exempt.items()}


def said(constraints):
    return [str(p) for p in constraints.predicates]


@pytest.fixture()
def reasoner(ontology):
    return OntologyReasoner(ontology)


def test_five_cones_in_a_line_close_the_area(reasoner):
    constraints = answered(reasoner, evidence(["floor", "traffic_cone"], held("traffic_cone", LINE_M), 42))
    assert said(constraints) == ["ON(floor)=safe", "NEAR(traffic_cone)=unsafe", "BETWEEN(traffic_cone)=unsafe"]
    assert constraints.classes == ("floor", "traffic_cone")
    assert (constraints.source, constraints.image_stamp_ns) == ("ontology", 42)
    assert "5 of the class traffic cone form a line and close the space between them." in constraints.justification


@pytest.mark.parametrize(
    "places", [LINE_M[:1], LINE_M[:2], LANE_M, [(0.0, 0.0), (2.1, 0.3), (1.0, 1.9), (2.6, 2.2), (0.4, 3.4)]]
)
def test_two_cones_a_lane_or_scattered_cones_close_nothing(reasoner, places):
    for _ in range(5):
        constraints = answered(reasoner, evidence(["floor"], held("traffic_cone", places)))
    assert said(constraints) == ["ON(floor)=safe", "NEAR(traffic_cone)=unsafe"]
    assert "does not close an area" in constraints.justification


def test_every_category_has_its_operators(reasoner):
    names = ["floor", "grass", "table", "forklift", "person", "traffic_cone", "caution_tape"]
    constraints = answered(reasoner, evidence(names))
    assert said(constraints) == [
        "NEAR(caution_tape)=unsafe",
        "AROUND(caution_tape, 1.0)=unsafe",
        "ON(floor)=safe",
        "NEAR(forklift)=unsafe",
        "AROUND(forklift, 1.5)=unsafe",
        "ON(grass)=unsafe",
        "NEAR(person)=unsafe",
        "AROUND(person, 1.0)=unsafe",
        "NEAR(table)=unsafe",
        "NEAR(traffic_cone)=unsafe",
    ]
    for words in (
        "floor is a surface meant for travel",
        "grass is not a surface",
        "table is a solid obstacle",
        "person is owed distance",
    ):
        assert words in constraints.justification


def test_between_replaces_around_of_a_barrier_that_is_a_hazard_too(reasoner):
    constraints = answered(reasoner, evidence([], held("road_flare", LINE_M)))
    assert said(constraints) == ["NEAR(road_flare)=unsafe", "BETWEEN(road_flare)=unsafe"]


def test_a_hazard_that_is_no_barrier_keeps_its_surroundings_in_a_line(reasoner):
    constraints = answered(reasoner, evidence([], held("wet_floor_sign", LINE_M)))
    assert said(constraints) == ["NEAR(wet_floor_sign)=unsafe", "AROUND(wet_floor_sign, 1.0)=unsafe"]


def test_an_unknown_class_is_an_obstacle_and_said_to_be_unknown(reasoner):
    constraints = answered(reasoner, evidence(["floor", "qwertz", "polished_floor"]))
    assert said(constraints) == ["ON(floor)=safe", "ON(polished_floor)=unsafe", "NEAR(qwertz)=unsafe"]
    assert "qwertz is not in the list of classes and is taken as a solid obstacle." in constraints.justification
    assert (
        "polished floor is not in the list of classes and is taken as not navigable by its ending floor."
        in constraints.justification
    )


def test_aliases_are_stated_by_their_canonical_name(reasoner):
    constraints = answered(reasoner, evidence(["ground"], held("safety_cone", LINE_M)))
    assert said(constraints) == ["ON(floor)=safe", "NEAR(traffic_cone)=unsafe", "BETWEEN(traffic_cone)=unsafe"]


def test_nothing_seen_states_nothing(reasoner):
    constraints = answered(reasoner, evidence())
    assert constraints.predicates == ()
    assert constraints.justification


def test_a_found_arrangement_stays_while_its_members_are_held(reasoner):
    cones = held("traffic_cone", LINE_M)
    assert "BETWEEN(traffic_cone)=unsafe" in said(answered(reasoner, evidence([], cones)))
    moved = tuple(
        HeldInstance(c.id, c.class_name, (c.position_m[0] + 0.7 * (c.id % 2), c.position_m[1]), 0, False) for c in cones
    )
    assert "BETWEEN(traffic_cone)=unsafe" in said(answered(reasoner, evidence([], moved)))
    assert "BETWEEN(traffic_cone)=unsafe" in said(answered(reasoner, evidence([], cones[:2])))
    assert "BETWEEN(traffic_cone)=unsafe" not in said(answered(reasoner, evidence([], cones[:1])))
    assert "BETWEEN(traffic_cone)=unsafe" not in said(answered(reasoner, evidence([], cones[:2])))


def test_reset_forgets_what_was_found(reasoner):
    cones = held("traffic_cone", LINE_M)
    answered(reasoner, evidence([], cones))
    reasoner.reset()
    assert "BETWEEN(traffic_cone)=unsafe" not in said(answered(reasoner, evidence([], cones[:2])))


def test_a_row_that_turns_out_to_be_one_side_of_a_lane_is_released(reasoner):
    first_row = held("traffic_cone", [(1.2 * k, 0.0) for k in range(4)])
    second_row = held("traffic_cone", [(1.2 * k, 1.9) for k in range(4)], first_id=11)
    assert "BETWEEN(traffic_cone)=unsafe" in said(answered(reasoner, evidence([], first_row)))
    assert "BETWEEN(traffic_cone)=unsafe" not in said(answered(reasoner, evidence([], first_row + second_row)))


def test_three_cones_need_three_answers_in_a_row(reasoner):
    three = evidence([], held("traffic_cone", LINE_M[:3]))
    others = evidence([], held("traffic_cone", LINE_M[:2]))
    results = [
        "BETWEEN(traffic_cone)=unsafe" in said(answered(reasoner, e))
        for e in (three, three, others, three, three, three, others)
    ]
    assert results == [False, False, False, False, False, True, True]


def test_a_second_line_far_away_is_found_beside_the_first(reasoner):
    first, second = held("traffic_cone", LINE_M), held("traffic_cone", [(x + 9.0, y) for x, y in LINE_M], first_id=21)
    constraints = answered(reasoner, evidence([], first + second))
    assert constraints.justification.count("form a line") == 2


def test_clusters_of_the_map_are_used_where_it_gives_them(ontology):
    spread = [(6.0, 3.2 * k) for k in range(5)]
    assert said(answered(OntologyReasoner(ontology), evidence([], held("traffic_cone", spread)))) == [
        "NEAR(traffic_cone)=unsafe"
    ]
    clustered = held("traffic_cone", spread, cluster=3)
    assert "BETWEEN(traffic_cone)=unsafe" in said(answered(OntologyReasoner(ontology), evidence([], clustered)))


def test_without_memory_only_what_is_in_view_counts(ontology):
    reasoner = OntologyReasoner(ontology, memory=False)
    assert "BETWEEN(traffic_cone)=unsafe" in said(
        answered(reasoner, evidence(["traffic_cone"], held("traffic_cone", LINE_M)))
    )
    hidden = held("traffic_cone", LINE_M, in_view=False)
    assert said(answered(reasoner, evidence(["floor"], hidden))) == ["ON(floor)=safe"]
    assert "BETWEEN(traffic_cone)=unsafe" in said(answered(reasoner, evidence([], held("traffic_cone", LINE_M[:3]))))


def test_between_speaks_of_the_arrangement_alone_and_exempts_every_other_instance(reasoner):
    strays = held("traffic_cone", [(20.0, 0.0), (20.4, 1.4), (25.0, 9.0)], first_id=31)
    constraints = answered(reasoner, evidence([], strays + held("traffic_cone", LINE_M), history_start_ns=7))
    assert said(constraints) == ["NEAR(traffic_cone)=unsafe", "BETWEEN(traffic_cone)=unsafe"]
    assert exempted(constraints) == {"BETWEEN(traffic_cone)=unsafe": (31, 32, 33)}
    assert constraints.instances_history_start_ns == 7


def test_without_the_history_of_the_map_nothing_is_exempt(reasoner):
    strays = held("traffic_cone", [(20.0, 0.0)], first_id=31)
    constraints = answered(reasoner, evidence([], strays + held("traffic_cone", LINE_M)))
    assert "BETWEEN(traffic_cone)=unsafe" in said(constraints)
    assert (constraints.exempt, constraints.instances_history_start_ns) == ({}, None)


def test_no_member_of_an_arrangement_in_force_is_ever_exempt_from_between(reasoner):
    cones = held("traffic_cone", LINE_M)
    answered(reasoner, evidence([], cones, history_start_ns=7))
    moved = tuple(HeldInstance(c.id, c.class_name, (c.position_m[0] + c.id % 2, c.position_m[1])) for c in cones)
    for rest in (moved, cones[:2]):
        constraints = answered(reasoner, evidence([], rest, history_start_ns=7))
        assert "BETWEEN(traffic_cone)=unsafe" in said(constraints)
        assert constraints.exempt == {}
        assert f"{len(rest)} of the class traffic cone form a line" in constraints.justification


def test_two_arrangements_of_one_class_are_judged_each_for_itself(reasoner):
    first = held("traffic_cone", LINE_M)
    lane = held("traffic_cone", [(x + 12.0, y) for x, y in LANE_M], first_id=21)
    far = held("traffic_cone", [(x + 30.0, y) for x, y in LINE_M], first_id=61)
    constraints = answered(reasoner, evidence([], first + lane + far, history_start_ns=7))
    assert exempted(constraints) == {"BETWEEN(traffic_cone)=unsafe": tuple(range(21, 31))}


def test_three_cones_are_exempt_until_they_have_persisted(reasoner):
    three = held("traffic_cone", [(x + 12.0, y) for x, y in LINE_M[:3]], first_id=21)
    frame = evidence([], held("traffic_cone", LINE_M) + three, history_start_ns=7)
    exempt = [exempted(answered(reasoner, frame)).get("BETWEEN(traffic_cone)=unsafe") for _ in range(4)]
    assert exempt == [(21, 22, 23), (21, 22, 23), None, None]


def test_a_hazard_outside_the_arrangement_keeps_its_surroundings(reasoner):
    alone = held("road_flare", [(20.0, 0.0)], first_id=31)
    for history, exempt in (
        (7, {"BETWEEN(road_flare)=unsafe": (31,), "AROUND(road_flare, 1.0)=unsafe": (1, 2, 3, 4, 5)}),
        (None, {}),
    ):
        constraints = answered(reasoner, evidence([], held("road_flare", LINE_M) + alone, history_start_ns=history))
        assert said(constraints) == [
            "NEAR(road_flare)=unsafe",
            "AROUND(road_flare, 1.0)=unsafe",
            "BETWEEN(road_flare)=unsafe",
        ]
        assert exempted(constraints) == exempt


def test_instances_that_are_out_of_view_are_not_exempt_without_memory(ontology):
    reasoner = OntologyReasoner(ontology, memory=False)
    hidden = held("traffic_cone", [(20.0, 0.0)], first_id=31, in_view=False)
    constraints = answered(reasoner, evidence([], held("traffic_cone", LINE_M) + hidden, history_start_ns=7))
    assert "BETWEEN(traffic_cone)=unsafe" in said(constraints)
    assert constraints.exempt == {}


@given(st.integers(0, 2**31), st.integers(0, 25))
def test_fuzz_every_held_barrier_is_either_blocking_or_exempt_and_stated_near(ontology, seed, count):
    rng = np.random.default_rng([SEED, seed])
    reasoner = OntologyReasoner(ontology)
    names = rng.choice(["traffic_cone", "road_flare", "barricade", "safety_cone", "person"], count)
    instances = tuple(
        HeldInstance(k + 1, str(n), tuple(rng.uniform(0.0, 8.0, 2)), 0, bool(rng.random() < 0.5))
        for k, n in enumerate(names)
    )
    for _ in range(4):
        constraints = answered(reasoner, evidence([], instances, history_start_ns=7))
        stated = said(constraints)
        for instance in instances:
            assert f"NEAR({ontology.canonical(instance.class_name)})=unsafe" in stated
        for predicate, ids in constraints.exempt.items():
            assert predicate in constraints.predicates
            assert predicate.operator in (Operator.BETWEEN, Operator.AROUND)
            assert ids == tuple(sorted(set(ids)))
            assert {ontology.canonical(instances[i - 1].class_name) for i in ids} == {predicate.class_name}
        for flare in (i for i in instances if i.class_name == "road_flare"):
            reached = [
                p
                for p in constraints.predicates
                if p.class_name == "road_flare"
                and p.operator in (Operator.BETWEEN, Operator.AROUND)
                and flare.id not in constraints.exempt.get(p, ())
            ]
            assert len(reached) == 1, "AROUND or BETWEEN, one of the two"


def test_without_wordnet_an_unknown_class_is_an_obstacle_and_the_reason_is_said(config_dir, tmp_path):
    reasoner = OntologyReasoner(Ontology.load(config_dir / "ontology.yaml", tmp_path))
    constraints = answered(reasoner, evidence(["plumber"]))
    assert said(constraints) == ["NEAR(plumber)=unsafe"]
    assert "taken as a solid obstacle." in constraints.justification
    assert f"WordNet could not be asked: {tmp_path}/index.noun: cannot be read" in constraints.justification
    assert "WordNet" not in answered(reasoner, evidence(["person"])).justification


@wants_wordnet
def test_a_class_judged_by_wordnet_says_so(reasoner):
    constraints = answered(reasoner, evidence(["plumber"]))
    assert said(constraints) == ["NEAR(plumber)=unsafe", "AROUND(plumber, 1.0)=unsafe"]
    assert "plumber is not in the list of classes and is taken as owed distance by WordNet: person." in (
        constraints.justification
    )


def test_an_answer_takes_less_than_five_milliseconds_with_unknown_names_and_moving_instances(ontology):
    assert milliseconds_per_frame(ontology, frames=40, seed=SEED) < 5.0


@pytest.mark.parametrize("name", ["oracle", "static"])
def test_fixed_reasoners_say_the_same_whatever_is_seen(name, config_dir):
    params = ReasonerParams.from_dict(
        {"reasoner": name, **({"predicates": ["ON(floor)=safe"]} if name == "oracle" else {})}
    )
    reasoner = make_reasoner(params, config_dir).reasoner
    assert not reasoner.reads_evidence
    one, other = (
        answered(reasoner, evidence([], (), 5)),
        answered(reasoner, evidence(["forklift"], held("forklift", LINE_M), 9)),
    )
    assert one.predicates == other.predicates
    assert (one.image_stamp_ns, other.image_stamp_ns, one.source) == (5, 9, name)


@pytest.mark.parametrize(
    "text",
    [
        "[]",
        "rules: []",
        "{justification: x, rules: [ON(floor)]}",
        "{justification: x, rules: []}",
        'justification: "\\ud800"\nrules: [NEAR(x)]',
        "a: [",
    ],
)
def test_wrong_rules_files_are_refused_with_their_path(tmp_path, config_dir, text):
    path = tmp_path / "rules.yaml"
    path.write_text(text)
    with pytest.raises(PerceptionError, match=str(path)):
        make_reasoner(ReasonerParams.from_dict({"reasoner": "static", "rules_file": str(path)}), config_dir)


@pytest.mark.parametrize("text", ["a: 2001-13-01", "[" * 5000])
@pytest.mark.parametrize(
    "load", [load_rules, load_rows, Ontology.load, PromptTemplate.load], ids=["rules", "rows", "ontology", "prompt"]
)
def test_what_yaml_itself_stumbles_over_is_refused_with_the_path(tmp_path, load, text):
    path = tmp_path / "file.yaml"
    path.write_text(text)
    with pytest.raises(PerceptionError, match=str(path)):
        load(path)


@pytest.mark.parametrize("load", [load_rows, Ontology.load, PromptTemplate.load], ids=["rows", "ontology", "prompt"])
def test_a_file_of_another_kind_is_refused_without_being_told_as_a_whole(tmp_path, load):
    path = tmp_path / "file.yaml"
    path.write_text("You are a safety officer. " * 100 + "The end.")
    with pytest.raises(PerceptionError, match="You are a safety officer") as error:
        load(path)
    assert "The end." not in str(error.value)

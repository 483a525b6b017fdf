# SPDX-License-Identifier: BSD-3-Clause
"""Scenes -> constraints: the embedded reasoner, the fixed ones, and what is remembered."""

import time

import numpy as np
import pytest

from core_perception.exceptions import PerceptionError
from core_perception.params import ReasonerParams
from core_perception.reasoners.base import Evidence, HeldInstance
from core_perception.reasoners.factory import make_reasoner
from core_perception.reasoners.ontology_reasoner import OntologyReasoner

LINE_M = [(6.0, 1.36 * k) for k in range(-2, 3)]
LANE_M = [(float(x), y) for x in range(5) for y in (-0.8, 0.8)]


def held(class_name, places, first_id=1, cluster=0, in_view=True):
    return tuple(HeldInstance(first_id + k, class_name, place, cluster, in_view) for k, place in enumerate(places))


def evidence(seen=(), instances=(), stamp_ns=0):
    return Evidence(stamp_ns, tuple(seen), tuple(instances))


def said(constraints):
    return [str(p) for p in constraints.predicates]


@pytest.fixture()
def reasoner(ontology):
    return OntologyReasoner(ontology)


def test_five_cones_in_a_line_close_the_area(reasoner):
    constraints = reasoner.reason(evidence(["floor", "traffic_cone"], held("traffic_cone", LINE_M), 42))
    assert said(constraints) == ["ON(floor)=safe", "NEAR(traffic_cone)=unsafe", "BETWEEN(traffic_cone)=unsafe"]
    assert constraints.classes == ("floor", "traffic_cone")
    assert (constraints.source, constraints.image_stamp_ns) == ("ontology", 42)
    assert "5 of the class traffic cone form a line and close the space between them." in constraints.justification


@pytest.mark.parametrize(
    "places", [LINE_M[:1], LINE_M[:2], LANE_M, [(0.0, 0.0), (2.1, 0.3), (1.0, 1.9), (2.6, 2.2), (0.4, 3.4)]]
)
def test_two_cones_a_lane_or_scattered_cones_close_nothing(reasoner, places):
    for _ in range(5):
        constraints = reasoner.reason(evidence(["floor"], held("traffic_cone", places)))
    assert said(constraints) == ["ON(floor)=safe", "NEAR(traffic_cone)=unsafe"]
    assert "does not close an area" in constraints.justification


def test_every_category_has_its_operators(reasoner):
    names = ["floor", "grass", "table", "forklift", "person", "traffic_cone", "caution_tape"]
    constraints = reasoner.reason(evidence(names))
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
    constraints = reasoner.reason(evidence([], held("road_flare", LINE_M)))
    assert said(constraints) == ["NEAR(road_flare)=unsafe", "BETWEEN(road_flare)=unsafe"]


def test_a_hazard_that_is_no_barrier_keeps_its_surroundings_in_a_line(reasoner):
    constraints = reasoner.reason(evidence([], held("wet_floor_sign", LINE_M)))
    assert said(constraints) == ["NEAR(wet_floor_sign)=unsafe", "AROUND(wet_floor_sign, 1.0)=unsafe"]


def test_an_unknown_class_is_an_obstacle_and_said_to_be_unknown(reasoner):
    constraints = reasoner.reason(evidence(["floor", "unicorn", "polished_floor"]))
    assert said(constraints) == ["ON(floor)=safe", "ON(polished_floor)=unsafe", "NEAR(unicorn)=unsafe"]
    assert "unicorn is not in the list of classes and is taken as a solid obstacle." in constraints.justification
    assert (
        "polished floor is not in the list of classes and is taken as not navigable by its ending floor."
        in constraints.justification
    )


def test_aliases_are_stated_by_their_canonical_name(reasoner):
    constraints = reasoner.reason(evidence(["ground"], held("safety_cone", LINE_M)))
    assert said(constraints) == ["ON(floor)=safe", "NEAR(traffic_cone)=unsafe", "BETWEEN(traffic_cone)=unsafe"]


def test_nothing_seen_states_nothing(reasoner):
    constraints = reasoner.reason(evidence())
    assert constraints.predicates == ()
    assert constraints.justification


def test_a_found_arrangement_stays_while_its_members_are_held(reasoner):
    cones = held("traffic_cone", LINE_M)
    assert "BETWEEN(traffic_cone)=unsafe" in said(reasoner.reason(evidence([], cones)))
    moved = tuple(
        HeldInstance(c.id, c.class_name, (c.position_m[0] + 0.7 * (c.id % 2), c.position_m[1]), 0, False) for c in cones
    )
    assert "BETWEEN(traffic_cone)=unsafe" in said(reasoner.reason(evidence([], moved)))
    assert "BETWEEN(traffic_cone)=unsafe" in said(reasoner.reason(evidence([], cones[:2])))
    assert "BETWEEN(traffic_cone)=unsafe" not in said(reasoner.reason(evidence([], cones[:1])))
    assert "BETWEEN(traffic_cone)=unsafe" not in said(reasoner.reason(evidence([], cones[:2])))


def test_reset_forgets_what_was_found(reasoner):
    cones = held("traffic_cone", LINE_M)
    reasoner.reason(evidence([], cones))
    reasoner.reset()
    assert "BETWEEN(traffic_cone)=unsafe" not in said(reasoner.reason(evidence([], cones[:2])))


def test_a_row_that_turns_out_to_be_one_side_of_a_lane_is_released(reasoner):
    first_row = held("traffic_cone", [(1.2 * k, 0.0) for k in range(4)])
    second_row = held("traffic_cone", [(1.2 * k, 1.9) for k in range(4)], first_id=11)
    assert "BETWEEN(traffic_cone)=unsafe" in said(reasoner.reason(evidence([], first_row)))
    assert "BETWEEN(traffic_cone)=unsafe" not in said(reasoner.reason(evidence([], first_row + second_row)))


def test_three_cones_need_three_answers_in_a_row(reasoner):
    three = evidence([], held("traffic_cone", LINE_M[:3]))
    others = evidence([], held("traffic_cone", LINE_M[:2]))
    results = [
        "BETWEEN(traffic_cone)=unsafe" in said(reasoner.reason(e))
        for e in (three, three, others, three, three, three, others)
    ]
    assert results == [False, False, False, False, False, True, True]


def test_a_second_line_far_away_is_found_beside_the_first(reasoner):
    first, second = held("traffic_cone", LINE_M), held("traffic_cone", [(x + 9.0, y) for x, y in LINE_M], first_id=21)
    constraints = reasoner.reason(evidence([], first + second))
    assert constraints.justification.count("form a line") == 2


def test_clusters_of_the_map_are_used_where_it_gives_them(ontology):
    spread = [(6.0, 3.2 * k) for k in range(5)]
    assert said(OntologyReasoner(ontology).reason(evidence([], held("traffic_cone", spread)))) == [
        "NEAR(traffic_cone)=unsafe"
    ]
    clustered = held("traffic_cone", spread, cluster=3)
    assert "BETWEEN(traffic_cone)=unsafe" in said(OntologyReasoner(ontology).reason(evidence([], clustered)))


def test_without_memory_only_what_is_in_view_counts(ontology):
    reasoner = OntologyReasoner(ontology, memory=False)
    assert "BETWEEN(traffic_cone)=unsafe" in said(
        reasoner.reason(evidence(["traffic_cone"], held("traffic_cone", LINE_M)))
    )
    hidden = held("traffic_cone", LINE_M, in_view=False)
    assert said(reasoner.reason(evidence(["floor"], hidden))) == ["ON(floor)=safe"]
    assert "BETWEEN(traffic_cone)=unsafe" in said(reasoner.reason(evidence([], held("traffic_cone", LINE_M[:3]))))


def test_an_answer_takes_less_than_five_milliseconds_for_forty_instances(reasoner, ontology):
    places = np.random.default_rng(0).uniform(0.0, 12.0, (40, 2))
    crowd = evidence(ontology.vocabulary[:40], held("traffic_cone", [tuple(p) for p in places]))
    durations = []
    for _ in range(9):
        start = time.thread_time()
        reasoner.reason(crowd)
        durations.append(time.thread_time() - start)
    assert sorted(durations)[4] < 5e-3


@pytest.mark.parametrize("name", ["oracle", "static"])
def test_fixed_reasoners_say_the_same_whatever_is_seen(name, config_dir):
    params = ReasonerParams.from_dict(
        {"reasoner": name, **({"predicates": ["ON(floor)=safe"]} if name == "oracle" else {})}
    )
    reasoner = make_reasoner(params, config_dir)
    assert not reasoner.reads_evidence
    one, other = (
        reasoner.reason(evidence([], (), 5)),
        reasoner.reason(evidence(["forklift"], held("forklift", LINE_M), 9)),
    )
    assert one.predicates == other.predicates
    assert (one.image_stamp_ns, other.image_stamp_ns, one.source) == (5, 9, name)


@pytest.mark.parametrize(
    "text", ["[]", "rules: []", "{justification: x, rules: [ON(floor)]}", "{justification: x, rules: []}", "a: ["]
)
def test_wrong_rules_files_are_refused_with_their_path(tmp_path, config_dir, text):
    path = tmp_path / "rules.yaml"
    path.write_text(text)
    with pytest.raises(PerceptionError, match=str(path)):
        make_reasoner(ReasonerParams.from_dict({"reasoner": "static", "rules_file": str(path)}), config_dir)

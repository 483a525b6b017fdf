# SPDX-License-Identifier: BSD-3-Clause
"""What replies said stays in force until enough of them looked and left it out."""

import pytest

from core_perception.constraint_memory import MAX_ENTRIES, ConstraintMemory
from core_perception.ontology import Category, Ontology, OntologyClass
from core_perception.predicates import Constraints, Operator, Predicate, Verdict, parse_predicate
from core_perception.reasoners.base import Evidence, HeldInstance

HISTORY_NS = 5


def held(*numbers, name="traffic_cone", in_view=True):
    return tuple(HeldInstance(number, name, (0.0, 0.0), 0, in_view) for number in numbers)


def unseen(*numbers, name="traffic_cone"):
    return held(*numbers, name=name, in_view=False)


class Talk:
    """Replies to one memory; keeps the constraints in force after the last one."""

    def __init__(self, ontology, *arguments):
        self.memory, self.now = ConstraintMemory(ontology, *arguments), Constraints()

    def say(self, *statements, instances=(), seen=(), named=(), history_ns=HISTORY_NS, times=1):
        for _ in range(times):
            reply = Constraints(tuple(map(parse_predicate, statements)), tuple(named), "why", "test", 7, 8, 0.5)
            self.now = self.memory.add(reply, Evidence(7, tuple(seen), instances, history_start_ns=history_ns))
        return self

    @property
    def stated(self):
        return [str(predicate) for predicate in self.now.predicates]

    def exempt(self, statement):
        return self.now.exempt.get(parse_predicate(statement), ())


@pytest.fixture
def talk(ontology):
    return Talk(ontology)


@pytest.mark.parametrize(
    "statement", ["NEAR(traffic_cone)", "AROUND(traffic_cone, 1.5)", "BETWEEN(traffic_cone, slow)"]
)
def test_an_unsafe_object_is_in_force_from_the_first_reply_for_every_instance(talk, statement):
    talk.say(statement, instances=unseen(1))
    assert talk.stated == [f"{statement}=unsafe"] and talk.now.exempt == {}


def test_everything_but_the_predicates_is_that_of_the_reply(talk):
    talk.say("NEAR(chair)", "ON(floor)=safe", named=("chair", "floor"))
    now = talk.now
    assert (now.classes, now.justification, now.source) == (("chair", "floor"), "why", "test")
    assert (now.image_stamp_ns, now.latency_ns, now.confidence) == (7, 8, 0.5)


def test_until_a_reply_names_ground_to_stand_on_the_statement_has_no_image_stamp(talk):
    talk.say("NEAR(chair)", "ON(floor)=unsafe", "ON(stairs)=safe")
    assert talk.now.image_stamp_ns is None
    assert "NEAR(chair)=unsafe" in talk.stated
    talk.say("ON(floor)=safe")
    assert talk.now.image_stamp_ns == 7
    talk.say("ON(floor)=unsafe", times=3)
    assert "ON(floor)=unsafe" in talk.stated and talk.now.image_stamp_ns == 7
    talk.memory.reset()
    talk.say("NEAR(chair)")
    assert talk.now.image_stamp_ns is None


def test_an_instance_is_exempt_after_three_replies_in_a_row_that_saw_it_and_left_it_out(talk):
    talk.say("NEAR(traffic_cone)", instances=held(1) + unseen(2))
    for _ in range(2):
        talk.say(instances=held(1) + unseen(2))
        assert talk.exempt("NEAR(traffic_cone)") == ()
    talk.say(instances=held(1) + unseen(2))
    assert talk.exempt("NEAR(traffic_cone)") == (1,)
    assert talk.stated == ["NEAR(traffic_cone)=unsafe"]
    assert talk.now.instances_history_start_ns == HISTORY_NS


def test_replies_that_did_not_see_the_instance_count_neither_way(talk):
    talk.say("NEAR(traffic_cone)", instances=held(1))
    for _ in range(2):
        talk.say(instances=held(1)).say(instances=unseen(1), times=5)
        assert talk.exempt("NEAR(traffic_cone)") == ()
    talk.say(instances=held(1, 2))
    assert talk.exempt("NEAR(traffic_cone)") == (1,)


def test_a_reply_that_covers_starts_the_row_anew(talk):
    talk.say("NEAR(traffic_cone)", instances=held(1)).say(instances=held(1) + unseen(2), times=2)
    talk.say("NEAR(traffic_cone)", instances=unseen(1, 2)).say(instances=held(1) + unseen(2), times=2)
    assert talk.exempt("NEAR(traffic_cone)") == ()
    talk.say(instances=held(1) + unseen(2))
    assert talk.exempt("NEAR(traffic_cone)") == (1,)


def test_covering_in_view_lifts_an_exemption_at_once_and_out_of_view_does_not(talk):
    talk.say("NEAR(traffic_cone)", instances=held(1, 2)).say(instances=held(1) + unseen(2), times=3)
    talk.say("NEAR(traffic_cone)", instances=unseen(1) + held(2))
    assert talk.exempt("NEAR(traffic_cone)") == (1,)
    talk.say("NEAR(traffic_cone)", instances=held(1, 2))
    assert talk.exempt("NEAR(traffic_cone)") == ()
    talk.say(instances=held(1) + unseen(2), times=2)
    assert talk.exempt("NEAR(traffic_cone)") == ()


def test_a_new_instance_of_an_exempted_class_is_unsafe(talk):
    talk.say("NEAR(traffic_cone)", instances=held(1) + unseen(2)).say(instances=held(1) + unseen(2), times=3)
    talk.say(instances=held(1, 3) + unseen(2))
    assert talk.exempt("NEAR(traffic_cone)") == (1,)


def test_an_instance_that_vanishes_is_forgotten(talk):
    talk.say("NEAR(traffic_cone)", instances=held(1) + unseen(2)).say(instances=held(1) + unseen(2), times=3)
    assert talk.exempt("NEAR(traffic_cone)") == (1,)
    talk.say(instances=unseen(2))
    assert talk.now.exempt == {} and talk.now.instances_history_start_ns is None
    talk.say(instances=held(1) + unseen(2))
    assert talk.exempt("NEAR(traffic_cone)") == ()


def test_another_history_drops_exemptions_and_counts_but_no_statement(talk):
    talk.say("NEAR(traffic_cone)", "NEAR(chair)", instances=held(1) + unseen(2) + unseen(3, name="chair"))
    talk.say(instances=held(1) + unseen(2) + held(3, name="chair"), times=2)
    talk.say(instances=held(1) + unseen(2) + unseen(3, name="chair"))
    assert talk.exempt("NEAR(traffic_cone)") == (1,)
    talk.say(instances=held(1, 2) + held(3, name="chair"), history_ns=HISTORY_NS + 1)
    assert talk.stated == ["NEAR(chair)=unsafe", "NEAR(traffic_cone)=unsafe"] and talk.now.exempt == {}
    talk.say(instances=held(1) + unseen(2) + held(3, name="chair"), history_ns=HISTORY_NS + 1)
    assert talk.now.exempt == {}


def test_without_a_map_no_instance_is_exempt_and_nothing_held_leaves(talk):
    talk.say("NEAR(traffic_cone)", instances=held(1), history_ns=None)
    talk.say(instances=held(1), times=9, history_ns=None)
    assert talk.stated == ["NEAR(traffic_cone)=unsafe"] and talk.now.exempt == {}


def test_a_map_that_is_lost_is_no_proof_that_nothing_is_held(talk):
    talk.say("NEAR(traffic_cone)", instances=held(1))
    talk.say(seen=("traffic_cone",), history_ns=None, times=9)
    assert talk.stated == ["NEAR(traffic_cone)=unsafe"]
    talk.say(times=2)
    assert talk.stated == ["NEAR(traffic_cone)=unsafe"]
    talk.say()
    assert talk.stated == []


def test_a_statement_leaves_when_its_last_instance_is_exempt(talk):
    talk.say("NEAR(traffic_cone)", instances=held(1, 2)).say(instances=held(1) + unseen(2), times=9)
    talk.say(instances=unseen(1) + held(2), times=2)
    assert talk.stated == ["NEAR(traffic_cone)=unsafe"]
    talk.say(instances=unseen(1) + held(2))
    assert talk.stated == []
    talk.say("NEAR(traffic_cone)", instances=unseen(1, 2))
    assert talk.stated == ["NEAR(traffic_cone)=unsafe"] and talk.now.exempt == {}


def test_a_statement_about_what_nobody_holds_leaves_after_three_replies(talk):
    talk.say("NEAR(odd_thing)", "AROUND(odd_thing)").say("AROUND(odd_thing)", times=2)
    assert talk.stated == ["NEAR(odd_thing)=unsafe", "AROUND(odd_thing)=unsafe"]
    talk.say("AROUND(odd_thing)")
    assert talk.stated == ["AROUND(odd_thing)=unsafe"]


def test_looking_away_keeps_a_statement_for_ever(talk):
    talk.say("NEAR(traffic_cone)", instances=held(1)).say(instances=unseen(1), times=50)
    assert talk.stated == ["NEAR(traffic_cone)=unsafe"] and talk.now.exempt == {}


@pytest.mark.parametrize(
    "first, later, leaves",
    [
        ("AROUND(forklift, 2.0)", "AROUND(forklift, 1.9)", True),
        ("AROUND(forklift, 2.0)", "AROUND(forklift, 2.1)", False),
        ("AROUND(forklift, 1.5)", "AROUND(forklift)", False),  # 1.5 m in the ontology
        ("AROUND(forklift, 1.6)", "AROUND(forklift)", True),
        ("AROUND(forklift)", "AROUND(forklift, 1.4)", True),
        ("AROUND(forklift)", "AROUND(forklift, 1.5)", False),
        ("AROUND(odd_thing)", "AROUND(odd_thing, 1.0)", False),
        ("AROUND(odd_thing)", "AROUND(odd_thing, 0.9)", True),
        ("AROUND(odd_thing, 1.0)", "AROUND(odd_thing)", False),
        ("AROUND(odd_thing, 1.1)", "AROUND(odd_thing)", True),
        ("NEAR(chair)", "NEAR(chair, slow)", True),
        ("NEAR(chair, slow)", "NEAR(chair)", False),
        ("NEAR(chair)", "AROUND(chair, 3.0)", True),
        ("NEAR(chair)", "NEAR(table)", True),
        ("BETWEEN(traffic_cone)", "BETWEEN(traffic_cone)=safe", True),
        ("AROUND(traffic_cone)", "BETWEEN(traffic_cone)", True),
    ],
)
def test_a_statement_is_kept_by_what_asks_for_at_least_as_much(talk, first, later, leaves):
    talk.say(first)
    before = talk.stated[0]
    talk.say(later, times=2)
    assert before in talk.stated
    talk.say(later)
    assert (before not in talk.stated) == leaves


def test_a_safe_between_clears_no_faster_than_silence_and_is_never_stated(talk):
    talk.say("BETWEEN(traffic_cone)", "AROUND(person)", instances=held(1, 2))
    for _ in range(2):
        talk.say("BETWEEN(traffic_cone)=safe", "AROUND(person)=safe", "NEAR(person)=safe", instances=held(1, 2))
        assert talk.stated == ["AROUND(person, 1.0)=unsafe", "BETWEEN(traffic_cone)=unsafe"] and not talk.now.exempt
    talk.say("BETWEEN(traffic_cone)=safe", instances=held(1, 2))
    assert talk.stated == []


def test_an_unsafe_around_stays_when_a_later_reply_says_between(talk):
    talk.say("AROUND(traffic_cone)", instances=held(1)).say("BETWEEN(traffic_cone)", instances=held(1), times=2)
    assert talk.stated == ["AROUND(traffic_cone)=unsafe", "BETWEEN(traffic_cone)=unsafe"]


def test_radii_are_rounded_up_to_tenths_of_a_metre_and_never_down(talk):
    for radius, kept in (
        ("1.01", "1.1"),
        ("1.1", "1.1"),
        ("0.3", "0.3"),
        ("0.0001", "0.1"),
        ("19.95", "20.0"),
        ("20", "20.0"),
    ):
        talk.memory.reset()
        talk.say(f"AROUND(chair, {radius})")
        assert talk.stated == [f"AROUND(chair, {kept})=unsafe"]


def test_a_radius_of_the_ontology_is_written_out(talk):
    talk.say("AROUND(forklift)", "AROUND(chair)")
    assert talk.stated == ["AROUND(chair)=unsafe", "AROUND(forklift, 1.5)=unsafe"]


def test_names_are_those_of_the_ontology(talk):
    talk.say("NEAR(safety_cone)", instances=held(1, name="cone") + unseen(2, name="cones"))
    talk.say(instances=held(1, name="pylon") + unseen(2), times=3)
    assert talk.stated == ["NEAR(traffic_cone)=unsafe"] and talk.exempt("NEAR(traffic_cone)") == (1,)


@pytest.mark.parametrize(
    "statement", ["ON(floor)=unsafe", "NEAR(floor)=unsafe", "ON(grass)=unsafe", "ON(odd_ground)=unsafe"]
)
def test_an_unsafe_surface_needs_two_of_three_replies(talk, statement):
    talk.say(statement).say(times=2).say(statement)
    assert talk.stated == []
    talk.say().say(statement)
    assert talk.stated == [statement]


def test_an_unsafe_surface_leaves_after_three_replies_that_saw_it(talk):
    talk.say("ON(floor)=unsafe", times=2).say(times=5)
    talk.say(seen=("floor",)).say().say(named=("floor",)).say(seen=("carpet",))
    assert talk.stated == ["ON(floor)=unsafe"]
    talk.say("ON(floor)=unsafe").say(seen=("floor",)).say(seen=("ground",))
    assert talk.stated == ["ON(floor)=unsafe"]
    talk.say(named=("ground",))
    assert talk.stated == []


def test_a_weaker_verdict_on_an_unsafe_surface_takes_its_place_without_a_gap(talk):
    talk.say("ON(floor)=unsafe", times=2).say(seen=("floor",), times=2).say("ON(floor, slow)=unsafe", seen=("floor",))
    assert talk.stated == ["ON(floor, slow)=unsafe"]


@pytest.mark.parametrize("name", ["floor", "sidewalk", "grass", "magic_floor", "odd_thing", "table"])
def test_only_a_class_listed_as_navigable_is_ever_safe(talk, name):
    talk.say(f"ON({name})=safe", seen=(name,), times=5)
    assert talk.stated == ([f"ON({name})=safe"] if name in ("floor", "sidewalk") else [])


def test_a_class_that_is_not_listed_is_never_safe_whatever_it_is_taken_for(config_dir):
    class Credulous(Ontology):
        def look_up(self, name):
            return OntologyClass(name, (Category.NAVIGABLE_SURFACE,), listed=name == "floor")

    talk = Talk(Credulous.load(config_dir / "ontology.yaml")).say("ON(floor)=safe", "ON(cliff)=safe")
    assert talk.stated == ["ON(floor)=safe"]


def test_a_safe_surface_stays_until_it_is_in_force_as_unsafe(talk):
    talk.say("ON(ground)=safe").say(seen=("floor",), times=9).say("ON(floor)=unsafe")
    assert talk.stated == ["ON(floor)=safe"]
    talk.say("ON(floor)=unsafe")
    assert talk.stated == ["ON(floor)=unsafe"]
    talk.say("ON(floor)=safe", seen=("floor",), times=2)
    assert talk.stated == ["ON(floor)=unsafe"]
    talk.say(seen=("floor",))
    assert talk.stated == []
    talk.say("ON(floor)=safe")
    assert talk.stated == ["ON(floor)=safe"]


def test_a_reply_that_calls_a_surface_unsafe_in_any_way_does_not_make_it_safe(talk):
    talk.say("ON(ground)=safe", "NEAR(floor)")
    assert talk.stated == []


def test_the_order_does_not_depend_on_the_order_of_the_replies(ontology):
    statements = [
        "NEAR(chair)",
        "AROUND(person, 1.5)",
        "AROUND(person, slow)",
        "BETWEEN(traffic_cone)",
        "ON(floor)=safe",
    ]
    orders = [statements, statements[::-1], statements[2:] + statements[:2]]
    results = []
    for order in orders:
        talk = Talk(ontology, 9)
        for statement in order:
            talk.say(statement)
        results.append(talk.stated)
    assert results[0] == results[1] == results[2] and len(results[0]) == 5


def test_reset_forgets_everything(talk):
    talk.say("NEAR(chair)", "ON(floor)=safe", "ON(grass)=unsafe", instances=held(1)).say("ON(grass)=unsafe")
    assert len(talk.stated) == 3
    talk.memory.reset()
    assert talk.say("ON(grass)=unsafe").stated == []


def test_the_number_of_entries_is_bounded_and_what_is_held_or_fresh_stays(ontology):
    talk = Talk(ontology, 1000)
    talk.say("NEAR(traffic_cone)", instances=unseen(1))
    for block in range(20):
        talk.say(*(f"NEAR(ghost_{block}_{number})" for number in range(32)), instances=unseen(1))
        assert len(talk.stated) <= MAX_ENTRIES
        assert f"NEAR(ghost_{block}_31)=unsafe" in talk.stated and "NEAR(traffic_cone)=unsafe" in talk.stated
    assert len(talk.stated) == MAX_ENTRIES


def test_surfaces_that_nobody_sees_do_not_crowd_out_what_is_said_now(talk):
    for block in range(20):
        ghosts = [f"ON(ghost_{block}_{number})=unsafe" for number in range(32)]
        talk.say(*ghosts, times=2)
    talk.say("NEAR(aardvark)", "NEAR(zebra)")
    assert {"NEAR(aardvark)=unsafe", "NEAR(zebra)=unsafe"} <= set(talk.stated) and len(talk.stated) == MAX_ENTRIES


def test_many_radii_of_one_held_class_stay_bounded(talk):
    for centimetres in range(1, 2001, 7):
        talk.say(f"AROUND(person, {centimetres / 100})", "AROUND(person, 20)", instances=held(1, name="person"))
    assert len(talk.stated) <= 200


def test_the_numbers_are_parameters(ontology):
    talk = Talk(ontology, 1, (1, 1)).say("NEAR(chair)", "ON(floor)=unsafe", seen=("floor",))
    assert talk.stated == ["NEAR(chair)=unsafe", "ON(floor)=unsafe"]
    assert talk.say(seen=("floor",)).stated == []
    talk = Talk(ontology, 1, (2, 4)).say("ON(floor)=unsafe", times=2).say(seen=("floor",)).say()
    assert talk.stated == []  # the two votes are still among the last four, but the newest reply is not one of them
    slow = Talk(ontology, 5).say("NEAR(chair)").say(times=4)
    assert slow.stated == ["NEAR(chair)=unsafe"] and slow.say().stated == []


@pytest.mark.parametrize(
    "arguments, word", [((0,), "clear_after_replies"), ((3, (0, 3)), "surface_votes"), ((3, (4, 3)), "surface_votes")]
)
def test_numbers_out_of_range_are_refused(ontology, arguments, word):
    with pytest.raises(ValueError, match=word):
        ConstraintMemory(ontology, *arguments)


def test_what_is_stated_is_a_reply_that_changes_nothing(ontology):
    talk = Talk(ontology).say("NEAR(chair)", "AROUND(forklift)", "AROUND(odd_thing, 0.33)", "ON(floor)=safe")
    before = talk.now.predicates
    again = talk.memory.add(talk.now, Evidence(9))
    assert again.predicates == before
    assert Predicate(Operator.ON, "floor", Verdict.SAFE) in before

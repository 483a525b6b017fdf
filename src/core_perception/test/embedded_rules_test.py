# SPDX-License-Identifier: BSD-3-Clause
"""The embedded rules under a model: they add what is unsafe, take nothing away, and do not hide a silent model."""

from core_perception.embedded_rules import GuardedAnswer, GuardedSchedule, add_embedded
from core_perception.predicates import Constraints, parse_predicate

HISTORY_NS = 7


def statement(source, *texts, exempt=None, stamp_ns=100, history_ns=HISTORY_NS):
    exempt = {parse_predicate(text): ids for text, ids in (exempt or {}).items()}
    return Constraints(
        tuple(parse_predicate(text) for text in texts),
        ("some",),
        f"{source} says so.",
        source,
        stamp_ns,
        latency_ns=5,
        exempt=exempt,
        instances_history_start_ns=history_ns if exempt else None,
    )


def texts(constraints):
    return [str(p) for p in constraints.predicates]


def test_what_the_rules_call_unsafe_is_added_and_what_they_call_safe_is_not():
    model = statement("ollama", "NEAR(table)", "ON(floor)=safe")
    embedded = statement(
        "ontology", "NEAR(traffic_cone)", "NEAR(table)", "ON(sidewalk)=safe", "ON(grass)=unsafe", stamp_ns=9
    )
    both = add_embedded(model, embedded)
    assert texts(both) == ["NEAR(table)=unsafe", "ON(floor)=safe", "NEAR(traffic_cone)=unsafe", "ON(grass)=unsafe"]
    assert (both.source, both.image_stamp_ns, both.latency_ns) == ("ollama+ontology", 100, 5)
    assert both.justification == "ollama says so. Embedded rules: ontology says so."


def test_before_the_first_answer_of_the_model_nothing_is_added():
    model = Constraints(source="ollama")
    assert add_embedded(model, statement("ontology", "NEAR(cone)")) is model


def test_a_surface_the_rules_call_unsafe_is_not_safe_by_the_model():
    both = add_embedded(statement("m", "ON(grass)=safe"), statement("ontology", "ON(grass)=unsafe"))
    assert texts(both) == ["ON(grass)=unsafe"]


def test_an_instance_is_exempt_only_when_all_who_state_the_predicate_exempt_it():
    cases = [
        (["BETWEEN(c)"], {"BETWEEN(c)": (1, 2)}, ["BETWEEN(c)"], {"BETWEEN(c)": (2, 3)}, (2,)),
        (["BETWEEN(c)"], {"BETWEEN(c)": (1, 2)}, ["BETWEEN(c)"], {}, ()),
        (["BETWEEN(c)"], {}, ["BETWEEN(c)"], {"BETWEEN(c)": (1,)}, ()),
        (["BETWEEN(c)"], {"BETWEEN(c)": (1, 2)}, ["NEAR(c)"], {}, (1, 2)),
        (["NEAR(c)"], {}, ["BETWEEN(c)"], {"BETWEEN(c)": (4,)}, (4,)),
    ]
    for stated, exempt, rules, spared, expected in cases:
        both = add_embedded(statement("m", *stated, exempt=exempt), statement("ontology", *rules, exempt=spared))
        assert both.exempt.get(parse_predicate("BETWEEN(c)"), ()) == expected
        assert both.instances_history_start_ns == (HISTORY_NS if expected else None)


def test_exemptions_counted_by_two_maps_are_dropped():
    model = statement("m", "NEAR(c)", exempt={"NEAR(c)": (1,)})
    embedded = statement("ontology", "BETWEEN(c)", exempt={"BETWEEN(c)": (1,)}, history_ns=HISTORY_NS + 1)
    both = add_embedded(model, embedded)
    assert (both.exempt, both.instances_history_start_ns) == ({}, None)


class Schedule:
    """States what is put into it."""

    def __init__(self):
        self.due, self.frames, self.evidence, self.forgotten = [], [], [], 0

    def add_frame(self, stamp_ns):
        self.frames.append(stamp_ns)

    def add_evidence(self, evidence):
        self.evidence.append(evidence)

    def poll(self):
        due, self.due = self.due, []
        return due

    def at(self, now_ns):
        return statement("s", f"NEAR(c{now_ns})")

    def forget_answers(self):
        self.forgotten += 1


def test_a_frame_is_stated_when_both_have_stated_it():
    model, embedded = Schedule(), Schedule()
    guarded = GuardedSchedule(model, embedded)
    guarded.add_frame(1)
    guarded.add_frame(2)
    embedded.due = [(1, statement("ontology", "NEAR(a)")), (2, statement("ontology", "NEAR(b)"))]
    assert guarded.poll() == []
    model.due = [(1, statement("m", "NEAR(x)"))]
    assert [(stamp, texts(c)) for stamp, c in guarded.poll()] == [(1, ["NEAR(x)=unsafe", "NEAR(a)=unsafe"])]
    model.due = [(2, statement("m", "NEAR(x)"))]
    assert [(stamp, texts(c)) for stamp, c in guarded.poll()] == [(2, ["NEAR(x)=unsafe", "NEAR(b)=unsafe"])]
    assert model.frames == embedded.frames == [1, 2]


def test_a_world_that_was_reset_pairs_nothing_of_before_with_what_comes_after():
    model, embedded = Schedule(), Schedule()
    guarded = GuardedSchedule(model, embedded)
    guarded.add_frame(50)
    embedded.due = [(50, statement("ontology", "NEAR(old)"))]
    assert guarded.poll() == []
    guarded.add_frame(1)
    model.due, embedded.due = [(1, statement("m", "NEAR(x)"))], [(1, statement("ontology", "NEAR(new)"))]
    assert [(stamp, texts(c)) for stamp, c in guarded.poll()] == [(1, ["NEAR(x)=unsafe", "NEAR(new)=unsafe"])]


def test_both_get_the_evidence_and_are_forgotten_together():
    for guard in (GuardedSchedule, GuardedAnswer):
        both = (Schedule(), Schedule())
        guarded = guard(*both)
        guarded.add_evidence("e")
        guarded.forget_answers()
        assert [(part.evidence, part.forgotten) for part in both] == [(["e"], 1)] * 2
    assert texts(guarded.at(3)) == ["NEAR(c3)=unsafe"]

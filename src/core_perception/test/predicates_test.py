# SPDX-License-Identifier: BSD-3-Clause
"""The grammar of predicates and the rules of constraints."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from core_perception.exceptions import PredicateError
from core_perception.predicates import (
    MAX_RADIUS_M,
    Constraints,
    Operator,
    Predicate,
    Severity,
    Verdict,
    apply_precedence,
    canonical_class_name,
    parse_predicate,
)

NAMES = st.from_regex(r"[a-z][a-z0-9]{0,8}(_[a-z0-9]{1,8}){0,3}", fullmatch=True)


@st.composite
def predicates(draw):
    operator = draw(st.sampled_from(Operator))
    verdict = draw(st.sampled_from(Verdict))
    radius_m = draw(st.none() | st.floats(0.0, MAX_RADIUS_M, exclude_min=True)) if operator == Operator.AROUND else None
    severity = draw(st.sampled_from(Severity)) if verdict == Verdict.UNSAFE else Severity.STOP
    return Predicate(operator, draw(NAMES), verdict, radius_m, severity)


@given(predicates())
def test_parse_of_print_is_the_identity(predicate):
    assert parse_predicate(str(predicate)) == predicate
    assert str(parse_predicate(str(predicate))) == str(predicate)
    assert parse_predicate(predicate.expression, predicate.verdict) == predicate


@given(st.text(max_size=40))
def test_any_text_parses_or_is_refused_with_words(text):
    try:
        predicate = parse_predicate(text)
    except PredicateError as error:
        assert "allowed" in str(error)
    else:
        assert parse_predicate(str(predicate)) == predicate


@given(st.text(max_size=60))
def test_canonical_names_are_a_fixed_point(text):
    try:
        name = canonical_class_name(text)
    except PredicateError:
        return
    assert canonical_class_name(name) == name


@pytest.mark.parametrize(
    "text, expected",
    [
        ("ON(floor)=safe", "ON(floor)=safe"),
        ("around( Forklift , 1.5 )", "AROUND(forklift, 1.5)=unsafe"),
        ("AROUND(person, 2, slow) = UNSAFE", "AROUND(person, 2.0, slow)=unsafe"),
        ("AROUND(person, slow)", "AROUND(person, slow)=unsafe"),
        ("Between(Traffic Cone)", "BETWEEN(traffic_cone)=unsafe"),
        ("BETWEEN(traffic_cone)=safe", "BETWEEN(traffic_cone)=safe"),
        ("NEAR(wet-floor sign, stop)", "NEAR(wet_floor_sign)=unsafe"),
    ],
)
def test_free_forms_are_read(text, expected):
    assert str(parse_predicate(text)) == expected


@pytest.mark.parametrize(
    "text, word",
    [
        ("ON(floor)", "verdict"),
        ("BEHIND(car)", "BEHIND"),
        ("ON(floor)=maybe", "maybe"),
        ("NEAR(car, 1.0)", "radius"),
        ("AROUND(car, 0)", "radius"),
        ("AROUND(car, -1)", "radius"),
        ("AROUND(car, nan)", "radius"),
        ("AROUND(car, inf)", "radius"),
        ("AROUND(car, 21)", "radius"),
        ("AROUND(car, slow, 1.0)", "'1.0'"),
        ("AROUND(car, 1.0, 2.0)", "'2.0'"),
        ("AROUND(car, near)", "'near'"),
        ("AROUND(car, slow)=safe", "slow"),
        ("NEAR()", "class name"),
        ("NEAR(3d_printer)", "class name"),
        ("NEAR(car), NEAR(bus)", "NEAR(car), NEAR(bus)"),
        ("NEAR(NEAR(car))", "NEAR(NEAR(car))"),
        ("", "predicate"),
        (None, "predicate"),
    ],
)
def test_wrong_statements_are_refused_by_the_part_that_is_wrong(text, word):
    with pytest.raises(PredicateError, match="allowed") as error:
        parse_predicate(text)
    assert word in str(error.value)


def parsed(*texts):
    return tuple(parse_predicate(text) for text in texts)


@pytest.mark.parametrize(
    "given_texts, kept",
    [
        (("AROUND(cone)", "BETWEEN(cone)"), ("BETWEEN(cone)",)),
        (("NEAR(cone)", "BETWEEN(cone)", "NEAR(cone)"), ("NEAR(cone)", "BETWEEN(cone)")),
        (("AROUND(person)", "BETWEEN(cone)"), ("AROUND(person)", "BETWEEN(cone)")),
        (("AROUND(cone)", "BETWEEN(cone)=safe"), ("AROUND(cone)", "BETWEEN(cone)=safe")),
        (("AROUND(cone)", "BETWEEN(cone, slow)"), ("AROUND(cone)", "BETWEEN(cone, slow)")),
        (("AROUND(cone, slow)", "BETWEEN(cone)"), ("BETWEEN(cone)",)),
    ],
)
def test_between_replaces_around_of_its_class_unless_around_asks_for_more(given_texts, kept):
    assert apply_precedence(parsed(*given_texts)) == parsed(*kept)


@given(st.lists(predicates(), max_size=8))
def test_precedence_only_ever_removes_around_and_repetitions(items):
    kept = apply_precedence(items)
    assert apply_precedence(kept) == kept
    assert all(p.operator == Operator.AROUND for p in set(items) - set(kept))


def test_a_region_that_is_safe_and_unsafe_is_refused():
    with pytest.raises(PredicateError, match="both safe and unsafe"):
        Constraints(parsed("ON(floor)=safe", "ON(floor)=unsafe"))

# SPDX-License-Identifier: BSD-3-Clause
"""Replies of models: what is forgiven, what is void, and that reading takes little time."""

import contextlib
import json
import re
import time
from pathlib import Path

import pytest
import yaml

from core_perception.exceptions import PredicateError, ReplyError
from core_perception.predicates import canonical_class_name
from core_perception.reply_parser import (
    MAX_DEPTH,
    MAX_ITEMS,
    MAX_JUSTIFICATION_CHARS,
    MAX_REPLY_BYTES,
    VOID_CAUSES,
    parse_reply,
    reply_schema,
)

REPLIES = Path(__file__).parent / "data" / "replies"
EXPECTED = yaml.safe_load((REPLIES / "expected.yaml").read_text(encoding="utf-8"))


def reply(unsafe=(), safe=(), classes=(), **more):
    return json.dumps(
        {"safety_logic": "why", "classes": classes, "unsafe_regions": unsafe, "safe_regions": safe, **more}
    )


def void_cause(text, thinking="", **options):
    with pytest.raises(ReplyError) as error:
        parse_reply(text, thinking, **options)
    assert error.value.cause in VOID_CAUSES
    message = str(error.value)
    assert message.isprintable() and len(message) < 400
    return error.value.cause


def statements(text, **options):
    return [str(predicate) for predicate in parse_reply(text, **options).predicates]


def test_every_sample_reply_has_an_expectation_and_the_other_way_round():
    assert {path.stem for path in REPLIES.glob("*.txt")} == set(EXPECTED)


@pytest.mark.parametrize("name", sorted(EXPECTED))
def test_sample_replies_read_as_they_were_meant(name, ontology):
    def is_object(class_name):
        known = ontology.look_up(class_name)
        return known.listed and not known.is_surface

    text, expected = (REPLIES / f"{name}.txt").read_text(encoding="utf-8"), EXPECTED[name]
    options = {"is_object": is_object, "canonical": ontology.canonical}
    if "void" in expected:
        assert void_cause(text, **options) == expected["void"]
        return
    read = parse_reply(text, **options)
    assert [str(predicate) for predicate in read.predicates] == expected["predicates"]
    assert list(read.classes) == expected["classes"]


@pytest.mark.parametrize("name", ["published_hazard_missed", "published_hazard_found", "published_format_example"])
def test_published_samples_keep_their_justification(name):
    text = (REPLIES / f"{name}.txt").read_text(encoding="utf-8")
    written = re.search(r'safety_logic"?: "?(.*?)"?,\n', text).group(1)
    assert len(written) > 20
    assert parse_reply(text).justification == written


def test_an_answer_in_thinking_is_read_only_when_the_text_is_blank():
    assert statements(" \n", thinking=reply(["NEAR(car)"])) == ["NEAR(car)=unsafe"]
    assert statements(reply(["NEAR(bus)"]), thinking=reply(["NEAR(car)"])) == ["NEAR(bus)=unsafe"]
    assert void_cause("no idea", thinking=reply(["NEAR(car)"])) == "not_json"
    assert void_cause("<think>all clear", thinking="") == "not_json"


@pytest.mark.parametrize(
    "text, cause",
    [
        ("", "empty"),
        (" \n\t", "empty"),
        ("<think>hm</think> ", "empty"),
        (None, "wrong_type"),
        ("hello", "not_json"),
        ("{", "not_json"),
        ("{}{", "missing_field"),
        ('{"classes": [}', "missing_field"),
        (reply()[:-1], "not_json"),
        ("[]", "not_an_object"),
        ('"ON(floor)"', "not_an_object"),
        ("```json\n[1, 2]\n```", "not_an_object"),
        ("17", "not_an_object"),
        ("null", "not_an_object"),
        ("{}", "missing_field"),
        ('{"error": {"message": "busy"}}', "missing_field"),
        ('{"classes": [], "unsafe_regions": []}', "missing_field"),
        ('{"unsafe_regions": [], "safe_regions": []}', "missing_field"),
        (json.dumps(json.loads(reply())["safe_regions"]), "not_an_object"),
        (json.dumps({"data": json.loads(reply())}), "missing_field"),
        (reply(unsafe=None), "wrong_type"),
        (reply(unsafe=7), "wrong_type"),
        (reply(unsafe=[7]), "wrong_type"),
        (reply(unsafe={"NEAR": "car"}), "wrong_type"),
        (reply(unsafe=[["NEAR(car)"]]), "wrong_type"),
        (reply(classes=[None]), "wrong_type"),
        (reply(safety_logic=["why"]), "wrong_type"),
        (reply(safety_logic={"a": 1}), "wrong_type"),
        (reply(unsafe=["BEHIND(car)"]), "bad_predicate"),
        (reply(unsafe=["NEAR car"]), "bad_predicate"),
        (reply(unsafe=["car"]), "bad_predicate"),
        (reply(unsafe=["NEAR(NEAR(car))"]), "bad_predicate"),
        (reply(unsafe=["NEAR(car) NEAR(bus)"]), "bad_predicate"),
        (reply(unsafe=["NEAR(car, bus)"]), "bad_predicate"),
        (reply(unsafe=["NEAR(car"]), "bad_predicate"),
        (reply(unsafe=["NEAR()"]), "bad_predicate"),
        (reply(unsafe=["NEAR(3d_printer)"]), "bad_predicate"),
        (reply(unsafe=["NEAR(car, 1.0)"]), "bad_predicate"),
        (reply(unsafe=["AROUND(car, 1e9)"]), "bad_predicate"),
        (reply(unsafe=["AROUND(car, -1)"]), "bad_predicate"),
        (reply(unsafe=["AROUND(car, nan)"]), "bad_predicate"),
        (reply(safe=["ON(floor, slow)"]), "bad_predicate"),
        (reply(unsafe="NEAR(car), anything"), "bad_predicate"),
        (reply(unsafe=["NEAR(c\u0430r)"]), "bad_predicate"),
        (reply(unsafe=["NEAR(" + "c" * 65 + ")"]), "bad_predicate"),
        (reply(unsafe=["NEAR(a.b)"]), "bad_class"),
        (reply(unsafe=["NEAR({car})"]), "bad_class"),
        (reply(classes=["\u8def\u9525"]), "bad_class"),
        (reply(classes=["fl\u043eor"]), "bad_class"),
        (reply(classes=["car\u200b"]), "bad_class"),
        (reply(classes=["\U0001d41f\u006coor"]), "bad_class"),
        (reply(classes=["ON(floor)"]), "bad_class"),
        (reply(classes=["a=b"]), "bad_class"),
        (reply(classes=["7"]), "bad_class"),
        (reply(classes=["c" * 65]), "bad_class"),
        (reply(["ON(floor)"], ["ON(floor)"]), "contradiction"),
        (reply(["BETWEEN(cone)"], ["NEAR(cone)", "BETWEEN(cone, stop)"]), "contradiction"),
        (reply(["AROUND(car, 1.0)"], ["AROUND(car, 2.0)"]), "contradiction"),
        (reply(["NEAR(car)=safe"]), "contradiction"),
        (reply([], ["ON(floor)=unsafe"]), "contradiction"),
    ],
)
def test_malformed_replies_are_void_by_cause(text, cause):
    assert void_cause(text) == cause


def test_one_wrong_entry_voids_the_whole_reply():
    good = ["NEAR(car)", "AROUND(person)"]
    assert len(statements(reply(good))) == 2
    for place in range(3):
        assert void_cause(reply([*good[:place], "NEAR(car,", *good[place:]])) == "bad_predicate"


def test_regions_that_mean_the_same_contradict_each_other_under_any_name(ontology):
    text = reply(["ON(ground)"], ["ON(floor)"])
    assert len(statements(text)) == 2
    assert void_cause(text, canonical=ontology.canonical) == "contradiction"


def test_on_of_an_object_is_void_whatever_its_verdict():
    for text in (reply(["ON(Table)"]), reply([], ["ON(Table)"])):
        assert void_cause(text, is_object=lambda name: name == "table") == "on_object"
        assert len(statements(text, is_object=lambda name: name == "chair")) == 1
    assert statements(reply(["NEAR(table)"]), is_object=lambda name: True) == ["NEAR(table)=unsafe"]


def test_names_are_those_of_the_canonical_function():
    def canonical(name):
        if name == "ghost":
            raise PredicateError("no such thing")
        return "traffic_cone" if "cone" in name else canonical_class_name(name)

    read = parse_reply(
        reply(["NEAR('safety cone')", "AROUND(café_table, 1.5)"], [], ["cones", "Café-Table", "traffic cone"]),
        canonical=canonical,
    )
    assert [str(p) for p in read.predicates] == ["NEAR(traffic_cone)=unsafe", "AROUND(cafe_table, 1.5)=unsafe"]
    assert read.classes == ("traffic_cone", "cafe_table")
    assert void_cause(reply(["NEAR(ghost)"]), canonical=canonical) == "bad_class"


def test_fields_are_found_under_other_spellings_but_not_twice():
    text = '{"Classes": [], "Unsafe Regions": ["NEAR(car)"], "safe-regions": []%s}'
    assert statements(text % "") == ["NEAR(car)=unsafe"]
    assert void_cause(text % ', "unsafe_regions": []') == "ambiguous"
    assert void_cause("classes: a\nunsafe_regions: NEAR(a)\nsafe_regions:\nunsafe_regions:\n") == "ambiguous"


def test_counts_and_sizes_have_limits():
    most = [f"NEAR(c{number})" for number in range(MAX_ITEMS)]
    assert len(statements(reply(most, ["ON(floor)"]))) == MAX_ITEMS + 1
    assert void_cause(reply([*most, "NEAR(d)"])) == "too_many"
    assert void_cause(reply(", ".join([*most, "NEAR(d)"]))) == "too_many"
    assert void_cause(reply([], ["ON(floor)"] * (MAX_ITEMS + 1))) == "too_many"
    assert void_cause(reply(classes=[f"c{number}" for number in range(MAX_ITEMS + 1)])) == "too_many"
    assert void_cause("{}" * (MAX_ITEMS + 1)) == "ambiguous"
    room = MAX_REPLY_BYTES - len(reply().encode())
    assert statements(reply() + " " * room) == []
    assert void_cause(reply() + " " * (room + 1)) == "too_large"
    assert void_cause(reply() + "\u00e9" * (room // 2 + 1)) == "too_large"
    assert void_cause("", thinking=" " * (MAX_REPLY_BYTES + 1)) == "too_large"


def test_nesting_has_a_limit():
    def nested(depth):
        return reply(extra=json.loads("[" * depth + "]" * depth))

    assert statements(nested(MAX_DEPTH - 1)) == []
    assert void_cause(nested(MAX_DEPTH)) == "too_deep"
    assert statements(reply(safety_logic="{[" * 1000)) == []


def test_the_justification_is_one_printable_line_that_a_message_can_carry():
    text = reply(safety_logic="a\nb\tc\u0000d\ud800e \u202eflow" + " x" * 2000)
    justification = parse_reply(text).justification
    assert justification.startswith("a b c d e flow x") and justification.isprintable()
    assert len(justification) == MAX_JUSTIFICATION_CHARS
    justification.encode("utf-8")
    assert parse_reply('{"classes": [], "unsafe_regions": [], "safe_regions": []}').justification == ""


def test_trailing_commas_and_line_ends_in_texts_are_forgiven_in_json_and_commas_in_texts_stay():
    text = '{"safety_logic": "a,\n}, b,]", "classes": ["a",], "unsafe_regions": ["NEAR(a)", ], "safe_regions": [],\t}'
    read = parse_reply(text)
    assert (statements(text), read.justification) == (["NEAR(a)=unsafe"], "a, }, b,]")
    assert void_cause(text.replace('"a",]', '"a",,]')) == "not_json"


def test_quotes_and_brackets_in_the_words_around_do_not_matter():
    assert statements(f'The gap is 30" wide [sic. {reply(["NEAR(car)"])} and 40" high}}') == ["NEAR(car)=unsafe"]


def test_text_inside_the_justification_is_only_text():
    inner = reply(["NEAR(car)"], ["ON(grass)"])
    read = parse_reply(reply(["NEAR(bus)"], safety_logic=f"The poster says {inner} and unsafe_regions: none"))
    assert [str(p) for p in read.predicates] == ["NEAR(bus)=unsafe"]
    assert "poster" in read.justification
    lines = "safety_logic: a poster, unsafe_regions: none\nclasses: bus\nunsafe_regions: NEAR(bus)\nsafe_regions: none"
    assert statements(lines) == ["NEAR(bus)=unsafe"]


HOSTILE = {
    "parentheses": "(",
    "brackets": "[",
    "braces": "{",
    "quotes": '"',
    "backslashes": "\\",
    "open objects": '{"a":',
    "open lists": '{"a":[',
    "empty objects": "{}",
    "commas": ",",
    "commas in an object": "{,}",
    "blanks": " ,",
    "fields": "classes: ",
    "lines of fields": "\nclasses:",
    "quoted backslashes": '"\\\n',
    "fences": "```",
    "stars": "*",
    "thoughts": "</think>",
    "digits": "9",
    "minus signs": "-",
    "accents": "e\u0301",
    "operators": "NEAR(",
}


@pytest.mark.parametrize("name", sorted(HOSTILE))
@pytest.mark.parametrize("wrap", ["%s", "{%s", '{"unsafe_regions": "%s"}', '{"classes": [], "safe_regions": [%s], '])
def test_hostile_repetitions_cost_little_time_and_raise_nothing_else(name, wrap):
    room = MAX_REPLY_BYTES - 100
    text = wrap % (HOSTILE[name] * (room // len(HOSTILE[name].encode())))
    begun_s = time.process_time()
    for candidate in (text, text + "}", reply(unsafe=text[: room // 2]), '{"x": %s}' % text[: room // 2]):
        with contextlib.suppress(ReplyError):
            parse_reply(candidate)
    assert time.process_time() - begun_s < 0.4


def test_ten_megabytes_are_refused_at_once():
    text = "(" * 10_000_000
    begun_s = time.process_time()
    assert void_cause(text) == "too_large"
    assert void_cause("", thinking=text) == "too_large"
    assert time.process_time() - begun_s < 0.1


def test_a_number_of_very_many_digits_costs_little_time():
    text = '{"classes": [], "unsafe_regions": [], "safe_regions": [], "confidence": %s}' % ("9" * 60000)
    begun_s = time.process_time()
    assert statements(text) == []
    assert time.process_time() - begun_s < 0.1


def test_the_schema_describes_what_the_reader_accepts():
    schema = reply_schema()
    assert list(schema["properties"]) == ["safety_logic", "classes", "unsafe_regions", "safe_regions"]
    assert schema["required"] == list(schema["properties"]) and schema["additionalProperties"] is False
    region = re.compile(schema["properties"]["unsafe_regions"]["items"]["pattern"])
    name = re.compile(schema["properties"]["classes"]["items"]["pattern"])
    assert schema["properties"]["safe_regions"]["items"]["pattern"] == region.pattern
    longest = "c" * 63
    for text in ("ON(floor)", "BETWEEN(traffic_cone)", "NEAR(a1)", f"AROUND({longest})"):
        assert region.search(text)
        assert len(statements(reply([text]))) == 1
    for text in ("on(floor)", "ON(floor)=safe", "NEAR(Car)", "NEAR(1a)", "NEAR()", f"NEAR({longest}c)", "x NEAR(a)"):
        assert not region.search(text)
    assert name.search("wet_floor_sign") and not name.search("wet floor sign") and not name.search("_a")


def test_without_chain_of_thought_the_schema_asks_for_no_justification():
    schema = reply_schema(chain_of_thought=False)
    assert schema["required"] == list(schema["properties"]) == ["classes", "unsafe_regions", "safe_regions"]
    assert "safety_logic" in reply_schema()["properties"]

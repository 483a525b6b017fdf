# SPDX-License-Identifier: BSD-3-Clause
"""Rules of a person: in force at once, above every answer, for their lifetime, across restarts."""

import contextlib
import itertools
import os
import stat
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from core_perception.exceptions import RuleError
from core_perception.operator_rules import MAX_RULES, MAX_SENTENCE_CHARS, OperatorRules, RuleKind
from core_perception.predicates import Constraints, canonical_class_name, parse_predicate

PREDICATE, GUIDELINE = RuleKind.PREDICATE, RuleKind.GUIDELINE


@pytest.fixture
def path(tmp_path):
    return tmp_path / "state" / "rules.yaml"


def load(path, now_s=0.0):
    return OperatorRules(path, canonical_class_name, now_s)


def in_memory(*texts):
    rules = load(None)
    for text in texts:
        rules.add(text, PREDICATE, 0.0, 0.0)
    return rules


def answer(*texts, exempt=None, stamp_ns=1):
    numbers = {parse_predicate(text): ids for text, ids in (exempt or {}).items()}
    return Constraints(tuple(map(parse_predicate, texts)), ("chair",), "why", "test", stamp_ns, 2, 0.5, numbers, 3)


def merged(rules, constraints, now_s=0.0):
    return [str(p) for p in rules.merge(constraints, now_s).predicates]


def texts(rules, now_s=0.0):
    return [rule.text for rule in rules.active(now_s)]


def test_a_predicate_is_kept_in_its_normal_form(ontology):
    rules = OperatorRules(None, ontology.canonical, 0.0)
    rule = rules.add(" around( Lift Truck , 2 ) ", PREDICATE, 0.0, 0.0)
    assert (rule.id, rule.text, rule.kind, rule.expires_s) == (
        "rule_1",
        "AROUND(lift_truck, 2.0)=unsafe",
        PREDICATE,
        None,
    )
    assert rules.add("near(cones)", 0, 5.0, 10.0).text == "NEAR(traffic_cone)=unsafe"
    assert [rule.expires_s for rule in rules.active(11.0)] == [None, 15.0]


def test_a_sentence_is_a_guideline_and_no_predicate():
    rules = in_memory("NEAR(car)")
    rules.add("  Stay away from NEAR(bus) and patients. ", GUIDELINE, 0.0, 0.0)
    assert rules.guidelines(0.0) == ("Stay away from NEAR(bus) and patients.",)
    assert merged(rules, answer()) == ["NEAR(car)=unsafe"]


@pytest.mark.parametrize(
    "text, kind, lifetime_s, word",
    [
        ("", GUIDELINE, 0.0, "printable"),
        ("   ", GUIDELINE, 0.0, "printable"),
        ("two\nlines", GUIDELINE, 0.0, "printable"),
        ("\x1b[31mred", GUIDELINE, 0.0, "printable"),
        ("half \ud800", GUIDELINE, 0.0, "printable"),
        ("turned \u202e round", GUIDELINE, 0.0, "printable"),
        ("x" * (MAX_SENTENCE_CHARS + 1), GUIDELINE, 0.0, "300"),
        (None, GUIDELINE, 0.0, "printable"),
        ("NEAR(car)", 2, 0.0, "GUIDELINE 1"),
        ("NEAR(car)", GUIDELINE, -1.0, "lifetime"),
        ("NEAR(car)", GUIDELINE, float("nan"), "lifetime"),
        ("NEAR(car)", GUIDELINE, float("inf"), "lifetime"),
        ("ON(floor)", PREDICATE, 0.0, "verdict"),
        ("Keep away from cars.", PREDICATE, 0.0, "predicate"),
        ("NEAR(car), NEAR(bus)", PREDICATE, 0.0, "predicate"),
        ("AROUND(car, 99)", PREDICATE, 0.0, "radius"),
    ],
)
def test_wrong_rules_are_refused_with_words_and_change_nothing(path, text, kind, lifetime_s, word):
    rules = load(path)
    with pytest.raises(RuleError, match=word) as error:
        rules.add(text, kind, lifetime_s, 0.0)
    assert "\n" not in str(error.value)
    assert rules.active(0.0) == () and not path.exists()
    assert rules.add("x" * MAX_SENTENCE_CHARS, GUIDELINE, 0.0, 0.0).id == "rule_1"


def test_two_rules_that_contradict_are_refused_while_the_first_is_in_force():
    rules = load(None)
    rules.add("BETWEEN(cone)=safe", PREDICATE, 10.0, 0.0)
    with pytest.raises(RuleError, match="rule_1 says BETWEEN"):
        rules.add("BETWEEN(cone, slow)", PREDICATE, 0.0, 9.0)
    rules.add("BETWEEN(barrel)", PREDICATE, 0.0, 9.0)
    rules.add("AROUND(cone)", PREDICATE, 0.0, 9.0)
    rules.add("BETWEEN(cone)", PREDICATE, 0.0, 10.0)
    assert len(rules.active(10.0)) == 3


def test_there_are_at_most_64_rules_and_an_expired_one_makes_room():
    rules = load(None)
    for number in range(MAX_RULES):
        rules.add(f"NEAR(c{number})", PREDICATE, 10.0 if number == 5 else 0.0, 0.0)
    with pytest.raises(RuleError, match="64"):
        rules.add("NEAR(car)", PREDICATE, 0.0, 9.0)
    assert rules.add("NEAR(car)", PREDICATE, 0.0, 10.0).id == "rule_65"


def test_no_rule_ends_later_than_a_message_can_tell():
    rules = load(None)
    assert rules.add("NEAR(car)", PREDICATE, 2.0, 2.0**32 - 3.0).expires_s == 2.0**32 - 1.0
    with pytest.raises(RuleError, match="lifetime"):
        rules.add("NEAR(bus)", PREDICATE, 3.0, 2.0**32 - 3.0)


def test_a_rule_ends_after_its_lifetime_and_at_once_when_removed():
    rules = in_memory("NEAR(car)")
    rules.add("NEAR(bus)", PREDICATE, 5.0, 10.0)
    assert merged(rules, answer(), 14.9) == ["NEAR(car)=unsafe", "NEAR(bus)=unsafe"]
    assert merged(rules, answer(), 15.0) == ["NEAR(car)=unsafe"]
    assert not rules.remove("rule_2") and not rules.remove("rule_9")
    assert rules.remove("rule_1") and not rules.remove("rule_1")
    assert merged(rules, answer(), 15.0) == []


def test_numbers_are_never_given_twice(path):
    rules = load(path)
    for text in ("NEAR(a)", "NEAR(b)"):
        rules.add(text, PREDICATE, 0.0, 0.0)
    rules.remove("rule_2")
    rules.remove("rule_1")
    again = load(path)
    assert again.active(0.0) == () and again.add("NEAR(c)", PREDICATE, 0.0, 0.0).id == "rule_3"


def test_rules_stand_in_front_and_an_unsafe_one_takes_nothing_from_an_answer_that_asks_for_more():
    rules = in_memory("AROUND(person, 0.5)", "ON(grass)=safe", "NEAR(cat)")
    stated = answer("ON(floor)=safe", "AROUND(person, 2.0)", "AROUND(person, slow)", "ON(grass)=unsafe", "NEAR(person)")
    assert merged(rules, stated) == [
        "AROUND(person, 0.5)=unsafe", "ON(grass)=safe", "NEAR(cat)=unsafe",
        "ON(floor)=safe", "AROUND(person, 2.0)=unsafe", "AROUND(person, slow)=unsafe", "NEAR(person)=unsafe",
    ]  # fmt: skip


def test_no_answer_makes_safe_what_a_rule_calls_unsafe():
    rules = in_memory("ON(floor)=unsafe", "BETWEEN(cone)", "NEAR(car)")
    stated = answer("ON(floor)=safe", "BETWEEN(cone)=safe", "NEAR(car)=safe")
    assert merged(rules, stated) == ["ON(floor)=unsafe", "BETWEEN(cone)=unsafe", "NEAR(car)=unsafe"]


@pytest.mark.parametrize("operator, kept", [("NEAR", []), ("AROUND", []), ("BETWEEN", ["BETWEEN(cone)=safe"])])
def test_a_safe_rule_removes_the_unsafe_answer_and_near_or_around_make_nothing_safe(operator, kept):
    rules = in_memory(f"{operator}(cone)=safe")
    assert merged(rules, answer(f"{operator}(cone)", f"{operator}(barrel)")) == [*kept, f"{operator}(barrel)=unsafe"]


def test_no_instance_is_exempt_from_a_rule():
    exempt = {"NEAR(cone)": (1, 2), "NEAR(cone, slow)": (4,), "AROUND(cone)": (3,)}
    result = in_memory("NEAR(cone)").merge(answer("NEAR(cone)", "NEAR(cone, slow)", "AROUND(cone)", exempt=exempt), 0.0)
    assert result.exempt == {parse_predicate("AROUND(cone)"): (3,), parse_predicate("NEAR(cone, slow)"): (4,)}
    assert result.instances_history_start_ns == 3


def test_without_rules_an_answer_stays_as_it_is():
    stated = answer("NEAR(cone)", "ON(floor)=safe", exempt={"NEAR(cone)": (1,)})
    assert load(None).merge(stated, 0.0) == stated


def test_before_the_first_answer_rules_forbid_but_allow_nothing():
    rules = in_memory("ON(grass)=safe", "BETWEEN(cone)=safe", "NEAR(car)=safe", "AROUND(person)", "ON(carpet)=unsafe")
    nothing = Constraints(source="test")
    assert merged(rules, nothing) == ["AROUND(person)=unsafe", "ON(carpet)=unsafe"]
    assert rules.merge(nothing, 0.0).image_stamp_ns is None


def test_rules_survive_a_restart(path):
    rules = load(path)
    rules.add("AROUND(forklift, 1.5)", PREDICATE, 0.0, 5.0)
    rules.add("Rules: 'no' #1 \u2013 café \U0001f6a7.", GUIDELINE, 100.0, 6.0)
    again = load(path, 7.0)
    assert again.active(7.0) == rules.active(7.0) and len(again.active(7.0)) == 2
    assert again.active(105.9) == rules.active(105.9) and len(again.active(106.0)) == 1
    assert load(path, 106.0).guidelines(106.0) == ()


@given(st.lists(st.text(min_size=1, max_size=40), max_size=3))
def test_any_sentence_that_is_taken_survives_a_restart(tmp_path_factory, sentences):
    path = tmp_path_factory.mktemp("rules") / "rules.yaml"
    rules = load(path)
    for sentence in sentences:
        text = sentence.strip()
        taken = text and text.isprintable() and not set(text) & set("<>[]{}|")
        with contextlib.nullcontext() if taken else pytest.raises(RuleError):
            rules.add(sentence, GUIDELINE, 0.0, 0.0)
    assert load(path).active(0.0) == rules.active(0.0)


@pytest.mark.parametrize("now_s, left_s", [(1000.0, 60.0), (1050.0, 10.0), (1059.9, 0.1), (400.0, 60.0), (0.0, 60.0)])
def test_a_clock_that_went_back_while_down_neither_prolongs_nor_ends_a_rule(path, now_s, left_s):
    load(path).add("NEAR(car)", PREDICATE, 60.0, 1000.0)
    for _ in range(2):  # the second start reads what the first one wrote
        rules = load(path, now_s)
        assert len(rules.active(now_s + left_s - 0.01)) == 1
        assert rules.active(now_s + left_s + 0.01) == ()
    assert load(path, now_s + left_s + 0.01).active(now_s + left_s + 0.01) == ()


def test_a_clock_that_goes_back_while_running_leaves_a_rule_its_time():
    rules = load(None)
    rules.add("NEAR(car)", PREDICATE, 60.0, 1000.0)
    assert len(rules.active(1050.0)) == len(rules.active(5.0)) == len(rules.active(14.9)) == 1
    assert rules.active(15.0) == ()


def test_callers_whose_clocks_differ_by_a_little_leave_a_rule_its_time():
    rules = load(None)
    rules.add("NEAR(car)", PREDICATE, 60.0, 1000.0)
    for tick in range(500):  # a lock-step world: the clock, then the stamp of an earlier frame
        now_s = 1000.0 + 0.1 * tick
        assert len(rules.active(now_s)) == len(rules.active(now_s - 0.4)) == 1
    assert len(rules.active(1059.9)) == 1 and rules.active(1060.0) == ()


@pytest.mark.parametrize("now_s, left_s", [(1010.0, 50.0), (1059.9, 0.1), (5.0, 60.0)])
def test_rules_wait_for_a_clock_that_has_not_begun_at_a_restart(path, now_s, left_s):
    load(path).add("NEAR(car)", PREDICATE, 60.0, 1000.0)
    content = path.read_text(encoding="utf-8")
    for _ in range(2):  # the second start reads what the first one may have written
        rules = load(path, None)
        assert len(rules.active(None)) == 1 and merged(rules, answer(), None) == ["NEAR(car)=unsafe"]
        assert path.read_text(encoding="utf-8") == content
        assert len(rules.active(now_s)) == len(rules.active(now_s + left_s - 0.01)) == 1
        assert rules.active(now_s + left_s + 0.01) == ()
        content = path.read_text(encoding="utf-8")
    assert load(path, now_s + left_s + 0.01).active(None) == ()


def test_no_lifetime_can_begin_before_the_clock():
    rules = load(None, None)
    with pytest.raises(RuleError, match="lifetime.*clock"):
        rules.add("NEAR(car)", PREDICATE, 60.0, None)
    rules.add("NEAR(car)", PREDICATE, 0.0, None)
    assert len(rules.active(None)) == len(rules.active(1000.0)) == 1


GOOD = {
    "format_version": 1,
    "saved_at_s": 5.0,
    "next_number": 3,
    "rules": [
        {"id": "rule_1", "text": "NEAR(car)=unsafe", "kind": "predicate", "expires_s": None},
        {"id": "rule_2", "text": "Slowly.", "kind": "guideline", "expires_s": 9.0},
    ],
}


def written(path, data):
    path.parent.mkdir(parents=True)
    path.write_text(data if isinstance(data, str) else yaml.safe_dump(data, allow_unicode=True), encoding="utf-8")
    return path


def rule(place, **change):
    rules = [dict(entry) for entry in GOOD["rules"]]
    rules[place].update(change)
    return {**GOOD, "rules": rules}


def test_a_good_file_is_read(path):
    assert texts(load(written(path, GOOD), 5.0), 5.0) == ["NEAR(car)=unsafe", "Slowly."]


@pytest.mark.parametrize(
    "data",
    [
        "",
        "rules: [",
        "[" * 3000,
        "\x00",
        "- 1",
        "just text",
        {},
        {**GOOD, "more": 1},
        {key: value for key, value in GOOD.items() if key != "next_number"},
        {**GOOD, "format_version": 2},
        {**GOOD, "saved_at_s": "soon"},
        {**GOOD, "saved_at_s": float("nan")},
        {**GOOD, "saved_at_s": [1]},
        {**GOOD, "rules": [{**GOOD["rules"][0], "expires_s": 1.7e12}]},
        {**GOOD, "rules": [{**GOOD["rules"][0], "expires_s": -1.0}]},
        {**GOOD, "next_number": 2},
        {**GOOD, "next_number": -3},
        {**GOOD, "next_number": 3.5},
        {**GOOD, "rules": None},
        {**GOOD, "rules": ["NEAR(car)"]},
        {**GOOD, "rules": GOOD["rules"][::-1]},
        {**GOOD, "rules": [GOOD["rules"][0]] * 2},
        {**GOOD, "next_number": 99, "rules": [dict(GOOD["rules"][0], id=f"rule_{k}") for k in range(1, MAX_RULES + 2)]},
        rule(0, id="rule_x"),
        rule(0, id="rule_01"),
        rule(0, id="1"),
        rule(0, id=["rule_1"]),
        rule(0, text="NEAR(car"),
        rule(0, text="ON(floor)"),
        rule(0, text="x\ny"),
        rule(0, kind="sentence"),
        rule(0, expires_s="later"),
        rule(0, expires_s=float("inf")),
        rule(0, extra=1),
        rule(1, text="NEAR(car)=safe", kind="predicate"),
    ],
)
def test_a_damaged_file_is_refused_with_its_path_and_left_as_it_is(path, data):
    written(path, data)
    before = path.read_bytes()
    with pytest.raises(RuleError, match="rules.yaml: ") as error:
        load(path, 5.0)
    assert "\n" not in str(error.value)
    assert path.read_bytes() == before


def test_a_file_that_is_no_text_or_too_large_is_refused(path):
    written(path, GOOD).write_bytes(b"\xff\xfe\x00")
    with pytest.raises(RuleError, match="rules.yaml"):
        load(path)
    path.write_text("#" * 2_000_000)
    with pytest.raises(RuleError, match="bytes"):
        load(path)
    path.unlink()
    path.mkdir()
    with pytest.raises(RuleError, match="rules.yaml"):
        load(path)


def test_an_expired_rule_in_the_file_contradicts_nobody(path):
    data = rule(1, text="NEAR(car)=safe", kind="predicate")
    assert texts(load(written(path, data), 9.0), 9.0) == ["NEAR(car)=unsafe"]


def test_a_good_file_is_not_rewritten_at_the_start(path):
    before = written(path, GOOD).read_bytes()
    load(path, 8.0)
    assert path.read_bytes() == before


def forbid_replace(monkeypatch):
    def fail(self, target):
        raise OSError("disk full")

    monkeypatch.setattr(Path, "replace", fail)


def test_a_rule_that_cannot_be_written_is_not_in_force_and_one_that_cannot_be_removed_stays(path, monkeypatch):
    rules = load(path)
    rules.add("NEAR(car)", PREDICATE, 0.0, 0.0)
    before = path.read_bytes()
    forbid_replace(monkeypatch)
    for change in (lambda: rules.add("NEAR(bus)", PREDICATE, 0.0, 0.0), lambda: rules.remove("rule_1")):
        with pytest.raises(RuleError, match="disk full"):
            change()
        assert texts(rules) == ["NEAR(car)=unsafe"]
        assert path.read_bytes() == before and list(path.parent.iterdir()) == [path]
    monkeypatch.undo()
    assert rules.add("NEAR(bus)", PREDICATE, 0.0, 0.0).id == "rule_2"


def test_the_content_is_on_the_disk_before_it_takes_the_place_of_the_old_one(path, monkeypatch):
    events = []
    fsync, replace = os.fsync, Path.replace

    def note_fsync(number):
        kind = "folder" if stat.S_ISDIR(os.fstat(number).st_mode) else "file"
        events.append((kind, os.fstat(number).st_size > 0))
        fsync(number)

    def note_replace(self, target):
        events.append(("replace", yaml.safe_load(self.read_text(encoding="utf-8"))["next_number"]))
        return replace(self, target)

    monkeypatch.setattr(os, "fsync", note_fsync)
    monkeypatch.setattr(Path, "replace", note_replace)
    load(path).add("NEAR(car)", PREDICATE, 0.0, 0.0)
    assert events == [("file", True), ("replace", 2), ("folder", True)]


def test_a_writer_that_dies_at_any_moment_leaves_the_old_or_the_new_rules(path, monkeypatch):
    """Every system call of the writing may be the last one."""
    load(path).add("NEAR(old)", PREDICATE, 0.0, 0.0)
    names = [(os, "fsync"), (os, "fdopen"), (Path, "replace")]
    for (owner, name), count in itertools.product(names, (0, 1)):
        with monkeypatch.context() as patch:
            calls, real = [0], getattr(owner, name)

            def dying(*arguments, calls=calls, real=real, count=count, **options):
                calls[0] += 1
                if calls[0] > count:
                    raise KeyboardInterrupt
                return real(*arguments, **options)

            patch.setattr(owner, name, dying)
            rules = load(path)
            with contextlib.suppress(KeyboardInterrupt):
                rules.add("NEAR(new)", PREDICATE, 0.0, 0.0)
        after = texts(load(path))
        assert after[0] == "NEAR(old)=unsafe" and set(after[1:]) <= {"NEAR(new)=unsafe"}
        assert list(path.parent.iterdir()) == [path]


def test_a_folder_that_cannot_be_synced_does_not_undo_a_rule(path, monkeypatch):
    def fsync(number):
        if stat.S_ISDIR(os.fstat(number).st_mode):
            raise OSError("not supported")

    monkeypatch.setattr(os, "fsync", fsync)
    rules = load(path)
    rules.add("NEAR(car)", PREDICATE, 0.0, 0.0)
    assert texts(rules) == texts(load(path)) == ["NEAR(car)=unsafe"]


def test_rules_without_a_file_write_nothing(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    in_memory("NEAR(car)").remove("rule_1")
    assert list(tmp_path.iterdir()) == []

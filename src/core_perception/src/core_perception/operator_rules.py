# SPDX-License-Identifier: BSD-3-Clause
"""Rules that a person gave: predicates that no answer can speak against, and sentences for a language model.

A rule holds at once, for its lifetime or until it is removed, and is kept in a file across restarts. Time is an
argument, in seconds of whatever clock the caller keeps; a clock that goes back leaves every rule the time it had, and
while it has not begun (None: sim time before the first message of its clock) no rule ages.

The file is YAML with exactly these keys, written whole and then put in place of the old one::

    format_version: 1
    saved_at_s: 1700000000.0
    next_number: 3
    rules:
    - {id: rule_1, text: AROUND(forklift, 1.5)=unsafe, kind: predicate, expires_s: null}
    - {id: rule_2, text: Patients may cross the hall at any time., kind: guideline, expires_s: 1700003600.0}
"""

from __future__ import annotations

import contextlib
import enum
import math
import os
import re
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Callable, Optional, Tuple

import yaml

from core_perception.exceptions import PerceptionError, RuleError
from core_perception.predicates import Constraints, Operator, Predicate, Verdict, parse_predicate
from core_perception.prompt import MAX_SENTENCE_CHARS, check_sentence

MAX_RULES = 64
# Statements of a lock-step world are stamped by frames, services by the clock, which is ahead of them: such a step back
# is no clock that went back.
CLOCK_SLACK_S = 1.0
MAX_FILE_BYTES = 1 << 20
LATEST_S = 2**32  # what a message can tell
FORMAT_VERSION = 1


class RuleKind(enum.IntEnum):
    """What a rule is; the values are those of core_msgs/OperatorRule."""

    PREDICATE = 0
    GUIDELINE = 1


@dataclass(frozen=True)
class Rule:
    """One rule of a person.

    Attributes:
        id: ``rule_1``, ``rule_2``, ... in the order given; never given twice.
        text: a predicate in the words of predicates.py, or a sentence.
        kind: which of the two.
        expires_s: when it ends [s]; None: when it is removed.
    """

    id: str
    text: str
    kind: RuleKind
    expires_s: Optional[float] = None


class OperatorRules:
    """The rules of one robot."""

    def __init__(self, path: Optional[Path], canonical: Callable[[str], str], now_s: Optional[float]):
        """Load what the file holds; rules that have expired are left out.

        Args:
            path: file to keep the rules in, made with the first rule; None keeps them in memory alone.
            canonical: the name under which a class is known; raises PredicateError for what is none.
            now_s: time [s]; None while the clock has not begun.

        Raises:
            RuleError: the file is there but cannot be read, written or understood; the message starts with the path.
        """
        self._path, self._canonical, self._now_s = path and Path(path), canonical, now_s or 0.0
        self._rules: Tuple[Rule, ...] = ()
        self._next_number = 1
        if self._path is not None and self._path.exists():
            self._load(now_s)

    def add(self, text: str, kind: RuleKind, lifetime_s: float, now_s: Optional[float]) -> Rule:
        """Add a rule, in force at once, and keep it in the file.

        Args:
            text: a predicate such as ``AROUND(forklift, 1.5)=unsafe``, or a sentence.
            kind: which of the two.
            lifetime_s: how long it holds [s]; 0: until it is removed.
            now_s: time [s]; None while the clock has not begun.

        Raises:
            RuleError: the text is no predicate, or no printable line of at most 300 characters; it says of a region
                the opposite of a rule in force; there are 64 rules; the lifetime is negative, not finite, or would
                begin before the clock; the file cannot be written. Nothing is changed then.
        """
        active = self.active(now_s)
        if not 0.0 <= lifetime_s < LATEST_S - (now_s or 0.0):
            raise RuleError(f"lifetime: got {lifetime_s}, allowed >= 0 s, 0 for ever, and an end before {LATEST_S} s")
        if lifetime_s and now_s is None:
            raise RuleError(f"lifetime: got {lifetime_s}, allowed 0 (for ever) while the clock has not begun")
        expires_s = now_s + lifetime_s if lifetime_s else None
        rule = self._checked(Rule(f"rule_{self._next_number}", text, kind, expires_s), active)
        self._keep((*active, rule), self._next_number + 1)
        return rule

    def remove(self, rule_id: str) -> bool:
        """Remove a rule, also from the file; False if there is none with this number that has not expired.

        Raises:
            RuleError: the file cannot be written; the rule stays in force.
        """
        active = self.active(self._now_s)
        left = tuple(rule for rule in active if rule.id != rule_id)
        if len(left) == len(active):
            return False
        self._keep(left, self._next_number)
        return True

    def active(self, now_s: Optional[float]) -> Tuple[Rule, ...]:
        """Return the rules in force, oldest first."""
        with contextlib.suppress(RuleError):  # they hold whether or not that could be written down
            self._follow(now_s)
        return _unexpired(self._rules, self._now_s if now_s is None else now_s)

    def guidelines(self, now_s: Optional[float]) -> Tuple[str, ...]:
        """Return the sentences in force, oldest first."""
        return tuple(rule.text for rule in self.active(now_s) if rule.kind == RuleKind.GUIDELINE)

    def merge(self, constraints: Constraints, now_s: Optional[float]) -> Constraints:
        """Put the rules in force in front of what a reasoner states.

        An unsafe rule adds: it replaces a safe statement of the same operator and class, stands beside an unsafe one,
        which may ask for more, and no instance is exempt from it. A safe rule removes what the reasoner states of the
        same operator and class, with its exemptions; a safe NEAR or AROUND does no more than that, for these operators
        make nothing safe. Before the first answer (image_stamp_ns is None) the unsafe rules alone are added.
        """
        rules = [p for rule in self.active(now_s) for p in self._predicates_of(rule)]
        if constraints.image_stamp_ns is None:
            rules = [p for p in rules if p.verdict == Verdict.UNSAFE]
        ruled = {_region(p): p.verdict for p in rules}
        stated = constraints.predicates
        kept = [p for p in stated if _region(p) not in ruled or p.verdict == ruled[_region(p)] == Verdict.UNSAFE]
        told = [p for p in rules if p.verdict == Verdict.UNSAFE or p.operator in (Operator.ON, Operator.BETWEEN)]
        exempt = {p: ids for p, ids in constraints.exempt.items() if p in kept and p not in told}
        return replace(constraints, predicates=tuple(dict.fromkeys((*told, *kept))), exempt=exempt)

    def _follow(self, now_s: Optional[float]):
        """Learn the time; a clock that has gone back leaves every rule the time it had, in the file as well."""
        if now_s is None:
            return
        by_s = now_s - self._now_s
        self._now_s = now_s if by_s < -CLOCK_SLACK_S else max(self._now_s, now_s)
        if by_s < -CLOCK_SLACK_S:
            self._rules = tuple(_shifted(rule, by_s) for rule in self._rules)
            self._keep(self._rules, self._next_number)

    def _predicates_of(self, rule: Rule) -> Tuple[Predicate, ...]:
        return (parse_predicate(rule.text),) if rule.kind == RuleKind.PREDICATE else ()

    def _checked(self, rule: Rule, others: Tuple[Rule, ...]) -> Rule:
        """The rule with its text in normal form."""
        if len(others) >= MAX_RULES:
            raise RuleError(f"rules: got more than {MAX_RULES}, allowed {MAX_RULES}; remove one first")
        text = rule.text.strip() if isinstance(rule.text, str) else ""
        if not (0 < len(text) <= MAX_SENTENCE_CHARS and text.isprintable()):
            raise RuleError(
                f"rule: got {str(rule.text)[:80]!r}, allowed one printable line, <= {MAX_SENTENCE_CHARS} chars"
            )
        if rule.kind not in tuple(RuleKind):
            raise RuleError(
                f"rule kind: got {rule.kind!r}, allowed {', '.join(f'{k.name} {k.value}' for k in RuleKind)}"
            )
        rule = replace(rule, text=text, kind=RuleKind(rule.kind))
        try:
            if rule.kind == RuleKind.GUIDELINE:
                return replace(rule, text=check_sentence(text))
            predicate = parse_predicate(text)
            predicate = replace(predicate, class_name=self._canonical(predicate.class_name))
        except PerceptionError as error:
            raise RuleError(f"rule: {error}") from error
        for other in others:
            for held in self._predicates_of(other):
                if _region(held) == _region(predicate) and held.verdict != predicate.verdict:
                    raise RuleError(f"rule: got {predicate}, but {other.id} says {held}; remove it first")
        return replace(rule, text=str(predicate))

    def _load(self, now_s: Optional[float]):
        try:
            if self._path.stat().st_size > MAX_FILE_BYTES:
                raise RuleError(f"got more than {MAX_FILE_BYTES} bytes")
            # The base loader leaves every scalar a text: it constructs nothing that could fail in another way.
            data = yaml.load(self._path.read_text(encoding="utf-8"), Loader=yaml.BaseLoader)
            self._now_s, self._next_number, rules = _read_file(data)
            for rule in _unexpired(rules, max(self._now_s, now_s or self._now_s)):
                self._rules = (*self._rules, self._checked(rule, self._rules))
        except (OSError, UnicodeDecodeError, yaml.YAMLError, RecursionError, RuleError) as error:
            raise RuleError(f"{self._path}: {' '.join(str(error).split())}") from error
        self._follow(now_s)

    def _keep(self, rules: Tuple[Rule, ...], next_number: int):
        """Write the file, then take the rules over."""
        if self._path is not None:
            data = {
                "format_version": FORMAT_VERSION,
                "saved_at_s": self._now_s,
                "next_number": next_number,
                "rules": [
                    {"id": r.id, "text": r.text, "kind": r.kind.name.lower(), "expires_s": r.expires_s} for r in rules
                ],
            }
            text = yaml.safe_dump(data, sort_keys=False, allow_unicode=True)
            try:
                _write_whole(self._path, text)
            except OSError as error:
                raise RuleError(f"{self._path}: cannot be written: {error}") from error
        self._rules, self._next_number = rules, next_number


def _region(predicate: Predicate) -> Tuple[Operator, str]:
    return predicate.operator, predicate.class_name


def _unexpired(rules: Tuple[Rule, ...], now_s: float) -> Tuple[Rule, ...]:
    return tuple(rule for rule in rules if rule.expires_s is None or rule.expires_s > now_s)


def _shifted(rule: Rule, by_s: float) -> Rule:
    return rule if rule.expires_s is None else replace(rule, expires_s=rule.expires_s + by_s)


def _read_file(data) -> Tuple[float, int, Tuple[Rule, ...]]:
    """Time of saving [s], next number and rules of a file's content; texts and contradictions are not checked here."""
    keys = {"format_version", "saved_at_s", "next_number", "rules"}
    if not isinstance(data, dict) or set(data) != keys or not isinstance(data["rules"], list):
        raise RuleError(f"got other content, allowed exactly {', '.join(sorted(keys))}")
    if data["format_version"] != str(FORMAT_VERSION):
        raise RuleError(f"format_version: got {data['format_version']!r}, allowed {FORMAT_VERSION}")
    next_number = _read_number(data["next_number"])
    rules = tuple(_read_rule(entry) for entry in data["rules"])
    numbers = [_read_number(rule.id[len("rule_") :]) for rule in rules]
    if sorted(set(numbers)) != numbers or not all(number < next_number for number in numbers):
        raise RuleError(f"id: got {[rule.id for rule in rules]}, allowed rising numbers below {next_number}")
    return _read_time(data["saved_at_s"]), next_number, rules


def _read_rule(entry) -> Rule:
    if not isinstance(entry, dict) or set(entry) != {"id", "text", "kind", "expires_s"}:
        raise RuleError("rule: got other keys, allowed exactly id, text, kind, expires_s")
    if not all(isinstance(value, str) for value in entry.values()) or not entry["id"].startswith("rule_"):
        raise RuleError(f"rule: got {str(entry)[:120]}, allowed id rule_1, rule_2, ... and plain values")
    if entry["kind"].upper() not in RuleKind.__members__:
        raise RuleError(f"kind: got {entry['kind'][:80]!r}, allowed predicate or guideline")
    expires_s = None if entry["expires_s"] == "null" else _read_time(entry["expires_s"])
    return Rule(entry["id"], entry["text"], RuleKind[entry["kind"].upper()], expires_s)


def _read_number(text) -> int:
    if not isinstance(text, str) or not re.match(r"[1-9][0-9]{0,17}\Z", text):
        raise RuleError(f"number: got {str(text)[:80]!r}, allowed 1, 2, 3, ...")
    return int(text)


def _read_time(text) -> float:
    try:
        time_s = float(text)
    except (TypeError, ValueError):
        time_s = math.nan
    if not 0.0 <= time_s < LATEST_S:
        raise RuleError(f"time: got {str(text)[:80]!r}, allowed seconds from 0 to {LATEST_S}")
    return time_s


def _write_whole(path: Path, text: str):
    """Replace a file by another content so that after a crash it holds the one or the other, never a part."""
    path.parent.mkdir(parents=True, exist_ok=True)
    number, temporary = tempfile.mkstemp(dir=str(path.parent), prefix=f".{path.name}.")
    try:
        with os.fdopen(number, "w", encoding="utf-8") as stream:
            stream.write(text)
            stream.flush()
            os.fsync(stream.fileno())
        Path(temporary).replace(path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise
    folder = os.open(str(path.parent), os.O_RDONLY)
    try:
        with contextlib.suppress(OSError):  # not every file system can; the content is one of the two all the same
            os.fsync(folder)
    finally:
        os.close(folder)

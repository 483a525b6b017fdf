# SPDX-License-Identifier: BSD-3-Clause
"""The language of safety: spatial operators over classes, their text form, and the constraints a reasoner states.

Grammar (white space is free, operators and keywords in any case)::

    statement := operator "(" class ["," radius_m] ["," severity] ")" ["=" verdict]
    operator  := "ON" | "NEAR" | "AROUND" | "BETWEEN"
    verdict   := "safe" | "unsafe"          may be left out for NEAR, AROUND and BETWEEN, which are then unsafe
    severity  := "stop" | "slow"            stop when left out
    class     := letter (letter | digit | "_")*
    radius_m  := number > 0, for AROUND only

Examples: ``ON(floor)=safe``, ``AROUND(forklift, 1.5)``, ``AROUND(person, 1.2, slow)=unsafe``.

Source: [CORE] contextual safety reasoning and appendix, spatial operators. Differs: verdict, radius and severity are
    part of the text.
"""

from __future__ import annotations

import enum
import math
import re
import unicodedata
from dataclasses import dataclass, field
from typing import Iterable, Mapping, Optional, Tuple

from core_perception.exceptions import PredicateError

MAX_CLASS_NAME_CHARS = 64
MAX_RADIUS_M = 20.0
_CLASS_NAME = re.compile(r"[a-z][a-z0-9]*(?:_[a-z0-9]+)*\Z")
_STATEMENT = re.compile(
    r"\s*(?P<operator>[a-z]+)\s*\((?P<arguments>[^()]*)\)\s*(?:=\s*(?P<verdict>[a-z]+)\s*)?\Z", re.IGNORECASE | re.ASCII
)


class Operator(enum.IntEnum):
    """Spatial operator; the values are those of core_msgs/Predicate."""

    ON = 0
    NEAR = 1
    AROUND = 2
    BETWEEN = 3


class Verdict(enum.IntEnum):
    """What a predicate says about its region; the values are those of core_msgs/Predicate."""

    SAFE = 0
    UNSAFE = 1


class Severity(enum.IntEnum):
    """What an unsafe region asks for: a barrier or a speed cap; the values are those of core_msgs/Predicate."""

    STOP = 0
    SLOW = 1


def canonical_class_name(text: str) -> str:
    """Write a class name as the map, the segmenter and the messages know it.

    "Wet floor-sign " becomes ``wet_floor_sign``: accents are dropped, letters made lower case, every run of other
    characters than letters and digits becomes one underscore. The function is idempotent.

    Raises:
        PredicateError: nothing is left, the name starts with a digit, or it is longer than 64 characters.
    """
    if not isinstance(text, str):
        raise PredicateError(f"class name: got {text!r}, allowed text")
    ascii_text = unicodedata.normalize("NFKD", text).encode("ascii", "ignore").decode("ascii")
    name = re.sub(r"[^a-z0-9]+", "_", ascii_text.lower()).strip("_")
    if len(name) > MAX_CLASS_NAME_CHARS or not _CLASS_NAME.match(name):
        raise PredicateError(
            f"class name: got {text[:80]!r}, allowed a letter, then up to 63 letters, digits or underscores"
        )
    return name


@dataclass(frozen=True)
class Predicate:
    """One spatial operator applied to one class, with its verdict.

    Attributes:
        operator: ON, NEAR, AROUND or BETWEEN.
        class_name: canonical class name.
        verdict: SAFE or UNSAFE.
        radius_m: reach of AROUND on the ground plane [m]; None means the default of the class.
        severity: STOP or SLOW; only an unsafe predicate can be SLOW.

    Raises:
        PredicateError: a name that is not canonical, a radius on another operator than AROUND, a radius outside (0, 20]
            m, or a severity SLOW on a safe predicate.
    """

    operator: Operator
    class_name: str
    verdict: Verdict
    radius_m: Optional[float] = None
    severity: Severity = Severity.STOP

    def __post_init__(self):
        """Check the grammar's rules."""
        if canonical_class_name(self.class_name) != self.class_name:
            raise PredicateError(
                f"class name: got {self.class_name!r}, allowed {canonical_class_name(self.class_name)!r}"
            )
        if self.radius_m is not None:
            self._check_radius()
        if self.severity == Severity.SLOW and self.verdict == Verdict.SAFE:
            raise PredicateError(
                f"{self.expression}: got a safe region with severity slow, allowed slow on unsafe ones"
            )

    def _check_radius(self):
        if self.operator != Operator.AROUND:
            raise PredicateError(f"{self.operator.name}({self.class_name}): got a radius, allowed on AROUND only")
        if not (math.isfinite(self.radius_m) and 0.0 < self.radius_m <= MAX_RADIUS_M):
            raise PredicateError(
                f"AROUND({self.class_name}): got radius {self.radius_m}, allowed 0 < radius <= {MAX_RADIUS_M} m"
            )

    @property
    def expression(self) -> str:
        """Operator and arguments without the verdict, for example ``AROUND(forklift, 1.5)``."""
        arguments = [self.class_name]
        if self.radius_m is not None:
            arguments.append(repr(float(self.radius_m)))
        if self.severity == Severity.SLOW:
            arguments.append("slow")
        return f"{self.operator.name}({', '.join(arguments)})"

    def __str__(self) -> str:
        """Return the whole statement; parse_predicate reads it back as an equal predicate."""
        return f"{self.expression}={self.verdict.name.lower()}"


def parse_predicate(text: str, verdict: Optional[Verdict] = None) -> Predicate:
    """Read one statement of the module's grammar; ``parse_predicate(str(p)) == p`` for every predicate p.

    Args:
        text: for example ``AROUND(forklift, 1.5)=unsafe``.
        verdict: verdict of a statement that names none; None means unsafe for NEAR, AROUND, BETWEEN and an error for
            ON.

    Raises:
        PredicateError: the text is no statement; the message says which part is wrong and what is allowed.
    """
    match = _STATEMENT.match(text) if isinstance(text, str) else None
    if match is None:
        raise PredicateError(
            f"predicate: got {str(text)[:80]!r}, allowed for example 'ON(floor)=safe' or 'AROUND(forklift, 1.5)'"
        )
    operator = _member(Operator, match.group("operator"), text)
    class_text, *options = [part.strip() for part in match.group("arguments").split(",")]
    radius_m, severity = _parse_options(options, text)
    if match.group("verdict"):
        verdict = _member(Verdict, match.group("verdict"), text)
    if verdict is None:
        if operator == Operator.ON:
            raise PredicateError(f"predicate: got {text!r} without a verdict, allowed '{text}=safe' or '{text}=unsafe'")
        verdict = Verdict.UNSAFE
    return Predicate(operator, canonical_class_name(class_text), verdict, radius_m, severity)


def _parse_options(options, text):
    radius_m, severity = None, None
    for option in options:
        if option.upper() in Severity.__members__ and severity is None:
            severity = Severity[option.upper()]
        elif radius_m is None and severity is None:
            radius_m = _parse_radius(option, text)
        else:
            raise PredicateError(
                f"predicate: got {option!r} in {text!r}, allowed (class), (class, radius), (class, radius, slow)"
            )
    return radius_m, Severity.STOP if severity is None else severity


def _parse_radius(option, text):
    try:
        return float(option)
    except ValueError as error:
        raise PredicateError(
            f"predicate: got {option!r} in {text!r}, allowed a radius in metres, 'stop' or 'slow'"
        ) from error


def _member(kind, word, text):
    try:
        return kind[word.upper()]
    except KeyError as error:
        raise PredicateError(
            f"predicate: got {word!r} in {text!r}, allowed one of {', '.join(m.name for m in kind)}"
        ) from error


def apply_precedence(predicates: Iterable[Predicate]) -> Tuple[Predicate, ...]:
    """Drop what an unsafe BETWEEN replaces, drop repetitions, keep the order.

    An unsafe AROUND of the same class is dropped unless it asks for more (STOP where BETWEEN only asks for SLOW).
    Source: [CORE] prompt, the grouped-barrier rule takes precedence over AROUND.
    """
    unique = tuple(dict.fromkeys(predicates))
    barriers = {
        (p.class_name, p.severity) for p in unique if p.operator == Operator.BETWEEN and p.verdict == Verdict.UNSAFE
    }

    def replaced(predicate):
        if predicate.operator != Operator.AROUND or predicate.verdict != Verdict.UNSAFE:
            return False
        return any(name == predicate.class_name and severity <= predicate.severity for name, severity in barriers)

    return tuple(p for p in unique if not replaced(p))


@dataclass(frozen=True)
class Constraints:
    """What a reasoner states about one image.

    Attributes:
        predicates: safe and unsafe predicates, without repetition.
        classes: canonical names of the classes the answer is about.
        justification: why, in words.
        source: the reasoner, for example ``ontology``.
        image_stamp_ns: stamp of the evidence [ns]; None while no answer exists.
        latency_ns: time from image to answer [ns].
        confidence: 0..1, NaN where the reasoner gives none.
        exempt: predicate -> numbers of held instances it does not speak of (core_msgs/Predicate.exempt_instances).
        instances_history_start_ns: history of the map that these numbers count by [ns]; None without exemptions.

    Raises:
        PredicateError: one region is called safe and unsafe at once.
    """

    predicates: Tuple[Predicate, ...] = ()
    classes: Tuple[str, ...] = ()
    justification: str = ""
    source: str = ""
    image_stamp_ns: Optional[int] = None
    latency_ns: int = 0
    confidence: float = field(default=math.nan, compare=False)
    exempt: Mapping[Predicate, Tuple[int, ...]] = field(default_factory=dict)
    instances_history_start_ns: Optional[int] = None

    def __post_init__(self):
        """Refuse contradictions."""
        verdicts = {}
        for predicate in self.predicates:
            key = (predicate.operator, predicate.class_name)
            if verdicts.setdefault(key, predicate.verdict) != predicate.verdict:
                raise PredicateError(
                    f"constraints: got {predicate.expression} both safe and unsafe, allowed one verdict a region"
                )

# SPDX-License-Identifier: BSD-3-Clause
"""True rules with drawn errors and latency, at the rates measured of some model: what holds when answers are wrong.

No model is asked. ``docs/emulated_reasoner.md`` describes the errors; ``config/emulated.yaml`` holds the rates.

Source: [CORE] Tables II and III. Differs: the paper gives the rates; what a wrong answer looks like is ours.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import statistics
from dataclasses import dataclass
from typing import Dict, FrozenSet, Iterable, List, NamedTuple, Sequence

from core_perception.exceptions import ParameterError, PerceptionError, PredicateError
from core_perception.ontology import Category, Ontology
from core_perception.predicates import Constraints, Operator, Predicate, Verdict, apply_precedence
from core_perception.reasoners.base import Answer, Evidence, Reasoner
from core_perception.yaml_file import read_yaml

CORRELATIONS = ("independent", "scene")
MALFORMED_CAUSE = "not_json"
_CONTEXTUAL = (Operator.ON, Operator.AROUND, Operator.BETWEEN)


def _check_number(key, value, low, high):
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not low <= value <= high:
        raise ParameterError(key, value, f"a number from {low:g} to {high:g}")


@dataclass(frozen=True)
class ErrorShares:
    """What the wrong parts are.

    Attributes:
        unsafe_missed: share of the wrong unsafe parts that leave a hazard out; the others are over-cautious.
        safe_missed: share of the wrong safe parts that leave a surface out; the others call it unsafe.

    Raises:
        ParameterError: a share outside 0..1.
    """

    unsafe_missed: float
    safe_missed: float

    def __post_init__(self):
        """Check the ranges."""
        for key in ("unsafe_missed", "safe_missed"):
            _check_number(f"shares.{key}", getattr(self, key), 0.0, 1.0)


@dataclass(frozen=True)
class EmulatedRow:
    """One row of a table of measured answers.

    Attributes:
        name: as in ``reasoner:=emulated``'s parameter, for example ``gemma3-27b``.
        safe_rate: share of answers whose safe part is right, malformed answers counted as wrong; 0..1.
        unsafe_rate: the same of the unsafe part.
        latency_mean_s: mean time from image to answer [s], > 0.
        latency_std_s: its standard deviation [s], >= 0.
        malformed_rate: share of answers that cannot be read at all; at most 1 - safe_rate and 1 - unsafe_rate.
        shares: what the wrong parts are.

    Raises:
        ParameterError: a number out of range.
    """

    name: str
    safe_rate: float
    unsafe_rate: float
    latency_mean_s: float
    latency_std_s: float
    malformed_rate: float
    shares: ErrorShares

    def __post_init__(self):
        """Check the ranges."""
        for key in ("safe_rate", "unsafe_rate"):
            _check_number(f"{self.name}.{key}", getattr(self, key), 0.0, 1.0)
        _check_number(f"{self.name}.latency_mean_s", self.latency_mean_s, 1e-3, 600.0)
        _check_number(f"{self.name}.latency_std_s", self.latency_std_s, 0.0, 600.0)
        readable = 1.0 - max(self.safe_rate, self.unsafe_rate)
        _check_number(f"{self.name}.malformed_rate", self.malformed_rate, 0.0, readable)

    def rate_of_readable(self, rate: float) -> float:
        """Share among the readable answers: rate / (1 - malformed_rate); 0 where none is readable."""
        return rate / (1.0 - self.malformed_rate) if self.malformed_rate < 1.0 else 0.0


def load_rows(path) -> Dict[str, EmulatedRow]:
    """Read ``config/emulated.yaml`` or a file like it; return the rows by name.

    Raises:
        PerceptionError: the file cannot be read or has other content; the message starts with the path.
    """
    data = read_yaml(path)
    try:
        if not isinstance(data, dict) or set(data) != {"shares", "rows"} or not isinstance(data["rows"], dict):
            raise ParameterError("top level", data, "exactly shares and rows, both mappings")
        shares = _read(ErrorShares, "shares", data["shares"], {})
        return {
            name: _read(EmulatedRow, name, entry, {"name": name, "shares": shares})
            for name, entry in data["rows"].items()
        }
    except ParameterError as error:
        raise PerceptionError(f"{path}: {error}") from error


def _read(cls, name, entry, known):
    keys = {f.name for f in dataclasses.fields(cls)} - set(known)
    if not isinstance(entry, dict) or set(entry) != keys:
        raise ParameterError(str(name), entry, "exactly " + ", ".join(sorted(keys)))
    return cls(**known, **entry)


class _Part(NamedTuple):
    """The safe or the unsafe part of an answer: its predicates, the class it leaves out, what is wrong in words."""

    predicates: List[Predicate]
    left_out: str = ""
    error: str = ""


class _Draws:
    """Uniform numbers in (0, 1) that depend on a seed, a key and a name, never on the order of the calls."""

    def __init__(self, seed: int, key):
        self._seed, self._key = seed, key

    def uniform(self, name: str) -> float:
        digest = hashlib.sha256(json.dumps([self._seed, self._key, name]).encode()).digest()
        return (int.from_bytes(digest[:8], "big") // 2**11 + 0.5) / 2**53

    def choose(self, name: str, candidates: Iterable[str]) -> str:
        """Return a candidate; it stays the same while it is among them, whichever others come or go after it."""
        return min(candidates, key=lambda candidate: (self.uniform(f"{name} {candidate}"), candidate))


def draw_latency_s(row: EmulatedRow, uniform: float) -> float:
    """Draw a latency from a log-normal distribution with the row's mean m and standard deviation s; it is never <= 0.

        sigma^2 = ln(1 + s^2 / m^2),   T = m exp(sigma z - sigma^2 / 2),   z = Phi^-1(uniform)

    Args:
        row: m and s.
        uniform: number in (0, 1).

    Returns:
        T [s].
    """
    variance = math.log1p((row.latency_std_s / row.latency_mean_s) ** 2)
    z = statistics.NormalDist().inv_cdf(uniform)
    return row.latency_mean_s * math.exp(math.sqrt(variance) * z - variance / 2.0)


class EmulatedReasoner(Reasoner):
    """States the true rules of what is seen; each part of an answer is wrong with the row's probability.

    The safe and the unsafe part fail independently of each other: the tables give no more than their rates. All rows
    draw from the same numbers, so that with one seed a better row is right wherever a worse one is.
    """

    forgets = True

    def __init__(
        self,
        predicates: Iterable[Predicate],
        row: EmulatedRow,
        correlation: str,
        seed: int,
        ontology: Ontology,
    ):
        """Keep the rules.

        Args:
            predicates: the true rules; precedence is applied.
            row: rates, kinds of error and latency.
            correlation: ``independent``: every image is a new draw; ``scene``: one draw decides as long as the same
                clusters of held instances are in view. The latency is drawn for every image either way.
            seed: of all draws.
            ontology: canonical names, and which classes are surfaces or form barriers.

        Raises:
            PredicateError: no rule at all, or a region that is safe and unsafe.
            ParameterError: another correlation.
        """
        if correlation not in CORRELATIONS:
            raise ParameterError("correlation", correlation, "one of " + ", ".join(CORRELATIONS))
        self.source = f"emulated-{row.name}"
        self._row, self._ontology = row, ontology
        self._correlation, self._seed = correlation, seed
        canonical = (dataclasses.replace(p, class_name=ontology.canonical(p.class_name)) for p in predicates)
        self._truth = Constraints(apply_precedence(canonical)).predicates
        if not self._truth:
            raise PredicateError(f"{self.source}: got no predicate, allowed at least one")

    def reason(self, evidence: Evidence) -> Answer:
        """Answer one evidence; the same evidence gets the same answer, whatever was asked before."""
        draws = _Draws(self._seed, self._key(evidence))
        latency_s = draw_latency_s(self._row, _Draws(self._seed, evidence.stamp_ns).uniform("latency"))
        latency_ns = round(latency_s * 1e9)
        if draws.uniform("malformed") < self._row.malformed_rate:
            return Answer(None, latency_ns, MALFORMED_CAUSE, f"{self.source}: sentences instead of JSON, emulated")
        seen = self._seen(evidence)
        stated = [p for p in self._truth if p.class_name in seen]
        parts = [self._safe_part(draws, stated), self._unsafe_part(draws, stated, seen, evidence)]
        predicates = apply_precedence([p for part in parts for p in part.predicates])
        classes = (seen - {part.left_out for part in parts}) | {p.class_name for p in predicates}
        words = f"No model answered: the true rules, with errors drawn at the rates of {self._row.name}."
        constraints = Constraints(
            predicates,
            tuple(sorted(classes)),
            " ".join([words, *(part.error for part in parts if part.error)]),
            self.source,
            evidence.stamp_ns,
            latency_ns,
        )
        return Answer(constraints, latency_ns)

    def _key(self, evidence):
        if self._correlation == "independent":
            return evidence.stamp_ns
        # The map numbers a cluster by its oldest member; an instance outside of all clusters has 0.
        return sorted({(self._canonical(i), i.cluster or i.id) for i in evidence.instances if i.in_view})

    def _canonical(self, instance):
        return self._ontology.canonical(instance.class_name)

    def _seen(self, evidence) -> FrozenSet[str]:
        in_view = [i.class_name for i in evidence.instances if i.in_view]
        return frozenset(self._ontology.canonical(name) for name in (*evidence.classes_seen, *in_view))

    def _unsafe_part(self, draws, stated: Sequence[Predicate], seen, evidence) -> _Part:
        unsafe = [p for p in stated if p.verdict == Verdict.UNSAFE]
        if draws.uniform("unsafe") < self._row.rate_of_readable(self._row.unsafe_rate):
            return _Part(unsafe)
        # What geometry alone keeps the robot out of comes last: its loss would change nothing.
        hazards = {p.class_name for p in unsafe if p.operator in _CONTEXTUAL} or {p.class_name for p in unsafe}
        ruled = {p.class_name for p in self._truth if p.operator in (Operator.AROUND, Operator.BETWEEN)}
        harmless = {name for name in seen - ruled if not self._ontology.look_up(name).is_surface}
        missed = draws.uniform("unsafe kind") < self._row.shares.unsafe_missed
        if hazards and (missed or not harmless):
            hazard = draws.choose("hazard", hazards)
            return _Part([p for p in unsafe if p.class_name != hazard], hazard, f"Wrong: {hazard} is left out.")
        if harmless:
            extra = self._over_cautious(draws.choose("harmless", harmless), evidence)
            return _Part([*unsafe, extra], error=f"Wrong: {extra.expression} is called unsafe.")
        return _Part(unsafe)

    def _over_cautious(self, name, evidence) -> Predicate:
        known = self._ontology.look_up(name)
        held = sum(self._canonical(i) == name for i in evidence.instances)
        if Category.SEMANTIC_BARRIER in known.categories and held >= 2:
            return Predicate(Operator.BETWEEN, name, Verdict.UNSAFE)
        return Predicate(Operator.AROUND, name, Verdict.UNSAFE, known.radius_m)

    def _safe_part(self, draws, stated: Sequence[Predicate]) -> _Part:
        safe = [p for p in stated if p.verdict == Verdict.SAFE]
        if not safe or draws.uniform("safe") < self._row.rate_of_readable(self._row.safe_rate):
            return _Part(safe)
        name = draws.choose("surface", {p.class_name for p in safe})
        others = [p for p in safe if p.class_name != name]
        if draws.uniform("safe kind") < self._row.shares.safe_missed:
            return _Part(others, name, f"Wrong: {name} is left out.")
        flipped = [dataclasses.replace(p, verdict=Verdict.UNSAFE) for p in safe if p.class_name == name]
        return _Part([*others, *flipped], error=f"Wrong: {flipped[0].expression} is called unsafe.")

# SPDX-License-Identifier: BSD-3-Clause
"""Reasoners whose rules do not depend on what they see: ``oracle`` (true), ``static`` (written before), ``none``."""

from __future__ import annotations

from dataclasses import replace
from typing import Iterable

from core_perception.exceptions import PerceptionError, PredicateError
from core_perception.predicates import Constraints, Predicate, apply_precedence, parse_predicate
from core_perception.reasoners.base import Answer, Evidence, Reasoner
from core_perception.yaml_file import read_yaml


class FixedReasoner(Reasoner):
    """States the same predicates for every frame.

    Source: [CORE] experimental results, baselines Oracle and No Context.
    """

    reads_evidence = False

    def __init__(self, source: str, predicates: Iterable[Predicate], justification: str):
        """Keep the rules.

        Args:
            source: ``oracle`` or ``static``.
            predicates: rules; precedence is applied.
            justification: where they come from, in words.

        Raises:
            PredicateError: no rule at all, or a region that is safe and unsafe.
        """
        self.source = source
        kept = apply_precedence(predicates)
        if not kept:
            raise PredicateError(f"{source}: got no predicate, allowed at least one")
        classes = tuple(dict.fromkeys(p.class_name for p in kept))
        self._constraints = Constraints(kept, classes, justification, source)

    def reason(self, evidence: Evidence) -> Answer:
        """Return the rules, stamped with the frame."""
        return Answer(replace(self._constraints, image_stamp_ns=evidence.stamp_ns))


class NoReasoner(Reasoner):
    """Nobody: says of every frame that there is no answer."""

    source = "none"
    reads_evidence = False

    def reason(self, evidence: Evidence) -> Answer:
        """Return constraints as before the first answer."""
        return Answer(Constraints(justification="There is no reasoner.", source=self.source))


def load_rules(path) -> FixedReasoner:
    """Read a rules file: a mapping with ``justification`` (text) and ``rules`` (list of statements, see predicates.py).

    Raises:
        PerceptionError: the file cannot be read or has other content; the message starts with the path.
    """
    data = read_yaml(path)
    try:
        if not isinstance(data, dict) or set(data) != {"justification", "rules"} or not isinstance(data["rules"], list):
            raise PredicateError("got other keys, allowed exactly justification (text) and rules (list)")
        justification = str(data["justification"])
        justification.encode("utf-8")  # half of a surrogate pair would fail later, in every message
        return FixedReasoner("static", [parse_predicate(rule) for rule in data["rules"]], justification)
    except ValueError as error:
        raise PerceptionError(f"{path}: {' '.join(str(error).split())}") from error

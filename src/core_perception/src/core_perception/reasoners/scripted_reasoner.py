# SPDX-License-Identifier: BSD-3-Clause
"""A stand-in for a model that is wrong in a known way: it says what it was told to say, whatever it sees."""

from __future__ import annotations

from typing import Iterable

from core_perception.exceptions import PredicateError
from core_perception.predicates import Constraints, Predicate, apply_precedence
from core_perception.reasoners.base import Answer, Evidence, Reasoner


class ScriptedReasoner(Reasoner):
    """States the same predicates about every picture, as late as a model would.

    Unlike a fixed reasoner it is treated as a model: the constraint memory holds its answers, the embedded rules hold
    besides, and the next question follows on the last answer. No model is asked, and nothing it says is called one's.
    """

    source = "scripted"
    forgets = True
    is_guarded = True

    def __init__(self, predicates: Iterable[Predicate], latency_s: float):
        """Keep what is to be said.

        Args:
            predicates: precedence is applied.
            latency_s: declared sim latency of every answer [s], > 0.

        Raises:
            PredicateError: no predicate at all, or a region that is safe and unsafe.
        """
        self._predicates = apply_precedence(predicates)
        if not self._predicates:
            raise PredicateError("scripted: got no predicate, allowed at least one")
        self._latency_ns = round(latency_s * 1e9)

    def reason(self, evidence: Evidence) -> Answer:
        """Return the predicates, stamped with the frame."""
        classes = tuple(dict.fromkeys(p.class_name for p in self._predicates))
        words = "No model answered: predicates written beforehand."
        stated = Constraints(self._predicates, classes, words, self.source, evidence.stamp_ns, self._latency_ns)
        return Answer(stated, self._latency_ns)

# SPDX-License-Identifier: BSD-3-Clause
"""One call of a reasoner under way, and what has come of all calls so far."""

from __future__ import annotations

import threading
import time
from collections import Counter
from dataclasses import replace
from typing import Optional

from core_perception.constraint_memory import ConstraintMemory
from core_perception.predicates import Constraints
from core_perception.reasoners.base import Answer, Evidence, Reasoner


class Asking:
    """A reasoner's work on one evidence; that of a slow one goes on in a thread of its own."""

    def __init__(self, reasoner: Reasoner, evidence: Evidence, after: Optional[Asking] = None):
        """Begin.

        Args:
            reasoner: it serves one call at a time.
            evidence: what it is asked about.
            after: an earlier call nobody waits for any more, which must end first.
        """
        self.evidence = evidence
        self._reasoner, self._after = reasoner, after
        self._ended = threading.Event()
        self._begun_ns = time.monotonic_ns()
        self._answer: Optional[Answer] = None
        if reasoner.is_slow:
            threading.Thread(target=self._run, name="reasoner", daemon=True).start()
        else:
            self._answer = self._ask()
            self._ended.set()

    @property
    def answer(self) -> Optional[Answer]:
        """The answer, None while there is none."""
        return self._answer

    @property
    def latency_floor_ns(self) -> int:
        """Wall time since the beginning [ns]: an answer that has not come takes at least that long."""
        return time.monotonic_ns() - self._begun_ns

    def _run(self):
        if self._after is not None:
            self._after._ended.wait()
            self._after = None
        self._answer = self._ask()
        self._ended.set()

    def _ask(self) -> Answer:
        try:
            return self._reasoner.reason(self.evidence)
        except Exception as error:  # a fault of ours must leave the robot with what is held, and be told
            return Answer(None, None, "internal_error", f"{type(error).__name__}: {error}")


class Findings:
    """What the answers so far amount to, and a count of how they went."""

    def __init__(self, reasoner: Reasoner, memory: Optional[ConstraintMemory] = None):
        """Start with nothing.

        Args:
            reasoner: gives the answers.
            memory: holds what earlier answers said, for a reasoner that forgets; None: each answer replaces the last.
        """
        self._source = reasoner.source
        self._memory = memory if reasoner.forgets else None
        self.counts: Counter = Counter()
        self.failures_in_row = 0
        self.last_failure = ""
        self._constraints = Constraints(source=self._source)

    @property
    def constraints(self) -> Constraints:
        """What is stated now; without predicates and image stamp while nothing has been answered."""
        return self._constraints

    def forget(self) -> None:
        """Forget every answer, not the counts."""
        self._constraints = Constraints(source=self._source)
        if self._memory is not None:
            self._memory.reset()

    def take(self, answer: Answer, evidence: Evidence, latency_ns: int) -> None:
        """Take in an answer; a void one changes nothing but the counts."""
        if answer.constraints is None:
            self.counts[f"void_{answer.void_cause}"] += 1
            self.failures_in_row += 1
            self.last_failure = answer.detail
            return
        self.counts["answers"] += 1
        self.failures_in_row = 0
        stated = replace(answer.constraints, latency_ns=latency_ns)
        self._constraints = stated if self._memory is None else self._memory.add(stated, evidence)

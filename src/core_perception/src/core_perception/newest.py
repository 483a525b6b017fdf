# SPDX-License-Identifier: BSD-3-Clause
"""The answer to the newest evidence, for a reasoner that runs at its own rate."""

from __future__ import annotations

import dataclasses
from typing import Optional

from core_perception.predicates import Constraints
from core_perception.reasoners.base import Evidence, Reasoner


class NewestAnswer:
    """Reasons once per evidence, states the answer as often as asked; image_stamp_ns tells the age of the evidence."""

    def __init__(self, reasoner: Reasoner):
        """Start without evidence."""
        self._reasoner = reasoner
        self._evidence: Optional[Evidence] = None
        self._answer: Optional[Constraints] = None

    def add_evidence(self, evidence: Evidence) -> None:
        """Take in the evidence of a frame; a stamp that goes back resets the reasoner."""
        newest = self._answer.image_stamp_ns if self._answer else None
        if newest is not None and evidence.stamp_ns < newest:
            self._reasoner.reset()
            self._answer = None
        self._evidence = evidence

    def at(self, now_ns: int) -> Constraints:
        """Return the constraints to state at now_ns; without predicates and image stamp while nothing has been seen."""
        if not self._reasoner.reads_evidence:
            return self._reasoner.reason(Evidence(now_ns))
        if self._evidence is not None:
            evidence, self._evidence = self._evidence, None
            answer = self._reasoner.reason(evidence)
            self._answer = dataclasses.replace(answer, latency_ns=max(0, now_ns - evidence.stamp_ns))
        return self._answer or Constraints(source=self._reasoner.source)

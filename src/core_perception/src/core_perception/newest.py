# SPDX-License-Identifier: BSD-3-Clause
"""The answer to the newest evidence, for a reasoner that runs at its own rate."""

from __future__ import annotations

import time
from typing import Optional

from core_perception.asking import Asking, Findings
from core_perception.predicates import Constraints
from core_perception.reasoners.base import Evidence, Reasoner

# Stamps of a camera may stumble by less than this; a clock that was set back, or a world that began anew, goes farther.
STUMBLE_NS = 1_000_000_000


class NewestAnswer:
    """Asks about the newest evidence, one question at a time; image_stamp_ns tells the age of what is stated.

    An answer that is there at once but has a latency, drawn or recorded, holds from image stamp + latency on.
    """

    def __init__(self, reasoner: Reasoner, findings: Findings):
        """Start without evidence.

        Args:
            reasoner: gives the answers.
            findings: collects them.
        """
        self._reasoner, self._findings = reasoner, findings
        self._evidence: Optional[Evidence] = None
        self._asking: Optional[Asking] = None
        self._newest_ns: Optional[int] = None
        self._discarded: Optional[Asking] = None  # nobody waits for its answer
        self._pause_until_s = 0.0  # monotonic

    def forget_answers(self) -> None:
        """Forget what was answered; the answer under way will not be taken in."""
        self._reasoner.reset()
        self._findings.forget()
        self._evidence = None
        self._discarded, self._asking = self._asking or self._discarded, None

    def add_evidence(self, evidence: Evidence) -> None:
        """Take in the evidence of a frame; a stamp that goes back forgets what was answered, if by a second or more.

        One that goes back by less is left out: hazards out of view must not be lost by a frame that came late.
        """
        if self._newest_ns is not None and evidence.stamp_ns < self._newest_ns:
            if evidence.stamp_ns > self._newest_ns - STUMBLE_NS:
                return
            self.forget_answers()
        self._newest_ns = evidence.stamp_ns
        self._evidence = evidence

    def at(self, now_ns: int) -> Constraints:
        """Return the constraints to state at now_ns; without predicates and image stamp while nothing was answered."""
        if not self._reasoner.reads_evidence:
            self._findings.take(self._reasoner.reason(Evidence(now_ns)), Evidence(now_ns), 0)
            return self._findings.constraints
        self._collect(now_ns)
        if self._asking is None and self._evidence is not None and time.monotonic() >= self._pause_until_s:
            self._asking, self._evidence = Asking(self._reasoner, self._evidence, self._discarded), None
            self._collect(now_ns)
        return self._findings.constraints

    def _collect(self, now_ns):
        if self._asking is None or self._asking.answer is None:
            return
        asking, answer = self._asking, self._asking.answer
        if not self._reasoner.is_slow and now_ns < asking.evidence.stamp_ns + (answer.latency_ns or 0):
            return
        self._asking = None
        self._pause_until_s = time.monotonic() + answer.retry_after_ns * 1e-9
        self._findings.take(answer, asking.evidence, max(0, now_ns - asking.evidence.stamp_ns))

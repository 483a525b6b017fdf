# SPDX-License-Identifier: BSD-3-Clause
"""When a reasoner's answers come into force in a lock-step world: at image stamp + declared latency, in sim time."""

from __future__ import annotations

from typing import Dict, List, Optional, Tuple

from core_perception.predicates import Constraints
from core_perception.reasoners.base import Evidence, Reasoner

# Stamps made from floating-point seconds may lie a nanosecond beside the exact multiple of a period.
STAMP_SLACK_NS = 1000


class ReleaseSchedule:
    """One statement per camera frame, the same however long the wall clock took.

    For a frame f the statement holds the newest answer whose evidence g has g + latency <= f; it waits until the
    evidence of every earlier frame g with g + latency <= f has been answered. As latency > 0, none waits for itself.
    Fixed rules (a reasoner that reads no evidence) hold from f itself on.
    """

    def __init__(self, reasoner: Reasoner, latency_ns: int):
        """Start with no frame.

        Args:
            reasoner: gives the answers.
            latency_ns: declared latency [ns], > 0.

        Raises:
            ValueError: a latency that is not positive; the first frame would wait for itself.
        """
        if latency_ns <= 0:
            raise ValueError(f"latency_ns: got {latency_ns}, allowed > 0")
        self._reasoner, self._latency_ns = reasoner, latency_ns
        self._forget()

    def _forget(self):
        self._newest_frame_ns: Optional[int] = None
        self._unstated: List[int] = []  # frames without a statement
        self._unanswered: List[int] = []  # frames whose evidence has not been answered
        self._evidence: Dict[int, Evidence] = {}
        self._answers: List[Constraints] = []

    def add_frame(self, stamp_ns: int) -> None:
        """Learn of a frame; a known one is ignored, one that goes back empties everything and resets the reasoner."""
        if stamp_ns == self._newest_frame_ns:
            return
        if self._newest_frame_ns is not None and stamp_ns < self._newest_frame_ns:
            self._forget()
            self._reasoner.reset()
        self._newest_frame_ns = stamp_ns
        self._unstated.append(stamp_ns)
        if self._reasoner.reads_evidence:
            self._unanswered.append(stamp_ns)

    def add_evidence(self, evidence: Evidence) -> None:
        """Take in the evidence of a frame; frames that are answered or unknown are ignored."""
        if evidence.stamp_ns in self._unanswered:
            self._evidence[evidence.stamp_ns] = evidence

    def poll(self) -> List[Tuple[int, Constraints]]:
        """Return the statements that have become due, oldest first: stamp each holds from [ns], constraints."""
        statements = []
        while self._unstated and self._answer_until(self._unstated[0] - self._latency_ns + STAMP_SLACK_NS):
            frame_ns = self._unstated.pop(0)
            statements.append((frame_ns, self._statement(frame_ns)))
        return statements

    def _answer_until(self, limit_ns):
        """Answer the evidence of frames up to limit_ns in their order; False if some of it has not come."""
        while self._unanswered and self._unanswered[0] <= limit_ns:
            evidence = self._evidence.pop(self._unanswered[0], None)
            if evidence is None:
                return False
            self._unanswered.pop(0)
            self._answers = [*self._answers, self._reasoner.reason(evidence)]
        return True

    def _statement(self, frame_ns):
        if not self._reasoner.reads_evidence:
            return self._reasoner.reason(Evidence(frame_ns))
        if not self._answers:
            return Constraints(source=self._reasoner.source)
        # Every answer here has become due by now, and none is due before an older one.
        self._answers = self._answers[-1:]
        answer = self._answers[0]
        return Constraints(
            answer.predicates,
            answer.classes,
            answer.justification,
            answer.source,
            answer.image_stamp_ns,
            self._latency_ns,
            answer.confidence,
        )

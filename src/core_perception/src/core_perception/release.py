# SPDX-License-Identifier: BSD-3-Clause
"""When a reasoner's answers come into force in a lock-step world: at image stamp + latency, in sim time."""

from __future__ import annotations

from typing import Dict, List, Optional, Tuple

from core_perception.asking import Asking, Findings
from core_perception.predicates import Constraints
from core_perception.reasoners.base import Evidence, Reasoner

# Stamps made from floating-point seconds may lie a nanosecond beside the exact multiple of a period.
STAMP_SLACK_NS = 1000
# Wall time within which an answer that a client has measured reaches this schedule, on busy cores too: a later one
# would come into force later than in a replay. It costs no time: frames that waited follow at once on the answer.
HANDLING_NS = 500_000_000


class ReleaseSchedule:
    """One statement per camera frame, the same however long the wall clock took.

    One question is under way at a time: the first frame g at or after the end of the last question is asked about, and
    frames between are not. Its answer holds from the first frame f >= g + latency on; then the next question follows,
    or after the pause the answer asks for. The latency is the declared one, or the answer's own. While a slow reasoner
    works, frames that its answer cannot reach any more (f < g + wall time spent) go on with what was known before, so
    that the world runs no faster than real time until it comes. Fixed rules (a reasoner that reads no evidence) hold
    from f itself on.
    """

    def __init__(self, reasoner: Reasoner, latency_ns: int, findings: Findings):
        """Start with no frame.

        Args:
            reasoner: gives the answers.
            latency_ns: declared latency [ns], > 0.
            findings: collects them.

        Raises:
            ValueError: a latency that is not positive; the first frame would wait for itself.
        """
        if latency_ns <= 0:
            raise ValueError(f"latency_ns: got {latency_ns}, allowed > 0")
        self._reasoner, self._latency_ns, self._findings = reasoner, latency_ns, findings
        self._asking: Optional[Asking] = None
        self._discarded: Optional[Asking] = None  # nobody waits for its answer
        self._forget_frames()

    def _forget_frames(self):
        self._newest_frame_ns: Optional[int] = None
        self._unstated: List[int] = []  # frames without a statement
        self._unasked: List[int] = []  # frames that may yet be asked about
        self._evidence: Dict[int, Evidence] = {}
        self._free_from_ns: Optional[int] = None  # when the next question may begin

    def forget_answers(self) -> None:
        """Forget what was answered and the question under way; frames go on."""
        self._discarded, self._asking = self._asking or self._discarded, None
        self._findings.forget()
        self._reasoner.reset()

    def add_frame(self, stamp_ns: int) -> None:
        """Learn of a frame; a known one is ignored, one that goes back empties everything and resets the reasoner."""
        if stamp_ns == self._newest_frame_ns:
            return
        if self._newest_frame_ns is not None and stamp_ns < self._newest_frame_ns:
            self.forget_answers()
            self._forget_frames()
        self._newest_frame_ns = stamp_ns
        self._unstated.append(stamp_ns)
        if self._reasoner.reads_evidence:
            self._unasked.append(stamp_ns)

    def add_evidence(self, evidence: Evidence) -> None:
        """Take in the evidence of a frame; frames that are past or unknown are ignored."""
        if evidence.stamp_ns in self._unasked:
            self._evidence[evidence.stamp_ns] = evidence

    def poll(self) -> List[Tuple[int, Constraints]]:
        """Return the statements that have become due, oldest first: stamp each holds from [ns], constraints."""
        statements = []
        while self._unstated and self._settle(self._unstated[0]):
            frame_ns = self._unstated.pop(0)
            statements.append((frame_ns, self._statement(frame_ns)))
        if self._newest_frame_ns is not None:
            self._ask_next(self._newest_frame_ns)
        return statements

    def _settle(self, frame_ns) -> bool:
        """Take in every answer that is due by a frame; False while one of them may still come."""
        while self._asking is not None or self._ask_next(frame_ns - 1):
            asking = self._asking
            if asking is None:
                return False  # its evidence has not come
            asked_ns, answer = asking.evidence.stamp_ns, asking.answer
            if answer is None:
                if asked_ns + asking.latency_floor_ns <= frame_ns + HANDLING_NS:
                    return False
                self._drop(lambda stamp_ns: stamp_ns <= frame_ns)  # nor will it be asked about: free its image
                return True
            latency_ns = self._latency_ns if answer.latency_ns is None else answer.latency_ns
            if asked_ns + latency_ns > frame_ns + STAMP_SLACK_NS:
                return True
            self._findings.take(answer, asking.evidence, latency_ns)
            # An answer that took no time would be asked about the same frame for ever.
            self._free_from_ns = asked_ns + max(1, latency_ns) + answer.retry_after_ns
            self._asking = None
        return True

    def _ask_next(self, limit_ns) -> bool:
        """Begin the next question if none is under way and its frame is at or before limit_ns; True if there is one."""
        if self._asking is not None:
            return True
        free_from_ns = self._free_from_ns
        if free_from_ns is not None:
            self._drop(lambda stamp_ns: stamp_ns + STAMP_SLACK_NS < free_from_ns)
        if not self._unasked or self._unasked[0] > limit_ns:
            return False
        evidence = self._evidence.get(self._unasked[0])
        if evidence is not None:
            self._asking = Asking(self._reasoner, evidence, self._discarded)
            self._drop(lambda stamp_ns: stamp_ns <= evidence.stamp_ns)
        return True

    def _drop(self, is_past):
        self._unasked = [stamp_ns for stamp_ns in self._unasked if not is_past(stamp_ns)]
        self._evidence = {stamp_ns: e for stamp_ns, e in self._evidence.items() if not is_past(stamp_ns)}

    def _statement(self, frame_ns):
        if not self._reasoner.reads_evidence:
            self._findings.take(self._reasoner.reason(Evidence(frame_ns)), Evidence(frame_ns), 0)
        return self._findings.constraints

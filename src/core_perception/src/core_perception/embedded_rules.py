# SPDX-License-Identifier: BSD-3-Clause
"""The embedded rules under a model: what the ontology calls unsafe holds besides whatever a model says.

A model that misses a hazard, or is talked into missing it, then takes nothing away: it can add hazards and it decides
which listed surfaces are safe. Differs from [CORE], whose failures were hazards that its model did not name.
"""

from __future__ import annotations

from dataclasses import replace
from typing import List, Tuple

from core_perception.predicates import Constraints, Predicate, Verdict
from core_perception.reasoners.base import Evidence


def add_embedded(model: Constraints, embedded: Constraints) -> Constraints:
    """Return the model's statement with the unsafe predicates of the embedded rules in it.

    Before the model has named ground to stand on nothing is added: it stays recognisable that the robot waits. An
    instance is exempt from a predicate that both state when both exempt it. Age and latency are the model's: its
    silence stops the robot.

    Args:
        model: what is in force by the model's answers.
        embedded: what the ontology states of the newest frame it has answered.
    """
    if model.image_stamp_ns is None:
        return model
    unsafe = [p for p in embedded.predicates if p.verdict == Verdict.UNSAFE]
    # In the memory of a model's answers only what the ontology lists as navigable is safe; it never calls that unsafe.
    regions = {(p.operator, p.class_name) for p in unsafe}
    kept = [p for p in model.predicates if p.verdict == Verdict.UNSAFE or (p.operator, p.class_name) not in regions]
    exempt = {p: _exempt(p, model, embedded, p in kept, p in unsafe) for p in (*kept, *unsafe)}
    exempt = {p: ids for p, ids in exempt.items() if ids}
    histories = {c.instances_history_start_ns for c in (model, embedded) if c.exempt}
    if len(histories) > 1:  # numbers of two maps say nothing about each other
        exempt, histories = {}, set()
    return replace(
        model,
        predicates=tuple(dict.fromkeys((*kept, *unsafe))),
        justification=f"{model.justification} Embedded rules: {embedded.justification}".strip(),
        source=f"{model.source}+{embedded.source}",
        exempt=exempt,
        instances_history_start_ns=histories.pop() if exempt else None,
    )


def _exempt(p: Predicate, model: Constraints, embedded: Constraints, by_model: bool, by_rules: bool) -> Tuple[int, ...]:
    spared = [set(c.exempt.get(p, ())) for c, states in ((model, by_model), (embedded, by_rules)) if states]
    return tuple(sorted(set.intersection(*spared)))


class GuardedSchedule:
    """Two schedules of one lock-step world, the model's and that of the embedded rules, as one."""

    def __init__(self, model, embedded):
        """Join two ReleaseSchedules."""
        self._both = (model, embedded)
        self._forget()

    def _forget(self):
        self._waiting: Tuple[List, List] = ([], [])
        self._newest_frame_ns = None

    def forget_answers(self) -> None:
        """As ReleaseSchedule, for both."""
        for schedule in self._both:
            schedule.forget_answers()

    def add_frame(self, stamp_ns: int) -> None:
        """As ReleaseSchedule, for both."""
        if self._newest_frame_ns is not None and stamp_ns < self._newest_frame_ns:
            self._forget()
        self._newest_frame_ns = stamp_ns
        for schedule in self._both:
            schedule.add_frame(stamp_ns)

    def add_evidence(self, evidence: Evidence) -> None:
        """As ReleaseSchedule, for both."""
        for schedule in self._both:
            schedule.add_evidence(evidence)

    def poll(self) -> List[Tuple[int, Constraints]]:
        """Return the frames for which both have stated something, oldest first."""
        for waiting, schedule in zip(self._waiting, self._both):
            waiting.extend(schedule.poll())
        count = min(map(len, self._waiting))
        pairs = list(zip(*(waiting[:count] for waiting in self._waiting)))
        for waiting in self._waiting:
            del waiting[:count]
        return [(stamp_ns, add_embedded(model, embedded)) for (stamp_ns, model), (_, embedded) in pairs]


class GuardedAnswer:
    """Two newest answers, the model's and that of the embedded rules, as one."""

    def __init__(self, model, embedded):
        """Join two NewestAnswers."""
        self._both = (model, embedded)

    def forget_answers(self) -> None:
        """As NewestAnswer, for both."""
        for newest in self._both:
            newest.forget_answers()

    def add_evidence(self, evidence: Evidence) -> None:
        """As NewestAnswer, for both."""
        for newest in self._both:
            newest.add_evidence(evidence)

    def at(self, now_ns: int) -> Constraints:
        """As NewestAnswer, of both together."""
        return add_embedded(*(newest.at(now_ns) for newest in self._both))

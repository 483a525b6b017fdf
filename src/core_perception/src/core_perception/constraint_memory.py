# SPDX-License-Identifier: BSD-3-Clause
"""Holds what the replies of a forgetful reasoner said: unsafe at once, no longer unsafe after several that looked.

With M = clear_after_replies, k of n = surface_votes. A reply *covers* a held predicate when it states the same operator
and class with at least its radius and at least its severity. "In a row" is over the replies that saw the thing in
question; one that did not see it counts neither way, unless it covers, which starts the row anew.

    unsafe NEAR, AROUND, BETWEEN of an object
        in force from the first reply that states it, for every instance of the class, seen or not yet seen;
        a held instance becomes exempt after M replies in a row that had it in view and did not cover, and is no longer
        exempt once a reply covers while it is in view;
        leaves after M replies in a row that saw the class, or knew no instance of it, and did not cover, when no held
        instance is left that is not exempt
    unsafe ON, and any unsafe predicate of a navigable surface (one hallucinated NEAR(floor) must not freeze the robot)
        in force when k of the last n replies cover it, or when it lies within what is in force; leaves after M replies
        in a row that saw the class and did not cover
    safe ON
        for classes the ontology lists as navigable, from the first reply that says so until the class is in force as
        unsafe, and again once that has left and a reply says so
        before any reply has named such a surface the statement has no image stamp, as before the first answer: the
        robot stands, and nothing is voted unsafe for want of a word (cells that it loses sight of would stay so)
    safe NEAR, AROUND, BETWEEN
        never stated; a safe BETWEEN is one reply that does not cover, no more

Source: DESIGN section 4, rows 4 and 12. [CORE] replaces the constraints with each reply; its failures were hazards that
    one reply missed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Dict, FrozenSet, Iterable, List, Optional, Set, Tuple

from core_perception.ontology import Ontology
from core_perception.predicates import Constraints, Operator, Predicate, Verdict
from core_perception.reasoners.base import Evidence

MAX_ENTRIES = 256
RADIUS_STEPS_PER_M = 10
FALLBACK_RADIUS_M = 1.0


@dataclass
class _Entry:
    """What is known of an unsafe predicate in force.

    Attributes:
        covered_at: number of the last reply that covered it.
        misses: replies in a row that could have covered it and did not.
        misses_of: the same for each held instance of its class, over the replies that had it in view; exempt from M on.
            Surfaces have no instances.
    """

    covered_at: int = 0
    misses: int = 0
    misses_of: Dict[int, int] = field(default_factory=dict)


@dataclass(frozen=True)
class _View:
    """What one reply's evidence shows, by canonical class name.

    Attributes:
        seen: classes in the frame.
        held: numbers of the instances held.
        in_view: those of them that the frame saw.
        knows_map: the list of instances is that of a map.
        counts_by_map: the numbers can be told from those of another map.
    """

    seen: FrozenSet[str]
    held: Dict[str, Set[int]]
    in_view: Dict[str, Set[int]]
    knows_map: bool
    counts_by_map: bool


class ConstraintMemory:
    """The rules of the module's docstring, for one robot; replies come in the order of their images."""

    def __init__(self, ontology: Ontology, clear_after_replies: int = 3, surface_votes: Tuple[int, int] = (2, 3)):
        """Start with nothing held.

        Args:
            ontology: canonical names, default radii, and which classes are navigable.
            clear_after_replies: M, >= 1.
            surface_votes: k of n replies, 1 <= k <= n.

        Raises:
            ValueError: a number out of range.
        """
        if clear_after_replies < 1:
            raise ValueError(f"clear_after_replies: got {clear_after_replies}, allowed >= 1")
        if not 1 <= surface_votes[0] <= surface_votes[1]:
            raise ValueError(f"surface_votes: got {tuple(surface_votes)}, allowed 1 <= first <= second")
        self._ontology, self._clear_after = ontology, clear_after_replies
        self._votes_needed, self._votes_kept = surface_votes
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._objects: Dict[Predicate, _Entry] = {}
        self._surfaces: Dict[Predicate, _Entry] = {}
        self._surface_statements: List[List[Predicate]] = []
        self._safe: Set[str] = set()
        self._has_named_ground = False
        self._replies = 0
        self._history_start_ns: Optional[int] = None
        self._map_was_known = False

    def add(self, reply: Constraints, evidence: Evidence) -> Constraints:
        """Take in a reply and return what is in force after it.

        Args:
            reply: what a reasoner made of one image.
            evidence: what the segmenter and the map knew at that image.

        Returns:
            The reply with its predicates replaced by those in force, ordered by class, operator, verdict, severity and
            radius, and with the instances each is not about. A radius is the one stated, rounded up to 0.1 m, or that
            of the ontology; None where neither gives one.
        """
        self._replies += 1
        view = self._look(evidence)
        stated = [self._normal(p) for p in reply.predicates if p.verdict == Verdict.UNSAFE]
        self._update_objects([p for p in stated if not self._is_surface_statement(p)], view)
        named = view.seen.union(self._ontology.canonical(name) for name in reply.classes)
        self._update_surfaces([p for p in stated if self._is_surface_statement(p)], named)
        self._update_safe(reply.predicates)
        self._drop_surplus(view)
        return self._state(reply)

    def _look(self, evidence: Evidence) -> _View:
        if evidence.history_start_ns != self._history_start_ns:
            self._history_start_ns = evidence.history_start_ns
            for entry in self._objects.values():
                entry.misses_of.clear()
        counts_by_map = evidence.history_start_ns is not None
        self._map_was_known = self._map_was_known or counts_by_map
        held: Dict[str, Set[int]] = {}
        in_view: Dict[str, Set[int]] = {}
        for instance in evidence.instances:
            name = self._ontology.canonical(instance.class_name)
            held.setdefault(name, set()).add(instance.id)
            if instance.in_view:
                in_view.setdefault(name, set()).add(instance.id)
        seen = frozenset(self._ontology.canonical(name) for name in evidence.classes_seen).union(in_view)
        return _View(seen, held, in_view, counts_by_map or not self._map_was_known, counts_by_map)

    def _normal(self, stated: Predicate) -> Predicate:
        """The key of what is stated: canonical class, radius of the ontology where none is given, steps of 0.1 m."""
        name = self._ontology.canonical(stated.class_name)
        radius_m = stated.radius_m
        if stated.operator == Operator.AROUND:
            radius_m = self._ontology.look_up(name).radius_m if radius_m is None else radius_m
            radius_m = None if radius_m is None else _round_up(radius_m)
        return replace(stated, class_name=name, radius_m=radius_m)

    def _is_surface_statement(self, predicate: Predicate) -> bool:
        return predicate.operator == Operator.ON or self._is_navigable(predicate.class_name)

    def _is_navigable(self, name: str) -> bool:
        return self._ontology.look_up(name).is_navigable

    def _update_objects(self, stated: List[Predicate], view: _View):
        for predicate in stated:
            self._objects.setdefault(predicate, _Entry())
        for predicate, entry in list(self._objects.items()):
            covered = _cover(stated, predicate)
            held = view.held.get(predicate.class_name, set())
            in_view = view.in_view.get(predicate.class_name, set())
            if view.counts_by_map:
                entry.misses_of = {i: self._misses(entry.misses_of.get(i, 0), covered, i in in_view) for i in held}
            if covered:
                entry.covered_at, entry.misses = self._replies, 0
            elif view.knows_map:
                entry.misses += not held or predicate.class_name in view.seen
                if entry.misses >= self._clear_after and held <= self._exempt(entry):
                    del self._objects[predicate]

    def _misses(self, misses: int, covered: bool, in_view: bool) -> int:
        if not covered:
            return misses + in_view
        return misses if misses >= self._clear_after and not in_view else 0

    def _exempt(self, entry: _Entry) -> Set[int]:
        return {i for i, misses in entry.misses_of.items() if misses >= self._clear_after}

    def _update_surfaces(self, stated: List[Predicate], seen: FrozenSet[str]):
        self._surface_statements = [*self._surface_statements, stated][-self._votes_kept :]
        before = list(self._surfaces)
        for predicate in dict.fromkeys(p for one in self._surface_statements for p in one):
            votes = [_cover(one, predicate) for one in self._surface_statements]
            # What lies within something in force needs no votes, so that it can take the place of that.
            if votes[-1] and (sum(votes) >= self._votes_needed or _cover(before, predicate)):
                self._surfaces.setdefault(predicate, _Entry())
        for predicate, entry in list(self._surfaces.items()):
            if _cover(stated, predicate):
                entry.covered_at, entry.misses = self._replies, 0
            else:
                entry.misses += predicate.class_name in seen
                if entry.misses >= self._clear_after:
                    del self._surfaces[predicate]

    def _update_safe(self, predicates: Iterable[Predicate]):
        said = {verdict: set() for verdict in Verdict}
        for predicate in predicates:
            if predicate.operator == Operator.ON or predicate.verdict == Verdict.UNSAFE:
                said[predicate.verdict].add(self._ontology.canonical(predicate.class_name))
        # A reply that calls a class unsafe in any way does not make it safe.
        self._safe |= {name for name in said[Verdict.SAFE] - said[Verdict.UNSAFE] if self._is_navigable(name)}
        self._safe -= {p.class_name for p in self._surfaces}
        self._has_named_ground = self._has_named_ground or bool(self._safe)

    def _drop_surplus(self, view: _View):
        """Keep the number of entries bounded: what was covered longest ago goes, a class that is held or seen never."""
        entries = {**self._objects, **self._surfaces}
        idle = [p for p in entries if p.class_name not in view.held and p.class_name not in view.seen]
        idle.sort(key=lambda p: (entries[p].covered_at, _order(p)))
        for predicate in idle[: max(0, len(entries) - MAX_ENTRIES)]:
            self._objects.pop(predicate, None)
            self._surfaces.pop(predicate, None)

    def _state(self, reply: Constraints) -> Constraints:
        unsafe = [*self._objects, *self._surfaces]
        safe = [Predicate(Operator.ON, name, Verdict.SAFE) for name in self._safe]
        exempt = {p: tuple(sorted(self._exempt(entry))) for p, entry in self._objects.items() if self._exempt(entry)}
        return replace(
            reply,
            image_stamp_ns=reply.image_stamp_ns if self._has_named_ground else None,
            predicates=tuple(sorted((*unsafe, *safe), key=_order)),
            exempt=exempt,
            instances_history_start_ns=self._history_start_ns if exempt else None,
        )


def _round_up(radius_m: float) -> float:
    """The next multiple of 0.1 m that is not less."""
    return math.ceil(radius_m * RADIUS_STEPS_PER_M) / RADIUS_STEPS_PER_M


def _reach_m(predicate: Predicate) -> float:
    return FALLBACK_RADIUS_M if predicate.radius_m is None else predicate.radius_m


def _cover(stated: Iterable[Predicate], held: Predicate) -> bool:
    """One of them, all normal, has the operator and the class of what is held, at least its radius and severity."""
    return any(
        (p.operator, p.class_name) == (held.operator, held.class_name)
        and _reach_m(p) >= _reach_m(held)
        and p.severity <= held.severity
        for p in stated
    )


def _order(p: Predicate) -> tuple:
    return (p.class_name, p.operator, p.verdict, p.severity, _reach_m(p), p.radius_m is None)

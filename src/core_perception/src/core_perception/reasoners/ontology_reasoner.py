# SPDX-License-Identifier: BSD-3-Clause
"""The embedded reasoner: class names and where things stand -> constraints, by an explicit list and plane geometry.

It reproduces the rules of [CORE] for the operators, not its reasoning: it knows no situation beyond the arrangement of
things. Per class, by category:

    navigable surface       ON safe
    non-navigable surface   ON unsafe
    metric obstacle         NEAR unsafe
    hazard indicator        NEAR, AROUND unsafe
    social zone             NEAR, AROUND unsafe
    semantic barrier        NEAR unsafe; BETWEEN unsafe where an arrangement blocks, and then BETWEEN replaces AROUND

BETWEEN speaks of the arrangements alone: the other instances of the class are exempt from it, and where they are
hazards or social zones too, AROUND stays for them.

Source: [CORE] contextual safety reasoning; appendix, VLM prompt. Differs: arrangements are judged on ground-plane
    positions of held instances, each for itself, and one that was found stays in force while two of its members are
    held.
"""

from __future__ import annotations

from typing import Dict, FrozenSet, List, Sequence, Tuple

import numpy as np

from core_perception.arrangement import LINK_M, Arrangement
from core_perception.ontology import Category, Ontology, OntologyClass
from core_perception.predicates import Constraints, Operator, Predicate, Verdict
from core_perception.reasoners.arrangement_memory import ArrangementMemory
from core_perception.reasoners.base import Answer, Evidence, HeldInstance, Reasoner
from core_perception.reasoners.justification import justify

REACHING = (Category.HAZARD_INDICATOR, Category.SOCIAL_ZONE)


class OntologyReasoner(Reasoner):
    """Applies the rules of the module's docstring to one frame after another."""

    source = "ontology"

    def __init__(self, ontology: Ontology, memory: bool = True, link_m: float = LINK_M, frames_of_three: int = 3):
        """Start with nothing seen.

        Args:
            ontology: the class list.
            memory: held instances count as seen, and a found arrangement stays in force; False uses the frame alone.
            link_m: single-link distance of an arrangement where the map gives no cluster [m].
            frames_of_three: answers in a row that must see an arrangement of only three instances.
        """
        self._ontology, self._memory = ontology, memory
        self._link_m, self._frames_of_three = link_m, frames_of_three
        self._arrangements: Dict[str, ArrangementMemory] = {}

    def reset(self) -> None:
        """Forget the arrangements."""
        self._arrangements.clear()

    def reason(self, evidence: Evidence) -> Answer:
        """State the constraints of one frame; predicates are ordered by class name, then operator.

        Exemptions are stated where the evidence says by which history of the map its instances are numbered.
        """
        instances = [i for i in evidence.instances if self._memory or i.in_view]
        members: Dict[str, List[HeldInstance]] = {}
        for instance in sorted(instances, key=lambda i: i.id):
            members.setdefault(self._ontology.canonical(instance.class_name), []).append(instance)
        names = {self._ontology.canonical(name) for name in evidence.classes_seen} | set(members)
        classes = [self._ontology.look_up(name) for name in sorted(names)]
        predicates: List[Predicate] = []
        shapes: Dict[str, List[Tuple[Arrangement, int]]] = {}
        exempt: Dict[Predicate, Tuple[int, ...]] = {}
        for known in classes:
            blocking: FrozenSet[int] = frozenset()
            held = frozenset(i.id for i in members.get(known.name, ()))
            if Category.SEMANTIC_BARRIER in known.categories:
                found = self._find_arrangements(known.name, members.get(known.name, []))
                shapes[known.name] = [(shape, len(ids)) for shape, ids in found]
                blocking = frozenset().union(*(ids for _, ids in found))
            stated = predicates_of(known, bool(blocking), bool(held - blocking))
            predicates += stated
            exempt.update(exemptions_of(stated, held, blocking))
        if evidence.history_start_ns is None:
            exempt = {}
        unlisted = any(not known.listed for known in classes)
        justification = justify(classes, shapes, self._ontology.wordnet_problem if unlisted else "")
        return Answer(
            Constraints(
                tuple(predicates),
                tuple(c.name for c in classes),
                justification,
                self.source,
                evidence.stamp_ns,
                exempt=exempt,
                instances_history_start_ns=evidence.history_start_ns if exempt else None,
            )
        )

    def _find_arrangements(self, name, members):
        if not self._memory:
            self._arrangements.pop(name, None)
        memory = self._arrangements.setdefault(
            name, ArrangementMemory(self._link_m, self._frames_of_three if self._memory else 1)
        )
        positions_m = np.array([i.position_m for i in members], dtype=float).reshape(-1, 2)
        return memory.update([i.id for i in members], positions_m, [i.cluster for i in members])


def predicates_of(known: OntologyClass, blocks: bool = False, others: bool = True) -> Tuple[Predicate, ...]:
    """Return the predicates of one class.

    Args:
        known: the class.
        blocks: some of its instances stand so that they close the way; only semantic barriers heed it.
        others: some of its instances are not among those, so that BETWEEN does not replace their AROUND.
    """
    name = known.name
    if known.is_surface:
        verdict = Verdict.SAFE if known.is_navigable else Verdict.UNSAFE
        return (Predicate(Operator.ON, name, verdict),)
    between = blocks and Category.SEMANTIC_BARRIER in known.categories
    predicates = [Predicate(Operator.NEAR, name, Verdict.UNSAFE)]
    if any(category in REACHING for category in known.categories) and (others or not between):
        predicates.append(Predicate(Operator.AROUND, name, Verdict.UNSAFE, known.radius_m))
    if between:
        predicates.append(Predicate(Operator.BETWEEN, name, Verdict.UNSAFE))
    return tuple(predicates)


def exemptions_of(
    predicates: Sequence[Predicate], held: FrozenSet[int], blocking: FrozenSet[int]
) -> Dict[Predicate, Tuple[int, ...]]:
    """Return which held instances of a class a predicate does not speak of, without predicates that speak of all.

    Args:
        predicates: of the class.
        held: numbers of all its instances.
        blocking: numbers of those that close the way, BETWEEN being stated if there are any.
    """
    spared = {Operator.BETWEEN: held - blocking, Operator.AROUND: blocking}
    return {p: tuple(sorted(spared[p.operator])) for p in predicates if spared.get(p.operator)}

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

Source: [CORE] contextual safety reasoning; appendix, VLM prompt. Differs: arrangements are judged on ground-plane
    positions of held
instances, and one that was found stays in force while two of its members are held.
"""

from __future__ import annotations

from typing import Dict, List, Tuple

import numpy as np

from core_perception.arrangement import LINK_M
from core_perception.ontology import Category, Ontology, OntologyClass
from core_perception.predicates import Constraints, Operator, Predicate, Verdict, apply_precedence
from core_perception.reasoners.arrangement_memory import ArrangementMemory
from core_perception.reasoners.base import Evidence, Reasoner
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

    def reason(self, evidence: Evidence) -> Constraints:
        """Return the constraints of one frame; predicates are ordered by class name, then operator."""
        instances = [i for i in evidence.instances if self._memory or i.in_view]
        names = {self._ontology.canonical(n) for n in (*evidence.classes_seen, *(i.class_name for i in instances))}
        classes = [self._ontology.look_up(name) for name in sorted(names)]
        blocked = {
            c.name: self._find_arrangements(c, instances) for c in classes if Category.SEMANTIC_BARRIER in c.categories
        }
        predicates: List[Predicate] = []
        for known in classes:
            predicates += predicates_of(known, bool(blocked.get(known.name)))
        kept = apply_precedence(predicates)
        shapes = {name: shape for name, shape in blocked.items() if shape}
        return Constraints(
            kept, tuple(c.name for c in classes), justify(classes, shapes), self.source, evidence.stamp_ns
        )

    def _find_arrangements(self, known, instances):
        members = [i for i in instances if self._ontology.canonical(i.class_name) == known.name]
        members.sort(key=lambda instance: instance.id)
        if not self._memory:
            self._arrangements.pop(known.name, None)
        memory = self._arrangements.setdefault(
            known.name, ArrangementMemory(self._link_m, self._frames_of_three if self._memory else 1)
        )
        positions_m = np.array([i.position_m for i in members], dtype=float).reshape(-1, 2)
        return memory.update([i.id for i in members], positions_m, [i.cluster for i in members])


def predicates_of(known: OntologyClass, blocks: bool) -> Tuple[Predicate, ...]:
    """Return the predicates of one class.

    Args:
        known: the class.
        blocks: its instances stand so that they close the way; only semantic barriers heed it.
    """
    name = known.name
    if known.is_surface:
        verdict = Verdict.SAFE if known.categories == (Category.NAVIGABLE_SURFACE,) else Verdict.UNSAFE
        return (Predicate(Operator.ON, name, verdict),)
    predicates = [Predicate(Operator.NEAR, name, Verdict.UNSAFE)]
    if any(category in REACHING for category in known.categories):
        predicates.append(Predicate(Operator.AROUND, name, Verdict.UNSAFE, known.radius_m))
    if blocks and Category.SEMANTIC_BARRIER in known.categories:
        predicates.append(Predicate(Operator.BETWEEN, name, Verdict.UNSAFE))
    return tuple(predicates)

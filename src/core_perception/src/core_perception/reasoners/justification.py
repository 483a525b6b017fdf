# SPDX-License-Identifier: BSD-3-Clause
"""The justification of the embedded reasoner, in sentences."""

from __future__ import annotations

from typing import Dict, Iterable, List, Sequence, Tuple

from core_perception.arrangement import Arrangement
from core_perception.ontology import Category, OntologyClass

SHAPE_WORDS = {
    Arrangement.LINE: "a line",
    Arrangement.ARC: "a curve",
    Arrangement.RING: "a closed perimeter",
    Arrangement.CORNER: "a corner",
}
CATEGORY_WORDS = (
    (Category.NAVIGABLE_SURFACE, "is a surface meant for travel", "are surfaces meant for travel"),
    (Category.NON_NAVIGABLE_SURFACE, "is not a surface to travel on", "are not surfaces to travel on"),
    (Category.METRIC_OBSTACLE, "is a solid obstacle", "are solid obstacles"),
    (Category.HAZARD_INDICATOR, "makes its surroundings dangerous", "make their surroundings dangerous"),
    (Category.SOCIAL_ZONE, "is owed distance", "are owed distance"),
)


def justify(
    classes: Sequence[OntologyClass],
    shapes: Dict[str, Sequence[Tuple[Arrangement, int]]],
    wordnet_problem: str = "",
) -> str:
    """Say in words why the predicates of the frame hold.

    Args:
        classes: every class of the answer.
        shapes: class name -> arrangements in force with the number of their members.
        wordnet_problem: why WordNet could not be asked about the classes that are not listed; empty if it could.

    Returns:
        Sentences; "Nothing known is in view." for no class.
    """
    sentences: List[str] = []
    for category, one, many in CATEGORY_WORDS:
        names = [_words(c.name) for c in classes if category in c.categories]
        if names:
            sentences.append(f"The {_list(names)} {one if len(names) == 1 else many}.")
    for known in classes:
        if Category.SEMANTIC_BARRIER in known.categories:
            sentences += _barrier_sentences(known.name, shapes.get(known.name, ()))
    sentences += [_unlisted_sentence(c) for c in classes if not c.listed]
    if wordnet_problem:
        sentences.append(f"WordNet could not be asked: {wordnet_problem}.")
    return " ".join(sentences) or "Nothing known is in view."


def _barrier_sentences(name, arrangements) -> Iterable[str]:
    if not arrangements:
        return [f"The {_words(name)} is an obstacle, but does not close an area."]
    return [
        f"{count} of the class {_words(name)} form {SHAPE_WORDS[shape]} and close the space between them."
        for shape, count in arrangements
    ]


def _unlisted_sentence(known):
    treated = {
        Category.METRIC_OBSTACLE: "a solid obstacle",
        Category.HAZARD_INDICATOR: "a hazard",
        Category.SOCIAL_ZONE: "owed distance",
        Category.SEMANTIC_BARRIER: "a barrier",
        Category.NON_NAVIGABLE_SURFACE: "not navigable",
    }[known.categories[0]]
    because = f" by {known.known_by}" if known.known_by else ""
    return f"The {_words(known.name)} is not in the list of classes and is taken as {treated}{because}."


def _words(name):
    return name.replace("_", " ")


def _list(names):
    return names[0] if len(names) == 1 else ", ".join(names[:-1]) + " and " + names[-1]

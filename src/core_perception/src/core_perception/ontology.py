# SPDX-License-Identifier: BSD-3-Clause
"""The embedded list of classes: name or alias -> category, reach of AROUND, motion; from a YAML file, checked at load.

Navigable comes only from a name that is written in the file. A name that is not written there is judged by what it
contains and by what WordNet says it is a kind of, and is always an obstacle, a hazard or not navigable, never the
contrary.

Source: [CORE] appendix, VLM prompt, semantic class definition. Differs: a sixth category for surfaces that are not
    navigable, which the paper's ON rule needs; an explicit list and WordNet instead of a language model.
"""

from __future__ import annotations

import functools
from typing import Dict, Tuple

from core_perception.hypernyms import Hypernyms
from core_perception.ontology_file import OntologyTables, read_file, read_tables
from core_perception.ontology_types import SURFACES, WITH_RADIUS, Category, OntologyClass
from core_perception.predicates import canonical_class_name
from core_perception.wordnet import WORDNET_DIR, WordNet

__all__ = ["SURFACES", "WITH_RADIUS", "Category", "Ontology", "OntologyClass"]

# Words between the parts of a phrase: a person_on_a_bicycle is judged as a person and as a bicycle.
PREPOSITIONS = frozenset(
    ("at", "by", "from", "in", "near", "of", "on", "with")
    + ("carrying", "holding", "pushing", "riding", "using", "wearing")
)
# Of the parts of a phrase, the one whose rules reach furthest decides.
CAUTION = (
    Category.SOCIAL_ZONE,
    Category.HAZARD_INDICATOR,
    Category.SEMANTIC_BARRIER,
    Category.METRIC_OBSTACLE,
    Category.NON_NAVIGABLE_SURFACE,
)


class Ontology:
    """Look-up of class names; the answers never change after construction."""

    def __init__(self, tables: OntologyTables, wordnet: WordNet):
        """Keep checked tables; use from_dict or load.

        Args:
            tables: content of an ontology file.
            wordnet: nouns for the names that are not in it.
        """
        self._tables, self._hypernyms = tables, Hypernyms(tables.hypernyms, wordnet)
        # Every frame asks for the same few names.
        self._canonical_cached = functools.lru_cache(maxsize=4096)(self._find_canonical)
        self._look_up_cached = functools.lru_cache(maxsize=4096)(self._find_class)

    @property
    def vocabulary(self) -> Tuple[str, ...]:
        """Canonical names, sorted: what a segmenter is always asked for."""
        return tuple(sorted(self._tables.classes))

    @property
    def classes(self) -> Dict[str, OntologyClass]:
        """Canonical name -> class."""
        return dict(self._tables.classes)

    @property
    def aliases(self) -> Dict[str, str]:
        """Alias -> canonical name."""
        return dict(self._tables.aliases)

    @property
    def wordnet_problem(self) -> str:
        """Why WordNet does not help with names that are not listed, in one line; empty while it does."""
        return self._hypernyms.problem

    def canonical(self, name: str) -> str:
        """Return the listed class that ``name`` is, or is an alias or plural of; otherwise the name in canonical form.

        Raises:
            PredicateError: the text is no class name.
        """
        return self._canonical_cached(name)

    def _find_canonical(self, name):
        name = canonical_class_name(name)
        for form in _singular_forms(name):
            if form in self._tables.classes:
                return form
            if form in self._tables.aliases:
                return self._tables.aliases[form]
        return name

    def look_up(self, name: str) -> OntologyClass:
        """Return what is known of a class; a name that is not listed gets the first answer that fits.

            a hazard word in it                      -> hazard indicator, by that word
            a noun of WordNet                        -> as the nearest of the file's hypernyms, else metric obstacle
            two parts, joined by a word such as on   -> the one of the parts that asks for more
            its last words are a listed class        -> that class, but a surface becomes a non-navigable surface
            its last words are a noun of WordNet     -> as above; the longest ending counts
            otherwise                                -> metric obstacle

        Raises:
            PredicateError: the text is no class name.
        """
        return self._look_up_cached(self.canonical(name))

    def _find_class(self, name):
        if name in self._tables.classes:
            return self._tables.classes[name]
        words = name.split("_")
        hazard = next((word for word in words if word in self._tables.hazard_words), None)
        if hazard is not None:
            radius_m = self._tables.hazard_radius_m
            return OntologyClass(
                name, (Category.HAZARD_INDICATOR,), radius_m, listed=False, known_by=f"the word {hazard}"
            )
        return self._hypernyms.judge(name) or self._by_parts(name, words) or self._by_ending(name, words)

    def _by_parts(self, name, words):
        """Judge a phrase; None where no preposition joins two parts."""
        at = next((k for k in range(1, len(words) - 1) if words[k] in PREPOSITIONS), None)
        if at is None or not words[at + 1][0].isalpha():
            return None
        parts = [self._as_part(name, "_".join(part)) for part in (words[:at], words[at + 1 :])]
        return min(parts, key=lambda part: CAUTION.index(part.categories[0]))

    def _as_part(self, name, part):
        known = self._look_up_cached(self.canonical(part))
        return self._like(name, known, f"its part {known.name}" if known.listed else known.known_by)

    def _by_ending(self, name, words):
        for start in range(1, len(words)):
            if not words[start][0].isalpha():
                continue
            ending = "_".join(words[start:])
            listed = self._tables.classes.get(self.canonical(ending))
            known = listed or self._hypernyms.judge(ending)
            if known is not None:
                return self._like(name, known, f"its ending {listed.name}" if listed else known.known_by)
        return OntologyClass(name, (Category.METRIC_OBSTACLE,), listed=False)

    @staticmethod
    def _like(name, known, known_by):
        """Give a name that is not listed what is known of another, except that it is navigable."""
        categories = (Category.NON_NAVIGABLE_SURFACE,) if known.is_surface else known.categories
        return OntologyClass(name, categories, known.radius_m, known.mobile, listed=False, known_by=known_by)

    @classmethod
    def load(cls, path, wordnet_dir=WORDNET_DIR) -> Ontology:
        """Read a YAML file; WordNet is read when a name is not in it.

        Args:
            path: of the file.
            wordnet_dir: folder of WordNet's dictionary files; where there are none, names that are not listed are
                judged by their words alone.

        Raises:
            OntologyError: the file cannot be read or its content is refused by from_dict; the message starts with the
                path.
        """
        return cls(read_file(path), WordNet(wordnet_dir))

    @classmethod
    def from_dict(cls, data: dict, wordnet_dir=WORDNET_DIR) -> Ontology:
        """Check and index the content of an ontology file (the shipped ``config/ontology.yaml`` describes the keys).

        Raises:
            OntologyError: as ontology_file.read_tables.
        """
        return cls(read_tables(data), WordNet(wordnet_dir))


def _singular_forms(name):
    yield name
    for plural, singular in (("es", ""), ("s", ""), ("ies", "y"), ("men", "man")):
        if name.endswith(plural):
            yield name[: -len(plural)] + singular

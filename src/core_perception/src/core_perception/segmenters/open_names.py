# SPDX-License-Identifier: BSD-3-Clause
"""Which of the names asked for means a thing: open vocabulary without a language model."""

from __future__ import annotations

import functools
from typing import FrozenSet, Iterable, Optional, Tuple

from core_perception.exceptions import OntologyError
from core_perception.hypernyms import Hypernyms
from core_perception.ontology import Ontology
from core_perception.wordnet import WORDNET_DIR, WordNet


class OpenNames:
    """Finds the name by which a thing was asked for.

    Names are compared in canonical form: case, hyphens, spaces and underscores do not count, nor does the plural.
    """

    def __init__(self, ontology: Ontology, wordnet_dir: str = ""):
        """Keep the sources of names; WordNet is opened when it is needed.

        Args:
            ontology: its classes and their aliases.
            wordnet_dir: folder of WordNet's files; empty means Debian's. Without them words have no synonyms.
        """
        self._ontology = ontology
        self._wordnet = WordNet(wordnet_dir or WORDNET_DIR)
        self._nouns = Hypernyms({}, self._wordnet)
        self._problem = ""
        # Every frame asks for the same names of the same few things.
        self._find_cached = functools.lru_cache(maxsize=4096)(self._find)
        self._forms = functools.lru_cache(maxsize=4096)(self._find_forms)
        self._senses = functools.lru_cache(maxsize=4096)(self._find_senses)

    @property
    def problem(self) -> str:
        """Why WordNet cannot be used, in one line; empty while it can, or while nobody has needed it."""
        return self._problem

    def find(
        self, names: Tuple[str, ...], asked: Tuple[str, ...], preferred: FrozenSet[str] = frozenset()
    ) -> Optional[str]:
        """Return the name asked for that means the thing, None where there is none; the first that fits:

            its class; a name that the ontology says means its class; one of its other names; a synonym in WordNet

        first among the preferred names, but a synonym only after all that is not one. So a rule about a
        ``loaded_pallet`` finds the thing that is also known as ``pallet``.

        Args:
            names: canonical names of the thing, its class first.
            asked: canonical names asked for, in order of preference.
            preferred: those of them that rules speak of.
        """  # noqa: D400, D415 - a list follows
        return self._find_cached(names, asked, preferred)

    def is_meant(self, name: str, others: Iterable[str]) -> bool:
        """Whether one of the other names means the same class as a name."""
        return self._find_cached((name,), tuple(others), frozenset()) is not None

    def _find(self, names, asked, preferred):
        rules = tuple(name for name in asked if name in preferred)
        for find in (self._by_name, self._by_synonym):
            for some in (rules, asked):
                found = find(names, some)
                if found is not None:
                    return found
        return None

    def _by_name(self, names, asked):
        own = names[0]
        if own in asked:
            return own
        meaning = self._ontology.canonical(own)
        for name in asked:
            if self._ontology.canonical(name) == meaning:
                return name
        known = frozenset().union(*(self._forms(name) for name in names))
        return next((name for name in asked if self._forms(name) & known), None)

    def _by_synonym(self, names, asked):
        thing = [self._senses(name) for name in names]
        for name in asked:
            chosen, senses = self._senses(name)
            for own_chosen, own_senses in thing:
                if (chosen is not None and chosen in own_senses) or (own_chosen is not None and own_chosen in senses):
                    return name
        return None

    def _find_forms(self, name) -> FrozenSet[str]:
        """The name and every singular it may be the plural of."""
        if not self._problem:
            try:
                return frozenset(self._wordnet.singular_forms(name))
            except OntologyError as error:
                self._problem = str(error)
        return frozenset((name, name[:-1])) if name.endswith("s") and len(name) > 2 else frozenset((name,))

    def _find_senses(self, name):
        """The sense a noun is most likely meant in, and all its senses."""
        if self._problem:
            return None, frozenset()
        try:
            senses = frozenset(sense for form in self._forms(name) for sense in self._wordnet.senses(form))
            return (self._nouns.concrete_sense(name), senses) if senses else (None, frozenset())
        except OntologyError as error:
            self._problem = str(error)
            return None, frozenset()

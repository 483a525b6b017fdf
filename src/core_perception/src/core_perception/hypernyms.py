# SPDX-License-Identifier: BSD-3-Clause
"""Judges a noun by what it is a kind of: the nearest hypernym in WordNet that the ontology names gives the category."""

from __future__ import annotations

import dataclasses
from typing import Dict, Mapping, Optional

from core_perception.exceptions import OntologyError
from core_perception.ontology_types import Category, OntologyClass
from core_perception.wordnet import CONCRETE_FILES, WordNet

LIVING_FILES = frozenset(CONCRETE_FILES[name] for name in ("animal", "body", "group", "person"))
THING_FILES = frozenset(CONCRETE_FILES[name] for name in ("artifact", "communication", "food"))


class Hypernyms:
    """The ontology's hypernyms, found in WordNet at the first question.

    Without WordNet, or with a damaged one, every noun is unknown and ``problem`` says why.
    """

    def __init__(self, hypernyms: Mapping[str, OntologyClass], wordnet: WordNet):
        """Keep both; nothing is read yet.

        Args:
            hypernyms: ``file.word``, the first sense of the word in that lexicographer file, or ``file.*``, any noun of
                it -> what a noun below it is; never a navigable surface.
            wordnet: the nouns.
        """
        self._hypernyms, self._wordnet = dict(hypernyms), wordnet
        self._by_offset: Optional[Dict[int, OntologyClass]] = None
        self._by_file: Dict[int, OntologyClass] = {}
        self._problem = ""

    @property
    def problem(self) -> str:
        """Why WordNet cannot be used, in one line; empty while it can."""
        self._find_hypernyms()
        return self._problem

    def judge(self, name: str) -> Optional[OntologyClass]:
        """Return what a noun is by its most frequent concrete sense; None for a name that WordNet does not have.

        A sense below none of the hypernyms is a metric obstacle.

        Args:
            name: canonical name, singular or plural.
        """
        by_offset = self._find_hypernyms()
        if self._problem:
            return None
        try:
            sense = self.concrete_sense(name)
            if sense is None:
                return None
            kinds = list(self._wordnet.kinds(sense))
        except OntologyError as error:
            self._problem = str(error)
            return None
        known = next((by_offset[kind.offset] for kind in kinds if kind.offset in by_offset), None)
        known = known or self._by_file.get(kinds[0].file_number)
        if known is None:
            because = f"WordNet: {kinds[min(1, len(kinds) - 1)].lemma}"
            return OntologyClass(name, (Category.METRIC_OBSTACLE,), listed=False, known_by=because)
        return OntologyClass(name, known.categories, known.radius_m, known.mobile, False, f"WordNet: {known.name}")

    def concrete_sense(self, name: str) -> Optional[int]:
        """Find the first concrete sense; before one that lives and that no text was found to use, comes a thing.

        A printer, a monitor and a crane in a room are seldom the person or the bird of that name; nor are the blind
        people, so that groups come last.

        Raises:
            OntologyError: WordNet cannot be read, or is damaged.
        """
        for form in self._wordnet.singular_forms(name):
            used, senses = self._wordnet.used_senses(form), self._wordnet.senses(form)
            synsets = [(rank, self._wordnet.synset(sense)) for rank, sense in enumerate(senses)]
            concrete = [(rank, synset) for rank, synset in synsets if synset.is_concrete]
            if not concrete:
                continue
            concrete.sort(key=lambda item: (item[1].file_number == CONCRETE_FILES["group"], item[0]))
            rank, first = concrete[0]
            thing = next((synset for _, synset in concrete if synset.file_number in THING_FILES), None)
            doubtful = first.file_number in LIVING_FILES and rank >= used
            return (thing if doubtful and thing is not None else first).offset
        return None

    def _find_hypernyms(self):
        if self._by_offset is None:
            self._by_offset = {}
            try:
                for key, known in self._hypernyms.items():
                    self._place(*key.split(".", 1), known)
            except OntologyError as error:
                self._problem = str(error)
        return self._by_offset

    def _place(self, file_name, word, known):
        number = CONCRETE_FILES[file_name]
        if word == "*":
            self._by_file[number] = dataclasses.replace(known, name=file_name)
            return
        for sense in self._wordnet.senses(word):
            if self._wordnet.synset(sense).file_number == number:
                self._by_offset[sense] = known
                return
        raise OntologyError(f"{self._wordnet.folder}: has no noun {file_name}.{word}")

# SPDX-License-Identifier: BSD-3-Clause
"""Nouns of WordNet 3 from its dictionary files, read where they lie: senses of a word and what each is a kind of.

``index.noun`` is sorted by bytes, so that a word is found by bisection; a sense is the byte offset of its record in
``data.noun``. Nothing is loaded but the pages that are touched. Source: wndb(5WN) of WordNet 3.0; Debian's package
wordnet-base.
"""

from __future__ import annotations

import functools
import mmap
from dataclasses import dataclass
from pathlib import Path
from typing import Dict, Iterator, Optional, Tuple

from core_perception.exceptions import OntologyError

#: Where Debian's wordnet-base puts the files.
WORDNET_DIR = "/usr/share/wordnet"
#: Numbers of the lexicographer files of what can stand, hang, lie or live somewhere: lexnames(5WN).
CONCRETE_FILES = {
    "Tops": 3,
    "animal": 5,
    "artifact": 6,
    "body": 8,
    "communication": 10,
    "food": 13,
    "group": 14,
    "location": 15,
    "object": 17,
    "person": 18,
    "phenomenon": 19,
    "plant": 20,
    "substance": 27,
}
# Ending of a plural -> that of the singular, tried in this order: morphy(7WN).
PLURAL_ENDINGS = (
    ("s", ""),
    ("ses", "s"),
    ("xes", "x"),
    ("zes", "z"),
    ("ches", "ch"),
    ("shes", "sh"),
    ("men", "man"),
    ("ies", "y"),
)
MAX_DEPTH = 20  # the deepest noun of WordNet 3.0 lies 19 levels below entity


@dataclass(frozen=True)
class Synset:
    """One sense.

    Attributes:
        offset: its number.
        file_number: of the lexicographer file, see CONCRETE_FILES.
        lemma: its first word, lower case, words joined by underscores.
        hypernyms: numbers of what it is a kind of, directly.
    """

    offset: int
    file_number: int
    lemma: str
    hypernyms: Tuple[int, ...]

    @property
    def is_concrete(self) -> bool:
        """Whether it is a kind of thing that can stand, hang, lie or live somewhere; no single one with a name."""
        is_kind = bool(self.hypernyms) or self.file_number == CONCRETE_FILES["Tops"]
        return is_kind and self.file_number in CONCRETE_FILES.values()


class WordNet:
    """The nouns; opened at the first question."""

    def __init__(self, folder=WORDNET_DIR):
        """Remember where the files are.

        Args:
            folder: of index.noun, data.noun and noun.exc.
        """
        self.folder = Path(folder)
        self._maps: Dict[str, mmap.mmap] = {}
        self._plurals: Optional[Dict[str, str]] = None
        self._synset_cached = functools.lru_cache(maxsize=4096)(self._read_synset)

    def senses(self, lemma: str) -> Tuple[int, ...]:
        """Return the senses of a noun in its singular, the most frequent first; empty for a word it does not have.

        Args:
            lemma: lower case, words joined by underscores.

        Raises:
            OntologyError: a file cannot be read, or is damaged.
        """
        return self._entry(lemma)[0]

    def used_senses(self, lemma: str) -> int:
        """Return how many of the senses, from the first, were found in the texts that WordNet was counted on.

        Raises:
            OntologyError: as senses.
        """
        return self._entry(lemma)[1]

    def _entry(self, lemma):
        line = self._find_line(lemma.encode("ascii", "replace"))
        if line is None:
            return (), 0
        fields = line.split()
        try:
            count = int(fields[2])
            return tuple(int(field) for field in fields[-count:]), int(fields[-count - 1])
        except (ValueError, IndexError) as error:
            raise OntologyError(f"{self.folder / 'index.noun'}: damaged at {lemma!r}") from error

    def singular_forms(self, name: str) -> Iterator[str]:
        """Yield the name, then every singular that it may be the plural of; irregular plurals first.

        Raises:
            OntologyError: noun.exc cannot be read.
        """
        yield name
        if self._plurals is None:
            self._plurals = self._read_plurals()
        if name in self._plurals:
            yield self._plurals[name]
        for plural, singular in PLURAL_ENDINGS:
            if name.endswith(plural) and len(name) > len(plural) + 1:
                yield name[: -len(plural)] + singular

    def synset(self, offset: int) -> Synset:
        """Read one sense.

        Raises:
            OntologyError: the file cannot be read, or has no record there.
        """
        return self._synset_cached(offset)

    def kinds(self, offset: int) -> Iterator[Synset]:
        """Yield a sense, what it is a kind of, what that is a kind of and so on, the nearest first.

        Raises:
            OntologyError: the file cannot be read, or is damaged.
        """
        level, seen = [offset], {offset}
        for _ in range(MAX_DEPTH):
            synsets = [self.synset(number) for number in level]
            yield from synsets
            level = [number for number in dict.fromkeys(n for s in synsets for n in s.hypernyms) if number not in seen]
            seen.update(level)

    def _map(self, name):
        if name not in self._maps:
            path = self.folder / name
            try:
                with path.open("rb") as file:
                    self._maps[name] = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
            except (OSError, ValueError) as error:
                raise OntologyError(f"{path}: cannot be read: {error}") from error
        return self._maps[name]

    def _find_line(self, lemma):
        """Bisect index.noun; the licence above the words begins with spaces, which sort before every letter."""
        text = self._map("index.noun")
        low, high = 0, len(text)
        while low < high:
            middle = text.rfind(b"\n", low, (low + high) // 2) + 1 or low
            end = text.find(b"\n", middle)
            end = len(text) if end < 0 else end
            word = text[middle : text.find(b" ", middle, end) if text[middle : middle + 1] != b" " else middle]
            if word == lemma and lemma:
                return text[middle:end].decode("ascii", "replace")
            if word < lemma:
                low = end + 1
            else:
                high = middle
        return None

    def _read_synset(self, offset):
        text = self._map("data.noun")
        end = text.find(b"\n", offset)
        fields = text[offset : end if end >= 0 else len(text)].decode("ascii", "replace").split(" | ")[0].split()
        try:
            if int(fields[0]) != offset:
                raise ValueError("another record")
            first_pointer = 5 + 2 * int(fields[3], 16)
            pointers = fields[first_pointer : first_pointer + 4 * int(fields[first_pointer - 1])]
            hypernyms = tuple(
                int(pointers[k + 1])
                for k in range(0, len(pointers), 4)
                if pointers[k] == "@" and pointers[k + 2] == "n"
            )
            return Synset(offset, int(fields[1]), fields[4].lower(), hypernyms)
        except (ValueError, IndexError) as error:
            raise OntologyError(f"{self.folder / 'data.noun'}: damaged at byte {offset}") from error

    def _read_plurals(self):
        path = self.folder / "noun.exc"
        try:
            lines = path.read_text(encoding="ascii", errors="replace").splitlines()
        except OSError as error:
            raise OntologyError(f"{path}: cannot be read: {error}") from error
        return dict(line.split()[:2] for line in lines if len(line.split()) >= 2)

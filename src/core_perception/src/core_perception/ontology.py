# SPDX-License-Identifier: BSD-3-Clause
"""The embedded list of classes: name or alias -> category, reach of AROUND, motion; from a YAML file, checked at load.

Navigable comes only from a name that is written in the file. A name that is not written there is judged by what it
contains and is always an obstacle, a hazard or not navigable, never the contrary.

Source: [CORE] appendix, VLM prompt, semantic class definition. Differs: a sixth category for surfaces that are not
    navigable, which the
paper's ON rule needs; an explicit list instead of a language model.
"""

from __future__ import annotations

import enum
import functools
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Dict, Mapping, Optional, Tuple

import yaml

from core_perception.exceptions import OntologyError, PredicateError
from core_perception.predicates import MAX_RADIUS_M, canonical_class_name


class Category(enum.Enum):
    """What a class means for safety."""

    METRIC_OBSTACLE = "metric_obstacle"
    HAZARD_INDICATOR = "hazard_indicator"
    SOCIAL_ZONE = "social_zone"
    SEMANTIC_BARRIER = "semantic_barrier"
    NAVIGABLE_SURFACE = "navigable_surface"
    NON_NAVIGABLE_SURFACE = "non_navigable_surface"


SURFACES = frozenset({Category.NAVIGABLE_SURFACE, Category.NON_NAVIGABLE_SURFACE})
WITH_RADIUS = frozenset({Category.HAZARD_INDICATOR, Category.SOCIAL_ZONE})


@dataclass(frozen=True)
class OntologyClass:
    """What is known of one class.

    Attributes:
        name: canonical name asked for or found.
        categories: one or two categories whose rules hold.
        radius_m: reach of AROUND on the ground [m]; None unless the class is a hazard indicator or a social zone.
        mobile: it can move by itself.
        listed: the name, or an alias of it, is written in the file.
        known_by: what a name that is not listed was judged by, in words; empty for a listed one or for nothing at all.
    """

    name: str
    categories: Tuple[Category, ...]
    radius_m: Optional[float] = None
    mobile: bool = False
    listed: bool = True
    known_by: str = ""

    @property
    def is_surface(self) -> bool:
        """A class that ON applies to."""
        return self.categories[0] in SURFACES


class Ontology:
    """Look-up of class names; immutable after construction."""

    def __init__(
        self, classes: Mapping[str, OntologyClass], aliases: Mapping[str, str], hazard_words, hazard_radius_m: float
    ):
        """Keep checked tables; use from_dict or load.

        Args:
            classes: canonical name -> class.
            aliases: alias -> canonical name; disjoint from classes.
            hazard_words: words that make a name that is not listed a hazard indicator.
            hazard_radius_m: reach of AROUND of such a name [m].
        """
        self._classes, self._aliases = dict(classes), dict(aliases)
        self._hazard_words, self._hazard_radius_m = frozenset(hazard_words), hazard_radius_m
        # Every frame asks for the same few names.
        self._canonical_cached = functools.lru_cache(maxsize=4096)(self._find_canonical)

    @property
    def vocabulary(self) -> Tuple[str, ...]:
        """Canonical names, sorted: what a segmenter is always asked for."""
        return tuple(sorted(self._classes))

    @property
    def classes(self) -> Dict[str, OntologyClass]:
        """Canonical name -> class."""
        return dict(self._classes)

    @property
    def aliases(self) -> Dict[str, str]:
        """Alias -> canonical name."""
        return dict(self._aliases)

    def canonical(self, name: str) -> str:
        """Return the listed class that ``name`` is, or is an alias or plural of; otherwise the name in canonical form.

        Raises:
            PredicateError: the text is no class name.
        """
        return self._canonical_cached(name)

    def _find_canonical(self, name):
        name = canonical_class_name(name)
        for form in _singular_forms(name):
            if form in self._classes:
                return form
            if form in self._aliases:
                return self._aliases[form]
        return name

    def look_up(self, name: str) -> OntologyClass:
        """Return what is known of a class; a name that is not listed gets the first answer that fits.

            a hazard word in it                    -> hazard indicator, by that word
            its last words are a listed class      -> that class, but a surface becomes a non-navigable surface
            otherwise                              -> metric obstacle

        Raises:
            PredicateError: the text is no class name.
        """
        name = self.canonical(name)
        if name in self._classes:
            return self._classes[name]
        words = name.split("_")
        hazard = next((word for word in words if word in self._hazard_words), None)
        if hazard is not None:
            return OntologyClass(
                name, (Category.HAZARD_INDICATOR,), self._hazard_radius_m, listed=False, known_by=f"the word {hazard}"
            )
        for start in range(1, len(words)):
            tail = self.canonical("_".join(words[start:])) if words[start][0].isalpha() else ""
            if tail in self._classes:
                return self._by_tail(name, self._classes[tail])
        return OntologyClass(name, (Category.METRIC_OBSTACLE,), listed=False)

    @staticmethod
    def _by_tail(name, listed):
        categories = (Category.NON_NAVIGABLE_SURFACE,) if listed.is_surface else listed.categories
        return OntologyClass(
            name, categories, listed.radius_m, listed.mobile, listed=False, known_by=f"its ending {listed.name}"
        )

    @classmethod
    def load(cls, path) -> Ontology:
        """Read a YAML file.

        Raises:
            OntologyError: the file cannot be read or its content is refused by from_dict; the message starts with the
                path.
        """
        try:
            data = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
        except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
            raise OntologyError(f"{path}: cannot be read as YAML: {' '.join(str(error).split())}") from error
        try:
            return cls.from_dict(data)
        except OntologyError as error:
            raise OntologyError(f"{path}: {error}") from error

    @classmethod
    def from_dict(cls, data: dict) -> Ontology:
        """Check and index the content of an ontology file (the shipped ``config/ontology.yaml`` describes the keys).

        Raises:
            OntologyError: unknown or missing key, a name that is not canonical or written twice, a radius out of range
                or on a class without AROUND, a second category that is the same, or mixes surfaces with objects.
        """
        expected = {"radius_m", "hazard_words"} | {category.value for category in Category}
        if not isinstance(data, dict) or set(data) != expected:
            got = sorted(map(str, data)) if isinstance(data, dict) else data
            raise OntologyError(f"top level: got {got}, allowed exactly {', '.join(sorted(expected))}")
        radii = _read_default_radii(data["radius_m"])
        classes, aliases = {}, {}
        for category in Category:
            for name, entry in _mapping(data[category.value], category.value).items():
                _check_name(name, classes, aliases)
                classes[name] = _read_class(name, category, _mapping(entry, name), radii)
                for alias in _names(entry.get("aliases", []), f"{name}.aliases"):
                    _check_name(alias, classes, aliases)
                    aliases[alias] = name
        words = _names(data["hazard_words"], "hazard_words")
        return cls(classes, aliases, words, radii[Category.HAZARD_INDICATOR])


def _singular_forms(name):
    yield name
    if name.endswith("es"):
        yield name[:-2]
    if name.endswith("s"):
        yield name[:-1]


def _mapping(value, key):
    if not isinstance(value, dict):
        raise OntologyError(f"{key}: got {value!r}, allowed a mapping")
    return value


def _names(value, key):
    if not isinstance(value, list) or not all(isinstance(name, str) for name in value):
        raise OntologyError(f"{key}: got {value!r}, allowed a list of names")
    return value


def _check_name(name, classes, aliases):
    try:
        canonical = canonical_class_name(name)
    except PredicateError as error:
        raise OntologyError(str(error)) from error
    if canonical != name:
        raise OntologyError(f"{name}: not canonical, allowed {canonical}")
    if name in classes or name in aliases:
        raise OntologyError(f"{name}: written twice, allowed once as class or alias")


def _read_radius(value, key):
    if (
        isinstance(value, bool)
        or not isinstance(value, (int, float))
        or not (math.isfinite(value) and 0.0 < value <= MAX_RADIUS_M)
    ):
        raise OntologyError(f"{key}: got {value!r}, allowed 0 < radius <= {MAX_RADIUS_M} m")
    return float(value)


def _read_default_radii(value):
    radii = _mapping(value, "radius_m")
    if set(radii) != {category.value for category in WITH_RADIUS}:
        raise OntologyError(f"radius_m: got {sorted(radii)}, allowed exactly {sorted(c.value for c in WITH_RADIUS)}")
    return {category: _read_radius(radii[category.value], f"radius_m.{category.value}") for category in WITH_RADIUS}


def _read_class(name, category, entry, radii):
    unknown = set(entry) - {"aliases", "radius_m", "mobile", "also"}
    if unknown:
        raise OntologyError(f"{name}: got key {sorted(unknown)[0]!r}, allowed aliases, radius_m, mobile, also")
    categories = (category,) + _read_second_category(name, category, entry)
    reaching = [c for c in categories if c in WITH_RADIUS]
    if "radius_m" in entry and not reaching:
        raise OntologyError(
            f"{name}.radius_m: got {entry['radius_m']!r}, allowed on hazard indicators and social zones only"
        )
    radius_m = _read_radius(entry.get("radius_m", radii[reaching[0]]), f"{name}.radius_m") if reaching else None
    if not isinstance(entry.get("mobile", False), bool):
        raise OntologyError(f"{name}.mobile: got {entry['mobile']!r}, allowed true or false")
    return OntologyClass(name, categories, radius_m, entry.get("mobile", False))


def _read_second_category(name, category, entry):
    if "also" not in entry:
        return ()
    allowed = [c for c in Category if c != category and c not in SURFACES]
    if category in SURFACES or entry["also"] not in [c.value for c in allowed]:
        raise OntologyError(f"{name}.also: got {entry['also']!r}, allowed another category of objects, on an object")
    return (Category(entry["also"]),)

# SPDX-License-Identifier: BSD-3-Clause
"""Reads and checks the ontology's YAML file; ``config/ontology.yaml`` describes the keys."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import FrozenSet, Mapping

from core_perception.exceptions import OntologyError, PerceptionError, PredicateError, quote
from core_perception.ontology_types import SURFACES, WITH_RADIUS, Category, OntologyClass
from core_perception.predicates import MAX_RADIUS_M, canonical_class_name
from core_perception.wordnet import CONCRETE_FILES
from core_perception.yaml_file import read_yaml


@dataclass(frozen=True)
class OntologyTables:
    """Content of an ontology file.

    Attributes:
        classes: canonical name -> class.
        aliases: alias -> canonical name; disjoint from classes.
        hazard_words: words that make a name that is not listed a hazard indicator.
        hazard_radius_m: reach of AROUND of such a name [m].
        hypernyms: ``file.word`` of WordNet -> what a noun below it is; name holds the word.
    """

    classes: Mapping[str, OntologyClass]
    aliases: Mapping[str, str]
    hazard_words: FrozenSet[str]
    hazard_radius_m: float
    hypernyms: Mapping[str, OntologyClass]


def read_file(path) -> OntologyTables:
    """Read a YAML file.

    Raises:
        OntologyError: the file cannot be read or read_tables refuses its content; the message starts with the path.
    """
    try:
        return read_tables(read_yaml(path))
    except OntologyError as error:
        raise OntologyError(f"{path}: {error}") from error
    except PerceptionError as error:
        raise OntologyError(str(error)) from error


def read_tables(data: dict) -> OntologyTables:
    """Check and index the content of an ontology file.

    Raises:
        OntologyError: unknown or missing key, a name that is not canonical or written twice, a radius out of range or
            on a class without AROUND, a second category that is the same, or mixes surfaces with objects, a hypernym
            that is navigable or names no lexicographer file.
    """
    expected = {"radius_m", "hazard_words", "wordnet"} | {category.value for category in Category}
    if not isinstance(data, dict) or set(data) != expected:
        got = sorted(map(str, data)) if isinstance(data, dict) else data
        raise OntologyError(f"top level: got {quote(got)}, allowed exactly {', '.join(sorted(expected))}")
    radii = _read_default_radii(data["radius_m"])
    classes, aliases = {}, {}
    for category in Category:
        for name, entry in _mapping(data[category.value], category.value).items():
            _check_name(name, classes, aliases)
            classes[name] = _read_class(name, category, _mapping(entry, name), radii)
            for alias in _names(entry.get("aliases", []), f"{name}.aliases"):
                _check_name(alias, classes, aliases)
                aliases[alias] = name
    words = frozenset(_names(data["hazard_words"], "hazard_words"))
    hypernyms = _read_hypernyms(data["wordnet"], radii)
    return OntologyTables(classes, aliases, words, radii[Category.HAZARD_INDICATOR], hypernyms)


def _mapping(value, key):
    if not isinstance(value, dict):
        raise OntologyError(f"{key}: got {quote(value)}, allowed a mapping")
    return value


def _names(value, key):
    if not isinstance(value, list) or not all(isinstance(name, str) for name in value):
        raise OntologyError(f"{key}: got {quote(value)}, allowed a list of names")
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
        raise OntologyError(f"{key}: got {quote(value)}, allowed 0 < radius <= {MAX_RADIUS_M} m")
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


def _read_hypernyms(value, radii):
    allowed = [c.value for c in Category if c != Category.NAVIGABLE_SURFACE]
    groups = _mapping(value, "wordnet")
    if set(groups) - set(allowed):
        raise OntologyError(f"wordnet: got {sorted(map(str, groups))}, allowed {', '.join(allowed)}")
    hypernyms = {}
    for group, names in groups.items():
        for name, entry in _mapping(names, f"wordnet.{group}").items():
            file_name, _, word = str(name).partition(".")
            if file_name not in CONCRETE_FILES or not word or name in hypernyms:
                raise OntologyError(
                    f"wordnet.{group}: got {name!r}, allowed once, as file.word with one of {', '.join(CONCRETE_FILES)}"
                )
            if "aliases" in _mapping(entry, name):
                raise OntologyError(f"{name}: got key 'aliases', allowed radius_m, mobile, also")
            hypernyms[name] = _read_class(word, Category(group), entry, radii)
    return hypernyms

# SPDX-License-Identifier: BSD-3-Clause
"""Open names: which of the names that were asked means a thing."""

import pytest

from core_perception.segmenters.open_names import OpenNames


@pytest.fixture(scope="module")
def names(ontology):
    return OpenNames(ontology)


@pytest.mark.parametrize(
    "thing, asked",
    [
        (("zeppelin",), "zeppelins"),
        (("zeppelins",), "zeppelin"),
        (("traffic_cone",), "pylon"),  # the ontology
        (("storage_rack", "wire_cage"), "wire_cages"),  # an alias of the world
        (("sofa",), "couch"),
        (("airplane",), "aeroplane"),  # WordNet: one sense
        (("aeroplane",), "plane"),  # not the first sense of the shorter word
        (("violin",), "fiddle"),
        (("cello",), "violoncello"),
        (("person_unknown", "umbrella"), "umbrellas"),
        (("gentleman",), "gentlemen"),
        (("wolves",), "wolf"),
    ],
)
def test_a_thing_is_found_by(names, thing, asked):
    assert names.find(thing, ("floor", asked)) == asked


@pytest.mark.parametrize(
    "thing, asked",
    [
        (("person",), "forklift"),
        (("floor",), "wall"),
        (("violin",), "cello"),  # of one kind, not the same
        (("horse",), "knight"),  # the same on a chess board only
        (("crane",), "heron"),
        (("unicorn",), "corn"),
        (("airplane",), "vehicle"),  # WordNet's wider words are not synonyms
    ],
)
def test_a_thing_is_not_found_by(names, thing, asked):
    assert names.find(thing, (asked,)) is None


def test_the_order_is_class_then_meaning_then_other_names_then_synonyms(names):
    thing = ("violin", "strings")
    assert names.find(thing, ("fiddle", "strings", "violin")) == "violin"
    assert names.find(thing, ("fiddle", "strings")) == "strings"
    assert names.find(thing, ("fiddle",)) == "fiddle"
    assert names.find(thing, ("fiddle", "violin"), frozenset(["fiddle"])) == "violin"
    assert names.find(thing, ("strings", "violin"), frozenset(["strings"])) == "strings"
    assert names.find(("traffic_cone",), ("pylon", "cone")) == "pylon"


def test_every_class_of_the_list_finds_itself_alone(names, ontology):
    for name in ontology.vocabulary:
        assert names.find((name,), ontology.vocabulary) == name


def test_without_wordnet_spellings_and_plurals_still_count_and_it_says_why(ontology, tmp_path):
    names = OpenNames(ontology, str(tmp_path))
    assert names.find(("airplane",), ("airplanes",)) == "airplanes"
    assert names.find(("airplane",), ("aeroplane",)) is None
    assert "cannot be read" in names.problem

# SPDX-License-Identifier: BSD-3-Clause
"""WordNet's files are read where they lie, and what a noun is a kind of decides its category."""

import os
import time
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from core_perception.exceptions import OntologyError
from core_perception.ontology import Category, Ontology, OntologyClass
from core_perception.ontology_file import read_file
from core_perception.wordnet import CONCRETE_FILES, WORDNET_DIR, WordNet

SEED = int(os.environ.get("CORE_SEED", "0"))
wants_wordnet = pytest.mark.skipif(
    not Path(WORDNET_DIR, "index.noun").exists(), reason="the Debian package wordnet-base is not installed"
)

# A dictionary of the format of wndb(5WN) that no licence covers: word -> (file, what it is a kind of).
SMALL = {
    "thing": ("Tops", None),
    "animal": ("Tops", "thing"),
    "person": ("Tops", "thing"),
    "crane": ("animal", "animal"),
    "plumber": ("person", "person"),
    "vehicle": ("artifact", "thing"),
    "hovercar": ("artifact", "vehicle"),
    "knoll": ("object", "thing"),
    "idea": (None, None),
}


def write_small(folder):
    """Write SMALL as index.noun, data.noun and noun.exc; return word -> offset."""
    licence = "  1 no licence \n"
    offsets, position = {}, len(licence)
    for word, (_, kind) in SMALL.items():
        offsets[word] = position
        position += len(record(0, 0, word, 0 if kind else None))
    lines = [record(offsets[w], CONCRETE_FILES.get(f, 9), w, offsets[k] if k else None) for w, (f, k) in SMALL.items()]
    (folder / "data.noun").write_text(licence + "".join(lines))
    index = [f"{w} n 1 1 @ 1 0 {offsets[w]:08d}  \n" for w in sorted(SMALL)]
    (folder / "index.noun").write_text(licence + "".join(index))
    (folder / "noun.exc").write_text("knollen knoll\n")
    return offsets


def record(offset, file_number, word, kind):
    pointers = "000" if kind is None else f"001 @ {kind:08d} n 0000"
    return f"{offset:08d} {file_number:02d} n 01 {word} 0 {pointers} | a gloss with @ 00000001 n 0000  \n"


@pytest.fixture()
def small(tmp_path):
    write_small(tmp_path)
    return tmp_path


HYPERNYMS = {
    "social_zone": {"Tops.person": {"mobile": True}, "animal.*": {"radius_m": 0.7}},
    "hazard_indicator": {"artifact.vehicle": {"radius_m": 1.5, "mobile": True}},
    "non_navigable_surface": {"object.knoll": {}},
}


@pytest.fixture()
def small_ontology(small, content):
    return Ontology.from_dict({**content, "wordnet": HYPERNYMS}, small)


@pytest.fixture()
def content(config_dir):
    return yaml.safe_load((config_dir / "ontology.yaml").read_text(encoding="utf-8"))


def test_every_word_of_a_dictionary_is_found_and_no_other(small):
    wordnet, offsets = WordNet(small), write_small(small)
    for word, offset in offsets.items():
        assert wordnet.senses(word) == (offset,)
        assert wordnet.synset(offset).lemma == word
    for word in ("", " ", "a", "cran", "cranes", "zzz", "thin", "things", "1", "  1", "plumber ", "\u00e9"):
        assert wordnet.senses(word) == ()


def test_a_sense_leads_to_what_it_is_a_kind_of_the_nearest_first(small):
    wordnet = WordNet(small)
    assert [s.lemma for s in wordnet.kinds(wordnet.senses("hovercar")[0])] == ["hovercar", "vehicle", "thing"]


def test_what_is_a_kind_of_itself_does_not_hang(small):
    text = (small / "data.noun").read_text()
    thing, vehicle = WordNet(small).senses("thing")[0], WordNet(small).senses("vehicle")[0]
    looped = text.replace(f"@ {thing:08d}", f"@ {vehicle:08d}")
    assert looped != text
    (small / "data.noun").write_text(looped)
    assert [s.lemma for s in WordNet(small).kinds(vehicle)] == ["vehicle"]


@pytest.mark.parametrize(
    "name, category, radius_m, mobile, known_by",
    [
        ("plumber", Category.SOCIAL_ZONE, 1.0, True, "WordNet: person"),
        ("plumbers", Category.SOCIAL_ZONE, 1.0, True, "WordNet: person"),
        ("old_plumber", Category.SOCIAL_ZONE, 1.0, True, "WordNet: person"),
        ("hovercar", Category.HAZARD_INDICATOR, 1.5, True, "WordNet: vehicle"),
        ("knollen", Category.NON_NAVIGABLE_SURFACE, None, False, "WordNet: knoll"),
        ("thing", Category.METRIC_OBSTACLE, None, False, "WordNet: thing"),
        ("idea", Category.METRIC_OBSTACLE, None, False, ""),
        ("plumber_on_a_hovercar", Category.SOCIAL_ZONE, 1.0, True, "WordNet: person"),
        ("hovercar_with_plumber", Category.SOCIAL_ZONE, 1.0, True, "WordNet: person"),
        ("sign_on_floor", Category.METRIC_OBSTACLE, None, False, "its part street_sign"),
        ("wet_plumber", Category.HAZARD_INDICATOR, 1.0, False, "the word wet"),
        ("crane", Category.HAZARD_INDICATOR, 2.0, True, ""),
        ("plumber_cone", Category.SEMANTIC_BARRIER, None, False, "its ending traffic_cone"),
    ],
)
def test_list_then_hazard_words_then_wordnet_then_endings_decide(
    small_ontology, name, category, radius_m, mobile, known_by
):
    known = small_ontology.look_up(name)
    assert (known.categories, known.radius_m, known.mobile, known.known_by) == ((category,), radius_m, mobile, known_by)


def test_a_whole_name_in_wordnet_comes_before_its_ending_in_the_list(small, content):
    assert Ontology.from_dict(content, small / "none").look_up("hot_dog").known_by == "its ending dog"
    (small / "index.noun").write_text((small / "index.noun").read_text().replace("hovercar n", "hot_dog n"))
    known = Ontology.from_dict({**content, "wordnet": {}}, small).look_up("hot_dog")
    assert (known.categories, known.known_by) == ((Category.METRIC_OBSTACLE,), "WordNet: vehicle")


def no_index(folder):
    (folder / "index.noun").unlink()


def cut_index(folder):
    (folder / "index.noun").write_text((folder / "index.noun").read_text().replace("person n 1", "person n x"))


def empty_index(folder):
    (folder / "index.noun").write_text("")


def shift_index(folder):
    text = (folder / "index.noun").read_text()
    for word in ("person", "plumber", "vehicle"):
        (offset,) = WordNet(folder).senses(word)
        text = text.replace(f"{offset:08d}", f"{offset + 1:08d}")
    (folder / "index.noun").write_text(text)


def shift_data(folder):
    (folder / "data.noun").write_text("  one line more\n" + (folder / "data.noun").read_text())


def cut_data(folder):
    (folder / "data.noun").write_bytes((folder / "data.noun").read_bytes()[:60])


def binary_data(folder):
    (folder / "data.noun").write_bytes(bytes(range(256)) * 8)


def no_plurals(folder):
    (folder / "noun.exc").unlink()


def another_wordnet(folder):
    (folder / "index.noun").write_text((folder / "index.noun").read_text().replace("vehicle n", "vehicla n"))


@pytest.mark.parametrize(
    "damage",
    [no_index, cut_index, empty_index, shift_index, shift_data, cut_data, binary_data, no_plurals, another_wordnet],
)
def test_a_missing_or_damaged_wordnet_makes_obstacles_and_says_where(small, content, damage):
    damage(small)
    ontology = Ontology.from_dict({**content, "wordnet": HYPERNYMS}, small)
    known = ontology.look_up("zeppelin_hangar")
    assert (known.categories, known.known_by) == ((Category.METRIC_OBSTACLE,), "")
    assert str(small) in ontology.wordnet_problem
    assert "\n" not in ontology.wordnet_problem
    assert ontology.look_up("hovercar").categories == (Category.METRIC_OBSTACLE,)
    assert ontology.look_up("wet_zeppelin").categories == (Category.HAZARD_INDICATOR,)


def test_fuzz_bytes_changed_anywhere_never_raise_nor_make_navigable(small, content):
    rng = np.random.default_rng([SEED, 5])
    original = {name: (small / name).read_bytes() for name in ("index.noun", "data.noun", "noun.exc")}
    for _ in range(150):
        for name, data in original.items():
            changed = bytearray(data)
            for place in rng.integers(0, len(changed), rng.integers(0, 6)):
                changed[place] = rng.integers(0, 256)
            (small / name).write_bytes(bytes(changed[: rng.integers(1, len(changed) + 1)]))
        ontology = Ontology.from_dict({**content, "wordnet": HYPERNYMS}, small)
        for word in SMALL:
            if word not in ontology.classes:
                assert Category.NAVIGABLE_SURFACE not in ontology.look_up(word).categories


def test_wordnet_is_not_opened_before_a_name_needs_it(small, content):
    no_index(small)
    ontology = Ontology.from_dict({**content, "wordnet": HYPERNYMS}, small)
    assert ontology.look_up("forklift").listed
    write_small(small)
    assert ontology.look_up("hovercar").known_by == "WordNet: vehicle"


@wants_wordnet
def test_debians_wordnet_holds_every_hypernym_of_the_list(ontology):
    assert ontology.wordnet_problem == ""


@wants_wordnet
def test_bisection_finds_what_a_scan_finds_in_debians_wordnet():
    with Path(WORDNET_DIR, "index.noun").open(encoding="ascii") as file:
        lines = [line.split() for line in file if not line.startswith(" ")]
    wordnet, rng = WordNet(), np.random.default_rng([SEED, 6])
    for k in (*range(20), *rng.integers(0, len(lines), 500), *range(len(lines) - 20, len(lines))):
        fields = lines[k]
        assert wordnet.senses(fields[0]) == tuple(int(f) for f in fields[-int(fields[2]) :]), fields[0]
        assert not wordnet.senses(fields[0] + "~")


@wants_wordnet
@pytest.mark.parametrize(
    "word, category",
    [
        ("plumber", Category.SOCIAL_ZONE),
        ("children", Category.SOCIAL_ZONE),
        ("waiter", Category.SOCIAL_ZONE),
        ("driver", Category.SOCIAL_ZONE),
        ("lioness", Category.SOCIAL_ZONE),
        ("tractor", Category.HAZARD_INDICATOR),
        ("rifle", Category.HAZARD_INDICATOR),
        ("dynamite", Category.HAZARD_INDICATOR),
        ("mountain", Category.NON_NAVIGABLE_SURFACE),
        ("footbridge", Category.NON_NAVIGABLE_SURFACE),
        ("hot_dog", Category.METRIC_OBSTACLE),
        ("pencil", Category.METRIC_OBSTACLE),
        ("dishwasher", Category.METRIC_OBSTACLE),
    ],
)
def test_debians_wordnet_tells_people_machines_and_ground_apart(ontology, word, category):
    known = ontology.look_up(word)
    assert known.categories == (category,)
    assert known.known_by.startswith("WordNet: ")


@wants_wordnet
def test_loading_and_the_first_answer_take_less_than_half_a_second(config_dir):
    tables = read_file(config_dir / "ontology.yaml")
    start = time.process_time()
    ontology = Ontology(tables, WordNet())
    assert isinstance(ontology.look_up("plumber"), OntologyClass)
    assert time.process_time() - start < 0.5


@wants_wordnet
@given(st.integers(0, 2**31))
def test_fuzz_no_noun_of_wordnet_is_navigable_unless_it_is_listed(ontology, seed):
    words = sorted(ontology.classes)
    rng = np.random.default_rng([SEED, seed])
    with Path(WORDNET_DIR, "index.noun").open("rb") as file:
        file.seek(int(rng.integers(2000, 4_000_000)))
        file.readline()
        nouns = [file.readline().split()[0].decode() for _ in range(20)]
    for noun in nouns:
        for name in (noun, f"{noun}_on_{rng.choice(words)}", f"{rng.choice(words)}_{noun}"):
            if not name[0].isalpha() or len(name) > 60:
                continue
            known = ontology.look_up(name)
            assert known.listed or Category.NAVIGABLE_SURFACE not in known.categories


def test_a_wordnet_without_files_raises_an_error_that_names_them(tmp_path):
    with pytest.raises(OntologyError, match=str(tmp_path)):
        WordNet(tmp_path).senses("person")
    with pytest.raises(OntologyError, match="noun.exc"):
        list(WordNet(tmp_path).singular_forms("people"))

# SPDX-License-Identifier: BSD-3-Clause
"""The shipped class list and the judgement of names."""

import copy

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from core_perception.exceptions import OntologyError
from core_perception.ontology import SURFACES, WITH_RADIUS, Category, Ontology
from core_perception.predicates import Operator, Verdict, canonical_class_name
from core_perception.reasoners.fixed_reasoner import load_rules


@pytest.fixture(scope="module")
def content(config_dir):
    return yaml.safe_load((config_dir / "ontology.yaml").read_text(encoding="utf-8"))


def test_shipped_list_is_large_and_every_entry_is_consistent(ontology):
    assert len(ontology.vocabulary) >= 120
    for name, known in ontology.classes.items():
        assert known.name == name == canonical_class_name(name)
        assert known.listed
        assert not known.known_by
        assert (known.radius_m is not None) == bool(WITH_RADIUS & set(known.categories)), name
        assert not (known.is_surface and (known.mobile or len(known.categories) > 1)), name
        assert ontology.look_up(name) is known
    for alias, name in ontology.aliases.items():
        assert ontology.canonical(alias) == name
        assert alias not in ontology.classes


def test_every_category_has_classes_and_the_classes_of_the_shipped_worlds_are_listed(ontology):
    for category in Category:
        assert sum(category in known.categories for known in ontology.classes.values()) >= 8, category
    for name in ("floor", "traffic_cone", "storage_rack", "cardboard_box", "pallet", "wall"):
        assert name in ontology.classes


@pytest.mark.parametrize(
    "name, category",
    [
        ("forklift", Category.HAZARD_INDICATOR),
        ("wet_floor_sign", Category.HAZARD_INDICATOR),
        ("person", Category.SOCIAL_ZONE),
        ("nurse", Category.SOCIAL_ZONE),
        ("traffic_cone", Category.SEMANTIC_BARRIER),
        ("cones", Category.SEMANTIC_BARRIER),
        ("grass", Category.NON_NAVIGABLE_SURFACE),
        ("curb", Category.NON_NAVIGABLE_SURFACE),
        ("stairs", Category.NON_NAVIGABLE_SURFACE),
        ("sidewalk", Category.NAVIGABLE_SURFACE),
        ("sidewalk_ramp", Category.NAVIGABLE_SURFACE),
        ("parking_lot", Category.NAVIGABLE_SURFACE),
        ("trash_can", Category.METRIC_OBSTACLE),
        ("vending_machine", Category.METRIC_OBSTACLE),
        ("table", Category.METRIC_OBSTACLE),
    ],
)
def test_classes_of_the_paper_have_their_category(ontology, name, category):
    assert ontology.look_up(name).categories[0] == category


def test_wet_or_slippery_or_unknown_kinds_of_a_navigable_surface_are_not_navigable(ontology):
    surfaces = [n for n, known in ontology.classes.items() if known.categories == (Category.NAVIGABLE_SURFACE,)]
    for surface in surfaces:
        for modifier in ("wet", "slippery", "muddy", "broken", "under_construction", "toxic"):
            known = ontology.look_up(f"{modifier}_{surface}")
            assert Category.NAVIGABLE_SURFACE not in known.categories
            assert not known.listed


@pytest.mark.parametrize("plural, name", [("ladies", "person"), ("women", "person"), ("parcels", "cardboard_box")])
def test_plurals_of_listed_names_are_listed(content, plural, name):
    content = copy.deepcopy(content)
    content["social_zone"]["person"]["aliases"].append("lady")
    assert Ontology.from_dict(content).canonical(plural) == name


@given(st.from_regex(r"[a-z]{1,8}(_[a-z]{1,8}){0,3}", fullmatch=True))
def test_only_a_listed_name_is_ever_navigable(ontology, name):
    known = ontology.look_up(name)
    assert known.listed == (known.name in ontology.classes)
    if Category.NAVIGABLE_SURFACE in known.categories:
        assert known.listed


@pytest.mark.parametrize(
    "name, category, known_by",
    [
        ("qwertz", Category.METRIC_OBSTACLE, ""),
        ("yellow_traffic_cone", Category.SEMANTIC_BARRIER, "its ending traffic_cone"),
        ("polished_floor", Category.NON_NAVIGABLE_SURFACE, "its ending floor"),
        ("leaking_drum", Category.HAZARD_INDICATOR, "the word leaking"),
        ("old_fork_lift", Category.HAZARD_INDICATOR, "its ending forklift"),
    ],
)
def test_an_unlisted_name_is_judged_by_its_words_and_says_so(ontology, name, category, known_by):
    known = ontology.look_up(name)
    assert (known.name, known.categories, known.listed, known.known_by) == (name, (category,), False, known_by)
    assert (known.radius_m is not None) == (category in WITH_RADIUS)


BROKEN = [
    (lambda d: d.pop("social_zone"), "top level"),
    (lambda d: d.update(fun={}), "top level"),
    (lambda d: d["metric_obstacle"].update({"Big Box": {}}), "not canonical"),
    (lambda d: d["metric_obstacle"].update(forklift={}), "written twice"),
    (lambda d: d["metric_obstacle"]["wall"].update(aliases=["floor"]), "written twice"),
    (lambda d: d["metric_obstacle"]["wall"].update(aliases="floor"), "a list of names"),
    (lambda d: d["metric_obstacle"]["wall"].update(radius_m=1.0), "hazard indicators and social zones only"),
    (lambda d: d["hazard_indicator"]["forklift"].update(radius_m=-1.0), "forklift.radius_m"),
    (lambda d: d["hazard_indicator"]["forklift"].update(radius_m=True), "forklift.radius_m"),
    (lambda d: d["hazard_indicator"]["forklift"].update(mobile="yes"), "forklift.mobile"),
    (lambda d: d["hazard_indicator"]["forklift"].update(also="navigable_surface"), "forklift.also"),
    (lambda d: d["hazard_indicator"]["forklift"].update(also="hazard_indicator"), "forklift.also"),
    (lambda d: d["navigable_surface"]["floor"].update(also="hazard_indicator"), "floor.also"),
    (lambda d: d["navigable_surface"]["floor"].update(colour="grey"), "colour"),
    (lambda d: d["radius_m"].pop("social_zone"), "radius_m"),
    (lambda d: d.update(hazard_words="wet"), "hazard_words"),
    (lambda d: d.update(metric_obstacle=[]), "metric_obstacle"),
    (lambda d: d.pop("wordnet"), "top level"),
    (lambda d: d.update(wordnet=[]), "wordnet: got"),
    (lambda d: d["wordnet"].update(navigable_surface={"artifact.floor": {}}), "wordnet: got"),
    (lambda d: d["wordnet"].update(social_zone=["Tops.person"]), "wordnet.social_zone: got"),
    (lambda d: d["wordnet"]["social_zone"].update({"person": {}}), "file.word"),
    (lambda d: d["wordnet"]["social_zone"].update({"verb.person": {}}), "file.word"),
    (lambda d: d["wordnet"]["social_zone"].update({"person.": {}}), "file.word"),
    (lambda d: d["wordnet"]["social_zone"].update({"artifact.vehicle": {}}), "allowed once"),
    (lambda d: d["wordnet"]["social_zone"].update({"person.boy": {"aliases": ["lad"]}}), "aliases"),
    (lambda d: d["wordnet"]["social_zone"].update({"person.boy": {"radius_m": 0}}), "boy.radius_m"),
    (lambda d: d["wordnet"]["metric_obstacle"].update({"food.cake": {"radius_m": 1.0}}), "cake.radius_m"),
]


@pytest.mark.parametrize("spoil, words", BROKEN)
def test_a_list_that_contradicts_itself_is_refused(content, spoil, words):
    data = copy.deepcopy(content)
    spoil(data)
    with pytest.raises(OntologyError, match=words):
        Ontology.from_dict(data)


def test_unreadable_files_are_named(tmp_path):
    for text in (None, "a: [", "- 1", "\0"):
        path = tmp_path / "list.yaml"
        if text is not None:
            path.write_text(text)
        with pytest.raises(OntologyError, match=str(path)) as error:
            Ontology.load(path)
        assert "\n" not in str(error.value)


def test_surfaces_are_never_both(ontology):
    for known in ontology.classes.values():
        assert len(SURFACES & set(known.categories)) in (0, 1)


def test_shipped_static_rules_keep_away_from_signage_and_say_nothing_of_arrangements(config_dir, ontology):
    rules = load_rules(config_dir / "static_rules.yaml")._constraints.predicates
    around = {p.class_name for p in rules if p.operator == Operator.AROUND}
    assert {"wet_floor_sign", "warning_sign"} <= around
    assert all(name.endswith("_sign") for name in around)
    assert not [p for p in rules if p.operator == Operator.BETWEEN]
    safe = {p.class_name for p in rules if p.operator == Operator.ON and p.verdict == Verdict.SAFE}
    navigable = {n for n, known in ontology.classes.items() if known.categories == (Category.NAVIGABLE_SURFACE,)}
    assert safe == navigable


def test_shipped_static_rules_agree_with_the_list(config_dir, ontology):
    constraints = load_rules(config_dir / "static_rules.yaml")._constraints
    for predicate in constraints.predicates:
        known = ontology.look_up(predicate.class_name)
        assert known.listed
        assert (predicate.operator.name == "ON") == known.is_surface
        if predicate.verdict.name == "SAFE":
            assert known.categories == (Category.NAVIGABLE_SURFACE,)

# SPDX-License-Identifier: BSD-3-Clause
"""Class names of public data sets, labelled before the ontology was run on them."""

import hashlib

import pytest
from ontology_bench import DATA_DIR, FIRST_SHOT_RIGHT, NAME_LISTS, judge_names, read_names, run
from wordnet_test import wants_wordnet

from core_perception.ontology import Category, Ontology

# Written down when the labels were, before the first run: a label changed afterwards would be noticed.
LABELLED_SHA256 = {
    "class_names_heldout.csv": "be0aa075be0d41e33a6a09bb67d8199871efd4595b6d0b4187f24d41cd2dcc7b",
    "class_names_heldout_2.csv": "aa78bc47fb1a44c97e635692696a6f1402cb58bb6b5ac0fc7271c509893dec6a",
}


@pytest.mark.parametrize("name", NAME_LISTS)
def test_the_labels_are_those_of_before_the_first_run(name):
    assert hashlib.sha256((DATA_DIR / name).read_bytes()).hexdigest() == LABELLED_SHA256[name]
    categories = {category.value for category in Category}
    rows = read_names(name)
    assert len(rows) >= 100
    assert len({label for label, _ in rows}) == len(rows)
    assert all(accepted and set(accepted) <= categories for _, accepted in rows)


@wants_wordnet
@pytest.mark.parametrize("name", NAME_LISTS)
def test_names_of_public_data_sets_get_their_category_and_no_hazard_is_navigable(ontology, name):
    counts = judge_names(ontology, read_names(name))
    assert counts["right"] >= 0.92 * counts["names"]
    assert counts["rare_right"] >= 0.90 * counts["rare"], "names for which obstacle would be wrong"
    assert counts["called_navigable"] == 0
    assert counts["right"] >= FIRST_SHOT_RIGHT[name]


def test_without_wordnet_no_hazard_is_navigable_either(config_dir, tmp_path):
    ontology = Ontology.load(config_dir / "ontology.yaml", tmp_path)
    for name in NAME_LISTS:
        assert judge_names(ontology, read_names(name))["called_navigable"] == 0


@wants_wordnet
def test_the_bench_reports_every_figure():
    figures = run(trials=10)
    assert figures["names"] == 297
    assert set(figures["accuracy_first_shot"]) == set(NAME_LISTS)
    assert figures["wordnet_problem"] == ""
    assert {"line", "arc", "ring", "corner", "lane", "scatter_3m_worst_count", "scatter_6m_worst_count"} <= set(
        figures["arrangements"]
    )

# SPDX-License-Identifier: BSD-3-Clause
"""Somebody else's label images: checked, named as they were asked for, and never a class that nobody looked for."""

import numpy as np
import pytest

from core_perception.exceptions import EvidenceError, ParameterError
from core_perception.params import SegmenterParams
from core_perception.segmenters.base import GivenLabel, SegmenterFrame, check_segmentation
from core_perception.segmenters.class_map import ClassMap
from core_perception.segmenters.open_names import OpenNames
from core_perception.segmenters.topic import TopicSegmenter

ASKED = ("floor", "traffic_cone", "person", "forklift")


@pytest.fixture()
def segment(ontology):
    def segment(labels, given=None, evaluated=(), class_map=None, asked=ASKED, rules=()):
        segmenter = TopicSegmenter(ontology, OpenNames(ontology), class_map and ClassMap.parse(class_map))
        given = {k: GivenLabel((name,), 0.8) for k, name in given.items()} if given is not None else None
        frame = SegmenterFrame(1, asked, frozenset(rules), frozenset(), None, labels, given, tuple(evaluated))
        segmentation = segmenter.segment(frame)
        check_segmentation(segmentation)
        return segmentation

    return segment


@pytest.fixture()
def labels():
    labels = np.full((12, 20), 7, np.uint16)
    labels[4:8, 2:5] = 300
    labels[4:8, 12:15] = 301
    return labels


GIVEN = {7: "floor", 300: "pylon", 301: "dragon"}


def test_labels_and_scores_are_kept_and_classes_get_the_names_that_were_asked(segment, labels):
    segmentation = segment(labels, GIVEN)
    assert (segmentation.labels == labels).all()
    assert [(m.label, m.class_name, m.score) for m in segmentation.masks] == [
        (7, "floor", 0.8),
        (300, "traffic_cone", 0.8),
        (301, "dragon", 0.8),  # theirs: nobody asked
    ]


def test_only_what_they_looked_for_is_evaluated(segment, labels):
    segmentation = segment(labels, GIVEN, evaluated=["people", "road"])
    assert set(segmentation.classes_evaluated) == {"floor", "traffic_cone", "dragon", "person", "road"}
    assert segmentation.not_evaluated(ASKED) == ("forklift",)
    assert segment(labels, GIVEN).not_evaluated(ASKED) == ("person", "forklift")


def test_of_two_names_that_mean_the_same_only_the_one_that_is_used_is_evaluated(segment, labels):
    asked = ("traffic_cone", "pylon", "floor")
    assert segment(labels, GIVEN, asked=asked).not_evaluated(asked) == ("traffic_cone",)
    by_rule = segment(labels, GIVEN, asked=asked, rules=["traffic_cone"])
    assert by_rule.not_evaluated(asked) == ("pylon",)


def test_a_label_that_the_image_does_not_show_is_no_instance_but_was_looked_for(segment, labels):
    segmentation = segment(labels, {**GIVEN, 9: "person"})
    assert "person" in segmentation.classes_evaluated
    assert len(segmentation.masks) == 3


@pytest.mark.parametrize(
    "spoil",
    [
        lambda labels: labels.astype(np.float32),
        lambda labels: labels.astype(np.int64),
        lambda labels: labels[:, :, None],
        lambda labels: labels[:0],
        lambda labels: labels + 1,
    ],
)
def test_an_image_of_another_kind_or_with_a_label_that_is_not_explained_is_refused(segment, labels, spoil):
    with pytest.raises(EvidenceError, match="labels: got"):
        segment(spoil(labels), GIVEN)


CLASS_MAP = ["0=floor", "11=Traffic-Cones", "12=person", "255=none"]


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_separate_objects_of_a_class_become_instances_and_a_surface_is_one(segment, kind):
    values = np.zeros((12, 20), kind)
    values[:3] = 255
    values[:, 10] = 255  # cuts the floor in two
    values[5:8, 2:5] = values[5:8, 12:15] = 11
    values[8, 5] = 11  # touches by its corner
    segmentation = segment(values, class_map=CLASS_MAP)
    assert sorted(mask.class_name for mask in segmentation.masks) == ["floor", "traffic_cone", "traffic_cone"]
    assert ((segmentation.labels == 0) == (values == 255)).all()
    by_name = {mask.class_name: mask.label for mask in segmentation.masks}
    assert ((segmentation.labels == by_name["floor"]) == (values == 0)).all()
    assert segmentation.labels[6, 3] == segmentation.labels[8, 5] != segmentation.labels[6, 13]
    assert segmentation.classes_evaluated == ("floor", "traffic_cone", "person")
    assert segmentation.not_evaluated(ASKED) == ("forklift",)


def test_a_value_that_is_not_in_the_class_map_is_refused(segment):
    with pytest.raises(EvidenceError, match="got value 3"):
        segment(np.array([[0, 3]], np.uint8), class_map=CLASS_MAP)


def test_more_objects_than_labels_are_refused(segment):
    values = np.full((600, 600), 255, np.uint8)
    values[::2, ::2] = 11
    with pytest.raises(EvidenceError, match="more than 65535"):
        segment(values, class_map=CLASS_MAP)


@pytest.mark.parametrize(
    "entries",
    ["11=person", [11], ["person"], ["=person"], ["11="], ["-1=person"], ["65536=person"], ["1.0=person"]]
    + [["11=person", "11=floor"], ["11=none", "11=floor"], ["11=9lives"], ["\u0661=person"], ["11=" + "a" * 80], None],
)
def test_a_class_map_that_is_none_is_refused(entries):
    with pytest.raises(ParameterError) as error:
        SegmenterParams.from_dict({"class_map": entries})
    assert error.value.key == "class_map"

# SPDX-License-Identifier: BSD-3-Clause
"""The simulated segmenter: only what is asked, by the name it is asked by."""

import numpy as np
import pytest

from core_perception.exceptions import EvidenceError
from core_perception.segmenters.simulated import SimulatedSegmenter

CLASSES = {1: "floor", 7: "traffic_cone", 8: "traffic_cone", 9: "storage_rack", 12: "unicorn"}


@pytest.fixture()
def truth():
    labels = np.ones((30, 50), np.uint16)
    labels[:5] = 0
    for k, label in enumerate((7, 8, 9, 12)):
        labels[10:20, 3 + 12 * k : 11 + 12 * k] = label
    return labels


def names(segmentation):
    return sorted(mask.class_name for mask in segmentation.masks)


def mask_of(segmentation, index):
    return segmentation.labels == segmentation.masks[index].label


def test_a_class_that_was_not_asked_is_never_returned(ontology, truth):
    segmentation = SimulatedSegmenter(ontology).segment(truth, CLASSES, ["traffic_cone", "forklift"], 0)
    assert names(segmentation) == ["traffic_cone", "traffic_cone"]
    assert segmentation.classes_evaluated == ("traffic_cone", "forklift")
    assert set(np.unique(segmentation.labels)) == {0} | {mask.label for mask in segmentation.masks}
    assert ((segmentation.labels > 0) == np.isin(truth, [7, 8])).all()


@pytest.mark.parametrize("asked", ["cone", "Safety Cone", "pylon", "traffic_cones"])
def test_an_alias_finds_the_object_and_gives_its_own_name_back(ontology, truth, asked):
    segmentation = SimulatedSegmenter(ontology).segment(truth, CLASSES, [asked], 0)
    assert names(segmentation) == [asked.lower().replace(" ", "_")] * 2


def test_an_alias_in_the_world_is_found_by_the_canonical_name(ontology, truth):
    segmentation = SimulatedSegmenter(ontology).segment(truth, {**CLASSES, 9: "pallet_rack"}, ontology.vocabulary, 0)
    assert names(segmentation) == ["floor", "storage_rack", "traffic_cone", "traffic_cone"]


def test_a_class_that_nobody_knows_is_found_by_its_own_name_only(ontology, truth):
    segmenter = SimulatedSegmenter(ontology)
    assert "unicorn" not in names(segmenter.segment(truth, CLASSES, ontology.vocabulary, 0))
    assert names(segmenter.segment(truth, CLASSES, ["unicorn"], 0)) == ["unicorn"]


def test_the_own_name_comes_first_then_the_first_asked(ontology, truth):
    segmenter = SimulatedSegmenter(ontology)
    assert names(segmenter.segment(truth, CLASSES, ["cone", "traffic_cone"], 0)) == ["traffic_cone"] * 2
    assert names(segmenter.segment(truth, CLASSES, ["pylon", "cone"], 0)) == ["pylon"] * 2


def test_label_numbers_change_from_frame_to_frame_and_masks_do_not(ontology, truth):
    segmenter = SimulatedSegmenter(ontology)
    frames = [segmenter.segment(truth, CLASSES, ontology.vocabulary, k * 100_000_000) for k in range(8)]
    numbering = {tuple(frame.labels[15, [5, 17, 29]]) for frame in frames}
    assert len(numbering) == 8
    for frame in frames:
        assert ((frame.labels > 0) == np.isin(truth, [1, 7, 8, 9])).all()
        assert len(np.unique(frame.labels[frame.labels > 0])) == 4


def test_the_same_seed_and_stamp_repeat_every_error(ontology, truth):
    spoiled = [
        SimulatedSegmenter(ontology, 3, 0.5, 0.2, 1).segment(truth, CLASSES, ontology.vocabulary, 77) for _ in range(2)
    ]
    assert (spoiled[0].labels == spoiled[1].labels).all()
    assert spoiled[0].masks == spoiled[1].masks
    other = SimulatedSegmenter(ontology, 4, 0.5, 0.2, 1).segment(truth, CLASSES, ontology.vocabulary, 77)
    assert (other.labels != spoiled[0].labels).any()


def test_miss_rate_is_the_share_of_instances_missed(ontology, truth):
    segmenter = SimulatedSegmenter(ontology, miss_rate=0.3)
    found = [len(segmenter.segment(truth, CLASSES, ontology.vocabulary, k).masks) for k in range(300)]
    assert np.mean(found) / 4 == pytest.approx(0.7, abs=0.05)
    assert SimulatedSegmenter(ontology, miss_rate=1.0).segment(truth, CLASSES, ["floor"], 0).masks == ()


@pytest.mark.parametrize("missed", ["traffic_cone", "pylon"])
def test_a_missed_class_is_never_found_though_it_was_looked_for(ontology, truth, missed):
    segmenter = SimulatedSegmenter(ontology, missed_classes=[missed])
    segmentation = segmenter.segment(truth, CLASSES, [*ontology.vocabulary, "cone"], 0)
    assert names(segmentation) == ["floor", "storage_rack"]
    assert {"traffic_cone", "cone"} <= set(segmentation.classes_evaluated)
    assert not segmentation.labels[np.isin(truth, [7, 8])].any()


def test_dropped_pixels_and_erosion_shrink_masks(ontology, truth):
    dropped = SimulatedSegmenter(ontology, pixel_drop_rate=0.25).segment(truth, CLASSES, ["floor"], 0)
    assert mask_of(dropped, 0).sum() / (truth == 1).sum() == pytest.approx(0.75, abs=0.05)
    eroded = SimulatedSegmenter(ontology, erode_px=2).segment(truth, CLASSES, ["storage_rack"], 0)
    assert mask_of(eroded, 0).sum() == (10 - 4) * (8 - 4)


@pytest.mark.parametrize(
    "labels", [np.ones((4, 4), np.int32), np.ones((4, 4, 1), np.uint16), np.full((4, 4), 99, np.uint16)]
)
def test_labels_without_a_class_or_of_another_type_are_refused(ontology, labels):
    with pytest.raises(EvidenceError, match="ground truth labels"):
        SimulatedSegmenter(ontology).segment(labels, CLASSES, ["floor"], 0)

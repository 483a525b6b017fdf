# SPDX-License-Identifier: BSD-3-Clause
"""The simulated segmenter: only what is asked, by the name it is asked by."""

import numpy as np
import pytest

from core_perception.exceptions import EvidenceError
from core_perception.predicates import canonical_class_name
from core_perception.segmenters.base import GivenLabel, Mask, Segmentation, SegmenterFrame, check_segmentation
from core_perception.segmenters.label_errors import LabelErrors
from core_perception.segmenters.open_names import OpenNames
from core_perception.segmenters.simulated import SimulatedSegmenter

CLASSES = {1: "floor", 7: "traffic_cone", 8: "traffic_cone", 9: "storage_rack", 12: "unicorn"}
SPOILED = {
    "miss_rate": 0.5,
    "false_positive_rate": 0.5,
    "pixel_drop_rate": 0.2,
    "erode_px": 1,
    "dilate_px": 2,
    "boundary_noise_px": 2,
}


@pytest.fixture()
def truth():
    labels = np.ones((30, 50), np.uint16)
    labels[:5] = 0
    for k, label in enumerate((7, 8, 9, 12)):
        labels[10:20, 3 + 12 * k : 11 + 12 * k] = label
    return labels


@pytest.fixture()
def segment(ontology):
    """Segment a truth; errors of the segmenter by their names."""
    names = OpenNames(ontology)

    def segment(truth, classes, asked, stamp_ns, seed=0, rules=(), **errors):
        asked = tuple(dict.fromkeys(canonical_class_name(name) for name in asked))
        given = {
            label: GivenLabel(tuple([words] if isinstance(words, str) else words)) for label, words in classes.items()
        }
        frame = SegmenterFrame(stamp_ns, asked, frozenset(rules), frozenset(), None, truth, given)
        segmentation = SimulatedSegmenter(ontology, names, seed, LabelErrors(**errors)).segment(frame)
        check_segmentation(segmentation)
        return segmentation

    return segment


def names(segmentation):
    return sorted(mask.class_name for mask in segmentation.masks)


def mask_of(segmentation, index):
    return segmentation.labels == segmentation.masks[index].label


def test_a_class_that_was_not_asked_is_never_returned(segment, ontology, truth):
    segmentation = segment(truth, CLASSES, ["traffic_cone", "forklift"], 0)
    assert names(segmentation) == ["traffic_cone", "traffic_cone"]
    assert segmentation.classes_evaluated == ("traffic_cone", "forklift")
    assert set(np.unique(segmentation.labels)) == {0} | {mask.label for mask in segmentation.masks}
    assert ((segmentation.labels > 0) == np.isin(truth, [7, 8])).all()


@pytest.mark.parametrize("asked", ["cone", "Safety Cone", "pylon", "traffic_cones"])
def test_an_alias_finds_the_object_and_gives_its_own_name_back(segment, ontology, truth, asked):
    segmentation = segment(truth, CLASSES, [asked], 0)
    assert names(segmentation) == [asked.lower().replace(" ", "_")] * 2


def test_an_alias_in_the_world_is_found_by_the_canonical_name(segment, ontology, truth):
    segmentation = segment(truth, {**CLASSES, 9: "pallet_rack"}, ontology.vocabulary, 0)
    assert names(segmentation) == ["floor", "storage_rack", "traffic_cone", "traffic_cone"]


def test_a_class_that_nobody_knows_is_found_by_its_own_name_only(segment, ontology, truth):
    assert "unicorn" not in names(segment(truth, CLASSES, ontology.vocabulary, 0))
    assert names(segment(truth, CLASSES, ["unicorn"], 0)) == ["unicorn"]


def test_the_own_name_comes_first_then_the_first_asked(segment, ontology, truth):
    assert names(segment(truth, CLASSES, ["cone", "traffic_cone"], 0)) == ["traffic_cone"] * 2
    assert names(segment(truth, CLASSES, ["pylon", "cone"], 0)) == ["pylon"] * 2


def test_label_numbers_change_from_frame_to_frame_and_masks_do_not(segment, ontology, truth):
    frames = [segment(truth, CLASSES, ontology.vocabulary, k * 100_000_000) for k in range(8)]
    numbering = {tuple(frame.labels[15, [5, 17, 29]]) for frame in frames}
    assert len(numbering) == 8
    for frame in frames:
        assert ((frame.labels > 0) == np.isin(truth, [1, 7, 8, 9])).all()
        assert len(np.unique(frame.labels[frame.labels > 0])) == 4


def test_the_same_seed_and_stamp_repeat_every_error(segment, ontology, truth):
    spoiled = [segment(truth, CLASSES, ontology.vocabulary, 77, 3, **SPOILED) for _ in range(2)]
    assert (spoiled[0].labels == spoiled[1].labels).all()
    assert spoiled[0].masks == spoiled[1].masks
    other = segment(truth, CLASSES, ontology.vocabulary, 77, 4, **SPOILED)
    assert (other.labels != spoiled[0].labels).any()


def test_miss_rate_is_the_share_of_instances_missed(segment, ontology, truth):
    found = [len(segment(truth, CLASSES, ontology.vocabulary, k, miss_rate=0.3).masks) for k in range(300)]
    assert np.mean(found) / 4 == pytest.approx(0.7, abs=0.05)
    assert segment(truth, CLASSES, ["floor"], 0, miss_rate=1.0).masks == ()


@pytest.mark.parametrize("missed", ["traffic_cone", "pylon"])
def test_a_missed_class_is_never_found_though_it_was_looked_for(segment, ontology, truth, missed):
    segmentation = segment(truth, CLASSES, [*ontology.vocabulary, "cone"], 0, missed_classes=(missed,))
    assert names(segmentation) == ["floor", "storage_rack"]
    assert {"traffic_cone", "cone"} <= set(segmentation.classes_evaluated)
    assert not segmentation.labels[np.isin(truth, [7, 8])].any()


def test_dropped_pixels_and_erosion_shrink_masks(segment, ontology, truth):
    dropped = segment(truth, CLASSES, ["floor"], 0, pixel_drop_rate=0.25)
    assert mask_of(dropped, 0).sum() / (truth == 1).sum() == pytest.approx(0.75, abs=0.05)
    eroded = segment(truth, CLASSES, ["storage_rack"], 0, erode_px=2)
    assert mask_of(eroded, 0).sum() == (10 - 4) * (8 - 4)


@pytest.mark.parametrize(
    "labels", [np.ones((4, 4), np.int32), np.ones((4, 4, 1), np.uint16), np.full((4, 4), 99, np.uint16)]
)
def test_labels_without_a_class_or_of_another_type_are_refused(segment, labels):
    with pytest.raises(EvidenceError, match="truth labels"):
        segment(labels, CLASSES, ["floor"], 0)


@pytest.mark.parametrize("asked", ["Unicorns", "uni-corn", "UNICORN", "monoceros", "horned horse", "horned_horses"])
def test_an_alias_of_the_world_is_found_in_any_spelling_and_gives_the_asked_name_back(segment, truth, asked):
    classes = {**CLASSES, 12: ("unicorn", "monoceros", "uni_corn", "horned_horse")}
    assert names(segment(truth, classes, ["floor", asked], 0)) == ["floor", canonical_class_name(asked)]


def test_a_name_that_a_rule_speaks_of_comes_before_the_class(segment, ontology, truth):
    classes = {**CLASSES, 9: ("storage_rack", "wire_cage")}
    asked = ["wire_cage", *ontology.vocabulary]
    assert "storage_rack" in names(segment(truth, classes, asked, 0))
    assert "wire_cage" in names(segment(truth, classes, asked, 0, rules=["wire_cage"]))
    both = segment(truth, classes, asked, 0, rules=["wire_cage", "storage_rack"])
    assert "storage_rack" in names(both)


def test_a_ghost_of_a_class_that_was_asked_appears_at_its_rate(segment, truth):
    asked = ["floor", "traffic_cone", "dragon"]
    frames = [segment(truth, CLASSES, asked, k, false_positive_rate=0.4) for k in range(400)]
    exact = [segment(truth, CLASSES, asked, k) for k in range(400)]
    haunted = [frame for frame, plain in zip(frames, exact) if (frame.labels != plain.labels).any()]
    assert len(haunted) / 400 == pytest.approx(0.4, abs=0.08)
    ghosts = [mask.class_name for frame in frames for mask in frame.masks if mask.class_name == "dragon"]
    assert len(ghosts) == pytest.approx(0.4 * 400 / 3, abs=25)  # each of the three as often
    assert segment(truth, CLASSES, [], 0, false_positive_rate=1.0).masks == ()


def test_a_missed_class_has_no_ghosts(segment, truth):
    for k in range(50):
        frame = segment(truth, CLASSES, ["cone", "dragon"], k, false_positive_rate=1.0, missed_classes=("pylon",))
        assert set(names(frame)) == {"dragon"}


def test_grown_objects_cover_surfaces_and_surfaces_only_nothing(segment, truth):
    grown = segment(truth, CLASSES, ["storage_rack", "floor"], 0, dilate_px=2)
    rack = mask_of(grown, [mask.class_name for mask in grown.masks].index("storage_rack"))
    assert rack.sum() == (10 + 4) * (8 + 4)
    floor = mask_of(grown, [mask.class_name for mask in grown.masks].index("floor"))
    assert floor[3:5].all()  # over what had no label
    assert not floor[:3].any()
    assert not (floor & (truth == 9)).any()


def test_edges_wander_at_most_as_far_as_asked_and_not_at_random_pixels(segment, truth):
    frayed = segment(truth, CLASSES, ["storage_rack"], 5, boundary_noise_px=3)
    rack = mask_of(frayed, 0)
    assert (rack != (truth == 9)).any()
    assert rack[13:17, 30:32].all()  # three pixels within
    outside = np.ones_like(rack)
    outside[7:23, 24:38] = False
    assert not rack[outside].any()
    rows = rack[10:20].astype(int)
    assert (np.abs(np.diff(rows, axis=1)).sum(axis=1) == 2).all()  # in one piece, row by row


def test_new_errors_do_not_change_the_random_numbers_of_the_old_ones(segment, ontology, truth):
    plain = segment(truth, CLASSES, ontology.vocabulary, 9, miss_rate=0.4, pixel_drop_rate=0.3)
    more = segment(truth, CLASSES, ontology.vocabulary, 9, miss_rate=0.4, pixel_drop_rate=0.3, false_positive_rate=1.0)
    assert plain.masks == tuple(mask for mask in more.masks if mask.label <= max(m.label for m in plain.masks))
    assert ((more.labels == plain.labels) | (more.labels == max(mask.label for mask in more.masks))).all()


@pytest.mark.parametrize(
    "labels, masks",
    [
        (np.zeros((2, 2), np.int32), []),
        (np.zeros((2, 2, 1), np.uint16), []),
        (np.zeros((0, 2), np.uint16), []),
        (np.ones((2, 2), np.uint16), []),  # a label without a mask
        (np.zeros((2, 2), np.uint16), [Mask(1, "floor")]),  # a mask without a pixel
        (np.ones((2, 2), np.uint16), [Mask(1, "floor"), Mask(1, "wall")]),
        (np.ones((2, 2), np.uint16), [Mask(1, "floor", 1.1)]),
        (np.ones((2, 2), np.uint16), [Mask(1, "floor", float("nan"))]),
    ],
)
def test_labels_and_masks_that_do_not_say_the_same_are_refused_whoever_made_them(labels, masks):
    check_segmentation(Segmentation(np.ones((2, 2), np.uint16), (Mask(1, "floor", 0.0),), ()))
    with pytest.raises(EvidenceError, match="segmentation: "):
        check_segmentation(Segmentation(labels, tuple(masks), ("floor", "wall")))


def test_what_was_asked_and_not_evaluated_is_told_in_order():
    segmentation = Segmentation(np.zeros((1, 1), np.uint16), (), ("wall",))
    assert segmentation.not_evaluated(("person", "wall", "floor")) == ("person", "floor")

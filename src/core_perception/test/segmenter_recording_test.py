# SPDX-License-Identifier: BSD-3-Clause
"""Record and replay of segmentations: bit for bit, failures too, and damaged files refused."""

import json

import numpy as np
import pytest

from core_perception.exceptions import EvidenceError, PerceptionError, ServerError
from core_perception.segmenters.base import Mask, Segmentation, Segmenter, SegmenterFrame
from core_perception.segmenters.recording import FILE_NAME, RecordingSegmenter, ReplaySegmenter


class Scripted(Segmenter):
    source = "scripted"

    def __init__(self, *outcomes):
        self._outcomes = list(outcomes)

    def segment(self, frame):
        outcome = self._outcomes.pop(0)
        if isinstance(outcome, Exception):
            raise outcome
        return outcome


def image(shade):
    return np.full((6, 8, 3), shade, np.uint8)


def frame(stamp_ns, shade=0):
    return SegmenterFrame(stamp_ns, ("floor", "person"), image=image(shade))


def segmentation(seed, latency_s=0.25):
    labels = np.random.default_rng(seed).choice(np.array([0, 5, 900, 65535], np.uint16), (6, 8))
    masks = (Mask(5, "floor"), Mask(900, "person", 0.1 + 0.2), Mask(65535, "person", 0.5))
    return Segmentation(labels, masks, ("floor", "person"), latency_s)


def record(folder, *frames):
    recorder = RecordingSegmenter(Scripted(*(outcome for _, outcome in frames)), folder)
    for asked, outcome in frames:
        if isinstance(outcome, Exception):
            with pytest.raises(type(outcome)):
                recorder.segment(asked)
        else:
            assert recorder.segment(asked) is outcome
    recorder._record.close()


def same(one, other):
    return (
        (one.labels == other.labels).all()
        and one.labels.dtype == other.labels.dtype
        and (
            (one.masks, one.classes_evaluated, one.latency_s) == (other.masks, other.classes_evaluated, other.latency_s)
        )
    )


@pytest.mark.parametrize("by", ["stamp", "hash"])
def test_a_replay_gives_every_bit_back(tmp_path, by):
    record(tmp_path, *((frame(k, k), segmentation(k)) for k in range(5)))
    replay = ReplaySegmenter(tmp_path, by)
    for k in (3, 0, 4, 1, 2):
        asked = frame(k, 77) if by == "stamp" else frame(123, k)
        assert same(replay.segment(asked), segmentation(k))


def test_failures_are_replayed_with_their_cause(tmp_path):
    failures = [ServerError("timeout", "no whole reply", 2.0), EvidenceError("reply: size: got [1, 2]")]
    record(tmp_path, *((frame(k), failure) for k, failure in enumerate(failures)))
    replay = ReplaySegmenter(tmp_path)
    with pytest.raises(ServerError) as error:
        replay.segment(frame(0))
    assert (error.value.cause, str(error.value), error.value.latency_s) == ("timeout", "timeout: no whole reply", 2.0)
    with pytest.raises(ServerError, match="refused: reply: size: got"):
        replay.segment(frame(1))


def test_a_frame_that_came_twice_is_answered_in_order_and_then_by_the_last(tmp_path):
    record(tmp_path, (frame(7), segmentation(1)), (frame(7), segmentation(2)))
    replay = ReplaySegmenter(tmp_path)
    for seed in (1, 2, 2):
        assert same(replay.segment(frame(7)), segmentation(seed))


@pytest.mark.parametrize("asked, by", [(frame(8), "stamp"), (frame(7, 9), "hash")])
def test_what_was_not_recorded_has_no_answer(tmp_path, asked, by):
    record(tmp_path, (frame(7), segmentation(1)))
    with pytest.raises(ServerError) as error:
        ReplaySegmenter(tmp_path, by).segment(asked)
    assert error.value.cause == "not_recorded"


def test_a_recording_of_another_image_size_has_no_answer(tmp_path):
    record(tmp_path, (frame(7), segmentation(1)))
    large = SegmenterFrame(7, (), image=np.zeros((60, 80, 3), np.uint8))
    with pytest.raises(ServerError, match="not_recorded"):
        ReplaySegmenter(tmp_path).segment(large)


def test_a_recording_without_hashes_cannot_be_gone_through_by_hash(tmp_path):
    record(tmp_path, (SegmenterFrame(7, ()), segmentation(1)))
    assert same(ReplaySegmenter(tmp_path).segment(frame(7)), segmentation(1))
    with pytest.raises(PerceptionError, match="replay_by: stamp"):
        ReplaySegmenter(tmp_path, "hash")


def test_a_torn_line_is_ignored_and_told_and_cut_off_by_the_next_recording(tmp_path):
    record(tmp_path, (frame(1), segmentation(1)), (frame(2), segmentation(2)))
    path = tmp_path / FILE_NAME
    path.write_bytes(path.read_bytes()[:-20])
    replay = ReplaySegmenter(tmp_path)
    assert "torn" in replay.warning
    assert same(replay.segment(frame(1)), segmentation(1))
    record(tmp_path, (frame(3), segmentation(3)))
    replay = ReplaySegmenter(tmp_path)
    assert replay.warning == ""
    assert same(replay.segment(frame(3)), segmentation(3))


def test_no_recording_and_a_recording_in_use_are_refused(tmp_path):
    with pytest.raises(PerceptionError, match="cannot be read"):
        ReplaySegmenter(tmp_path)
    keep = RecordingSegmenter(Scripted(), tmp_path)
    with pytest.raises(PerceptionError, match="another process"):
        RecordingSegmenter(Scripted(), tmp_path)
    assert keep.source == "scripted"


def mask(**changed):
    return {"label": 1, "class": "floor", "score": 1.0, "counts": [0, 48], **changed}


DAMAGED = [
    {"format_version": 2},
    {"stamp_ns": -1},
    {"stamp_ns": True},
    {"stamp_ns": 1.5},
    {"image_sha256": "0"},
    {"image_sha256": 7},
    {"latency_s": -1},
    {"latency_s": "0"},
    {"source": None},
    {"more": 1},
    {"size": [6]},
    {"size": [0, 8]},
    {"size": [6, 10**9]},
    {"size": [6.0, 8]},
    {"classes_evaluated": ["Not Canonical"]},
    {"classes_evaluated": [None]},
    {"masks": {}},
    {"masks": [1]},
    {"masks": [mask(label=0)]},
    {"masks": [mask(label=65536)]},
    {"masks": [mask(score=2)]},
    {"masks": [mask(score=None)]},
    {"masks": [{**mask(), "class": "9"}]},
    {"masks": [mask(counts=[0, 47])]},
    {"masks": [mask(counts="048")]},
    {"masks": [mask(), mask(counts=[47, 1])]},
    {"masks": [mask(label=2, counts=[40, 8]), mask(label=1, counts=[0, 8, 40])]},
]


@pytest.mark.parametrize("changed", DAMAGED)
def test_a_damaged_line_is_refused_with_file_and_line(tmp_path, changed):
    record(tmp_path, (frame(1), segmentation(1)), (frame(2), segmentation(2)))
    path = tmp_path / FILE_NAME
    first, second = path.read_text().splitlines()
    path.write_text(f"{first}\n{json.dumps({**json.loads(second), **changed})}\n")
    for begin in (lambda: ReplaySegmenter(tmp_path), lambda: RecordingSegmenter(Scripted(), tmp_path)):
        with pytest.raises(PerceptionError, match=f"{FILE_NAME}:2: no line of a recording") as error:
            begin()
        assert "\n" not in str(error.value)


@pytest.mark.parametrize("masks", [[mask(), mask(label=2, counts=[40, 8])], [mask(counts=[48])]])
def test_masks_that_overlap_or_are_empty_give_no_answer(tmp_path, masks):
    record(tmp_path, (frame(1), segmentation(1)))
    path = tmp_path / FILE_NAME
    path.write_text(json.dumps({**json.loads(path.read_text()), "masks": masks}) + "\n")
    with pytest.raises(EvidenceError, match="recording"):
        ReplaySegmenter(tmp_path).segment(frame(1))

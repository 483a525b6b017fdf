# SPDX-License-Identifier: BSD-3-Clause
"""Records what a segmenter answered, and answers from a recording without the segmenter.

``segmentations.jsonl`` in a folder, one JSON object a line, in the order of the frames:

    format_version   1
    stamp_ns         of the frame [ns]
    image_sha256     of data type, shape and pixels of the colour image; null where the segmenter read none
    source           which segmenter
    latency_s        of the answer or of the failure [s]
    size, masks, classes_evaluated     of an answer: height and width [px]; label, class, score and run lengths (rle.py)
    error_cause, error_detail          of a failure, instead of those

No pixel of the camera is kept.
"""

from __future__ import annotations

import json
from collections import defaultdict
from pathlib import Path
from typing import Any, Dict, List, Optional, Tuple, Union

import numpy as np

from core_perception.exceptions import EvidenceError, PerceptionError, PredicateError, ServerError
from core_perception.predicates import canonical_class_name
from core_perception.reasoners.recording import hash_image
from core_perception.record_file import RecordFile, load_lines
from core_perception.segmenters.base import (
    IMAGE,
    MAX_LABEL,
    Mask,
    Segmentation,
    Segmenter,
    SegmenterFrame,
)
from core_perception.segmenters.rle import decode_mask, encode_mask, read_runs

FORMAT_VERSION = 1
FILE_NAME = "segmentations.jsonl"
MAX_EDGE_PX = 16384
_COMMON = {"format_version", "stamp_ns", "image_sha256", "source", "latency_s"}
_ANSWER = _COMMON | {"size", "masks", "classes_evaluated"}
_FAILURE = _COMMON | {"error_cause", "error_detail"}
_HASH_CHARS = frozenset("0123456789abcdef")

#: The line of a segmentation, whose masks are read when they are wanted; or cause, detail and latency [s] of a failure.
Outcome = Union[bytes, Tuple[str, str, float]]


class RecordingSegmenter(Segmenter):
    """Hands every frame to a segmenter and writes down what comes of it."""

    def __init__(self, segmenter: Segmenter, directory):
        """Open the folder's file, or make both.

        Args:
            segmenter: which one.
            directory: folder of the recording; further frames are added to one that is there.

        Raises:
            PerceptionError: as RecordFile.
        """
        self._segmenter = segmenter
        self._record = RecordFile(Path(directory) / FILE_NAME, _read_line)
        self.source, self.reads, self.reads_truth = segmenter.source, segmenter.reads, segmenter.reads_truth
        self.is_slow, self.is_held_back = segmenter.is_slow, segmenter.is_held_back

    @property
    def warning(self) -> str:
        """That of the segmenter."""
        return self._segmenter.warning

    def close(self) -> None:
        """Close the segmenter; the file is closed with the process, so that no frame under way is lost."""
        self._segmenter.close()

    def segment(self, frame: SegmenterFrame) -> Segmentation:
        """Ask the segmenter, and write its answer or failure down before it is handed on.

        Raises:
            PerceptionError: as the segmenter.
            ServerError: record_failed, it could not be written: a run with a gap in its recording would not repeat.
        """
        try:
            segmentation = self._segmenter.segment(frame)
        except PerceptionError as error:
            cause = getattr(error, "cause", "refused")
            detail = str(error)[len(cause) + 2 :] if isinstance(error, ServerError) else str(error)
            self._write(frame, {"error_cause": cause, "error_detail": detail}, getattr(error, "latency_s", 0.0))
            raise
        self._write(frame, _describe(segmentation), segmentation.latency_s)
        return segmentation

    def _write(self, frame: SegmenterFrame, entry: Dict[str, Any], latency_s: float) -> None:
        common = {
            "format_version": FORMAT_VERSION,
            "stamp_ns": frame.stamp_ns,
            "image_sha256": hash_image(frame.image),
            "source": self.source,
            "latency_s": latency_s,
        }
        line = json.dumps({**common, **entry}).encode()
        try:
            _read_line(line)  # one line that cannot be read would make the whole recording useless
            self._record.append(line)
        except (OSError, ValueError) as error:
            raise ServerError("record_failed", str(error), latency_s) from error


class ReplaySegmenter(Segmenter):
    """Answers from a recording, by stamp or by hash of the image; whatever is asked now, it tells what was asked then.

    The same frame gets its recorded outcomes in their order, failures too, and then the last one again.
    """

    source = "replay"
    reads = frozenset((IMAGE,))

    def __init__(self, directory, by: str = "stamp", is_held_back: bool = False):
        """Read the whole recording.

        Args:
            directory: folder of the recording.
            by: ``stamp`` or ``hash``.
            is_held_back: an answer comes as late as it was recorded; False where the world waits.

        Raises:
            PerceptionError: no recording there, a damaged line, or no hashes to go by; the message names the file.
        """
        path = Path(directory) / FILE_NAME
        lines, self._torn_lines = load_lines(path, _read_line)
        self._by, self.is_slow, self.is_held_back = by, is_held_back, is_held_back
        self._outcomes: Dict[Any, List[Outcome]] = defaultdict(list)
        for stamp_ns, image_hash, outcome in lines:
            self._outcomes[stamp_ns if by == "stamp" else image_hash].append(outcome)
        if by == "hash" and (None in self._outcomes or not lines):
            raise PerceptionError(f"{path}: has frames without image_sha256; allowed: replay_by: stamp")
        self._asked: Dict[Any, int] = defaultdict(int)

    @property
    def warning(self) -> str:
        """Say so where the recording ends within a line."""
        return "the last line of the recording was torn off and is ignored" if self._torn_lines else ""

    def segment(self, frame: SegmenterFrame) -> Segmentation:
        """Return what was recorded.

        Raises:
            ServerError: the recorded failure; not_recorded, there is no such frame in the recording.
            EvidenceError: masks of the recording overlap.
        """
        key = frame.stamp_ns if self._by == "stamp" else hash_image(frame.image)
        if key not in self._outcomes:
            raise ServerError("not_recorded", f"{self._by} {key if self._by == 'stamp' else key[:12]}")
        outcomes = self._outcomes[key]
        outcome = outcomes[min(self._asked[key], len(outcomes) - 1)]
        self._asked[key] += 1
        if not isinstance(outcome, bytes):
            raise ServerError(*outcome)
        segmentation = _decode(json.loads(outcome.decode("ascii")))
        if segmentation.labels.shape != frame.image.shape[:2]:
            raise ServerError("not_recorded", f"{segmentation.labels.shape} recorded, {frame.image.shape[:2]} now")
        return segmentation


def _describe(segmentation: Segmentation) -> Dict[str, Any]:
    masks = [
        {
            "label": mask.label,
            "class": mask.class_name,
            "score": mask.score,
            "counts": encode_mask(segmentation.labels == mask.label),
        }
        for mask in segmentation.masks
    ]
    evaluated = list(segmentation.classes_evaluated)
    return {"size": list(segmentation.labels.shape), "masks": masks, "classes_evaluated": evaluated}


def _read_line(line: bytes) -> Tuple[int, Optional[str], Outcome]:
    entry = json.loads(line.decode("ascii"))
    if not isinstance(entry, dict) or set(entry) not in (_ANSWER, _FAILURE):
        raise ValueError(f"allowed exactly {', '.join(sorted(_ANSWER))} or {', '.join(sorted(_FAILURE))}")
    if entry["format_version"] != FORMAT_VERSION:
        raise ValueError(f"format_version: got {entry['format_version']!r}, allowed {FORMAT_VERSION}")
    stamp_ns, image_hash, latency_s = (entry[name] for name in ("stamp_ns", "image_sha256", "latency_s"))
    _check(type(stamp_ns) is int and 0 <= stamp_ns < 2**63, "stamp_ns: allowed a whole number >= 0")
    is_hash = isinstance(image_hash, str) and len(image_hash) == 64 and _HASH_CHARS.issuperset(image_hash)
    _check(image_hash is None or is_hash, "image_sha256: allowed null or 64 hexadecimal digits")
    _check(_is_number(latency_s) and 0.0 <= latency_s < 1e6, "latency_s: allowed a number >= 0")
    _check(isinstance(entry["source"], str), "source: allowed text")
    if "error_cause" in entry:
        cause, detail = entry["error_cause"], entry["error_detail"]
        _check(isinstance(cause, str) and isinstance(detail, str), "error_cause, error_detail: allowed text")
        return stamp_ns, image_hash, (cause, detail, float(latency_s))
    _check_answer(entry)
    return stamp_ns, image_hash, line


def _check_answer(entry: Dict[str, Any]) -> None:
    """Check all but that the masks do not overlap, for which they would have to be drawn."""
    size_px, masks, evaluated = entry["size"], entry["masks"], entry["classes_evaluated"]
    is_size = isinstance(size_px, list) and len(size_px) == 2 and all(type(edge) is int for edge in size_px)
    _check(is_size and all(0 < edge <= MAX_EDGE_PX for edge in size_px), "size: allowed [height, width]")
    _check(isinstance(masks, list) and len(masks) <= MAX_LABEL, "masks: allowed a list")
    _check(isinstance(evaluated, list) and all(map(_is_class, evaluated)), "classes_evaluated: allowed class names")
    for mask in masks:
        keys = isinstance(mask, dict) and set(mask) == {"label", "class", "score", "counts"}
        _check(keys, "masks: allowed objects of label, class, score and counts")
        label, score = mask["label"], mask["score"]
        _check(type(label) is int and 0 < label <= MAX_LABEL, f"label: allowed 1..{MAX_LABEL}")
        _check(_is_class(mask["class"]), "class: allowed a class name")
        _check(_is_number(score) and 0.0 <= score <= 1.0, "score: allowed 0..1")
        read_runs(mask["counts"], tuple(size_px))
    labels = [mask["label"] for mask in masks]
    _check(labels == sorted(set(labels)), "masks: allowed each label once, in ascending order")


def _decode(entry: Dict[str, Any]) -> Segmentation:
    size_px = tuple(entry["size"])
    labels = np.zeros(size_px, np.uint16)
    for mask in entry["masks"]:
        where = decode_mask(mask["counts"], size_px)
        if not where.any() or labels[where].any():
            raise EvidenceError(f"recording: the mask of label {mask['label']} is empty or overlaps another")
        labels[where] = mask["label"]
    masks = tuple(Mask(mask["label"], mask["class"], float(mask["score"])) for mask in entry["masks"])
    return Segmentation(labels, masks, tuple(entry["classes_evaluated"]), float(entry["latency_s"]))


def _is_class(name) -> bool:
    try:
        return canonical_class_name(name) == name
    except PredicateError:
        return False


def _is_number(value) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and np.isfinite(value)


def _check(is_right: bool, problem: str) -> None:
    if not is_right:
        raise ValueError(problem)

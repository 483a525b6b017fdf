# SPDX-License-Identifier: BSD-3-Clause
"""The interface of a segmenter, what it is given and what it answers."""

from __future__ import annotations

import abc
import math
from dataclasses import dataclass, field
from typing import FrozenSet, Mapping, Optional, Tuple

import numpy as np

from core_perception.exceptions import EvidenceError

MAX_LABEL = 65535

#: What a segmenter can read of a frame: the colour image; a label image; what its labels mean.
IMAGE, LABELS, LABEL_INFO = "image", "labels", "label_info"


@dataclass(frozen=True)
class GivenLabel:
    """What somebody else says of one label of a label image.

    Attributes:
        names: canonical names of it, the class first, then other names it may be known by.
        score: 0..1.
    """

    names: Tuple[str, ...]
    score: float = 1.0


@dataclass(frozen=True)
class SegmenterFrame:
    """One frame, and what to look for in it.

    Attributes:
        stamp_ns: stamp of the frame [ns].
        classes: canonical names asked for, in order of preference, each once.
        rule_classes: those of them that a rule in force speaks of.
        unsafe_classes: those that a rule in force calls unsafe.
        image: (h, w, 3) uint8 rgb; None where the segmenter reads none.
        labels: (h, w) uint8 or uint16, somebody else's label image; None where the segmenter reads none.
        given: what its labels mean; None where the segmenter reads no such thing.
        given_evaluated: canonical names that were looked for in it.
    """

    stamp_ns: int
    classes: Tuple[str, ...]
    rule_classes: FrozenSet[str] = frozenset()
    unsafe_classes: FrozenSet[str] = frozenset()
    image: Optional[np.ndarray] = field(default=None, compare=False, repr=False)
    labels: Optional[np.ndarray] = field(default=None, compare=False, repr=False)
    given: Optional[Mapping[int, GivenLabel]] = field(default=None, repr=False)
    given_evaluated: Tuple[str, ...] = ()


@dataclass(frozen=True)
class Mask:
    """One instance in a label image.

    Attributes:
        label: its value in the label image, 1..65535.
        class_name: canonical name it was asked for by.
        score: 0..1.
    """

    label: int
    class_name: str
    score: float = 1.0


@dataclass(frozen=True)
class Segmentation:
    """Instances found in one image.

    Attributes:
        labels: (h, w) uint16, 0 for none; every other value is the label of one mask.
        masks: the instances, ordered by label.
        classes_evaluated: every class of which there is nothing in the image but these masks. One that is not here was
            not looked for, or not all that was found of it could be shown; that is not the same as absent.
        latency_s: time it took, as measured or recorded [s].
    """

    labels: np.ndarray
    masks: Tuple[Mask, ...]
    classes_evaluated: Tuple[str, ...]
    latency_s: float = 0.0

    def not_evaluated(self, asked: Tuple[str, ...]) -> Tuple[str, ...]:
        """Those of the classes asked for that nothing is known about, in their order."""
        evaluated = set(self.classes_evaluated)
        return tuple(name for name in asked if name not in evaluated)


class Segmenter(abc.ABC):
    """Finds instances of classes in images. One object serves one camera."""

    #: Short name, for logs, diagnostics and recordings.
    source: str = ""
    #: Which of IMAGE, LABELS and LABEL_INFO it reads.
    reads: FrozenSet[str] = frozenset()
    #: True where the label image it reads is the simulator's ground truth.
    reads_truth: bool = False
    #: True where segment() may take long: it is then called from a thread of its own, with the newest frame.
    is_slow: bool = False
    #: True where its answer is to be handed on no earlier than the stamp of the frame plus the answer's latency.
    is_held_back: bool = False

    @abc.abstractmethod
    def segment(self, frame: SegmenterFrame) -> Segmentation:
        """Find the instances of the classes asked for; one caller at a time.

        Raises:
            PerceptionError: there is no answer for this frame; nothing may be concluded about it.
        """

    @property
    def warning(self) -> str:
        """What its user should know besides the answers, in one line; empty for nothing."""
        return ""

    def close(self) -> None:  # noqa: B027 - most hold nothing
        """Give up a running segment() and free what is held; the segmenter is not used afterwards."""


def check_segmentation(segmentation: Segmentation) -> None:
    """Check that labels and masks say the same, whoever made them.

    Raises:
        EvidenceError: labels of another type or shape, a label without a mask or with two, a mask without a pixel, or a
            score outside 0..1.
    """
    labels, masks = segmentation.labels, segmentation.masks
    if labels.dtype != np.uint16 or labels.ndim != 2 or labels.size == 0:
        raise EvidenceError(f"segmentation: got labels {labels.dtype} {labels.shape}, allowed uint16 (h, w)")
    present = set(find_labels(labels))
    numbers = [mask.label for mask in masks]
    if set(numbers) != present or len(numbers) != len(present):
        wrong = sorted(set(numbers) ^ present or {n for n in numbers if numbers.count(n) > 1})
        raise EvidenceError(f"segmentation: labels of image and masks differ, first at {wrong[0]}")
    for mask in masks:
        if not (math.isfinite(mask.score) and 0.0 <= mask.score <= 1.0):
            raise EvidenceError(f"segmentation: got score {mask.score} of {mask.class_name}, allowed 0..1")


def find_labels(labels: np.ndarray) -> Tuple[int, ...]:
    """Values other than 0 in a label image, in ascending order."""
    return tuple(int(label) for label in np.flatnonzero(np.bincount(labels.ravel())) if label != 0)

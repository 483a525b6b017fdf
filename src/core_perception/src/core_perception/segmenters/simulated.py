# SPDX-License-Identifier: BSD-3-Clause
"""A segmenter that answers from the simulator's ground truth, but only by the names it is asked for."""

from __future__ import annotations

from typing import Dict

import numpy as np

from core_perception.exceptions import EvidenceError
from core_perception.ontology import Ontology
from core_perception.segmenters import label_errors
from core_perception.segmenters.base import (
    LABEL_INFO,
    LABELS,
    MAX_LABEL,
    Mask,
    Segmentation,
    Segmenter,
    SegmenterFrame,
    find_labels,
)
from core_perception.segmenters.label_errors import LabelErrors
from core_perception.segmenters.open_names import OpenNames

# Ends of the seeds of what must not change the random numbers of the rest; labels of instances lie below.
FRAY_STREAM, GHOST_STREAM = MAX_LABEL + 1, MAX_LABEL + 2


class SimulatedSegmenter(Segmenter):
    """Stands for an open-vocabulary segmenter such as SAM 3: image and names in, instance masks out.

    A thing is returned if a name that was asked means it; see OpenNames for which, and for which comes first. The masks
    are exact unless errors are asked for. Labels are numbered anew in every frame, so that nobody can rely on them from
    frame to frame. The same seed, stamp and input give the same output.
    """

    source = "simulated"
    reads = frozenset((LABELS, LABEL_INFO))
    reads_truth = True

    def __init__(
        self,
        ontology: Ontology,
        names: OpenNames,
        seed: int = 0,
        errors: LabelErrors = LabelErrors(),  # noqa: B008 - frozen
        latency_s: float = 0.0,
    ):
        """Keep the settings.

        Args:
            ontology: canonical names, and which classes are surfaces.
            names: finds what is meant.
            seed: >= 0.
            errors: how wrong it is.
            latency_s: declared sim latency [s]; while an answer is awaited, no other frame is looked at.
        """
        self._ontology, self._names, self._seed, self._errors = ontology, names, seed, errors
        self._missed_classes = frozenset(ontology.canonical(name) for name in errors.missed_classes)
        self._latency_s = latency_s
        self.is_slow = self.is_held_back = latency_s > 0.0

    def segment(self, frame: SegmenterFrame) -> Segmentation:
        """Return the instances of the classes asked for; frame.labels and frame.given are the truth.

        Raises:
            EvidenceError: a label image of another type or shape, or a label that no class is known for.
        """
        truth = frame.labels
        if truth.ndim != 2 or truth.dtype != np.uint16:
            raise EvidenceError(f"truth labels: got {truth.dtype} {truth.shape}, allowed uint16 (h, w)")
        stamp = [frame.stamp_ns & 0xFFFFFFFF, frame.stamp_ns >> 32]
        found = self._match(frame)
        rng = np.random.default_rng([self._seed, *stamp])
        kept = {label: name for label, name in found.items() if not self._missed(label, stamp)}
        numbers = rng.permutation(len(kept)) + 1 + rng.integers(0, 1000)
        table = np.zeros(MAX_LABEL + 1, np.uint16)
        table[list(kept)] = numbers
        classes = {int(number): name for number, name in zip(numbers, kept.values())}
        labels = self._spoil(table[truth], classes, rng, stamp)
        labels = self._haunt(labels, classes, frame.classes, stamp)
        masks = tuple(Mask(label, classes[label]) for label in find_labels(labels))
        return Segmentation(labels, masks, frame.classes, self._latency_s)

    def _match(self, frame: SegmenterFrame) -> Dict[int, str]:
        """Truth label -> asked name, for the labels in the image that some asked name fits; ordered by label."""
        found = {}
        for label in find_labels(frame.labels):
            if label not in frame.given:
                raise EvidenceError(f"truth labels: got label {label} without a class, allowed {sorted(frame.given)}")
            names = frame.given[label].names
            if self._ontology.canonical(names[0]) in self._missed_classes:
                continue
            name = self._names.find(names, frame.classes, frame.rule_classes)
            if name is not None:
                found[label] = name
        return found

    def _missed(self, label, stamp):
        rate = self._errors.miss_rate
        return rate > 0.0 and np.random.default_rng([self._seed, *stamp, label]).random() < rate

    def _spoil(self, labels, classes, rng, stamp):
        errors = self._errors
        if errors.erode_px > 0:
            labels = label_errors.erode(labels, errors.erode_px)
        if errors.dilate_px > 0:
            labels = label_errors.dilate(
                labels, errors.dilate_px, lambda label: self._ontology.look_up(classes[label]).is_surface
            )
        if errors.boundary_noise_px > 0:
            own = np.random.default_rng([self._seed, *stamp, FRAY_STREAM])
            labels = label_errors.fray(labels, errors.boundary_noise_px, own)
        if errors.pixel_drop_rate > 0.0:
            labels = label_errors.drop_pixels(labels, errors.pixel_drop_rate, rng)
        return labels

    def _haunt(self, labels, classes, asked, stamp):
        """Perhaps add one instance that is not there, also to ``classes``."""
        choices = [name for name in asked if self._ontology.canonical(name) not in self._missed_classes]
        own = np.random.default_rng([self._seed, *stamp, GHOST_STREAM])
        if not choices or own.random() >= self._errors.false_positive_rate:
            return labels
        number = max(classes, default=0) + 1
        classes[number] = choices[int(own.integers(0, len(choices)))]
        return label_errors.add_ghost(labels, number, own)

# SPDX-License-Identifier: BSD-3-Clause
"""A segmenter that answers from the simulator's ground truth, but only by the names it is asked for."""

from __future__ import annotations

from typing import Dict, Iterable, Mapping

import cv2
import numpy as np

from core_perception.exceptions import EvidenceError
from core_perception.ontology import Ontology
from core_perception.predicates import canonical_class_name
from core_perception.segmenters.base import Mask, Segmentation

MAX_LABEL = 65535


class SimulatedSegmenter:
    """Stands for an open-vocabulary segmenter such as SAM 3: image and names in, instance masks out.

    An object is returned if a name that was asked is its class, or an alias of it in the ontology. Where several names
    fit, its own class comes first, then the first name that was asked. The masks are exact unless errors are asked for.
    Labels are numbered anew in every frame, so that nobody can rely on them from frame to frame. The same seed, stamp
    and input give the same output.
    """

    def __init__(
        self,
        ontology: Ontology,
        seed: int = 0,
        miss_rate: float = 0.0,
        pixel_drop_rate: float = 0.0,
        erode_px: int = 0,
        missed_classes: Iterable[str] = (),
    ):
        """Set the errors; all default to none.

        Args:
            ontology: gives the aliases.
            seed: >= 0.
            miss_rate: probability that an instance is missed in a frame, 0..1.
            pixel_drop_rate: share of a mask's pixels that are dropped, 0..1.
            erode_px: width by which masks shrink [px].
            missed_classes: classes, by any of their names, that are never found although they are looked for.
        """  # noqa: D417 - all described
        self._ontology, self._seed = ontology, seed
        self._miss_rate, self._pixel_drop_rate, self._erode_px = miss_rate, pixel_drop_rate, erode_px
        self._missed_classes = frozenset(ontology.canonical(name) for name in missed_classes)

    def segment(
        self, truth_labels: np.ndarray, truth_classes: Mapping[int, str], asked: Iterable[str], stamp_ns: int
    ) -> Segmentation:
        """Return the instances of the asked classes.

        Args:
            truth_labels: (h, w) uint16 object id of the world per pixel, 0 for none.
            truth_classes: object id -> class name.
            asked: class names in order of preference; repetitions are allowed.
            stamp_ns: stamp of the frame [ns]; seeds the errors and the numbering.

        Raises:
            EvidenceError: a label image of another type or shape, or a label that no class is known for.
        """
        if truth_labels.ndim != 2 or truth_labels.dtype != np.uint16:
            raise EvidenceError(
                f"ground truth labels: got {truth_labels.dtype} {truth_labels.shape}, allowed uint16 (h, w)"
            )
        names = tuple(dict.fromkeys(canonical_class_name(name) for name in asked))
        found = self._match(truth_labels, truth_classes, names)
        rng = np.random.default_rng([self._seed, stamp_ns & 0xFFFFFFFF, stamp_ns >> 32])
        kept = {label: name for label, name in found.items() if not self._missed(label, stamp_ns)}
        numbers = rng.permutation(len(kept)) + 1 + rng.integers(0, 1000)
        table = np.zeros(MAX_LABEL + 1, np.uint16)
        table[list(kept)] = numbers
        labels = self._spoil(table[truth_labels], rng)
        masks = [Mask(int(number), name) for number, name in zip(numbers, kept.values()) if (labels == number).any()]
        return Segmentation(labels, tuple(sorted(masks, key=lambda mask: mask.label)), names)

    def _match(self, truth_labels, truth_classes, names) -> Dict[int, str]:
        """Truth label -> asked name, for the labels in the image that some asked name fits; ordered by label."""
        by_meaning: Dict[str, str] = {}
        for name in names:
            by_meaning.setdefault(self._ontology.canonical(name), name)
        found = {}
        for label in map(int, np.flatnonzero(np.bincount(truth_labels.ravel()))):
            if label == 0:
                continue
            if label not in truth_classes:
                raise EvidenceError(
                    f"ground truth labels: got label {label} without a class, allowed {sorted(truth_classes)}"
                )
            own = canonical_class_name(truth_classes[label])
            if self._ontology.canonical(own) in self._missed_classes:
                continue
            name = own if own in names else by_meaning.get(self._ontology.canonical(own))
            if name is not None:
                found[label] = name
        return found

    def _missed(self, label, stamp_ns):
        if self._miss_rate == 0.0:
            return False
        return (
            np.random.default_rng([self._seed, stamp_ns & 0xFFFFFFFF, stamp_ns >> 32, label]).random() < self._miss_rate
        )

    def _spoil(self, labels, rng):
        if self._erode_px > 0:
            kernel = np.ones((2 * self._erode_px + 1, 2 * self._erode_px + 1), np.uint8)
            # A pixel stays where its whole neighbourhood carries its label: the smallest and the largest label around
            # are equal.
            labels = np.where(cv2.erode(labels, kernel) == cv2.dilate(labels, kernel), labels, 0).astype(np.uint16)
        if self._pixel_drop_rate > 0.0:
            labels = np.where(rng.random(labels.shape) < self._pixel_drop_rate, 0, labels).astype(np.uint16)
        return labels

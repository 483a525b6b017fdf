# SPDX-License-Identifier: BSD-3-Clause
"""Somebody else's label images, checked and put into our words: label images with their infos, or images of class ids.

Their vocabulary is theirs: what they found and nobody asked for is handed on as well.
"""

from __future__ import annotations

from typing import Iterable, List, Optional, Tuple

import cv2
import numpy as np

from core_perception.exceptions import EvidenceError
from core_perception.ontology import Ontology
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
from core_perception.segmenters.class_map import ClassMap
from core_perception.segmenters.open_names import OpenNames


class TopicSegmenter(Segmenter):
    """Hands on what another node found.

    Of several asked names that mean the same, only the one that is used counts as evaluated.
    """

    source = "topic"

    def __init__(self, ontology: Ontology, names: OpenNames, class_map: Optional[ClassMap] = None):
        """Keep the settings.

        Args:
            ontology: which classes are surfaces.
            names: finds the name that was asked for a thing.
            class_map: meaning of the values of images of class ids; None for label images with infos.
        """
        self._ontology, self._names, self._class_map = ontology, names, class_map
        self.reads = frozenset((LABELS,)) if class_map else frozenset((LABELS, LABEL_INFO))

    def segment(self, frame: SegmenterFrame) -> Segmentation:
        """Check frame.labels and what they mean, and give them the names that were asked for.

        Raises:
            EvidenceError: an image of another type or shape, or a value without a meaning.
        """
        labels = frame.labels
        if labels.ndim != 2 or labels.dtype not in (np.uint8, np.uint16) or labels.size == 0:
            raise EvidenceError(f"labels: got {labels.dtype} {labels.shape}, allowed uint8 or uint16 (h, w)")
        if self._class_map is not None:
            return self._from_classes(labels.astype(np.uint16), frame)
        return self._from_instances(labels.astype(np.uint16), frame)

    def _from_instances(self, labels, frame: SegmenterFrame) -> Segmentation:
        masks = []
        for label in find_labels(labels):
            if label not in frame.given:
                raise EvidenceError(f"labels: got label {label}, of which label_info says nothing")
            given = frame.given[label]
            masks.append(Mask(label, self._asked_name(given.names[0], frame), given.score))
        looked_for = [*frame.given_evaluated, *(given.names[0] for given in frame.given.values())]
        return Segmentation(labels, tuple(masks), self._evaluated(looked_for, frame))

    def _from_classes(self, values, frame: SegmenterFrame) -> Segmentation:
        """Objects of one class apart from each other become instances; a surface is one."""
        classes, ignored = self._class_map.classes, self._class_map.ignored
        labels = np.zeros(values.shape, np.uint16)
        masks: List[Mask] = []
        for value in map(int, np.flatnonzero(np.bincount(values.ravel()))):
            if value in ignored:
                continue
            if value not in classes:
                raise EvidenceError(f"labels: got value {value}, allowed those of class_map")
            name = self._asked_name(classes[value], frame)
            where = values == value
            count, pieces = 1, where.astype(np.int32)
            if not self._ontology.look_up(name).is_surface:
                regions, pieces = cv2.connectedComponents(where.astype(np.uint8), connectivity=8)
                count = regions - 1
            if len(masks) + count > MAX_LABEL:
                raise EvidenceError(f"labels: got more than {MAX_LABEL} separate objects")
            first = len(masks) + 1
            labels[where] = (pieces[where] + first - 1).astype(np.uint16)
            masks.extend(Mask(first + k, name) for k in range(count))
        return Segmentation(labels, tuple(masks), self._evaluated(classes.values(), frame))

    def _asked_name(self, theirs: str, frame: SegmenterFrame) -> str:
        return self._names.find((theirs,), frame.classes, frame.rule_classes) or theirs

    def _evaluated(self, looked_for: Iterable[str], frame: SegmenterFrame) -> Tuple[str, ...]:
        return tuple(dict.fromkeys(self._asked_name(theirs, frame) for theirs in looked_for))

# SPDX-License-Identifier: BSD-3-Clause
"""Instances whose masks may overlap -> one label image, in which a pixel has room for one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Callable, Sequence, Tuple

import numpy as np

from core_perception.exceptions import EvidenceError
from core_perception.segmenters.base import MAX_LABEL, Mask, Segmentation, SegmenterFrame, find_labels
from core_perception.segmenters.rle import decode_mask


@dataclass(frozen=True)
class Instance:
    """One thing found.

    Attributes:
        class_name: canonical name it was asked for by.
        score: 0..1.
        runs: its mask as run lengths, see rle; a whole mask a thing would be much, where a server may send many.
    """

    class_name: str
    score: float
    runs: Sequence[int]


def paint_instances(
    instances: Sequence[Instance],
    size_px: Tuple[int, int],
    evaluated: Sequence[str],
    frame: SegmenterFrame,
    is_surface: Callable[[str], bool],
) -> Segmentation:
    """Lay the masks over one another: surfaces below objects, below what a rule calls unsafe; then by score.

    A class of which a whole instance is covered counts as not evaluated in this frame, even if others of it are shown:
    it was found, but the label image cannot say where. Labels are 1, 2, … in the order of the instances.

    Args:
        instances: at most 65535.
        size_px: height and width of the image.
        evaluated: classes that were looked for.
        frame: which classes a rule calls unsafe.
        is_surface: of a class name.

    Raises:
        EvidenceError: more instances than labels.
    """
    if len(instances) > MAX_LABEL:
        raise EvidenceError(f"segmentation: got {len(instances)} instances, allowed {MAX_LABEL}")
    labels = np.zeros(size_px, np.uint16)

    def height(k):
        name = instances[k].class_name
        return name in frame.unsafe_classes, not is_surface(name), instances[k].score, -k

    for k in sorted(range(len(instances)), key=height):
        labels[decode_mask(instances[k].runs, size_px)] = k + 1
    present = set(find_labels(labels))
    masks = tuple(Mask(k + 1, one.class_name, one.score) for k, one in enumerate(instances) if k + 1 in present)
    covered = {one.class_name for k, one in enumerate(instances) if k + 1 not in present and len(one.runs) > 1}
    return Segmentation(labels, masks, tuple(name for name in evaluated if name not in covered))

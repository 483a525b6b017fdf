# SPDX-License-Identifier: BSD-3-Clause
"""The result of a segmenter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Tuple

import numpy as np


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
        classes_evaluated: every name that was asked; a class that is not here was not looked for, which is not the same
            as absent.
    """

    labels: np.ndarray
    masks: Tuple[Mask, ...]
    classes_evaluated: Tuple[str, ...]

# SPDX-License-Identifier: BSD-3-Clause
"""Masks as run lengths: the lengths of the runs of a mask read row by row, those of zeros and of ones in turn.

    [[0, 1, 1],      ->  [1, 2, 1, 2]        zeros first: a mask that begins with a one begins with a run of length 0
     [0, 1, 1]]

The counts are those of COCO's uncompressed form, but COCO reads column by column.
"""

from __future__ import annotations

from typing import List, Sequence, Tuple

import numpy as np


def encode_mask(mask: np.ndarray) -> List[int]:
    """Return the run lengths of a mask.

    Args:
        mask: (h, w) bool, at least one pixel.
    """
    flat = np.asarray(mask, bool).ravel()
    changes = np.flatnonzero(flat[1:] != flat[:-1]) + 1
    runs = np.diff(np.concatenate(([0], changes, [flat.size])))
    return [*([0] if flat[0] else []), *map(int, runs)]


def read_runs(counts: Sequence[int], size_px: Tuple[int, int]) -> np.ndarray:
    """Return checked run lengths, (n,) int64: small, whatever the size of the mask.

    Args:
        counts: run lengths >= 0, zeros first; only the first may be 0.
        size_px: height and width of the mask.

    Raises:
        ValueError: no list of whole numbers, a run of length 0 within, or a sum that is not the number of pixels.
    """
    height_px, width_px = size_px
    pixels = height_px * width_px
    if not isinstance(counts, (list, tuple)) or not counts:
        raise ValueError("run lengths: allowed a list of whole numbers")
    if len(counts) > pixels + 1:
        raise ValueError(f"run lengths: got {len(counts)}, allowed at most {pixels + 1}")
    # bool is a kind of int, and a larger number would overflow numpy's
    if not all(type(count) is int and 0 <= count <= pixels for count in counts):
        raise ValueError(f"run lengths: allowed whole numbers from 0 to {pixels}")
    runs = np.asarray(counts, np.int64)
    if (runs[1:] == 0).any():
        raise ValueError("run lengths: got a run of length 0, allowed at the beginning only")
    if int(runs.sum()) != pixels:
        raise ValueError(f"run lengths: got a sum of {int(runs.sum())}, allowed {pixels}, {height_px} x {width_px}")
    return runs


def decode_mask(runs: Sequence[int], size_px: Tuple[int, int]) -> np.ndarray:
    """Return the mask of checked run lengths, (h, w) bool."""
    return np.repeat(np.arange(len(runs)) % 2 == 1, runs).reshape(size_px)

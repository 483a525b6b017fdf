# SPDX-License-Identifier: BSD-3-Clause
"""Errors of a segmenter, made on label images: shrunk, grown and frayed masks, lost pixels, things that are not there.

Every function takes the random numbers it may use; the same ones give the same errors.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Callable, Tuple

import cv2
import numpy as np

# Edges wander on this scale [px]; shorter would be noise of single pixels, longer a shift of the whole mask.
WANDER_PX = 8.0
# Half axes of a ghost, as share of the image's height.
GHOST_SHARE = (0.05, 0.20)


@dataclass(frozen=True)
class LabelErrors:
    """How wrong a simulated segmenter is; all default to not at all.

    Attributes:
        miss_rate: probability that an instance is missed in a frame, 0..1.
        false_positive_rate: probability of one instance in a frame that is not there, of a random class asked for,
            0..1.
        pixel_drop_rate: share of a mask's pixels that are dropped, 0..1.
        erode_px: width by which masks shrink [px].
        dilate_px: width by which they grow, after they have shrunk [px].
        boundary_noise_px: largest distance by which their edges wander [px].
        missed_classes: classes, by any of their names, that are never found although they are looked for.
    """

    miss_rate: float = 0.0
    false_positive_rate: float = 0.0
    pixel_drop_rate: float = 0.0
    erode_px: int = 0
    dilate_px: int = 0
    boundary_noise_px: int = 0
    missed_classes: Tuple[str, ...] = ()


def erode(labels: np.ndarray, width_px: int) -> np.ndarray:
    """Take a rim off every mask; a pixel stays where its whole neighbourhood carries its label."""
    kernel = _square(width_px)
    return np.where(cv2.erode(labels, kernel) == cv2.dilate(labels, kernel), labels, 0).astype(np.uint16)


def dilate(labels: np.ndarray, width_px: int, is_surface: Callable[[int], bool]) -> np.ndarray:
    """Put a rim around every mask: of objects over surfaces and nothing, of surfaces over nothing.

    Where the rims of two objects meet, the greater label wins.
    """
    table = np.zeros(65536, bool)
    for label in np.flatnonzero(np.bincount(labels.ravel())):
        table[label] = label != 0 and is_surface(int(label))
    surface = table[labels]
    kernel = _square(width_px)
    objects = np.where(surface, 0, labels).astype(np.uint16)
    objects = np.where(objects > 0, objects, cv2.dilate(objects, kernel))
    surfaces = np.where(surface, labels, 0).astype(np.uint16)
    surfaces = np.where(surfaces > 0, surfaces, cv2.dilate(surfaces, kernel))
    return np.where(objects > 0, objects, surfaces).astype(np.uint16)


def fray(labels: np.ndarray, width_px: int, rng: np.random.Generator) -> np.ndarray:
    """Let the edges of the masks wander: every pixel takes the label of a place beside it, at most width_px away.

    The places follow two smooth random fields, so that a mask stays in one piece.
    """
    height_px, width = labels.shape
    shifts = [_smooth_field(labels.shape, rng) * (width_px / np.sqrt(2.0)) for _ in range(2)]
    columns, rows = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height_px, dtype=np.float32))
    x, y = (np.float32(place + shift) for place, shift in zip((columns, rows), shifts))
    return cv2.remap(labels, x, y, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE)


def drop_pixels(labels: np.ndarray, rate: float, rng: np.random.Generator) -> np.ndarray:
    """Lose a share of the pixels."""
    return np.where(rng.random(labels.shape) < rate, 0, labels).astype(np.uint16)


def add_ghost(labels: np.ndarray, label: int, rng: np.random.Generator) -> np.ndarray:
    """Draw an upright ellipse of random size somewhere in the image, over everything."""
    height_px, width_px = labels.shape
    center = tuple(int(rng.integers(0, size)) for size in (width_px, height_px))
    axes = tuple(max(1, round(float(rng.uniform(*GHOST_SHARE)) * height_px)) for _ in range(2))
    shape = cv2.ellipse(np.zeros(labels.shape, np.uint8), center, axes, 0.0, 0.0, 360.0, 1, -1)
    return np.where(shape > 0, label, labels).astype(np.uint16)


def _square(width_px):
    return np.ones((2 * width_px + 1, 2 * width_px + 1), np.uint8)


def _smooth_field(shape, rng):
    """Random field of that shape in [-1, 1]."""
    coarse = rng.uniform(-1.0, 1.0, [int(np.ceil(size / WANDER_PX)) + 1 for size in shape]).astype(np.float32)
    return cv2.resize(coarse, (shape[1], shape[0]), interpolation=cv2.INTER_LINEAR)

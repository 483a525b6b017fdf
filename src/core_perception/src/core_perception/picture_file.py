# SPDX-License-Identifier: BSD-3-Clause
"""Writes an image as the file that a server is sent."""

from __future__ import annotations

from typing import Tuple

import cv2
import numpy as np

from core_perception.exceptions import EvidenceError


def write_picture(
    image_rgb: np.ndarray, max_image_px: int, kind: str = "jpeg", jpeg_quality: int = 90
) -> Tuple[bytes, Tuple[int, int]]:
    """Return an image as a file, and the height and width of what is in it [px].

    Args:
        image_rgb: (h, w, 3) uint8.
        max_image_px: longest edge; a larger image is scaled down by averaging.
        kind: ``jpeg`` or ``png``.
        jpeg_quality: 0..100.

    Raises:
        EvidenceError: the image has another shape or type, or no pixel.
    """
    image = np.asarray(image_rgb)
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3 or image.size == 0:
        raise EvidenceError(f"an image is (h, w, 3) uint8, not {image.shape} {image.dtype}")
    height_px, width_px = image.shape[:2]
    scale = max_image_px / max(height_px, width_px)
    if scale < 1.0:
        size = (max(1, round(width_px * scale)), max(1, round(height_px * scale)))
        image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    options = [cv2.IMWRITE_JPEG_QUALITY, jpeg_quality] if kind == "jpeg" else []
    file = cv2.imencode("." + kind, cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2BGR), options)[1]
    return file.tobytes(), image.shape[:2]

# SPDX-License-Identifier: BSD-3-Clause
"""Contact sheets: labelled pictures on a grid. Images are (h, w, 3) uint8 rgb."""

from __future__ import annotations

from pathlib import Path
from typing import Sequence, Tuple

import cv2
import numpy as np

from core_bringup.evaluation.results import atomic_path

LABEL_PX, GAP_PX = 44, 6
FONT = cv2.FONT_HERSHEY_SIMPLEX
PANEL_RGB, TITLE_RGB, TEXT_RGB = (22, 24, 28), (255, 255, 255), (186, 190, 198)


def label_picture(picture: np.ndarray, title: str, text: str = "") -> np.ndarray:
    """The picture with a title and a smaller line of text below, (h + LABEL_PX, w, 3)."""
    width_px = picture.shape[1]
    label = np.full((LABEL_PX, width_px, 3), PANEL_RGB, np.uint8)
    _write(label, title, (8, 18), 0.52, TITLE_RGB)
    _write(label, text, (8, 36), 0.42, TEXT_RGB)
    return np.vstack([picture, label])


def _write(image: np.ndarray, text: str, place_px: Tuple[int, int], scale: float, color: Tuple[int, int, int]) -> None:
    """Write a line, made smaller when it would not fit."""
    width_px = cv2.getTextSize(text, FONT, scale, 1)[0][0]
    scale *= min(1.0, (image.shape[1] - 2 * place_px[0]) / max(width_px, 1))
    cv2.putText(image, text, place_px, FONT, scale, color, 1, cv2.LINE_AA)


def inset_picture(picture: np.ndarray, small: np.ndarray, share: float) -> np.ndarray:
    """The picture with a small one in its lower right corner, share of its width wide."""
    width_px = int(round(share * picture.shape[1]))
    height_px = int(round(width_px * small.shape[0] / small.shape[1]))
    out = picture.copy()
    out[-height_px - 2 :, -width_px - 2 :] = PANEL_RGB
    out[-height_px:, -width_px:] = cv2.resize(small, (width_px, height_px), interpolation=cv2.INTER_AREA)
    return out


def arrange_grid(tiles: Sequence[np.ndarray], columns: int) -> np.ndarray:
    """Tiles of one size in rows, left to right; what is left over is empty."""
    height_px, width_px = tiles[0].shape[:2]
    rows = -(-len(tiles) // columns)
    sheet = np.full((rows * (height_px + GAP_PX) + GAP_PX, columns * (width_px + GAP_PX) + GAP_PX, 3), 255, np.uint8)
    for index, tile in enumerate(tiles):
        top, left = (GAP_PX + place * (size + GAP_PX) for place, size in zip(divmod(index, columns), tile.shape[:2]))
        sheet[top : top + height_px, left : left + width_px] = tile
    return sheet


def stack_sheets(sheets: Sequence[np.ndarray]) -> np.ndarray:
    """Sheets below each other, the narrow ones filled up on the right."""
    width_px = max(sheet.shape[1] for sheet in sheets)
    missing_px = [width_px - sheet.shape[1] for sheet in sheets]
    padded = [np.pad(s, ((0, 0), (0, gap), (0, 0)), constant_values=255) for s, gap in zip(sheets, missing_px)]
    return np.vstack(padded)


def shrink(picture: np.ndarray, width_px: int) -> np.ndarray:
    """The picture at another width, its sides in the same ratio."""
    height_px = int(round(picture.shape[0] * width_px / picture.shape[1]))
    return cv2.resize(picture, (width_px, height_px), interpolation=cv2.INTER_AREA)


def write_picture(path: Path, picture: np.ndarray) -> None:
    """Write a PNG; OSError if it cannot be written."""
    with atomic_path(path) as temporary:
        if not cv2.imwrite(str(temporary), cv2.cvtColor(picture, cv2.COLOR_RGB2BGR)):
            raise OSError(f"{path}: the picture cannot be written")

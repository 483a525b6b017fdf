# SPDX-License-Identifier: BSD-3-Clause
"""The texture of all persons: an atlas of heads, torsos and plain cloth."""

import numpy as np

SIZE_PX = 256
CELL_PX = 64
SWATCH_PX = 32

SKIN, SKIN_DARK = (226, 178, 146), (142, 96, 70)
CLOTHS = {
    "skin": SKIN,
    "skin_dark": SKIN_DARK,
    "hair_brown": (72, 46, 28),
    "hair_black": (30, 26, 26),
    "hair_blond": (196, 160, 96),
    "jeans": (52, 74, 118),
    "navy": (34, 42, 66),
    "khaki": (150, 132, 100),
    "shirt_blue": (112, 156, 208),
    "jacket_red": (176, 38, 44),
    "vest_orange": (255, 106, 12),
    "teal": (22, 138, 140),
    "helmet": (250, 206, 22),
    "shoe_black": (34, 32, 32),
    "shoe_white": (236, 236, 232),
    "shoe_brown": (104, 68, 42),
    "bag": (92, 62, 40),
    "white": (240, 240, 236),
    "paper": (250, 250, 250),
    "trousers_work": (44, 58, 84),
}
HEADS = ("head_man", "head_woman", "head_worker", "head_nurse")
TORSOS = ("torso_shirt", "torso_jacket", "torso_vest", "torso_scrubs")


def patch_of(name):
    """Patch (u0, v0, u1, v1) of a head, torso or cloth, a pixel inside its edges."""
    if name in HEADS or name in TORSOS:
        row = 0 if name in HEADS else 1
        column, size = (HEADS if row == 0 else TORSOS).index(name), CELL_PX
        left, top = column * size, row * size
    else:
        index, size = list(CLOTHS).index(name), SWATCH_PX
        left, top = (index % 8) * size, 2 * CELL_PX + (index // 8) * size
    edges = np.array([left + 1, SIZE_PX - top - size + 1, left + size - 1, SIZE_PX - top - 1])
    return tuple(edges / SIZE_PX)


def _fill(cell, u_range, v_range, color):
    """Paint the part of a cell between two shares of its width and of its height, measured from below."""
    height, width = cell.shape[:2]
    rows = slice(int(round((1 - v_range[1]) * height)), int(round((1 - v_range[0]) * height)))
    cell[rows, int(round(u_range[0] * width)) : int(round(u_range[1] * width))] = color


def _head(skin, hair, fringe_v, nape_v, beard=False):
    """A head, unrolled from back to back: hair above and behind, a face in the middle."""
    cell = np.zeros((CELL_PX, CELL_PX, 3)) + np.array(skin, dtype=float)
    skin = np.array(skin)
    _fill(cell, (0.0, 0.27), (nape_v, 1.0), hair)
    _fill(cell, (0.73, 1.0), (nape_v, 1.0), hair)
    _fill(cell, (0.27, 0.31), (0.52, 1.0), hair)
    _fill(cell, (0.69, 0.73), (0.52, 1.0), hair)
    _fill(cell, (0.0, 1.0), (fringe_v, 1.0), hair)
    for left in (0.36, 0.55):
        _fill(cell, (left, left + 0.09), (0.57, 0.60), np.array(hair) * 0.8)  # brow
        _fill(cell, (left, left + 0.09), (0.48, 0.54), (246, 246, 244))
        _fill(cell, (left + 0.03, left + 0.07), (0.48, 0.54), (40, 34, 34))
    _fill(cell, (0.475, 0.525), (0.34, 0.52), skin * 0.88)  # nose
    if beard:
        _fill(cell, (0.32, 0.68), (0.0, 0.28), np.array(hair) * 0.5 + skin * 0.5)
    _fill(cell, (0.42, 0.58), (0.21, 0.25), (168, 84, 80))  # mouth
    return cell


def _torso_shirt():
    cell = np.zeros((CELL_PX, CELL_PX, 3)) + np.array(CLOTHS["shirt_blue"], dtype=float)
    cell[:, ::8] *= 0.93
    _fill(cell, (0.48, 0.52), (0.0, 0.9), np.array(CLOTHS["shirt_blue"]) * 0.84)
    for v in (0.2, 0.36, 0.52, 0.68, 0.82):
        _fill(cell, (0.49, 0.515), (v, v + 0.03), (245, 245, 245))
    _fill(cell, (0.40, 0.60), (0.88, 1.0), (236, 240, 246))  # collar
    _fill(cell, (0.0, 1.0), (0.0, 0.07), (60, 44, 32))  # belt
    return cell


def _torso_jacket():
    cell = np.zeros((CELL_PX, CELL_PX, 3)) + np.array(CLOTHS["jacket_red"], dtype=float)
    _fill(cell, (0.43, 0.57), (0.0, 1.0), CLOTHS["white"])  # open over a white shirt
    _fill(cell, (0.41, 0.43), (0.0, 1.0), np.array(CLOTHS["jacket_red"]) * 0.6)
    _fill(cell, (0.57, 0.59), (0.0, 1.0), np.array(CLOTHS["jacket_red"]) * 0.6)
    for left in (0.28, 0.62):
        _fill(cell, (left, left + 0.10), (0.24, 0.27), np.array(CLOTHS["jacket_red"]) * 0.6)
    return cell


def _torso_vest():
    """Hi-vis: orange with silver bands between yellow ones, two upright and two around."""
    cell = np.zeros((CELL_PX, CELL_PX, 3)) + np.array(CLOTHS["vest_orange"], dtype=float)
    silver, lime = (232, 234, 236), (206, 255, 40)
    for left in (0.32, 0.60, 0.10, 0.82):
        _fill(cell, (left, left + 0.08), (0.5, 1.0), lime)
        _fill(cell, (left + 0.02, left + 0.06), (0.5, 1.0), silver)
    for v in (0.14, 0.40):
        _fill(cell, (0.0, 1.0), (v, v + 0.15), lime)
        _fill(cell, (0.0, 1.0), (v + 0.035, v + 0.115), silver)
    _fill(cell, (0.492, 0.508), (0.0, 0.9), (90, 50, 20))
    _fill(cell, (0.43, 0.57), (0.88, 1.0), CLOTHS["navy"])
    return cell


def _torso_scrubs():
    """Teal top with a V-neck, a stethoscope, a pocket and a badge."""
    teal = np.array(CLOTHS["teal"], dtype=float)
    cell = np.zeros((CELL_PX, CELL_PX, 3)) + teal
    for row in range(CELL_PX // 5):
        half = max(0.0, 0.085 * (1.0 - row / (CELL_PX / 5)))
        cell[row, int((0.5 - half) * CELL_PX) : int((0.5 + half) * CELL_PX) + 1] = SKIN
    for left in (0.38, 0.59):
        _fill(cell, (left, left + 0.03), (0.55, 1.0), (40, 42, 48))
    _fill(cell, (0.57, 0.64), (0.48, 0.56), (190, 194, 200))
    _fill(cell, (0.30, 0.40), (0.30, 0.46), teal * 0.78)
    _fill(cell, (0.31, 0.37), (0.62, 0.72), (248, 248, 248))
    _fill(cell, (0.0, 1.0), (0.0, 0.04), teal * 0.7)
    return cell


def people_texture(rng):
    """The atlas (SIZE_PX, SIZE_PX, 3), values 0..255; patch_of says where things are."""
    image = np.zeros((SIZE_PX, SIZE_PX, 3))
    heads = (
        _head(SKIN, CLOTHS["hair_brown"], 0.72, 0.28),
        _head(SKIN_DARK, CLOTHS["hair_black"], 0.74, 0.0),
        _head(SKIN, CLOTHS["hair_brown"], 0.80, 0.34, beard=True),
        _head(SKIN, CLOTHS["hair_blond"], 0.70, 0.24),
    )
    torsos = (_torso_shirt(), _torso_jacket(), _torso_vest(), _torso_scrubs())
    for row, cells in enumerate((heads, torsos)):
        for column, cell in enumerate(cells):
            image[row * CELL_PX : (row + 1) * CELL_PX, column * CELL_PX : (column + 1) * CELL_PX] = cell
    for index, color in enumerate(CLOTHS.values()):
        left, top = (index % 8) * SWATCH_PX, 2 * CELL_PX + (index // 8) * SWATCH_PX
        image[top : top + SWATCH_PX, left : left + SWATCH_PX] = color
    return image * (1.0 + 0.02 * rng.standard_normal((SIZE_PX, SIZE_PX, 1)))

# SPDX-License-Identifier: BSD-3-Clause
"""Houses and the front of a mall. A house faces x; the mall front is a wall along x that faces y."""

import numpy as np

from .mesh import Mesh
from .textures import Atlas, Picture, make_rng, write_model

FRAME, GLASS, SKY_GLASS, STONE = (244, 244, 240), (58, 76, 92), (120, 148, 168), (150, 146, 138)
WALL_M, EAVES_M, RIDGE_M, OVERHANG_M = (8.4, 6.2), 3.0, 5.1, 0.35


def _wall(rng, width_px, height_px, kind, color):
    """A bare wall: 'brick' in courses, or 'siding' in boards."""
    image = np.zeros((height_px, width_px, 3)) + np.array(color, dtype=float)
    image *= 1.0 + 0.025 * rng.standard_normal((height_px, width_px, 1))
    if kind == "siding":
        image[::6] *= 0.80
        return image
    for course, top in enumerate(range(0, height_px, 5)):
        for left in range(3 * (course % 2), width_px, 10):
            image[top : top + 4, left : left + 9] *= rng.uniform(0.86, 1.10)
            image[top : top + 4, left + 9 : left + 10] = (196, 188, 176)
        image[top + 4 : top + 5] = (196, 188, 176)
    return image


def _window(picture, low, high):
    """A window with a frame, a cross bar and a sill; shares of the picture."""
    (x0, y0), (x1, y1) = low, high
    dx, dy = 0.10 * (x1 - x0), 0.07 * (y1 - y0)
    picture.rect((x0 - dx, y0 - 1.8 * dy), (x1 + dx, y1 + dy), FRAME).rect(low, high, GLASS)
    picture.polygon(((x0, y0), (x0 + 0.35 * (x1 - x0), y0), (x1, y1), (x1 - 0.35 * (x1 - x0), y1)), SKY_GLASS)
    middle = 0.5 * (x0 + x1)
    picture.rect((middle - 0.25 * dx, y0), (middle + 0.25 * dx, y1), FRAME)
    picture.rect((x0, 0.5 * (y0 + y1) - 0.3 * dy), (x1, 0.5 * (y0 + y1) + 0.3 * dy), FRAME)


def _house_front(rng, kind, color, door):
    """Front wall: a door with steps between two windows."""
    picture = Picture(124, 64, color)
    picture.image[:] = _wall(rng, 124, 64, kind, color)
    picture.rect((0.0, 0.0), (1.0, 0.08), STONE)
    picture.rect((0.415, 0.0), (0.585, 0.76), FRAME).rect((0.435, 0.06), (0.565, 0.72), door)
    for low in (0.12, 0.42):
        picture.rect((0.455, low), (0.545, low + 0.22), np.array(door) * 0.8)
    picture.disc((0.55, 0.36), 0.010, (220, 190, 90))
    for x in (0.10, 0.70):
        _window(picture, (x, 0.34), (x + 0.20, 0.74))
    return picture.image


def _house_side(rng, kind, color):
    picture = Picture(128, 64, color)
    picture.image[:] = _wall(rng, 128, 64, kind, color)
    picture.rect((0.0, 0.0), (1.0, 0.08), STONE)
    for x in (0.10, 0.43, 0.74):
        _window(picture, (x, 0.34), (x + 0.15, 0.74))
    return picture.image


def _roof_tiles(rng, color):
    image = np.zeros((64, 64, 3)) + np.array(color, dtype=float)
    image *= 1.0 + 0.05 * rng.standard_normal((64, 64, 1))
    for row in range(0, 64, 6):
        image[row : row + 1] *= 0.66
        image[row : row + 6, (row % 12) // 2 :: 6] *= 0.88
    return image


def make_house(folder, name, kind, color, roof, door):
    """Write a house of 9 x 7 x 5.5 m with a gabled roof, its ridge along x, and a chimney."""
    rng = make_rng(len(name) + sum(color))
    atlas = Atlas({
        "front": _house_front(rng, kind, color, door), "side": _house_side(rng, kind, color),
        "gable": _wall(rng, 64, 32, kind, color), "roof": _roof_tiles(rng, roof),
        "frame": FRAME, "brick": (142, 78, 62), "stone": STONE, "dark": (52, 48, 46),
    }, 128)  # fmt: skip
    mesh, (x, y) = Mesh(), (WALL_M[0] / 2, WALL_M[1] / 2)
    faces = {"X": atlas.patch("front"), "x": atlas.patch("side"), "y": atlas.patch("side"), "Y": atlas.patch("side")}
    mesh.add_box((-x, -y, 0), (x, y, EAVES_M), atlas.patch("side"), skip="zZ", faces=faces)
    mesh.add_prism(((-y, EAVES_M), (y, EAVES_M), (0, RIDGE_M)), (-x, x), atlas.patch("gable"), "x", [None] * 3)
    slope = (RIDGE_M - EAVES_M) / y
    eave_y, eave_z = y + OVERHANG_M, EAVES_M - slope * OVERHANG_M
    long_x = x + 0.3
    for side in (1, -1):
        low, high = (
            [(-long_x, side * eave_y), (long_x, side * eave_y)][::-side],
            [(long_x, 0.0), (-long_x, 0.0)][::-side],
        )
        top = [(*p, eave_z + 0.08) for p in low] + [(*p, RIDGE_M + 0.08) for p in high]
        mesh.add_quad(top, atlas.patch("roof"))
        mesh.add_quad([(px, py, pz - 0.10) for px, py, pz in top][::-1], atlas.patch("dark"))
        (ax, ay), (bx, by) = low
        edge = [(ax, ay, eave_z - 0.02), (bx, by, eave_z - 0.02), (bx, by, eave_z + 0.08), (ax, ay, eave_z + 0.08)]
        mesh.add_quad(edge, atlas.patch("frame"))
    for end in (1, -1):
        for side in (1, -1):
            board = [(end * long_x, side * eave_y, eave_z - 0.06), (end * long_x, 0.0, RIDGE_M - 0.06)]
            board += [(end * long_x, 0.0, RIDGE_M + 0.08), (end * long_x, side * eave_y, eave_z + 0.08)]
            mesh.add_quad(board[:: -end * side], atlas.patch("frame"))
    mesh.add_box((-2.2, 0.9, 3.6), (-1.6, 1.5, 5.5), atlas.patch("brick"), skip="z")
    mesh.add_box((x, -0.9, 0.0), (x + 0.3, 0.9, 0.16), atlas.patch("stone"), skip="xz")
    mesh.fit((9.0, 7.0, 5.5))
    write_model(folder, name, mesh, atlas)


def _shop(word, color):
    """One shop window, 6 m wide and 3.4 m high, with its sign above."""
    picture = Picture(128, 72, (206, 198, 184)).rect((0.03, 0.0), (0.97, 0.06), STONE)
    picture.rect((0.04, 0.06), (0.62, 0.68), (60, 62, 66)).rect((0.05, 0.08), (0.61, 0.66), GLASS)
    for x in (0.16, 0.35, 0.53):
        picture.rect((x - 0.03, 0.08), (x + 0.03, 0.34), (196, 170, 140)).disc((x, 0.40), 0.018, (226, 190, 160))
    picture.polygon(((0.10, 0.08), (0.20, 0.08), (0.42, 0.66), (0.32, 0.66)), SKY_GLASS)
    picture.rect((0.235, 0.08), (0.245, 0.66), (60, 62, 66)).rect((0.425, 0.08), (0.435, 0.66), (60, 62, 66))
    picture.rect((0.66, 0.0), (0.95, 0.68), (60, 62, 66))
    for x in (0.675, 0.81):
        picture.rect((x, 0.04), (x + 0.125, 0.66), GLASS).rect((x + 0.01, 0.30), (x + 0.022, 0.44), (210, 212, 216))
    picture.rect((0.0, 0.72), (1.0, 1.0), color)
    return picture.text(word, (0.22, 0.78), (0.78, 0.95), (250, 250, 246)).image


def make_mall_front(folder):
    """Write three shops under a parapet, 18 x 1.0 x 5.0 m, facing +y."""
    rng = make_rng(18)
    words = (("MARKET", (30, 110, 66)), ("BAKERY", (168, 92, 28)), ("BOOKS", (38, 74, 140)))
    parts = {f"shop_{k}": _shop(*shop) for k, shop in enumerate(words)}
    parts.update({"wall": _wall(rng, 128, 32, "brick", (188, 150, 124)), "trim": (226, 220, 208), "dark": (88, 84, 80)})
    atlas, mesh = Atlas(parts, 128), Mesh()
    for k in range(3):
        x0 = 9.0 - 6.0 * (k + 1)  # read from +y, x runs to the left
        shop, wall = atlas.patch(f"shop_{2 - k}"), atlas.patch("wall")
        mesh.add_box((x0, -0.40, 0.0), (x0 + 6.0, 0.25, 3.4), wall, skip="xXyzZ", faces={"Y": shop})
        mesh.add_box((x0, -0.40, 3.4), (x0 + 6.0, 0.25, 4.7), wall, skip="xXyzZ")
        mesh.add_box((x0 - 0.0, 0.25, 0.0), (x0 + 0.18, 0.40, 3.4), atlas.patch("trim"), skip="yz")
    mesh.add_box((-9.0, -0.40, 3.36), (9.0, 0.60, 3.48), atlas.patch("trim"))
    mesh.add_box((-9.0, -0.40, 4.7), (9.0, 0.40, 5.0), atlas.patch("trim"))
    mesh.add_box((-9.0, -0.40, 0.0), (9.0, 0.25, 4.7), atlas.patch("dark"), skip="YzZ")
    mesh.fit((18.0, 1.0, 5.0))
    write_model(folder, "mall_front", mesh, atlas)


def make_all(folder):
    """Write the buildings and their textures into a folder."""
    make_house(folder, "house_a", "siding", (222, 208, 168), (122, 66, 52), (120, 34, 30))
    make_house(folder, "house_b", "brick", (168, 94, 74), (74, 78, 86), (32, 74, 58))
    make_mall_front(folder)

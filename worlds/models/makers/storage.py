# SPDX-License-Identifier: BSD-3-Clause
"""Cones, cartons, pallets and storage racks of the warehouse, and its concrete floor."""

import numpy as np

from makers.mesh import Mesh
from makers.textures import make_rng, tileable_noise, wood_grain, write_png

ORANGE, WHITE, BLACK = (238, 92, 20), (245, 245, 240), (38, 38, 40)
RACK_BLUE, BEAM_ORANGE, STEEL = (34, 70, 150), (236, 110, 24), (150, 154, 160)
CARDBOARD, CARDBOARD_DARK, TAPE = (190, 148, 98), (168, 126, 80), (214, 186, 140)
WOOD, WOOD_DARK = (196, 158, 108), (150, 112, 70)

# Patches of the rack's texture: name -> (u0, v0, u1, v1), v upwards.
RACK_PATCHES = {
    "blue": (0.0, 0.75, 0.25, 1.0),
    "orange": (0.25, 0.75, 0.5, 1.0),
    "steel": (0.5, 0.75, 0.75, 1.0),
    "wood": (0.75, 0.75, 1.0, 1.0),
    "stack_a": (0.0, 0.375, 0.5, 0.75),
    "stack_b": (0.5, 0.375, 1.0, 0.75),
    "stack_c": (0.0, 0.0, 0.5, 0.375),
    "stack_d": (0.5, 0.0, 1.0, 0.375),
}


def concrete_texture(rng, size_px=256):
    """Grey slab with stains, grain and a joint along two edges, repeatable."""
    tone = 158 + 6.0 * tileable_noise(rng, size_px, 4) + 2.5 * rng.standard_normal((size_px, size_px))
    tone[:2, :] -= 34
    tone[:, :2] -= 34
    return tone[..., None] * np.array([1.0, 0.995, 0.975])


def cardboard_face(rng, height_px, width_px, color):
    """One face of a carton: fibres, a tape strip down the middle and a printed label."""
    image = np.array(color) + 4.0 * rng.standard_normal((height_px, width_px, 1)) + np.zeros(3)
    tape = np.array(TAPE) + 2.0 * rng.standard_normal((height_px, 1, 1))
    image[:, int(0.46 * width_px) : int(0.54 * width_px)] = tape
    image[int(0.58 * height_px) : int(0.82 * height_px), int(0.64 * width_px) : int(0.90 * width_px)] = WHITE
    for row in (0.64, 0.70, 0.76):
        image[int(row * height_px) : int(row * height_px) + 2, int(0.68 * width_px) : int(0.86 * width_px)] = BLACK
    image[[0, 1, -1, -2]] *= 0.72
    image[:, [0, 1, -1, -2]] *= 0.72
    return image


def wood_texture(rng, size_px, color=WOOD, dark=WOOD_DARK):
    """Square of boards with grain along the image's x axis."""
    return wood_grain(rng, (size_px, size_px), color, dark)


def rack_texture(rng, size_px=256):
    """Atlas of RACK_PATCHES."""
    image = np.zeros((size_px, size_px, 3))
    quarter = size_px // 4
    for i, color in enumerate((RACK_BLUE, BEAM_ORANGE, STEEL)):
        grain = 2.0 * rng.standard_normal((quarter, quarter, 1))
        image[:quarter, i * quarter : (i + 1) * quarter] = np.array(color) + grain
    image[:quarter, 3 * quarter :] = wood_texture(rng, quarter)
    height_px, width_px = 3 * quarter // 2, size_px // 2
    for i, (rows, columns) in enumerate(((2, 3), (2, 2), (3, 3), (2, 4))):
        top, left = quarter + (i // 2) * height_px, (i % 2) * width_px
        image[top : top + height_px, left : left + width_px] = stack_face(rng, (height_px, width_px), rows, columns)
    return image


def stack_face(rng, shape_px, rows, columns):
    """A wall of cartons of slightly different browns."""
    image = np.zeros((*shape_px, 3))
    ys, xs = (np.linspace(0, n, k + 1).astype(int) for n, k in zip(shape_px, (rows, columns)))
    for y0, y1 in zip(ys[:-1], ys[1:]):
        for x0, x1 in zip(xs[:-1], xs[1:]):
            color = np.array(CARDBOARD if rng.random() < 0.6 else CARDBOARD_DARK) * rng.uniform(0.92, 1.05)
            image[y0:y1, x0:x1] = cardboard_face(rng, y1 - y0, x1 - x0, color)
    return image


def cone_texture(size_px=64):
    """Left half: orange cone with two white bands, by height. Right half: black foot."""
    image = np.zeros((size_px, size_px, 3)) + np.array(ORANGE)
    height = 1.0 - (np.arange(size_px) + 0.5) / size_px
    for low, high in ((0.34, 0.56), (0.70, 0.82)):
        image[(height > low) & (height < high)] = WHITE
    image[:, size_px // 2 :] = ORANGE
    image[size_px // 2 :, size_px // 2 :] = BLACK
    return image


def make_cone(foot_m=0.36, height_m=0.70, foot_height_m=0.045, sides=14):
    """Traffic cone: square foot, frustum with bands, flat tip."""
    mesh = Mesh()
    half = foot_m / 2
    mesh.add_box((-half, -half, 0), (half, half, foot_height_m), (0.6, 0.6, 0.9, 0.9), skip="z")
    angle = 2 * np.pi * np.arange(sides + 1) / sides
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    r0, r1 = 0.135, 0.03
    for a, b in zip(ring[:-1], ring[1:]):
        low = [(*(r0 * a), foot_height_m), (*(r0 * b), foot_height_m)]
        high = [(*(r1 * b), height_m), (*(r1 * a), height_m)]
        mesh.add_quad(low + high, (0.1, 0.02, 0.4, 0.98))
    for i in range(1, sides - 2, 2):  # the tip as a fan of quads; sides is even
        mesh.add_quad([(*(r1 * ring[j]), height_m) for j in (0, i, i + 1, i + 2)], (0.1, 0.95, 0.4, 0.98))
    return mesh


def make_box():
    """Unit carton, 1 x 1 x 1, to be scaled."""
    mesh = Mesh()
    mesh.add_box((-0.5, -0.5, 0), (0.5, 0.5, 1), (0.0, 0.0, 1.0, 1.0), skip="z")
    return mesh


def make_pallet(length_m=1.2, width_m=0.8, height_m=0.144, patch=(0.0, 0.0, 1.0, 0.25)):
    """Pallet of five top boards along x on three beams across them, and three boards below."""
    mesh = Mesh()
    board_m, thick_m, x, y = 0.12, 0.022, length_m / 2, width_m / 2
    for centre in np.linspace(-y + board_m / 2, y - board_m / 2, 5):
        mesh.add_box((-x, centre - board_m / 2, height_m - thick_m), (x, centre + board_m / 2, height_m), patch)
    for centre in (-x + 0.06, 0.0, x - 0.06):
        mesh.add_box((centre - 0.05, -y, 0), (centre + 0.05, y, height_m - thick_m), patch, skip="zZ")
    return mesh


def make_rack(rng, sides="yY", length_m=2.7, depth_m=1.1, height_m=2.8):
    """Bay of a storage rack: blue uprights, orange beams at two levels, two loads of cartons on each of three levels.

    sides: long sides that can be seen, 'yY' for a rack between two aisles, 'y' for one with its back to a wall.
    """
    mesh = Mesh()
    x, y, post_m = length_m / 2, depth_m / 2, 0.09
    hidden = "" if "Y" in sides else "Y"
    fronts = [-y, y - post_m] if "Y" in sides else [-y]
    for sy in fronts:
        for sx in (-x, x - post_m):
            mesh.add_box((sx, sy, 0), (sx + post_m, sy + post_m, height_m), RACK_PATCHES["blue"], skip="zZ" + hidden)
        for level_m in (1.25, 2.25):
            low, high = (-x + post_m, sy, level_m - 0.13), (x - post_m, sy + 0.05, level_m)
            mesh.add_box(low, high, RACK_PATCHES["orange"], skip="xXZ" + ("Y" if sy < 0 else "y"))
    for level_m in (1.25, 2.25):  # decks, seen from below
        under = [(-x, y, level_m - 0.03), (x, y, level_m - 0.03), (x, -y, level_m - 0.03), (-x, -y, level_m - 0.03)]
        mesh.add_quad(under, RACK_PATCHES["steel"])
    for level_m, room_m in ((0.0, 1.05), (1.25, 0.80), (2.25, 0.50)):
        _load_level(mesh, rng, (x, y), (level_m, room_m), hidden)
    return mesh


def _load_level(mesh, rng, half_m, level, hidden):
    """Put two pallets on one level, each with one block of cartons."""
    (x, y), (level_m, room_m) = half_m, level
    pallet_high = level_m + 0.12
    mesh.add_box((-x + 0.1, -y + 0.06, level_m), (x - 0.1, y - 0.06, pallet_high), RACK_PATCHES["wood"], "z" + hidden)
    for low_x, high_x in ((-x + 0.13, -0.04), (0.04, x - 0.13)):
        low_x, high_x = low_x + rng.uniform(0.0, 0.05), high_x - rng.uniform(0.0, 0.05)
        top, inset = pallet_high + room_m * rng.uniform(0.66, 0.90), rng.uniform(0.08, 0.13)
        patch = RACK_PATCHES[("stack_a", "stack_b", "stack_c", "stack_d")[int(rng.integers(4))]]
        mesh.add_box((low_x, -y + inset, pallet_high), (high_x, y - inset, top), patch, skip="z" + hidden)


def make_all(folder):
    """Write these models and textures into a folder."""
    rng = make_rng(7)
    textures = folder / "textures"
    textures.mkdir(parents=True, exist_ok=True)
    write_png(textures / "concrete.png", concrete_texture(rng))
    write_png(textures / "cone.png", cone_texture())
    write_png(textures / "cardboard.png", cardboard_face(rng, 128, 128, CARDBOARD))
    write_png(textures / "wood.png", wood_texture(rng, 128))
    write_png(textures / "rack.png", rack_texture(rng))
    make_cone().write(folder, "traffic_cone", "textures/cone.png")
    make_box().write(folder, "cardboard_box", "textures/cardboard.png")
    make_pallet().write(folder, "pallet", "textures/wood.png")
    for letter in "abc":
        make_rack(rng).write(folder, f"storage_rack_{letter}", "textures/rack.png")
        make_rack(rng, sides="y").write(folder, f"storage_rack_wall_{letter}", "textures/rack.png")

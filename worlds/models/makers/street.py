# SPDX-License-Identifier: BSD-3-Clause
"""Small things of a street and a parking lot. What is longer along x than along y faces +y, the rest faces +x."""

import numpy as np

from .mesh import Mesh
from .textures import Atlas, Picture, make_rng, write_model

STEEL, RUBBER, WOOD = (168, 172, 178), (32, 32, 34), (158, 110, 64)


def _grain(rng, color, shape_px=(16, 64), amount=0.10):
    """Wood: lines along the picture's x axis."""
    lines = amount * rng.standard_normal((shape_px[0], 1, 1)) + 0.03 * rng.standard_normal((*shape_px, 1))
    return (1.0 + lines) * np.array(color, dtype=float)


def make_hydrant(folder):
    """Write a red fire hydrant of 0.35 x 0.35 x 0.75 m."""
    atlas = Atlas({"red": (204, 28, 28), "dark": (136, 18, 20), "cap": (244, 200, 40)}, 16)
    mesh, red, cap = Mesh(), atlas.patch("red"), atlas.patch("cap")
    profile = (
        (0, 0),
        (0.15, 0),
        (0.15, 0.05),
        (0.095, 0.07),
        (0.095, 0.50),
        (0.125, 0.51),
        (0.125, 0.55),
        (0.10, 0.56),
    )
    profile += ((0.085, 0.65), (0.04, 0.70), (0.0, 0.705))
    patches = [None, red, red, red, red, atlas.patch("dark"), red, red, red, red]
    mesh.add_lathe(profile, patches, sides=12)
    mesh.add_lathe(((0.03, 0.69), (0.03, 0.75), (0, 0.75)), cap, sides=5)
    for side, radius, reach in (("x", 0.065, 0.175), ("y", 0.05, 0.175), ("-y", 0.05, 0.175)):
        sign = -1.0 if side[0] == "-" else 1.0
        direction = np.array([1.0, 0, 0]) if side[-1] == "x" else np.array([0, sign, 0])
        start = np.array([0, 0, 0.40])
        mesh.add_tube([start, start + 0.14 * direction], radius, red, sides=8, caps=False)
        mesh.add_tube([start + 0.13 * direction, start + reach * direction], radius + 0.008, cap, sides=8)
    mesh.fit((0.35, 0.35, 0.75))
    write_model(folder, "fire_hydrant", mesh, atlas)


def make_bench(folder):
    """Write a park bench of 1.6 x 0.6 x 0.85 m: wooden slats on iron legs, to sit facing +y."""
    atlas = Atlas({"wood": _grain(make_rng(51), WOOD), "iron": (46, 50, 52)}, 64)
    mesh, wood, iron = Mesh(), atlas.patch("wood"), atlas.patch("iron")
    for y in (-0.12, 0.0, 0.12, 0.24):
        mesh.add_box((-0.8, y - 0.05, 0.42), (0.8, y + 0.05, 0.46), wood)
    for z, y in ((0.53, -0.20), (0.65, -0.235), (0.77, -0.27)):
        mesh.add_box((-0.8, y - 0.02, z - 0.045), (0.8, y + 0.015, z + 0.045), wood)
    for x in (-0.66, 0.66):
        low, high = x - 0.03, x + 0.03
        mesh.add_prism(((-0.20, 0.42), (0.28, 0.42), (0.28, 0.36), (-0.20, 0.36)), (low, high), iron, "x")
        mesh.add_prism(((0.30, 0.0), (0.24, 0.0), (0.22, 0.40), (0.28, 0.40)), (low, high), iron, "x")
        mesh.add_prism(
            ((-0.30, 0.0), (-0.24, 0.0), (-0.17, 0.42), (-0.24, 0.85), (-0.29, 0.85), (-0.23, 0.42)),
            (low, high),
            iron,
            "x",
        )
        mesh.add_box((low, -0.24, 0.62), (high, 0.30, 0.66), iron)
        mesh.add_box((low, 0.25, 0.44), (high, 0.29, 0.62), iron, skip="zZ")
    mesh.fit((1.6, 0.6, 0.85))
    write_model(folder, "bench", mesh, atlas)


def make_wheelie_bin(folder):
    """Write a green household bin of 0.6 x 0.75 x 1.1 m, its lid's lip to +x, wheels behind."""
    green = (44, 98, 58)
    front = (
        Picture(32, 48, green)
        .rect((0.3, 0.5), (0.7, 0.76), (236, 236, 230))
        .text("7", (0.42, 0.53), (0.58, 0.73), (30, 30, 30))
    )
    front.rect((0.12, 0.1), (0.16, 0.9), np.array(green) * 0.8).rect((0.84, 0.1), (0.88, 0.9), np.array(green) * 0.8)
    atlas = Atlas({"front": front.image, "green": green, "lid": (30, 72, 42), "black": RUBBER, "hub": STEEL}, 48)
    mesh, body = Mesh(), atlas.patch("green")
    low = np.array([(-0.18, -0.22), (0.18, -0.22), (0.18, 0.22), (-0.18, 0.22)])
    high = np.array([(-0.24, -0.29), (0.27, -0.29), (0.27, 0.29), (-0.24, 0.29)])
    bottom, top = (np.column_stack([ring, np.full(4, z)]) for ring, z in ((low, 0.07), (high, 0.98)))
    for k in range(4):
        mesh.add_quad(
            [bottom[k], bottom[(k + 1) % 4], top[(k + 1) % 4], top[k]], atlas.patch("front") if k == 1 else body
        )
    mesh.add_quad(bottom[::-1], body)
    lid = ((-0.30, 0.98), (0.32, 0.98), (0.32, 1.03), (0.10, 1.09), (-0.30, 1.05))
    mesh.add_prism(lid, (-0.33, 0.33), atlas.patch("lid"), "y")
    mesh.add_tube([(-0.29, -0.28, 1.06), (-0.29, 0.28, 1.06)], 0.025, atlas.patch("black"), sides=6)
    for y in (-0.35, 0.27):
        profile = ((0, 0), (0.10, 0), (0.10, 0.08), (0, 0.08))
        hub = [atlas.patch("hub"), atlas.patch("black"), atlas.patch("hub")]
        mesh.add_lathe(profile, hub, 10, "y", offset_m=(-0.20, y, 0.10))
    mesh.fit((0.6, 0.75, 1.1))
    write_model(folder, "wheelie_bin", mesh, atlas)


def make_lamp_post(folder):
    """Write a street lamp of 0.3 x 0.3 x 4.5 m with a lantern on top."""
    atlas = Atlas({"iron": (52, 58, 60), "light": (255, 244, 206)}, 16)
    mesh, iron = Mesh(), atlas.patch("iron")
    mesh.add_lathe(
        ((0.15, 0), (0.15, 0.10), (0.09, 0.25), (0.075, 0.9), (0.05, 1.0), (0.04, 3.9), (0.08, 3.95)), iron, sides=8
    )
    mesh.add_lathe(((0.08, 3.95), (0.13, 4.3)), atlas.patch("light"), sides=6)
    mesh.add_lathe(((0.0, 4.3), (0.15, 4.3), (0.05, 4.42), (0.03, 4.5), (0, 4.5)), iron, sides=6)
    mesh.fit((0.3, 0.3, 4.5))
    write_model(folder, "lamp_post", mesh, atlas)


def make_mailbox(folder):
    """Write a blue street mailbox of 0.5 x 0.45 x 1.3 m, its flap to +x."""
    blue = (28, 70, 148)
    front = (
        Picture(32, 64, blue)
        .rect((0.12, 0.80), (0.88, 0.86), (14, 28, 58))
        .rect((0.10, 0.87), (0.90, 0.90), (200, 204, 210))
    )
    front.rect((0.2, 0.34), (0.8, 0.66), (240, 240, 240)).text("MAIL", (0.25, 0.44), (0.75, 0.56), blue)
    side = (
        Picture(32, 64, blue)
        .rect((0.1, 0.44), (0.9, 0.66), (240, 240, 240))
        .text("MAIL", (0.16, 0.49), (0.84, 0.61), blue)
    )
    atlas = Atlas({"front": front.image, "side": side.image, "blue": blue, "dark": (18, 44, 96)}, 64)
    mesh, x, y = Mesh(), 0.25, 0.225
    for dx in (-x, x - 0.06):
        for dy in (-y, y - 0.06):
            mesh.add_box((dx, dy, 0), (dx + 0.06, dy + 0.06, 0.2), atlas.patch("dark"), skip="zZ")
    faces = {"X": atlas.patch("front"), "y": atlas.patch("side"), "Y": atlas.patch("side")}
    mesh.add_box((-x, -y, 0.2), (x, y, 1.05), atlas.patch("blue"), skip="Z", faces=faces)
    arch = [(x * np.cos(a), 1.05 + 0.25 * np.sin(a)) for a in np.linspace(0, np.pi, 7)]
    mesh.add_prism(arch, (-y, y), atlas.patch("blue"), "y", [*[atlas.patch("blue")] * 6, None])
    mesh.fit((0.5, 0.45, 1.3))
    write_model(folder, "mailbox", mesh, atlas)


def _wire(color, gap):
    """Wire mesh, seen against a dark inside."""
    picture = Picture(48, 32, gap)
    picture.image[::6] = picture.image[1::6] = color
    picture.image[:, ::6] = color
    picture.image[:3] = picture.image[-3:] = color
    return picture.image


def make_cart(folder):
    """Write a shopping cart of 0.95 x 0.58 x 1.0 m, its handle behind at -x."""
    atlas = Atlas(
        {"wire": _wire((206, 210, 214), (86, 90, 96)), "steel": STEEL, "red": (206, 34, 40), "black": RUBBER}, 64
    )
    mesh, wire, steel = Mesh(), atlas.patch("wire"), atlas.patch("steel")
    low = np.array([(-0.30, -0.19, 0.50), (0.36, -0.19, 0.56), (0.36, 0.19, 0.56), (-0.30, 0.19, 0.50)])
    high = np.array([(-0.36, -0.27, 0.93), (0.47, -0.22, 0.86), (0.47, 0.22, 0.86), (-0.36, 0.27, 0.93)])
    for k in range(4):
        quad = [low[k], low[(k + 1) % 4], high[(k + 1) % 4], high[k]]
        mesh.add_quad(quad, wire)
        mesh.add_quad([quad[1], quad[0], quad[3], quad[2]], wire)
        mesh.add_tube([high[k], high[(k + 1) % 4]], 0.012, steel, sides=4)
    mesh.add_quad(low[::-1], wire)
    mesh.add_quad(low, wire)
    for y in (-0.24, 0.24):
        legs = [(-0.36, 1.1 * y, 0.93), (-0.32, y, 0.50), (-0.38, y, 0.16), (0.38, 0.8 * y, 0.16)]
        mesh.add_tube(legs, 0.014, steel, sides=5)
        mesh.add_tube([(-0.32, y, 0.50), (0.10, 0.9 * y, 0.16)], 0.012, steel, sides=4)
        mesh.add_tube([(-0.36, 1.1 * y, 0.92), (-0.46, 1.1 * y, 0.985)], 0.014, steel, sides=5)
        for x, scale in ((-0.38, 1.0), (0.38, 0.8)):
            profile = ((0, 0), (0.065, 0), (0.065, 0.03), (0, 0.03))
            mesh.add_lathe(profile, atlas.patch("black"), 8, "y", offset_m=(x, scale * y - 0.015, 0.065))
            mesh.add_tube([(x, scale * y, 0.16), (x, scale * y, 0.08)], 0.014, steel, sides=4, caps=False)
    mesh.add_tube([(-0.46, -0.285, 0.98), (-0.46, 0.285, 0.98)], 0.022, atlas.patch("red"), sides=6)
    mesh.fit((0.95, 0.58, 1.0))
    write_model(folder, "shopping_cart", mesh, atlas)


def make_curb_stone(folder):
    """Write a piece of curb of 2 x 0.15 x 0.08 m in two stones, both long edges bevelled."""
    rng = make_rng(52)
    face = _grain(rng, (176, 174, 168), (16, 64), 0.03) * (1.0 + 0.04 * rng.standard_normal((16, 64, 1)))
    face[:, (0, 31, 32, 63)] = (120, 118, 112)
    atlas, mesh = Atlas({"stone": face, "end": (150, 148, 142)}, 64), Mesh()
    section = ((-0.075, 0.0), (0.075, 0.0), (0.075, 0.06), (0.055, 0.08), (-0.055, 0.08), (-0.075, 0.06))
    mesh.add_prism(section, (-1.0, 1.0), atlas.patch("end"), "x", [None, *[atlas.patch("stone")] * 5])
    mesh.fit((2.0, 0.15, 0.08))
    write_model(folder, "curb_stone", mesh, atlas)


def make_fence(folder, pickets=12):
    """Write a white picket fence of 2 x 0.08 x 1.1 m; pieces join end to end."""
    atlas = Atlas({"white": _grain(make_rng(53), (236, 234, 226), (32, 16), 0.0), "post": (222, 220, 212)}, 32)
    mesh, white, pitch = Mesh(), atlas.patch("white"), 2.0 / pickets
    for z in (0.28, 0.78):
        mesh.add_box((-1.0, -0.015, z - 0.045), (1.0, 0.015, z + 0.045), atlas.patch("post"))
    for k in range(pickets):
        x = -1.0 + pitch * (k + 0.5)
        outline = ((x - 0.045, 0.06), (x + 0.045, 0.06), (x + 0.045, 0.93), (x, 1.0), (x - 0.045, 0.93))
        mesh.add_prism(outline, (-0.03, -0.015), white, "y", [None, white, white, white, white])
    for x in (-0.96, 0.96):
        mesh.add_box((x - 0.04, -0.04, 0), (x + 0.04, 0.04, 1.1), atlas.patch("post"), skip="z")
    mesh.fit((2.0, 0.08, 1.1))
    write_model(folder, "fence", mesh, atlas)


def make_storefront_sign(folder):
    """Write a board for the pavement of 0.65 x 0.6 x 1.0 m, written on both faces, +x and -x."""
    face = Picture(48, 64, (36, 44, 40)).rect((0.0, 0.0), (1.0, 0.04), WOOD).rect((0.0, 0.96), (1.0, 1.0), WOOD)
    face.rect((0.0, 0.0), (0.06, 1.0), WOOD).rect((0.94, 0.0), (1.0, 1.0), WOOD)
    face.text("OPEN", (0.16, 0.66), (0.84, 0.86), (250, 250, 240)).text(
        "COFFEE", (0.14, 0.42), (0.86, 0.56), (240, 190, 90)
    )
    face.text("CAKE", (0.22, 0.20), (0.78, 0.34), (240, 150, 160))
    atlas, mesh = Atlas({"face": face.image, "wood": WOOD}, 64), Mesh()
    for end in (1, -1):
        low, high = (end * 0.32, end * 0.03)
        quad = [(low, -end * 0.30, 0.0), (low, end * 0.30, 0.0), (high, end * 0.30, 1.0), (high, -end * 0.30, 1.0)]
        mesh.add_quad(quad, atlas.patch("face"))
        mesh.add_quad([(x - end * 0.025, y, z) for x, y, z in quad][::-1], atlas.patch("wood"))
    mesh.add_box((-0.055, -0.30, 0.96), (0.055, 0.30, 1.0), atlas.patch("wood"))
    mesh.fit((0.65, 0.6, 1.0))
    write_model(folder, "storefront_sign", mesh, atlas)


def make_all(folder):
    """Write these models and their textures into a folder."""
    for make in (make_hydrant, make_bench, make_wheelie_bin, make_lamp_post, make_mailbox, make_cart, make_curb_stone):
        make(folder)
    make_fence(folder)
    make_storefront_sign(folder)

# SPDX-License-Identifier: BSD-3-Clause
"""Furniture of the hospital. What is long along x (counter, row of chairs) faces +y."""

import numpy as np

from makers.colors import BLACK, DARK, STEEL, WHITE
from makers.mesh import Mesh
from makers.textures import Atlas, Picture, make_rng, wood_grain, write_model

SEAT = (44, 104, 168)


def _add_seat(mesh, place_m, turn_rad, patch):
    """Upholstered shell: seat and back, looking along +x before it is turned."""
    shell = Mesh()
    shell.add_box((-0.23, -0.23, 0.41), (0.24, 0.23, 0.48), patch("seat"))
    shell.add_prism([(-0.23, 0.50), (-0.17, 0.50), (-0.22, 0.85), (-0.28, 0.85)], (-0.23, 0.23), patch("seat"))
    mesh.add_mesh(shell, place_m, (0, 0, turn_rad))


def make_waiting_chair():
    """Chair with arm rests, looking along +x."""
    atlas = Atlas({"seat": SEAT, "steel": STEEL, "black": BLACK})
    mesh, patch = Mesh(), atlas.patch
    _add_seat(mesh, (0, 0, 0), 0.0, patch)
    for y in (-0.255, 0.255):
        legs = [(0.22, y, 0), (0.20, y, 0.66), (-0.24, y, 0.66), (-0.26, y, 0)]
        mesh.add_tube(legs, 0.016, patch("steel"), sides=4, caps=False)
        mesh.add_box((-0.2, y - 0.025, 0.655), (0.2, y + 0.025, 0.69), patch("black"))
        mesh.add_beam((-0.25, y, 0.42), (0.21, y, 0.42), (0.025, 0.03), patch("steel"), caps=False)
    mesh.add_beam((-0.2, -0.25, 0.42), (-0.2, 0.25, 0.42), (0.03, 0.03), patch("steel"), caps=False)
    mesh.fit((0.55, 0.55, 0.85))
    return mesh, atlas


def make_chair_row():
    """Three seats on a beam along x, looking along +y."""
    atlas = Atlas({"seat": SEAT, "steel": STEEL, "black": BLACK})
    mesh, patch = Mesh(), atlas.patch
    for x in (-0.57, 0.0, 0.57):
        _add_seat(mesh, (x, 0, 0), np.pi / 2, patch)
    mesh.add_box((-0.8, -0.05, 0.34), (0.8, 0.03, 0.41), patch("steel"))
    for x in (-0.55, 0.55):
        mesh.add_box((x - 0.03, -0.04, 0.03), (x + 0.03, 0.02, 0.35), patch("steel"), skip="zZ")
        mesh.add_box((x - 0.03, -0.30, 0), (x + 0.03, 0.28, 0.04), patch("black"), skip="z")
    for x in (-0.83, -0.285, 0.285, 0.83):
        mesh.add_box((x - 0.02, -0.18, 0.62), (x + 0.02, 0.22, 0.66), patch("black"))
        mesh.add_beam((x, 0.0, 0.36), (x, 0.0, 0.63), (0.03, 0.03), patch("steel"), caps=False)
    mesh.fit((1.7, 0.6, 0.85))
    return mesh, atlas


def make_coffee_table():
    """Low wooden table with two magazines."""
    cover = Picture(32, 24, (206, 60, 60)).rect((0.1, 0.65), (0.9, 0.85), WHITE).disc((0.5, 0.35), 0.2, (240, 190, 120))
    other = (
        Picture(32, 24, (70, 130, 190))
        .rect((0.1, 0.65), (0.7, 0.85), WHITE)
        .rect((0.2, 0.15), (0.8, 0.5), (230, 220, 120))
    )
    wood = wood_grain(make_rng("table"), (32, 64), (186, 136, 88), (150, 104, 62))
    atlas = Atlas({"wood": wood, "cover": cover.image, "other": other.image, "steel": DARK})
    mesh, patch = Mesh(), atlas.patch
    mesh.add_box((-0.55, -0.3, 0.405), (0.55, 0.3, 0.445), patch("wood"))
    for x in (-0.5, 0.5):
        for y in (-0.25, 0.25):
            mesh.add_box((x - 0.025, y - 0.025, 0), (x + 0.025, y + 0.025, 0.405), patch("steel"), skip="zZ")
    mesh.add_box((-0.46, -0.2, 0.15), (0.46, 0.2, 0.17), patch("wood"))
    for x, y, name in ((-0.2, -0.02, "cover"), (0.18, 0.05, "other")):
        mesh.add_box((x - 0.14, y - 0.1, 0.445), (x + 0.14, y + 0.1, 0.45), patch(name), skip="z")
    return mesh, atlas


def make_reception_counter():
    """Reception desk: high front towards +y with its name on it, working top and a screen behind."""
    wood = wood_grain(make_rng("counter"), (24, 192), (200, 152, 100), (172, 124, 78))
    front = Picture(192, 64, (200, 152, 100)).paste(np.repeat(wood, 3, axis=0)[:64], (0, 0), (1, 1))
    for x in (0.2, 0.8):
        front.rect((x - 0.004, 0), (x + 0.004, 1), (130, 92, 58))
    front.rect((0.0, 0.0), (1.0, 0.1), DARK).rect((0.24, 0.34), (0.76, 0.76), (24, 120, 130))
    front.text("RECEPTION", (0.27, 0.44), (0.73, 0.67), WHITE)
    atlas = Atlas(
        {
            "front": front.image,
            "wood": wood,
            "white": WHITE,
            "top": (232, 234, 232),
            "dark": DARK,
            "screen": (40, 90, 140),
        },
        width_px=192,
    )
    mesh, patch = Mesh(), atlas.patch
    mesh.add_box((-1.5, 0.32, 0), (1.5, 0.40, 1.06), patch("wood"), skip="zZ", faces={"Y": patch("front")})
    mesh.add_box((-1.5, 0.12, 1.06), (1.5, 0.45, 1.10), patch("top"))
    for low, high in ((-1.5, -1.44), (1.44, 1.5)):
        mesh.add_box((low, -0.45, 0), (high, 0.32, 0.76), patch("wood"), skip="Yz")
    mesh.add_box((-1.44, -0.45, 0.72), (1.44, 0.32, 0.76), patch("white"))
    for x in (-0.6, 0.7):
        mesh.add_box((x - 0.26, 0.02, 0.80), (x + 0.26, 0.06, 1.09), patch("dark"), faces={"y": patch("screen")})
        mesh.add_box((x - 0.08, -0.04, 0.76), (x + 0.08, 0.1, 0.80), patch("dark"), skip="z")
    return mesh, atlas


def _vending_front():
    picture = Picture(128, 256, (196, 22, 30))
    picture.rect((0.06, 0.24), (0.70, 0.86), (24, 30, 40)).text("DRINKS", (0.1, 0.885), (0.9, 0.965), WHITE)
    colors = ((230, 60, 40), (250, 190, 30), (60, 160, 60), (240, 240, 240), (50, 110, 210), (240, 130, 30))
    for row in range(5):
        low = 0.25 + 0.122 * row
        picture.rect((0.07, low), (0.69, low + 0.116), (226, 238, 246)).rect(
            (0.07, low), (0.69, low + 0.016), (120, 124, 130)
        )
        for column in range(6):
            x, color = 0.095 + 0.1 * column, colors[(column + 2 * row) % 6]
            picture.rect((x, low + 0.016), (x + 0.07, low + 0.075), color)
            picture.rect((x + 0.022, low + 0.075), (x + 0.048, low + 0.1), color)
            picture.rect((x, low + 0.035), (x + 0.07, low + 0.055), WHITE)
    picture.rect((0.75, 0.24), (0.95, 0.86), (50, 52, 58)).rect((0.78, 0.72), (0.92, 0.81), (70, 220, 150))
    for row in range(4):
        for column in range(3):
            x, y = 0.785 + 0.048 * column, 0.5 + 0.045 * row
            picture.rect((x, y), (x + 0.036, y + 0.032), (220, 222, 224))
    picture.rect((0.83, 0.40), (0.87, 0.46), BLACK).rect((0.79, 0.28), (0.91, 0.34), BLACK)
    picture.rect((0.06, 0.07), (0.70, 0.19), (40, 42, 46)).rect((0.08, 0.085), (0.68, 0.15), (14, 14, 16))
    return picture.image


def make_vending_machine():
    """Red drinks machine, its lit front towards +x."""
    side = Picture(32, 64, (196, 22, 30)).polygon([(0, 0.2), (1, 0.45), (1, 0.7), (0, 0.45)], WHITE)
    atlas = Atlas({"front": _vending_front(), "side": side.image, "back": DARK, "red": (196, 22, 30)}, width_px=256)
    mesh, patch = Mesh(), atlas.patch
    faces = {"X": patch("front"), "x": patch("back"), "y": patch("side"), "Y": patch("side")}
    mesh.add_box((-0.45, -0.425, 0.06), (0.45, 0.425, 1.85), patch("red"), skip="z", faces=faces)
    mesh.add_box((-0.41, -0.385, 0), (0.41, 0.385, 0.06), patch("back"), skip="zZ")
    return mesh, atlas


def make_trash_can():
    """Round steel bin with a dark domed lid and an opening."""
    body = Picture(128, 64, (196, 200, 204)).rect((0, 0), (1, 0.06), DARK).rect((0, 0.94), (1, 1), DARK)
    for x in (0.0, 0.5):
        body.rect((x + 0.13, 0.3), (x + 0.37, 0.72), (28, 132, 70)).text(
            "TRASH", (x + 0.15, 0.42), (x + 0.35, 0.6), WHITE
        )
    lid = Picture(128, 16, (60, 64, 70))
    for x in (0.0, 0.5):
        lid.rect((x + 0.15, 0.15), (x + 0.35, 0.85), (8, 8, 10))
    atlas = Atlas({"body": body.image, "lid": lid.image, "dark": (60, 64, 70)})
    mesh, patch = Mesh(), atlas.patch
    profile = [(0.19, 0), (0.2, 0.55), (0.21, 0.55), (0.205, 0.68), (0.12, 0.74), (0, 0.75)]
    mesh.add_lathe(profile, [patch("body"), patch("dark"), patch("lid"), patch("dark"), patch("dark")], 14)
    mesh.fit((0.42, 0.42, 0.75))
    return mesh, atlas


def make_potted_plant():
    """Leafy plant in a round pot."""
    rng = make_rng("plant")
    leaf = Picture(16, 32, (58, 140, 58)).line((0.5, 0.0), (0.5, 1.0), 0.12, (120, 190, 100)).image
    atlas = Atlas(
        {
            "leaf": leaf,
            "dark": leaf * 0.72,
            "pot": (186, 98, 62),
            "rim": (168, 84, 52),
            "soil": (70, 50, 36),
            "stem": (96, 82, 50),
        }
    )
    mesh, patch = Mesh(), atlas.patch
    profile = [(0.14, 0), (0.19, 0.34), (0.205, 0.34), (0.205, 0.40), (0.18, 0.40), (0.17, 0.36), (0, 0.36)]
    mesh.add_lathe(profile, [patch(x) for x in ("pot", "rim", "rim", "rim", "soil", "soil")], 10)
    mesh.add_tube([(0, 0, 0.36), (0.01, 0.01, 0.9)], [0.02, 0.012], patch("stem"), sides=4, caps=False)
    for k in range(30):
        turn, start = 2.4 * k, 0.42 + 0.019 * k
        lift = rng.uniform(0.35, 0.75) + 0.02 * k
        reach, width = rng.uniform(0.34, 0.42), 0.08
        out = np.array([np.cos(turn), np.sin(turn), 0.0])
        across = width * np.array([-np.sin(turn), np.cos(turn), 0.0])
        root = np.array([0.0, 0.0, start])
        middle = root + 0.5 * reach * (np.cos(lift) * out + np.sin(lift) * np.array([0, 0, 1.0]))
        tip = middle + 0.5 * reach * (np.cos(lift - 0.7) * out + np.sin(lift - 0.7) * np.array([0, 0, 1.0]))
        sides = (middle - across, middle + across)
        for name, (left, right) in (("leaf", sides), ("dark", sides[::-1])):  # upper and lower face
            u0, v0, u1, v1 = patch(name)
            half = (u0 + u1) / 2
            mesh.add_triangle([root, left, tip], [(half, v0), (u0, (v0 + v1) / 2), (half, v1)])
            mesh.add_triangle([root, tip, right], [(half, v0), (half, v1), (u1, (v0 + v1) / 2)])
    mesh.fit((0.6, 0.6, 1.3))
    return mesh, atlas


MODELS = {
    "waiting_chair": make_waiting_chair,
    "chair_row": make_chair_row,
    "coffee_table": make_coffee_table,
    "reception_counter": make_reception_counter,
    "vending_machine": make_vending_machine,
    "trash_can": make_trash_can,
    "potted_plant": make_potted_plant,
}


def make_all(folder):
    """Write these models and textures into a folder."""
    for name, make in MODELS.items():
        write_model(folder, name, *make())

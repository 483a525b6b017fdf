# SPDX-License-Identifier: BSD-3-Clause
"""Machines, signs and tools of the warehouse."""

import numpy as np

from makers.colors import BLACK, DARK, ORANGE, RED, RUBBER, STEEL, WHITE, YELLOW
from makers.mesh import Mesh
from makers.storage import cardboard_face, make_pallet, stack_face, wood_texture
from makers.textures import Atlas, Picture, make_rng, write_model


def make_pallet_loaded():
    """Pallet with a block of cartons, 1.05 high."""
    rng = make_rng(11)
    wood = wood_texture(rng, 32)
    atlas = Atlas(
        {
            "long": stack_face(rng, (96, 128), 3, 3),
            "short": stack_face(rng, (96, 96), 3, 2),
            "top": cardboard_face(rng, 64, 64, (184, 142, 94)),
            "wood": wood,
        },
        width_px=256,
    )
    mesh = Mesh()
    mesh.add_mesh(make_pallet(patch=atlas.patch("wood")))
    long, short = atlas.patch("long"), atlas.patch("short")
    faces = {"x": short, "X": short, "y": long, "Y": long}
    mesh.add_box((-0.58, -0.38, 0.144), (0.58, 0.38, 1.05), atlas.patch("top"), skip="z", faces=faces)
    return mesh, atlas


def hazard_stripes(width_px, height_px, first, second, stripes):
    """Diagonal stripes in two colours."""
    picture = Picture(width_px, height_px, first)
    step = 1.0 / stripes
    lean = height_px / width_px
    for k in range(-2 * stripes, 2 * stripes):
        x = k * step
        picture.polygon([(x, 0), (x + step / 2, 0), (x + step / 2 + lean, 1), (x + lean, 1)], second)
    return picture.image


def make_forklift():
    """Counterbalance forklift: forks towards +x, overhead guard, seat, beacon."""
    label = Picture(96, 32, ORANGE).text("LIFT 25", (0.04, 0.1), (0.96, 0.9), BLACK)
    back = Picture(64, 48, ORANGE).paste(hazard_stripes(64, 16, YELLOW, BLACK, 4), (0, 0.05), (1, 0.38))
    back.rect((0.06, 0.62), (0.2, 0.82), RED).rect((0.8, 0.62), (0.94, 0.82), RED)
    atlas = Atlas(
        {
            "label": label.image, "back": back.image, "orange": ORANGE, "black": BLACK, "rubber": RUBBER, "dark": DARK,
            "steel": STEEL, "red": RED, "hub": YELLOW, "seat": (48, 44, 46), "beacon": (255, 170, 30),
        }
    )  # fmt: skip
    mesh, patch = Mesh(), atlas.patch
    # Counterweight, hood and cowl, with the driver's floor between them.
    weight = [(-1.2, 0.32), (-1.2, 0.86), (-1.12, 1.0), (-0.42, 1.0), (-0.42, 0.46), (-0.05, 0.46), (-0.05, 0.22),
              (-0.62, 0.22), (-1.1, 0.22)]  # fmt: skip
    edges = [None, patch("orange"), patch("black"), patch("orange"), patch("dark"), *[patch("orange")] * 4]
    mesh.add_box((-1.2, -0.52, 0.32), (-1.0, 0.52, 0.86), patch("back"), skip="XyYzZ")
    mesh.add_prism(weight, (-0.52, 0.52), patch("orange"), side_patch=edges)
    cowl = [(-0.05, 0.22), (0.1, 0.22), (0.1, 0.72), (-0.02, 1.0), (-0.08, 1.0)]
    mesh.add_prism(cowl, (-0.46, 0.46), patch("orange"))
    mesh.add_box((-0.78, -0.24, 1.0), (-0.42, 0.24, 1.12), patch("seat"), skip="z")
    mesh.add_beam((-0.76, 0, 1.1), (-0.88, 0, 1.5), (0.46, 0.1), patch("seat"))
    mesh.add_tube([(-0.06, 0.0, 1.0), (-0.2, 0.0, 1.16)], 0.025, patch("black"), sides=3, caps=False)
    mesh.add_tube([(-0.195, 0, 1.15), (-0.22, 0, 1.18)], [0.17, 0.17], patch("black"), sides=6)
    _add_guard(mesh, patch)
    _add_mast(mesh, patch)
    for x, radius, width, out in ((-0.08, 0.32, 0.2, 0.6), (-0.84, 0.25, 0.18, 0.57)):
        for side in (-1, 1):
            profile = [(0, out - width), (radius, out - width), (radius, out), (0.6 * radius, out), (0, out - 0.02)]
            wheel = Mesh()
            wheel.add_lathe(profile, [*[patch("rubber")] * 3, patch("hub")], 10, axis="y")
            mesh.add_mesh(wheel, (x, 0, radius), (0, 0, 0 if side > 0 else np.pi))
    for name, y in (("y", -0.522), ("Y", 0.522)):
        low, high = (-1.06, min(y, 0), 0.54), (-0.46, max(y, 0), 0.86)
        mesh.add_box(low, high, patch("label"), skip="xXyYzZ".replace(name, ""))
    mesh.fit((2.4, 1.2, 2.1))
    return mesh, atlas


def _add_guard(mesh, patch):
    """Posts and roof bars above the driver, with a beacon."""
    for y in (-0.48, 0.48):
        mesh.add_beam((-0.98, y, 0.98), (-0.86, y, 2.0), (0.07, 0.07), patch("black"), caps=False)
        mesh.add_beam((0.03, y, 0.7), (-0.2, y, 2.0), (0.07, 0.07), patch("black"), caps=False)
        mesh.add_beam((-0.9, y, 2.0), (-0.16, y, 2.0), (0.07, 0.06), patch("black"), caps=False)
    for x in np.linspace(-0.88, -0.18, 4):
        mesh.add_beam((x, -0.5, 2.0), (x, 0.5, 2.0), (0.05, 0.05), patch("black"), caps=False)
    mesh.add_lathe([(0.06, 2.02), (0.06, 2.1), (0, 2.1)], patch("beacon"), 5, offset_m=(-0.8, 0.3, 0))


def _add_mast(mesh, patch):
    """Mast, carriage, load backrest and the two forks."""
    for y in (-0.32, 0.32):
        mesh.add_box((0.12, y - 0.06, 0.06), (0.26, y + 0.06, 2.1), patch("black"), skip="z")
        mesh.add_box((0.30, y - 0.07, 0.07), (0.36, y + 0.07, 0.62), patch("steel"), skip="xz")
        outline = [(0.30, 0.0), (1.14, 0.0), (1.2, 0.015), (1.2, 0.025), (0.36, 0.07), (0.30, 0.07)]
        mesh.add_prism(outline, (y - 0.07, y + 0.07), patch("steel"))
    for z in (1.25, 2.04):
        mesh.add_box((0.15, -0.26, z - 0.06), (0.22, 0.26, z + 0.06), patch("black"), skip="yY")
    mesh.add_tube([(0.19, 0, 0.1), (0.19, 0, 1.9)], 0.045, patch("steel"), sides=4, caps=False)
    for z in (0.18, 0.52, 1.08):
        mesh.add_box((0.24, -0.5, z - 0.05), (0.30, 0.5, z + 0.05), patch("dark"), skip="" if z > 1 else "x")
    for y in (-0.47, -0.16, 0.16, 0.47):
        mesh.add_box((0.25, y - 0.03, 0.57), (0.29, y + 0.03, 1.03), patch("dark"), skip="zZ")


def make_barrier_tape():
    """Two posts with two red and white tapes between them."""
    red_white = hazard_stripes(256, 16, WHITE, (212, 24, 30), 10)
    atlas = Atlas({"tape": red_white, "post": (44, 46, 50), "cap": RED}, width_px=256)
    mesh, tape, post = Mesh(), atlas.patch("tape"), atlas.patch("post")
    for x in (-0.97, 0.97):
        mesh.add_box((x - 0.03, -0.03, 0), (x + 0.03, 0.03, 0.96), post, skip="zZ")
        mesh.add_box((x - 0.03, -0.03, 0.96), (x + 0.03, 0.03, 1.0), atlas.patch("cap"), skip="z")
    for z in (0.45, 0.80):
        mesh.add_box((-0.94, -0.006, z), (0.94, 0.006, z + 0.13), tape, skip="xX")
    return mesh, atlas


def wet_floor_picture():
    """Front of the sign: a triangle with a slipping figure between CAUTION and WET FLOOR."""
    picture = Picture(96, 192, YELLOW)
    picture.text("CAUTION", (0.08, 0.82), (0.92, 0.91), BLACK)
    picture.polygon([(0.04, 0.36), (0.96, 0.36), (0.5, 0.80)], BLACK)
    picture.polygon([(0.145, 0.39), (0.855, 0.39), (0.5, 0.73)], YELLOW)
    limbs = [
        [(0.47, 0.585), (0.40, 0.50)],  # trunk, falling backwards
        [(0.40, 0.50), (0.56, 0.50), (0.68, 0.545)],  # leg in the air
        [(0.40, 0.50), (0.48, 0.44), (0.62, 0.425)],  # leg that slips
        [(0.47, 0.58), (0.60, 0.60)],
        [(0.46, 0.575), (0.35, 0.555), (0.31, 0.50)],
    ]
    for limb in limbs:
        for start, end in zip(limb[:-1], limb[1:]):
            picture.line(start, end, 0.06, BLACK)
    picture.disc((0.50, 0.645), 0.055, BLACK)
    picture.line((0.26, 0.405), (0.74, 0.405), 0.025, BLACK)
    picture.text("WET", (0.2, 0.20), (0.8, 0.32), BLACK)
    picture.text("FLOOR", (0.08, 0.05), (0.92, 0.17), BLACK)
    return picture.rect((0.3, 0.935), (0.7, 0.975), (70, 60, 20)).image


def make_wet_floor_sign():
    """Yellow A-frame; both panels carry the picture and lean against each other at the top."""
    atlas = Atlas({"sign": wet_floor_picture(), "yellow": YELLOW, "inside": (196, 160, 14)})
    mesh = Mesh()
    foot, top, half, thick = 0.175, 0.026, 0.16, 0.012
    for s in (1, -1):
        outside = [
            (s * foot, -s * half, 0),
            (s * foot, s * half, 0),
            (s * top, s * 0.13, 0.65),
            (s * top, -s * 0.13, 0.65),
        ]
        inside = [(x - s * thick, y, z) for x, y, z in outside]
        mesh.add_quad(outside, atlas.patch("sign"))
        mesh.add_quad([inside[i] for i in (1, 0, 3, 2)], atlas.patch("inside"))
        for a, b in ((1, 0), (2, 1), (3, 2), (0, 3)):
            mesh.add_quad([outside[a], outside[b], inside[b], inside[a]], atlas.patch("yellow"))
    return mesh, atlas


def make_step_ladder():
    """Aluminium step ladder, steps towards +x, with a red top."""
    atlas = Atlas(
        {"rail": (196, 200, 206), "step": (110, 114, 120), "red": RED, "foot": BLACK, "back": (168, 172, 178)}
    )
    mesh = Mesh()
    low, high = np.array([0.35, 0.25, 0.03]), np.array([0.07, 0.19, 1.74])
    for side in (-1, 1):
        flip = np.array([1, side, 1])
        mesh.add_beam(low * flip, high * flip, (0.03, 0.08), atlas.patch("rail"))
        back = np.array([-1, side, 1])
        mesh.add_beam(low * back, high * back, (0.03, 0.05), atlas.patch("back"))
        for foot in (flip, back):
            x, y, _ = low * foot
            mesh.add_box((x - 0.045, y - 0.03, 0), (x + 0.045, y + 0.03, 0.06), atlas.patch("foot"), skip="z")
    for k in range(1, 6):
        x, y, z = low + (high - low) * k / 6
        mesh.add_box((x - 0.07, -y, z - 0.025), (x + 0.05, y, z + 0.015), atlas.patch("step"), skip="yY")
    for t in (0.25, 0.6):
        x, y, z = low + (high - low) * t
        mesh.add_beam((-x, -y, z), (-x, y, z), (0.03, 0.03), atlas.patch("back"))
    mesh.add_box((-0.13, -0.22, 1.73), (0.14, 0.22, 1.8), atlas.patch("red"))
    mesh.fit((0.75, 0.55, 1.8))
    return mesh, atlas


MODELS = {
    "pallet_loaded": make_pallet_loaded,
    "forklift": make_forklift,
    "barrier_tape": make_barrier_tape,
    "wet_floor_sign": make_wet_floor_sign,
    "step_ladder": make_step_ladder,
}


def make_all(folder):
    """Write these models and textures into a folder."""
    for name, make in MODELS.items():
        write_model(folder, name, *make())

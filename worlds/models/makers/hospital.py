# SPDX-License-Identifier: BSD-3-Clause
"""Equipment of the hospital: bed, gurney, wheelchair, IV stand, cart."""

import numpy as np

from makers.colors import BLACK, BLUE, DARK, ORANGE, RUBBER, STEEL, WHITE
from makers.mesh import Mesh
from makers.textures import Atlas, Picture, write_model
from makers.tools import add_wheel

CREAM, TEAL, SHEET = (226, 222, 208), (40, 150, 150), (206, 226, 240)


def _add_castors(mesh, half_m, radius_m, patches):
    """Four swivel castors; half_m is half the distance between them along x and y."""
    for x in (-half_m[0], half_m[0]):
        for y in (-half_m[1], half_m[1]):
            add_wheel(mesh, (x, y, radius_m), (radius_m, 0.05), patches, 7)


def make_hospital_bed():
    """Ward bed with the back part raised: head at -x, foot board at +x, side rails, blanket and pillow."""
    board = Picture(64, 32, CREAM).rect((0.08, 0.15), (0.92, 0.85), (120, 176, 190))
    blanket = Picture(32, 32, (86, 150, 196)).rect((0.0, 0.0), (1.0, 0.12), WHITE)
    atlas = Atlas(
        {"board": board.image, "blanket": blanket.image, "cream": CREAM, "steel": STEEL, "rubber": RUBBER,
         "sheet": SHEET, "white": WHITE, "dark": DARK, "blue": (86, 150, 196)}
    )  # fmt: skip
    mesh, patch = Mesh(), atlas.patch
    faces = {"x": patch("board"), "X": patch("board")}
    mesh.add_box((-1.05, -0.45, 0.38), (-1.01, 0.45, 1.05), patch("cream"), faces=faces)
    mesh.add_box((1.0, -0.45, 0.34), (1.04, 0.45, 0.86), patch("cream"), faces=faces)
    mesh.add_box((-1.0, -0.40, 0.36), (1.0, 0.40, 0.46), patch("steel"))
    mesh.add_box((-0.15, -0.43, 0.46), (0.98, 0.43, 0.60), patch("sheet"), skip="z")
    mesh.add_box((-0.02, -0.455, 0.44), (0.99, 0.455, 0.63), patch("blue"), skip="z", faces={"Z": patch("blanket")})
    raised = [(-0.15, 0.46), (-0.15, 0.60), (-0.90, 0.96), (-0.96, 0.84)]
    mesh.add_prism(raised, (-0.43, 0.43), patch("sheet"))
    pillow = [(-0.52, 0.78), (-0.60, 0.90), (-0.88, 1.03), (-0.90, 0.95)]
    mesh.add_prism(pillow, (-0.3, 0.3), patch("white"))
    for side in (-1, 1):
        y = side * 0.46
        for low, high, lift in ((-0.78, -0.2, 0.12), (0.05, 0.7, 0.0)):
            for z in (0.66 + lift, 0.80 + lift):
                mesh.add_box((low, y - 0.015, z), (high, y + 0.015, z + 0.045), patch("cream"))
            for x in (low, high - 0.04):
                mesh.add_box((x, y - 0.014, 0.42), (x + 0.04, y + 0.014, 0.84 + lift), patch("steel"), skip="zZ")
    for x in (-0.7, 0.7):
        mesh.add_beam((x, 0, 0.16), (0.75 * x, 0, 0.36), (0.5, 0.06), patch("dark"), caps=False)
        mesh.add_box((x - 0.05, -0.38, 0.14), (x + 0.05, 0.38, 0.20), patch("cream"))
    mesh.add_box((-0.7, -0.06, 0.14), (0.7, 0.06, 0.2), patch("dark"), skip="xX")
    _add_castors(mesh, (0.70, 0.38), 0.075, (patch("rubber"), patch("steel")))
    mesh.fit((2.1, 0.95, 1.05))
    return mesh, atlas


def make_gurney():
    """Transport stretcher: thin mattress with orange straps on a high wheeled frame, head at -x raised."""
    mattress = Picture(64, 16, BLUE)
    for x in (0.28, 0.7):
        mattress.rect((x, 0), (x + 0.07, 1), ORANGE)
    atlas = Atlas(
        {"mattress": mattress.image, "blue": BLUE, "steel": STEEL, "rubber": RUBBER, "dark": DARK, "white": WHITE,
         "orange": ORANGE}
    )  # fmt: skip
    mesh, patch = Mesh(), atlas.patch
    top = patch("mattress")
    mesh.add_box((-0.35, -0.29, 0.80), (0.96, 0.29, 0.90), patch("blue"), faces={"Z": top, "y": top, "Y": top})
    mesh.add_prism([(-0.35, 0.79), (-0.35, 0.90), (-0.90, 1.25), (-0.96, 1.16)], (-0.29, 0.29), patch("blue"))
    mesh.add_prism([(-0.66, 1.09), (-0.69, 1.17), (-0.88, 1.29), (-0.89, 1.24)], (-0.2, 0.2), patch("white"))
    for side in (-1, 1):
        y = side * 0.35
        mesh.add_beam((-1.0, y, 0.78), (1.0, y, 0.78), (0.04, 0.05), patch("steel"))
        rail = [(-0.3, y, 0.78), (-0.24, y, 1.04), (0.56, y, 1.04), (0.62, y, 0.78)]
        mesh.add_tube(rail, 0.016, patch("steel"), sides=4, caps=False)
        for x in (-0.02, 0.32):
            mesh.add_beam((x, y, 0.78), (x, y, 1.04), (0.02, 0.02), patch("steel"), caps=False)
        mesh.add_beam((-0.72, 0.8 * y, 0.26), (0.72, 0.8 * y, 0.26), (0.04, 0.05), patch("dark"))
        for x in (-0.55, 0.55):
            mesh.add_beam((x, 0.8 * y, 0.26), (-x, 0.8 * y, 0.77), (0.035, 0.05), patch("steel"), caps=False)
    for x in (-0.98, 0.98):
        mesh.add_beam((x, -0.35, 0.78), (x, 0.35, 0.78), (0.04, 0.05), patch("steel"))
    for x in (-0.7, 0.7):
        mesh.add_beam((x, -0.28, 0.26), (x, 0.28, 0.26), (0.06, 0.05), patch("dark"))
    _add_castors(mesh, (0.72, 0.28), 0.11, (patch("rubber"), patch("steel")))
    mesh.fit((2.0, 0.75, 1.25))
    return mesh, atlas


def _make_large_wheel(patch, radius_m=0.31, sides=13):
    """Spoked wheel of the wheelchair about y, outside towards +y."""
    wheel = Mesh()
    profile = [(0.265, -0.012), (radius_m, -0.012), (radius_m, 0.012), (0.275, 0.016), (0.255, 0.016)]
    wheel.add_lathe(profile, [*[patch("rubber")] * 3, patch("steel")], sides, axis="y")
    for k in range(3):
        x, z = 0.27 * np.cos(np.pi * k / 3), 0.27 * np.sin(np.pi * k / 3)
        wheel.add_beam((-x, 0, -z), (x, 0, z), (0.012, 0.012), patch("steel"), caps=False)
    wheel.add_box((-0.035, -0.012, -0.035), (0.035, 0.022, 0.035), patch("dark"), skip="y")
    return wheel


def make_wheelchair():
    """Wheelchair: two large spoked wheels, seat and back of blue cloth, push handles at -x, foot rests at +x."""
    atlas = Atlas({"cloth": (34, 62, 132), "steel": STEEL, "rubber": RUBBER, "dark": DARK, "black": BLACK})
    mesh, patch = Mesh(), atlas.patch
    mesh.add_box((-0.24, -0.22, 0.46), (0.20, 0.22, 0.51), patch("cloth"))
    mesh.add_prism([(-0.24, 0.50), (-0.20, 0.50), (-0.27, 0.90), (-0.31, 0.90)], (-0.22, 0.22), patch("cloth"))
    wheel = _make_large_wheel(patch)
    for side in (-1, 1):
        y = side * 0.235
        mesh.add_mesh(wheel, (-0.16, side * 0.29, 0.31), (0, 0, 0 if side > 0 else np.pi))
        mesh.add_beam((-0.16, side * 0.2, 0.31), (-0.16, side * 0.29, 0.31), (0.03, 0.03), patch("dark"), caps=False)
        frame = [(-0.20, y, 0.30), (-0.29, y, 0.90), (-0.42, y, 0.93)]
        mesh.add_tube(frame, 0.014, patch("steel"), sides=4, caps=False)
        mesh.add_tube([(-0.34, y, 0.915), (-0.45, y, 0.935)], 0.022, patch("black"), sides=4)
        mesh.add_tube([(-0.2, y, 0.47), (0.22, y, 0.48), (0.42, y, 0.13)], 0.014, patch("steel"), sides=4, caps=False)
        mesh.add_tube([(-0.24, y, 0.69), (0.10, y, 0.69), (0.14, y, 0.48)], 0.014, patch("steel"), sides=4, caps=False)
        mesh.add_box((-0.2, y - 0.03, 0.69), (0.10, y + 0.03, 0.725), patch("black"))
        mesh.add_box((-0.18, y - 0.006, 0.50), (0.09, y + 0.006, 0.67), patch("cloth"), skip="xXzZ")
        mesh.add_beam((-0.2, y, 0.30), (0.3, y, 0.26), (0.025, 0.025), patch("steel"), caps=False)
        mesh.add_beam((0.28, y, 0.48), (0.28, y, 0.1), (0.025, 0.025), patch("steel"), caps=False)
        mesh.add_beam((0.36, side * 0.14, 0.11), (0.56, side * 0.14, 0.11), (0.16, 0.025), patch("dark"))
        add_wheel(mesh, (0.26, y, 0.09), (0.09, 0.03), (patch("rubber"), patch("steel")), 7)
    mesh.add_beam((-0.2, 0, 0.24), (0.28, 0, 0.24), (0.46, 0.02), patch("dark"))
    mesh.fit((1.05, 0.65, 0.95))
    return mesh, atlas


def make_iv_stand():
    """Pole on a five-armed wheeled foot, with a pump and two bags."""
    bag = Picture(32, 48, (226, 238, 244)).rect((0.15, 0.45), (0.85, 0.8), WHITE)
    bag.rect((0.22, 0.68), (0.78, 0.74), BLUE).rect((0.22, 0.55), (0.7, 0.6), DARK).rect(
        (0, 0), (1, 0.3), (190, 214, 228)
    )
    pump = Picture(32, 32, (232, 234, 236)).rect((0.12, 0.5), (0.88, 0.88), (40, 120, 90))
    for x in (0.18, 0.42, 0.66):
        pump.rect((x, 0.15), (x + 0.16, 0.35), BLUE)
    atlas = Atlas({"bag": bag.image, "pump": pump.image, "case": (232, 234, 236), "steel": STEEL, "rubber": RUBBER})
    mesh, patch = Mesh(), atlas.patch
    mesh.add_tube([(0, 0, 0.1), (0, 0, 1.9)], 0.016, patch("steel"), sides=6, caps=False)
    mesh.add_lathe([(0.05, 0.09), (0.05, 0.15), (0.016, 0.18)], patch("steel"), 6)
    for k in range(5):
        angle = 2 * np.pi * k / 5
        x, y = 0.25 * np.cos(angle), 0.25 * np.sin(angle)
        mesh.add_beam((0, 0, 0.12), (x, y, 0.075), (0.035, 0.03), patch("steel"))
        mesh.add_box((x - 0.025, y - 0.025, 0), (x + 0.025, y + 0.025, 0.06), patch("rubber"), skip="zZ")
    face = patch("pump")
    mesh.add_box((0.02, -0.09, 1.0), (0.15, 0.09, 1.2), patch("case"), faces={"X": face, "y": face, "Y": face})
    mesh.add_beam((0, -0.2, 1.84), (0, 0.2, 1.84), (0.015, 0.015), patch("steel"))
    for y in (-0.17, 0.17):
        mesh.add_beam((0, y, 1.72), (0, y, 1.85), (0.01, 0.01), patch("steel"), caps=False)
        mesh.add_box((-0.03, y - 0.07, 1.46), (0.03, y + 0.07, 1.72), patch("bag"))
    line = [(0, -0.17, 1.46), (0.03, -0.12, 1.3), (0.08, -0.04, 1.2)]
    mesh.add_tube(line, 0.008, patch("bag"), sides=3, caps=False)
    mesh.fit((0.55, 0.55, 1.9))
    return mesh, atlas


def make_medical_cart():
    """White cart with teal drawers towards +x, a screen on top and a push handle at the back."""
    drawers = Picture(48, 64, (236, 238, 238))
    for k, (low, high) in enumerate(((0.03, 0.33), (0.36, 0.58), (0.61, 0.78), (0.81, 0.97))):
        drawers.rect((0.05, low), (0.95, high), TEAL if k != 3 else (206, 44, 40))
        drawers.rect((0.3, high - 0.07), (0.7, high - 0.03), WHITE)
    screen = Picture(48, 32, (30, 34, 40)).rect((0.06, 0.1), (0.94, 0.92), (10, 40, 44))
    pulse = [(0.08, 0.5), (0.3, 0.5), (0.38, 0.8), (0.46, 0.2), (0.54, 0.5), (0.92, 0.5)]
    for start, end in zip(pulse[:-1], pulse[1:]):
        screen.line(start, end, 0.04, (90, 250, 120))
    atlas = Atlas(
        {"drawers": drawers.image, "screen": screen.image, "white": (236, 238, 238), "dark": DARK, "rubber": RUBBER,
         "teal": TEAL, "steel": STEEL}
    )  # fmt: skip
    mesh, patch = Mesh(), atlas.patch
    mesh.add_box((-0.26, -0.23, 0.14), (0.28, 0.23, 0.80), patch("white"), faces={"X": patch("drawers")})
    mesh.add_box((-0.30, -0.25, 0.80), (0.30, 0.25, 0.84), patch("teal"))
    mesh.add_box((-0.02, -0.16, 0.86), (0.04, 0.16, 1.05), patch("dark"), faces={"X": patch("screen")})
    mesh.add_box((-0.05, -0.05, 0.84), (0.05, 0.05, 0.87), patch("dark"), skip="z")
    handle = [(-0.28, -0.2, 0.78), (-0.35, -0.2, 0.88), (-0.35, 0.2, 0.88), (-0.28, 0.2, 0.78)]
    mesh.add_tube(handle, 0.016, patch("steel"), sides=4, caps=False)
    _add_castors(mesh, (0.22, 0.19), 0.06, (patch("rubber"), patch("steel")))
    mesh.add_box((-0.27, -0.24, 0.10), (0.29, 0.24, 0.15), patch("dark"))
    mesh.fit((0.65, 0.5, 1.05))
    return mesh, atlas


MODELS = {
    "hospital_bed": make_hospital_bed,
    "gurney": make_gurney,
    "wheelchair": make_wheelchair,
    "iv_stand": make_iv_stand,
    "medical_cart": make_medical_cart,
}


def make_all(folder):
    """Write these models and textures into a folder."""
    for name, make in MODELS.items():
        write_model(folder, name, *make())

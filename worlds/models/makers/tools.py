# SPDX-License-Identifier: BSD-3-Clause
"""Small equipment of the warehouse: trucks moved by hand, bollard, fire extinguisher, barrel."""

from makers.colors import BLACK, BLUE, DARK, RED, RUBBER, STEEL, WHITE, YELLOW
from makers.mesh import Mesh
from makers.textures import Atlas, Picture, write_model


def add_wheel(mesh, centre_m, size_m, patches, sides=8):
    """Add a wheel with its axle along y: size_m is (radius, width), patches those of tyre and hub."""
    (radius, width), (tyre, hub) = size_m, patches
    outline = [(0, -width / 2), (radius, -width / 2), (radius, width / 2), (0, width / 2)]
    mesh.add_lathe(outline, [hub, tyre, hub], sides, axis="y", offset_m=centre_m)


def make_pallet_jack():
    """Hand pallet truck: forks towards +x, pump and steering handle behind."""
    atlas = Atlas({"red": RED, "dark": DARK, "black": BLACK, "rubber": RUBBER, "steel": STEEL})
    mesh, patch = Mesh(), atlas.patch
    for y in (-0.19, 0.19):
        outline = [(-0.38, 0.10), (0.62, 0.10), (0.75, 0.13), (0.75, 0.15), (0.68, 0.18), (-0.38, 0.18)]
        mesh.add_prism(outline, (y - 0.085, y + 0.085), patch("red"))
        add_wheel(mesh, (0.5, y, 0.05), (0.05, 0.1), (patch("rubber"), patch("steel")), 6)
    head = [(-0.38, 0.10), (-0.38, 0.18), (-0.44, 0.42), (-0.56, 0.42), (-0.52, 0.18)]
    mesh.add_prism(head, (-0.2, 0.2), patch("red"))
    for y in (-0.08, 0.08):
        add_wheel(mesh, (-0.57, y, 0.1), (0.1, 0.07), (patch("rubber"), patch("steel")), 8)
    mesh.add_tube([(-0.56, 0, 0.1), (-0.56, 0, 0.5)], 0.055, patch("steel"), sides=6)
    mesh.add_tube([(-0.57, 0, 0.4), (-0.68, 0, 0.98)], 0.026, patch("red"), sides=5, caps=False)
    grip = [(-0.68, 0, 0.96), (-0.69, 0.13, 1.04), (-0.72, 0.13, 1.17), (-0.73, 0.0, 1.18), (-0.72, -0.13, 1.17),
            (-0.69, -0.13, 1.04), (-0.68, 0, 0.96)]  # fmt: skip
    mesh.add_tube(grip, 0.022, patch("black"), sides=4, caps=False)
    mesh.fit((1.5, 0.55, 1.2))
    return mesh, atlas


def make_hand_truck():
    """Sack truck standing upright: plate towards +x, two wheels, two handles."""
    atlas = Atlas({"blue": BLUE, "steel": STEEL, "black": BLACK, "rubber": RUBBER})
    mesh, patch = Mesh(), atlas.patch
    mesh.add_box((-0.02, -0.22, 0.0), (0.25, 0.22, 0.015), patch("steel"))
    mesh.add_box((-0.02, -0.22, 0.0), (0.0, 0.22, 0.18), patch("steel"))
    for y in (-0.17, 0.17):
        mesh.add_tube([(-0.01, y, 0.03), (-0.02, y, 1.0), (-0.08, y, 1.12)], 0.02, patch("blue"), sides=5, caps=False)
        mesh.add_tube([(-0.08, y, 1.12), (-0.22, y, 1.18)], 0.024, patch("black"), sides=5)
        mesh.add_beam((-0.02, y, 0.45), (-0.12, y, 0.14), (0.02, 0.04), patch("blue"))
        add_wheel(mesh, (-0.12, 1.25 * y, 0.13), (0.13, 0.06), (patch("rubber"), patch("steel")), 10)
    mesh.add_tube([(-0.12, -0.2, 0.13), (-0.12, 0.2, 0.13)], 0.015, patch("steel"), sides=4, caps=False)
    for z in (0.3, 0.52, 0.74, 0.96):
        mesh.add_beam((-0.015, -0.17, z), (-0.015, 0.17, z), (0.015, 0.045), patch("blue"))
    mesh.fit((0.5, 0.5, 1.2))
    return mesh, atlas


def make_bollard():
    """Steel post, yellow with black bands and a round head."""
    picture = Picture(8, 64, YELLOW)
    for low, high in ((0.18, 0.36), (0.54, 0.72)):
        picture.rect((0, low), (1, high), BLACK)
    atlas = Atlas({"post": picture.image, "cap": YELLOW, "foot": DARK})
    mesh = Mesh()
    profile = [(0.075, 0), (0.075, 0.03), (0.06, 0.03), (0.06, 0.94), (0.045, 0.98), (0, 1.0)]
    parts = [atlas.patch(name) for name in ("foot", "foot", "post", "cap", "cap")]
    mesh.add_lathe(profile, parts, 12)
    return mesh, atlas


def make_fire_extinguisher():
    """Red cylinder with a label, black valve, lever and hose."""
    body = Picture(64, 32, RED)
    for x in (0.0, 0.5):
        body.rect((x + 0.06, 0.2), (x + 0.44, 0.8), WHITE).text("FIRE", (x + 0.1, 0.52), (x + 0.4, 0.74), RED)
        body.rect((x + 0.1, 0.34), (x + 0.4, 0.40), DARK).rect((x + 0.1, 0.25), (x + 0.4, 0.3), DARK)
    atlas = Atlas({"body": body.image, "red": RED, "black": BLACK, "steel": STEEL})
    mesh, patch = Mesh(), atlas.patch
    profile = [(0.085, 0), (0.085, 0.02), (0.085, 0.36), (0.06, 0.42), (0.025, 0.44), (0.025, 0.48), (0, 0.48)]
    mesh.add_lathe(profile, [patch(x) for x in ("black", "body", "red", "red", "steel", "black")], 12)
    mesh.add_beam((-0.04, 0, 0.49), (0.09, 0, 0.53), (0.03, 0.03), patch("black"))
    mesh.add_beam((-0.04, 0, 0.48), (0.08, 0, 0.46), (0.025, 0.02), patch("black"))
    hose = [(-0.03, 0, 0.46), (-0.09, 0.02, 0.44), (-0.1, 0.03, 0.2), (-0.095, 0.03, 0.1)]
    mesh.add_tube(hose, [0.012, 0.012, 0.012, 0.022], patch("black"), sides=4)
    mesh.fit((0.18, 0.18, 0.55))
    return mesh, atlas


def make_barrel():
    """Blue steel drum with two ribs and a bung in the lid."""
    lid = Picture(48, 48, (24, 74, 140)).disc((0.5, 0.5), 0.42, (34, 100, 180)).disc((0.7, 0.5), 0.07, STEEL)
    side = Picture(64, 32, (30, 96, 178)).rect((0.1, 0.15), (0.32, 0.85), WHITE).rect((0.6, 0.15), (0.82, 0.85), WHITE)
    for x in (0.1, 0.6):
        side.text("OIL", (x + 0.03, 0.5), (x + 0.19, 0.8), BLACK).rect((x + 0.03, 0.25), (x + 0.19, 0.35), RED)
    atlas = Atlas({"lid": lid.image, "side": side.image, "blue": (30, 96, 178), "rib": (22, 74, 142)})
    mesh, patch = Mesh(), atlas.patch
    profile = [(0.3, 0.0), (0.29, 0.03)]
    parts = [patch("rib")]
    for z in (0.29, 0.59):
        profile += [(0.29, z - 0.02), (0.3, z), (0.29, z + 0.02)]
        parts += [patch("blue" if z < 0.5 else "side"), patch("rib"), patch("rib")]
    profile += [(0.29, 0.87), (0.3, 0.9), (0.28, 0.9), (0.27, 0.885)]
    parts += [patch("blue"), patch("rib"), patch("rib"), patch("rib")]
    mesh.add_lathe(profile, parts, 12)
    mesh.add_box((-0.2, -0.2, 0.88), (0.2, 0.2, 0.886), patch("lid"), skip="xXyYz")
    return mesh, atlas


MODELS = {
    "pallet_jack": make_pallet_jack,
    "hand_truck": make_hand_truck,
    "bollard": make_bollard,
    "fire_extinguisher": make_fire_extinguisher,
    "barrel": make_barrel,
}


def make_all(folder):
    """Write these models and textures into a folder."""
    for name, make in MODELS.items():
        write_model(folder, name, *make())

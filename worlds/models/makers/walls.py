# SPDX-License-Identifier: BSD-3-Clause
"""Walls of the hospital: panel, window, door. Both sides are alike; the length lies along x."""

from makers.colors import DARK, STEEL, WHITE
from makers.mesh import Mesh
from makers.textures import Atlas, Picture, write_model

WALL, WALL_LOW, RAIL, SKIRTING = (252, 249, 240), (186, 222, 218), (168, 116, 70), (96, 112, 118)


def _add_wall(mesh, patch, height_m=2.7):
    """Wall 2 m long: colour up to the hand rail, pale above, skirting below, rail on both sides."""
    face = patch("wall")
    mesh.add_box((-1, -0.04, 0), (1, 0.04, height_m), patch("edge"), skip="z", faces={"y": face, "Y": face})
    for low, high in ((-0.06, -0.04), (0.04, 0.06)):
        hidden = "Y" if low < 0 else "y"
        mesh.add_box((-1, low, 0.84), (1, high, 0.98), patch("rail"), skip="xX" + hidden)
        mesh.add_box((-1, low * 0.8, 0), (1, high * 0.8, 0.12), patch("skirting"), skip="xXz" + hidden)


def _wall_picture():
    picture = Picture(32, 128, WALL).rect((0, 0), (1, 0.98 / 2.7), WALL_LOW)
    return picture.rect((0, 0.98 / 2.7), (1, 1.05 / 2.7), (60, 150, 150))


def make_wall_panel():
    """Wall panel with hand rail."""
    atlas = Atlas({"wall": _wall_picture().image, "edge": WALL, "rail": RAIL, "skirting": SKIRTING})
    mesh = Mesh()
    _add_wall(mesh, atlas.patch)
    return mesh, atlas


def _window_picture():
    """What the panes show: sky above trees and a lawn, with bars before it."""
    picture = Picture(96, 80, (176, 212, 244)).rect((0, 0), (1, 0.16), (120, 170, 90))
    for x, radius in ((0.1, 0.12), (0.32, 0.09), (0.58, 0.13), (0.85, 0.1)):
        picture.disc((x, 0.26), radius, (72, 132, 74))
    for x in (0.15, 0.66):
        picture.polygon([(x, 0), (x + 0.1, 0), (x + 0.3, 1), (x + 0.2, 1)], (206, 230, 250))
    return picture.rect((0.485, 0), (0.515, 1), WHITE).rect((0, 0.68), (1, 0.72), WHITE).image


def make_window_panel():
    """Wall panel with a large window above the hand rail's height of a low sill."""
    atlas = Atlas(
        {
            "wall": _wall_picture().image,
            "edge": WALL,
            "rail": RAIL,
            "skirting": SKIRTING,
            "pane": _window_picture(),
            "frame": WHITE,
        }
    )
    mesh, patch = Mesh(), atlas.patch
    low_z, high_z, half = 0.55, 2.35, 0.86
    wall = patch("wall")
    pieces = [
        ((-1, 0), (1, low_z)),
        ((-1, high_z), (1, 2.7)),
        ((-1, low_z), (-half, high_z)),
        ((half, low_z), (1, high_z)),
    ]
    for (x0, z0), (x1, z1) in pieces:
        part = patch("wall", (0, z0 / 2.7), (1, z1 / 2.7))
        mesh.add_box((x0, -0.04, z0), (x1, 0.04, z1), patch("edge"), skip="z", faces={"y": part, "Y": part})
    pane = patch("pane")
    mesh.add_box((-half, -0.015, low_z), (half, 0.015, high_z), wall, skip="xXzZ", faces={"y": pane, "Y": pane})
    for z0, z1, depth in ((low_z - 0.04, low_z + 0.02, 0.06), (high_z - 0.03, high_z + 0.03, 0.05)):
        mesh.add_box((-half - 0.04, -depth, z0), (half + 0.04, depth, z1), patch("frame"))
    for x in (-half, half):
        mesh.add_box((x - 0.035, -0.05, low_z), (x + 0.035, 0.05, high_z), patch("frame"), skip="zZ")
    for y in (-0.048, 0.048):
        mesh.add_box((-1, min(y, 0.8 * y), 0), (1, max(y, 0.8 * y), 0.12), patch("skirting"), skip="xXz")
    return mesh, atlas


def make_door():
    """Closed door in its frame: wooden leaf with a window, a kick plate and handles."""
    leaf = Picture(64, 128, (206, 164, 112)).rect((0.04, 0.02), (0.96, 0.14), STEEL)
    for x in range(1, 8):
        leaf.rect((x / 8, 0.14), (x / 8 + 0.006, 1.0), (194, 150, 98))
    leaf.rect((0.58, 0.55), (0.84, 0.92), DARK).rect((0.60, 0.56), (0.82, 0.91), (190, 220, 240))
    leaf.rect((0.16, 0.62), (0.46, 0.76), (30, 90, 160)).text("101", (0.2, 0.65), (0.42, 0.73), WHITE)
    atlas = Atlas({"leaf": leaf.image, "frame": (150, 158, 166), "steel": (120, 124, 130)})
    mesh, patch = Mesh(), atlas.patch
    picture = patch("leaf")
    mesh.add_box(
        (-0.44, -0.03, 0.0), (0.44, 0.03, 2.04), patch("frame"), skip="xXzZ", faces={"y": picture, "Y": picture}
    )
    for low, high in ((-0.5, -0.44), (0.44, 0.5)):
        mesh.add_box((low, -0.06, 0), (high, 0.06, 2.1), patch("frame"), skip="z")
    mesh.add_box((-0.44, -0.06, 2.04), (0.44, 0.06, 2.1), patch("frame"), skip="xX")
    for x in (-0.36, 0.36):  # one handle on each side
        y = 0.05 if x > 0 else -0.05
        mesh.add_box(
            (x - 0.03, min(y, 0), 0.94), (x + 0.03, max(y, 0), 1.14), patch("steel"), skip="Y" if y < 0 else "y"
        )
    return mesh, atlas


MODELS = {"wall_panel": make_wall_panel, "window_panel": make_window_panel, "door": make_door}


def make_all(folder):
    """Write these models and textures into a folder."""
    for name, make in MODELS.items():
        write_model(folder, name, *make())

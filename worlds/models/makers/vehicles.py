# SPDX-License-Identifier: BSD-3-Clause
"""Cars, a van and a bicycle. x is forward."""

import numpy as np

from .mesh import Mesh
from .solids import add_polygon, add_wheel, project
from .textures import Atlas, Picture, write_model

GLASS, GLASS_LIGHT, TYRE, RIM, CHROME = (38, 48, 58), (92, 112, 128), (30, 30, 32), (188, 192, 198), (206, 208, 212)
LAMP, TAIL, PLATE, PLASTIC = (250, 248, 232), (196, 22, 22), (238, 238, 228), (44, 44, 48)

# Half of a car's outline seen from the left, x and z over the sill: (bottom, hood, belt, roof).
CAR_A = {  # hatchback
    "body": (
        (-2.13, 0.30),
        (-2.15, 0.62),
        (-2.08, 0.92),
        (-1.98, 0.98),
        (0.92, 0.94),
        (1.90, 0.78),
        (2.12, 0.64),
        (2.15, 0.32),
    ),
    "cabin": ((-2.00, 0.97), (-1.62, 1.43), (-0.05, 1.45), (0.98, 0.93)),
}
CAR_B = {  # saloon
    "body": (
        (-2.13, 0.30),
        (-2.15, 0.72),
        (-2.10, 0.94),
        (-1.45, 0.98),
        (0.80, 0.93),
        (1.88, 0.80),
        (2.12, 0.66),
        (2.15, 0.32),
    ),
    "cabin": ((-1.62, 0.97), (-1.05, 1.42), (0.05, 1.45), (0.95, 0.92)),
}
AXLES_M, WHEEL_M, SILL_Z_M = (-1.32, 1.32), 0.31, 0.22


def _wheel_picture():
    picture = Picture(32, 32, TYRE).disc((0.5, 0.5), 0.33, RIM).disc((0.5, 0.5), 0.28, (120, 124, 130))
    for angle in 2 * np.pi * np.arange(5) / 5:
        picture.line((0.5, 0.5), (0.5 + 0.28 * np.sin(angle), 0.5 + 0.28 * np.cos(angle)), 0.09, RIM)
    return picture.disc((0.5, 0.5), 0.07, CHROME).image


def _side_picture(color):
    """A car's left side below the windows, the front to the left: doors, handles, dark wheel arches."""
    dark = np.array(color) * 0.55
    picture = Picture(128, 32, color).rect((0.0, 0.0), (1.0, 0.12), PLASTIC)
    for axle in AXLES_M:
        picture.disc((0.5 - axle / 4.3, 0.10), 0.092, (16, 16, 18))
    for x in (0.335, 0.52, 0.69):
        picture.rect((x, 0.14), (x + 0.008, 1.0), dark)
    for x in (0.46, 0.63):
        picture.rect((x, 0.72), (x + 0.035, 0.78), CHROME)
    picture.rect((0.0, 0.44), (1.0, 0.48), np.array(color) * 0.84)
    return picture.rect((0.0, 0.56), (0.045, 0.74), LAMP).rect((0.955, 0.62), (1.0, 0.82), TAIL).image


def _front_picture(color):
    picture = Picture(64, 32, color).rect((0.0, 0.0), (1.0, 0.16), PLASTIC)
    picture.rect((0.20, 0.16), (0.80, 0.40), (28, 28, 30)).rect((0.34, 0.20), (0.66, 0.36), PLATE)
    picture.rect((0.30, 0.56), (0.70, 0.80), (28, 28, 30)).rect((0.30, 0.66), (0.70, 0.70), CHROME)
    for low in (0.03, 0.75):
        picture.rect((low, 0.54), (low + 0.22, 0.84), LAMP)
    return picture.image


def _rear_picture(color):
    picture = Picture(64, 32, color).rect((0.0, 0.0), (1.0, 0.18), PLASTIC).rect((0.34, 0.38), (0.66, 0.56), PLATE)
    for low in (0.02, 0.80):
        picture.rect((low, 0.50), (low + 0.18, 0.88), (50, 16, 18)).rect(
            (low + 0.02, 0.52), (low + 0.16, 0.86), (232, 40, 36)
        )
        picture.rect((low + 0.03, 0.52), (low + 0.15, 0.60), LAMP)
    return picture.image


def _window_picture(color, pillars):
    """Side windows in the cabin's colour frame; the front of the car is to the left."""
    picture = Picture(64, 32, color).polygon(((0.06, 0.06), (0.35, 0.86), (0.86, 0.86), (0.95, 0.06)), GLASS)
    picture.polygon(((0.18, 0.06), (0.42, 0.86), (0.50, 0.86), (0.30, 0.06)), GLASS_LIGHT)
    for x in pillars:
        picture.rect((x, 0.0), (x + 0.035, 1.0), color)
    return picture.image


def _screen_picture(color):
    picture = Picture(32, 32, color).polygon(((0.04, 0.05), (0.10, 0.93), (0.90, 0.93), (0.96, 0.05)), GLASS)
    return picture.polygon(((0.30, 0.05), (0.50, 0.93), (0.62, 0.93), (0.46, 0.05)), GLASS_LIGHT).image


def _car_atlas(color, pillars):
    parts = {
        "side": _side_picture(color), "front": _front_picture(color), "rear": _rear_picture(color),
        "window": _window_picture(color, pillars), "screen": _screen_picture(color), "wheel": _wheel_picture(),
        "color": color, "black": (16, 16, 18), "tyre": TYRE, "plastic": PLASTIC,
    }  # fmt: skip
    return Atlas(parts, 128)


def _add_flank(mesh, outline, y_m, side, patch, box):
    """One side of an outline (x, z) at +-y; box (x0, z0, x1, z1) is what the picture fills, its left edge in front."""
    points = np.array([(x, side * y_m, z) for x, z in outline])
    x0, z0, x1, z1 = box
    uv = project(points, (x1, 0, z0), (-1, 0, 0), (0, 0, 1), (x1 - x0, z1 - z0), patch)
    order = slice(None) if side > 0 else slice(None, None, -1)  # outlines run clockwise seen from the right
    add_polygon(mesh, points[order], uv[order])


def _add_body(mesh, atlas, body, half_m):
    """The lower body: flat flanks, and bonnet, front and rear as strips across."""
    outline = [(body[0][0], SILL_Z_M), *body, (body[-1][0], SILL_Z_M)]
    xs, zs = np.array(body).T
    for side in (1, -1):
        _add_flank(mesh, outline, half_m, side, atlas.patch("side"), (xs.min(), SILL_Z_M, xs.max(), zs.max()))
    ends = {"front": (xs.max(), SILL_Z_M, body[-3][1]), "rear": (xs.min(), SILL_Z_M, body[2][1])}
    for (x0, z0), (x1, z1) in zip(outline[:-1], outline[1:]):
        quad = np.array([(x0, half_m, z0), (x0, -half_m, z0), (x1, -half_m, z1), (x1, half_m, z1)])
        steep = abs(z1 - z0) > abs(x1 - x0)
        if not steep:
            mesh.add_quad(quad, atlas.patch("color"))
            continue
        name = "front" if x0 > 0 else "rear"
        _, low, high = ends[name]
        right = (0, 1, 0) if name == "front" else (0, -1, 0)
        uv = project(quad, (0, -right[1] * half_m, low), right, (0, 0, 1), (2 * half_m, high - low), atlas.patch(name))
        add_polygon(mesh, quad, uv)
    x0, x1 = body[0][0], body[-1][0]
    under = [(x0, half_m, SILL_Z_M), (x1, half_m, SILL_Z_M), (x1, -half_m, SILL_Z_M), (x0, -half_m, SILL_Z_M)]
    mesh.add_quad(under, atlas.patch("black"))


def _add_cabin(mesh, atlas, cabin, low_half_m, high_half_m):
    """The part with windows, narrower at the roof."""
    halves = (low_half_m, high_half_m, high_half_m, low_half_m)
    left = np.array([(x, half, z) for (x, z), half in zip(cabin, halves)])
    right = left * (1, -1, 1)
    x1, z0, z1 = left[3, 0], left[:, 2].min(), left[:, 2].max()
    size = (x1 - left[0, 0], z1 - z0)
    for points in (left, right[::-1]):
        add_polygon(mesh, points, project(points, (x1, 0, z0), (-1, 0, 0), (0, 0, 1), size, atlas.patch("window")))
    mesh.add_quad([left[0], right[0], right[1], left[1]], atlas.patch("screen"))
    mesh.add_quad([left[1], right[1], right[2], left[2]], atlas.patch("color"))
    mesh.add_quad([right[3], left[3], left[2], right[2]], atlas.patch("screen"))


def _add_wheels(mesh, atlas, axles_m, half_m, radius_m):
    for x in axles_m:
        for y in (half_m, -half_m):
            add_wheel(mesh, (x, y, radius_m), radius_m, 0.2, atlas.patch("wheel"), atlas.patch("tyre"))


def make_car(folder, name, shape, color, pillars):
    """Write a car of 4.3 x 1.8 x 1.45 m with its texture."""
    mesh, atlas = Mesh(), _car_atlas(color, pillars)
    _add_body(mesh, atlas, shape["body"], 0.88)
    _add_cabin(mesh, atlas, shape["cabin"], 0.86, 0.66)
    _add_wheels(mesh, atlas, AXLES_M, 0.80, WHEEL_M)
    for y in (0.88, -0.88):
        low, high = sorted((y, y * 1.06))
        mesh.add_box((0.62, low, 0.92), (0.78, high, 1.04), atlas.patch("color"))
    mesh.fit((4.3, 1.8, 1.45))
    write_model(folder, name, mesh, atlas)


def _van_side(mirror):
    """A van's side in white with a stripe and a word, the front to the left; mirrored for the right side."""
    picture = Picture(128, 64, (238, 240, 242)).rect((0.0, 0.0), (1.0, 0.10), PLASTIC)
    for x in (0.185, 0.81):
        picture.disc((x, 0.06), 0.088, (16, 16, 18))
    picture.rect((0.30, 0.30), (1.0, 0.36), (226, 120, 20)).rect((0.28, 0.12), (0.285, 0.9), (150, 152, 156))
    picture.rect((0.60, 0.12), (0.605, 0.9), (150, 152, 156)).rect((0.25, 0.46), (0.28, 0.49), PLASTIC)
    picture.polygon(((0.075, 0.54), (0.155, 0.86), (0.265, 0.86), (0.265, 0.54)), GLASS)
    if mirror:
        picture.image = picture.image[:, ::-1]
        return picture.text("PARCEL", (0.06, 0.56), (0.60, 0.80), (28, 74, 150)).image
    return picture.text("PARCEL", (0.40, 0.56), (0.94, 0.80), (28, 74, 150)).image


def _van_end(front):
    picture = Picture(64, 64, (238, 240, 242)).rect((0.0, 0.0), (1.0, 0.14), PLASTIC)
    if front:
        picture.rect((0.28, 0.18), (0.72, 0.34), (30, 30, 32)).rect((0.36, 0.06), (0.64, 0.14), PLATE)
        for low in (0.04, 0.76):
            picture.rect((low, 0.50), (low + 0.20, 0.78), (70, 74, 80)).rect(
                (low + 0.03, 0.54), (low + 0.17, 0.74), LAMP
            )
        picture.rect((0.30, 0.54), (0.70, 0.74), (30, 30, 32))
        return picture.image
    picture.rect((0.495, 0.14), (0.505, 1.0), (120, 122, 126)).rect((0.54, 0.44), (0.60, 0.47), PLASTIC)
    for low in (0.02, 0.90):
        picture.rect((low, 0.22), (low + 0.08, 0.48), TAIL)
    for low in (0.10, 0.55):
        picture.rect((low, 0.60), (low + 0.35, 0.88), GLASS)
    return picture.rect((0.36, 0.18), (0.64, 0.27), PLATE).image


def make_van(folder):
    """Write a white delivery van of 5.2 x 2.0 x 2.1 m."""
    atlas = Atlas({
        "left": _van_side(False), "right": _van_side(True), "front": _van_end(True), "rear": _van_end(False),
        "screen": _screen_picture((238, 240, 242)), "wheel": _wheel_picture(), "color": (238, 240, 242),
        "black": (16, 16, 18), "tyre": TYRE, "plastic": PLASTIC,
    }, 128)  # fmt: skip
    mesh, half = Mesh(), 0.96
    outline = (
        (-2.60, 0.25),
        (-2.60, 2.02),
        (-2.52, 2.10),
        (1.20, 2.10),
        (1.86, 1.22),
        (2.50, 1.00),
        (2.60, 0.80),
        (2.60, 0.25),
    )
    for side, name in ((1, "left"), (-1, "right")):
        points = np.array([(x, side * half, z) for x, z in outline])[::side]
        uv = project(points, (side * 2.6, 0, 0.25), (-side, 0, 0), (0, 0, 1), (5.2, 1.85), atlas.patch(name))
        add_polygon(mesh, points, uv)
    strips = ("rear", "color", "color", "screen", "color", "color", "front")
    for (x0, z0), (x1, z1), name in zip(outline[:-1], outline[1:], strips):
        quad = [(x0, half, z0), (x0, -half, z0), (x1, -half, z1), (x1, half, z1)]
        if name in ("front", "screen"):  # these run downwards: start at the lower left seen from ahead
            quad = [quad[2], quad[3], quad[0], quad[1]]
        mesh.add_quad(quad, atlas.patch(name))
    mesh.add_quad(
        [(-2.6, half, 0.25), (2.6, half, 0.25), (2.6, -half, 0.25), (-2.6, -half, 0.25)], atlas.patch("black")
    )
    _add_wheels(mesh, atlas, (-1.61, 1.64), 0.88, 0.36)
    for y in (half, -half - 0.16):
        mesh.add_box((1.50, y, 1.18), (1.58, y + 0.16, 1.46), atlas.patch("plastic"))
    mesh.fit((5.2, 2.0, 2.1))
    write_model(folder, "van", mesh, atlas)


def make_bicycle(folder):
    """Write a bicycle of 1.75 x 0.5 x 1.05 m."""
    atlas = Atlas({"frame": (30, 110, 170), "tyre": TYRE, "chrome": CHROME, "saddle": (40, 34, 30)}, 16)
    mesh, frame, radius = Mesh(), atlas.patch("frame"), 0.33
    rear, front, crank = (-0.53, 0.0, 0.345), (0.53, 0.0, 0.345), (-0.09, 0.0, 0.29)
    seat, head, fork = (-0.24, 0.0, 0.80), (0.33, 0.0, 0.80), (0.36, 0.0, 0.70)
    angle = 2 * np.pi * np.arange(17) / 16
    for hub in (rear, front):
        circle = np.array(hub) + radius * np.stack([np.cos(angle), 0 * angle, np.sin(angle)], axis=1)
        mesh.add_tube(circle, 0.016, atlas.patch("tyre"), sides=4, caps=False)
        for k in range(0, 16, 2):
            mesh.add_tube([hub, circle[k]], 0.004, atlas.patch("chrome"), sides=3, caps=False)
    for path in ((seat, crank), (crank, fork), (seat, head), (seat, rear), (crank, rear), (fork, front)):
        mesh.add_tube(path, 0.017, frame, sides=5, caps=False)
    mesh.add_tube([fork, (0.30, 0.0, 0.98)], 0.015, frame, sides=5)
    bar = [(0.14, 0.25, 1.0), (0.28, 0.22, 1.02), (0.30, 0.0, 0.99), (0.28, -0.22, 1.02), (0.14, -0.25, 1.0)]
    mesh.add_tube(bar, 0.015, atlas.patch("saddle"), sides=5)
    mesh.add_tube([seat, (-0.26, 0.0, 0.90)], 0.013, atlas.patch("chrome"), sides=4, caps=False)
    mesh.add_ball((-0.28, 0.0, 0.92), (0.15, 0.07, 0.035), atlas.patch("saddle"), sides=6, rings=3)
    mesh.add_tube(
        [(-0.09, -0.10, 0.18), (-0.09, -0.06, 0.18), (-0.09, 0.06, 0.40), (-0.09, 0.10, 0.40)],
        0.012,
        atlas.patch("chrome"),
        sides=4,
    )
    mesh.fit((1.75, 0.5, 1.05))
    write_model(folder, "bicycle", mesh, atlas)


def make_all(folder):
    """Write the vehicles and their textures into a folder."""
    make_car(folder, "car_a", CAR_A, (172, 28, 34), (0.50, 0.76))
    make_car(folder, "car_b", CAR_B, (64, 104, 158), (0.52,))
    make_van(folder)
    make_bicycle(folder)

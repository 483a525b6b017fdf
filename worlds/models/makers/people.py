# SPDX-License-Identifier: BSD-3-Clause
"""Persons: standing, walking, a worker with vest and helmet, a nurse. x is forward, y to the left."""

from dataclasses import dataclass

import numpy as np

from .mesh import Mesh
from .people_texture import patch_of, people_texture
from .solids import add_ellipsoid, add_polygon, add_tube, unit
from .textures import make_rng, write_png

HIP_Z_M, SHOULDER_Z_M, NECK_Z_M = 0.88, 1.39, 1.44
HIP_Y_M, SHOULDER_Y_M = 0.096, 0.205
THIGH_M, SHANK_M, ANKLE_Z_M = 0.41, 0.39, 0.08
UPPER_ARM_M, FOREARM_M, HAND_M = 0.29, 0.25, 0.14
# From the hips up: height, half depth, half width, shift forward.
TORSO_M = (
    (0.83, 0.138, 0.200, 0.000),
    (1.02, 0.116, 0.168, 0.005),
    (1.20, 0.130, 0.185, 0.010),
    (1.33, 0.126, 0.205, 0.000),
    (1.40, 0.090, 0.178, -0.005),
    (1.455, 0.050, 0.065, -0.005),
)
HEAD_M = (
    (1.485, 0.040, 0.036, 0.020),
    (1.515, 0.080, 0.057, 0.014),
    (1.565, 0.096, 0.072, 0.008),
    (1.620, 0.104, 0.077, 0.002),
    (1.670, 0.098, 0.073, -0.003),
    (1.705, 0.066, 0.052, -0.006),
    (1.720, 0.012, 0.010, -0.006),
)


@dataclass(frozen=True)
class Pose:
    """Angles [rad] of one side: hip and shoulder forward positive, knee and elbow bent positive, spread of the arm."""

    hip: float
    knee: float
    shoulder: float
    elbow: float
    spread: float = 0.09


@dataclass(frozen=True)
class Look:
    """Names of the patches of a person; sleeve is for the upper arm, cuff for the forearm."""

    head: str
    torso: str
    sleeve: str
    cuff: str
    skin: str
    trousers: str
    shoe: str


def _chain(origin_m, first_rad, second_rad, lengths_m, spread_rad=0.0):
    """Three joints of a limb that hangs down; angles turn it forward about y, spread outwards (signed, about x)."""
    points = [np.asarray(origin_m, dtype=float)]
    for angle, length in zip((first_rad, second_rad), lengths_m):
        down = np.array([np.sin(angle), 0.0, -np.cos(angle)])
        down[1], down[2] = -down[2] * np.sin(spread_rad), down[2] * np.cos(spread_rad)
        points.append(points[-1] + length * down)
    return points


def _add_leg(mesh, look, pose, side, lift_m):
    hip, knee, ankle = _chain(
        (0.0, side * HIP_Y_M, HIP_Z_M + lift_m), pose.hip, pose.hip - pose.knee, (THIGH_M, SHANK_M)
    )
    path = [hip, 0.55 * hip + 0.45 * knee, knee, 0.65 * knee + 0.35 * ankle, ankle]
    add_tube(mesh, path, [0.088, 0.094, 0.074, 0.070, 0.060], patch_of(look.trousers), sides=5, caps="none")
    pitch = 0.6 * (pose.hip - pose.knee)  # the foot follows the shank in part
    toe, up = np.array([np.cos(pitch), 0.0, np.sin(pitch)]), np.array([-np.sin(pitch), 0.0, np.cos(pitch)])
    heel = ankle - 0.035 * up
    path = [heel - 0.075 * toe, heel - 0.03 * toe, heel + 0.09 * toe - 0.012 * up, heel + 0.185 * toe - 0.025 * up]
    radii = [(0.030, 0.036), (0.050, 0.050), (0.038, 0.054), (0.020, 0.036)]
    add_tube(mesh, path, radii, patch_of(look.shoe), sides=5, front=(0.0, 0.0, 1.0), axis=toe)


def _add_arm(mesh, look, pose, side, lift_m):
    origin = (0.0, side * SHOULDER_Y_M, SHOULDER_Z_M - 0.02 + lift_m)
    joints = _chain(origin, pose.shoulder, pose.shoulder + pose.elbow, (UPPER_ARM_M, FOREARM_M), side * pose.spread)
    shoulder, elbow, wrist = joints
    add_ellipsoid(mesh, shoulder, (0.066, 0.062, 0.062), patch_of(look.sleeve), sides=5, rows=3)
    add_tube(
        mesh, [shoulder, elbow + 0.03 * unit(elbow - shoulder)], [0.060, 0.050], patch_of(look.sleeve), 5, caps="end"
    )
    add_tube(mesh, [elbow, wrist], [0.050, 0.036], patch_of(look.cuff), sides=5, caps="start")
    down = (wrist - elbow) / FOREARM_M
    path = [wrist - 0.02 * down, wrist + 0.05 * down, wrist + HAND_M * down]
    add_tube(mesh, path, [(0.030, 0.026), (0.046, 0.026), (0.020, 0.014)], patch_of(look.skin), sides=4)


def _lift(rings, lift_m):
    rings = np.asarray(rings, dtype=float)
    path = np.stack([rings[:, 3], np.zeros(len(rings)), rings[:, 0] + lift_m], axis=1)
    return path, rings[:, 1:3]


def make_person(look, left, right, lift_m=0.0):
    """A person without hair or hat. left, right: Pose of each side; lift_m: how far the hips move up (down if < 0)."""
    mesh = Mesh()
    up = (0.0, 0.0, 1.0)
    add_tube(mesh, *_lift(TORSO_M, lift_m), patch_of(look.torso), sides=8, axis=up)
    neck = [(-0.005, 0.0, NECK_Z_M + lift_m - 0.02), (0.0, 0.0, NECK_Z_M + lift_m + 0.09)]
    add_tube(mesh, neck, [0.052, 0.050], patch_of(look.skin), sides=5, caps="none")
    add_tube(mesh, *_lift(HEAD_M, lift_m), patch_of(look.head), sides=8, axis=up, caps="end")
    nose = np.array([(0.098, 0.016, 1.572), (0.098, -0.016, 1.572), (0.126, 0.0, 1.578), (0.100, 0.0, 1.625)])
    nose[:, 2] += lift_m
    for corners in ((1, 0, 2), (0, 3, 2), (3, 1, 2)):
        add_polygon(mesh, nose[list(corners)][::-1], [patch_of(look.skin)[:2]] * 3)
    for side, pose in ((1, left), (-1, right)):
        _add_leg(mesh, look, pose, side, lift_m)
        _add_arm(mesh, look, pose, side, lift_m)
    return mesh


def make_standing():
    """A man in a blue shirt, arms hanging, one foot a little ahead."""
    look = Look("head_man", "torso_shirt", "shirt_blue", "shirt_blue", "skin", "navy", "shoe_brown")
    return make_person(look, Pose(0.06, 0.05, 0.03, 0.2), Pose(-0.05, 0.03, -0.04, 0.25))


def make_walking():
    """A woman in a red jacket in full stride, with long hair and a shoulder bag."""
    look = Look("head_woman", "torso_jacket", "jacket_red", "jacket_red", "skin_dark", "jeans", "shoe_white")
    lift = -0.035
    mesh = make_person(look, Pose(0.36, 0.08, -0.36, 0.25), Pose(-0.24, 0.32, 0.34, 0.40), lift)
    hair = patch_of("hair_black")
    rings = ((1.36, 0.020, 0.050, -0.075), (1.44, 0.055, 0.086, -0.055), (1.56, 0.090, 0.090, -0.038))
    rings += ((1.66, 0.100, 0.088, -0.022), (1.71, 0.080, 0.066, -0.014), (1.735, 0.020, 0.020, -0.012))
    add_tube(mesh, *_lift(rings, lift), hair, sides=6, axis=(0.0, 0.0, 1.0), caps="start")
    mesh.add_box((-0.17, -0.31, 0.80), (0.13, -0.21, 1.02), patch_of("bag"))
    strap = [(-0.02, -0.25, 1.02), (-0.02, -0.16, 1.36 + lift)]
    add_tube(mesh, strap, [0.02, 0.02], patch_of("bag"), sides=4, caps="none")
    return mesh


def make_worker():
    """A man in an orange hi-vis vest with silver bands and a yellow helmet."""
    look = Look("head_worker", "torso_vest", "navy", "navy", "skin", "trousers_work", "shoe_black")
    mesh = make_person(look, Pose(0.10, 0.06, 0.10, 0.75, 0.22), Pose(-0.08, 0.04, -0.06, 0.3, 0.18))
    helmet = patch_of("helmet")
    rings = (
        (1.645, 0.118, 0.092, 0.0),
        (1.69, 0.112, 0.086, -0.004),
        (1.73, 0.080, 0.062, -0.006),
        (1.752, 0.02, 0.02, -0.006),
    )
    add_tube(mesh, *_lift(rings, 0.0), helmet, sides=8, axis=(0.0, 0.0, 1.0), caps="none")
    brim = ((1.642, 0.118, 0.090, 0.045), (1.655, 0.118, 0.090, 0.040))
    add_tube(mesh, *_lift(brim, 0.0), helmet, sides=8, axis=(0.0, 0.0, 1.0))
    return mesh


def make_nurse():
    """A woman in teal scrubs, fair hair in a bun, one arm bent, holding a clipboard."""
    look = Look("head_nurse", "torso_scrubs", "teal", "skin", "skin", "teal", "shoe_white")
    mesh = make_person(look, Pose(0.05, 0.04, 0.05, 1.35, 0.10), Pose(-0.06, 0.03, -0.02, 0.2))
    hair = patch_of("hair_blond")
    add_ellipsoid(mesh, (-0.115, 0.0, 1.655), (0.050, 0.052, 0.048), hair, sides=5, rows=3)
    rings = (
        (1.555, 0.060, 0.070, -0.055),
        (1.63, 0.092, 0.083, -0.028),
        (1.69, 0.090, 0.074, -0.018),
        (1.728, 0.02, 0.02, -0.01),
    )
    add_tube(mesh, *_lift(rings, 0.0), hair, sides=6, axis=(0.0, 0.0, 1.0), caps="start")
    board = np.array([(0.20, 0.30, 1.02), (0.20, 0.08, 1.02), (0.30, 0.08, 1.28), (0.30, 0.30, 1.28)])
    for points, name in ((board, "bag"), (board[::-1], "paper")):
        add_polygon(mesh, points, [patch_of(name)[:2]] * 4)
    return mesh


def make_all(folder):
    """Write the persons and their texture into a folder."""
    (folder / "textures").mkdir(parents=True, exist_ok=True)
    write_png(folder / "textures" / "people.png", people_texture(make_rng(31)))
    persons = (
        ("person_standing", make_standing, (0.34, 0.58, 1.72)),
        ("person_walking", make_walking, (0.84, 0.60, 1.72)),
        ("person_worker", make_worker, (0.48, 0.66, 1.76)),
        ("nurse", make_nurse, (0.56, 0.58, 1.74)),
    )
    for name, make, size_m in persons:
        mesh = make()
        mesh.fit(size_m)
        mesh.write(folder, name, "textures/people.png")

# SPDX-License-Identifier: BSD-3-Clause
"""Small worlds for the tests of the simulator: a floor, boxes and cylinders."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from core_bringup.backend import RobotState
from core_bringup.robot import RobotConfig
from core_bringup.world_types import Lighting, Motion, Surface, World, WorldObject

ROBOT_FILE = Path(__file__).resolve().parents[1] / "config" / "robots" / "spot_like.yaml"
ROBOT = RobotConfig.load(ROBOT_FILE)
FLOOR_ID = 1


def make_surface(label_id, corner_m, opposite_m, z_m=0.0, texture=None):
    (x0, y0), (x1, y1) = corner_m, opposite_m
    polygon = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]], dtype=float)
    return Surface(label_id, f"surface_{label_id}", "floor", polygon, z_m, np.array([0.6, 0.6, 0.5, 1.0]), texture)


def make_ramp(label_id, corner_m, opposite_m, start_z_m, end_z_m):
    """A patch that rises along x."""
    level = make_surface(label_id, corner_m, opposite_m, min(start_z_m, end_z_m))
    return replace(level, corner_z_m=np.array([start_z_m, end_z_m, end_z_m, start_z_m], dtype=float))


def make_mover(label_id, size_m, position_m, path_m, speed_mps=0.8, shape="cylinder", **motion):
    item = make_object(label_id, size_m, position_m, shape=shape)
    return replace(item, motion=Motion(np.array(path_m, dtype=float), speed_mps, **motion))


def make_object(label_id, size_m, position_m, yaw_rad=0.0, shape="box", solid=True):
    return WorldObject(
        id=label_id, name=f"object_{label_id}", class_name="cardboard_box", aliases=(), shape=shape,
        size_m=np.array(size_m, dtype=float), mesh=None, mesh_scale=np.ones(3),
        position_m=np.array(position_m, dtype=float), yaw_rad=yaw_rad, color_rgba=np.array([0.8, 0.4, 0.1, 1.0]),
        solid=solid, collision="cylinder" if shape == "cylinder" else "box",
    )  # fmt: skip


def make_table(label_id, position_m, yaw_rad=0.0, top_m=0.7):
    """A table of 2 x 1 m that collides by its parts: four legs of 0.1 m at the corners, and a top of 0.1 m on them."""
    legs = [(x, y, 0.0, x + 0.1, y + 0.1, top_m) for x in (-1.0, 0.9) for y in (-0.5, 0.4)]
    item = make_object(label_id, (2.0, 1.0, top_m + 0.1), position_m, yaw_rad)
    parts_m = np.array([*legs, (-1.0, -0.5, top_m, 1.0, 0.5, top_m + 0.1)])
    return replace(item, collision="parts", collision_parts_m=parts_m)


def make_world(*objects, surfaces=()):
    floor = make_surface(FLOOR_ID, (-20.0, -20.0), (20.0, 20.0))
    light = Lighting(np.array([0.3, 0.2, 1.0]), np.ones(3))
    return World(Path("simple"), "simple", tuple(objects), (floor, *surfaces), light, {})


def make_state(x_m=0.0, y_m=0.0, yaw_rad=0.0):
    q = np.array([0.0, 0.0, np.sin(0.5 * yaw_rad), np.cos(0.5 * yaw_rad)])
    return RobotState(0.0, np.array([x_m, y_m, ROBOT.quadruped.gait.body_height_m]), q, np.zeros(3), np.zeros(3))

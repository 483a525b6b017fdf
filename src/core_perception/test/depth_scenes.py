# SPDX-License-Identifier: BSD-3-Clause
"""Rooms seen by a camera at a known pose, for the tests of depth completion and of the self-check."""

from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True)
class View:
    """A pinhole camera, height_m above the floor, looking down by pitch_rad and rolled by roll_rad."""

    width_px: int = 320
    height_px: int = 240
    fx_px: float = 260.0
    fy_px: float = 260.0
    height_m: float = 0.7
    pitch_rad: float = 0.2
    roll_rad: float = 0.0

    @property
    def center_px(self):
        return (self.width_px - 1) / 2.0, (self.height_px - 1) / 2.0

    def T_map_camera(self):
        """Optical frame in a map frame: x forward, y left, z up, floor at z = 0."""
        level = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
        c, s = np.cos(self.pitch_rad), np.sin(self.pitch_rad)
        down = np.array([[1.0, 0.0, 0.0], [0.0, c, s], [0.0, -s, c]])
        c, s = np.cos(self.roll_rad), np.sin(self.roll_rad)
        rolled = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        pose = np.eye(4)
        pose[:3, :3] = level @ down @ rolled
        pose[2, 3] = self.height_m
        return pose


@dataclass(frozen=True)
class Room:
    """What the camera saw: depth (h, w) [m] along the optical axis; surface (h, w): 0 floor, 1.. walls, 10.. boxes."""

    view: View
    depth_m: np.ndarray
    surface: np.ndarray
    color: np.ndarray


def random_view(random, **changes):
    return replace(
        View(height_m=random.uniform(0.4, 1.2), pitch_rad=random.uniform(0.1, 0.4), roll_rad=random.normal(0.0, 0.02)),
        **changes,
    )


def make_room(random, view=None, boxes=6):
    """A floor, three walls and boxes that stand on the floor, each surface with its own colour and texture."""
    view = view or random_view(random)
    pose = view.T_map_camera()
    u, v = np.meshgrid(np.arange(view.width_px), np.arange(view.height_px))
    cx, cy = view.center_px
    rays = np.stack([(u - cx) / view.fx_px, (v - cy) / view.fy_px, np.ones(u.shape)], axis=-1) @ pose[:3, :3].T
    camera = pose[:3, 3]
    depth, surface = np.full(u.shape, np.inf), np.zeros(u.shape, int)

    def meet(t, number, on):
        nearer = on & (t > 0.05) & (t < depth)
        depth[nearer], surface[nearer] = t[nearer], number

    with np.errstate(divide="ignore", invalid="ignore"):
        meet(-camera[2] / rays[..., 2], 0, rays[..., 2] < 0.0)
        far_m, left_m, right_m = random.uniform(5.0, 7.0), random.uniform(2.0, 3.5), -random.uniform(2.0, 3.5)
        meet(far_m / rays[..., 0], 1, rays[..., 0] > 0.0)
        meet(left_m / rays[..., 1], 2, rays[..., 1] > 0.0)
        meet(right_m / rays[..., 1], 3, rays[..., 1] < 0.0)
        for k in range(boxes):
            low = np.array([random.uniform(1.5, far_m - 1.5), random.uniform(right_m + 0.3, left_m - 0.8), 0.0])
            high = low + [random.uniform(0.2, 0.6), random.uniform(0.2, 0.6), random.uniform(0.3, 1.4)]
            near_t, far_t = np.full(u.shape, -np.inf), np.full(u.shape, np.inf)
            for axis in range(3):
                t = np.stack(
                    [(low[axis] - camera[axis]) / rays[..., axis], (high[axis] - camera[axis]) / rays[..., axis]]
                )
                near_t, far_t = np.maximum(near_t, t.min(axis=0)), np.minimum(far_t, t.max(axis=0))
            meet(near_t, 10 + k, near_t < far_t)
    depth[~np.isfinite(depth)] = np.nan
    return Room(view, depth.astype(np.float32), surface, paint(random, surface))


def paint(random, surface):
    """Colour image: a colour of its own for each surface, coarse texture and camera noise."""
    palette = random.randint(30, 226, (surface.max() + 1, 3))
    height_px, width_px = surface.shape
    coarse = random.normal(0.0, 6.0, (height_px // 8 + 2, width_px // 8 + 2))
    texture = np.kron(coarse, np.ones((8, 8)))[:height_px, :width_px]
    noise = random.normal(0.0, 3.0, (height_px, width_px, 3))
    return np.clip(palette[surface] + texture[..., None] + noise, 0, 255).astype(np.uint8)


def sense(random, depth_m, noise=0.01, holes=0.1, patches=6):
    """What a sensor gives of true depth: relative noise, single lost pixels, and lost patches."""
    sensed = depth_m * (1.0 + noise * random.normal(size=depth_m.shape))
    sensed[random.uniform(size=depth_m.shape) < holes] = np.nan
    height_px, width_px = depth_m.shape
    for _ in range(patches):
        u, v = random.randint(0, width_px - 20), random.randint(0, height_px - 16)
        sensed[v : v + random.randint(6, 16), u : u + random.randint(6, 20)] = np.nan
    return sensed.astype(np.float32)


def predict(random, depth_m, scale, noise=0.03):
    """What a model gives: depth over scale, with an error that varies slowly over the image."""
    height_px, width_px = depth_m.shape
    coarse = random.normal(0.0, noise, (height_px // 40 + 2, width_px // 40 + 2))
    smooth = np.kron(coarse, np.ones((40, 40)))[:height_px, :width_px]
    return (depth_m / scale * np.exp(smooth)).astype(np.float32)

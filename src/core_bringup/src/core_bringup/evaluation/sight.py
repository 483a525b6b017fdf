# SPDX-License-Identifier: BSD-3-Clause
"""What the frames of an exact recording showed, and when: cells of the ground that could vote, and objects."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Dict, List, Mapping, Sequence, Tuple

import numpy as np

from core_bringup.camera import CameraModel
from core_bringup.motion import WorldMotion
from core_bringup.world_types import WorldObject

SHOWN_PX, SHOWN_FRAMES = 8, 2  # an object counts from the second frame on that shows this much of it within range


@dataclass(frozen=True)
class SightParams:
    """Which points can vote: those of profile core, whichever profile is measured."""

    resolution_m: float = 0.2
    floor_z_m: float = 0.0
    range_min_m: float = 0.3
    range_max_m: float = 7.0
    band_min_z_m: float = -0.15
    band_max_z_m: float = 0.9
    metric_min_height_m: float = 0.10
    metric_slope: float = 0.01
    metric_min_points: int = 3
    depth_edge_ratio: float = 0.05

    @classmethod
    def from_map(cls, values: Mapping[str, Any]) -> SightParams:
        """Take them from the section semantic_map of a profile."""
        return cls(**{name: values[name] for name in cls.__dataclass_fields__})


@dataclass
class Sight:
    """What was seen up to any frame.

    Attributes:
        first_frame: cell (x, y) of the fixed frame -> first frame in which it was observed.
        objects_seen: id -> frames that showed it.
        poses: id -> pose in each of these frames, of what moves.
        path_m: place (2,) of the robot at every frame.
    """

    first_frame: Dict[Tuple[int, int], int] = field(default_factory=dict)
    objects_seen: Dict[int, List[int]] = field(default_factory=dict)
    poses: Dict[int, List[Tuple[np.ndarray, float]]] = field(default_factory=dict)
    path_m: List[np.ndarray] = field(default_factory=list)

    def observed(self, frame: int, origin: Tuple[int, int], cells: Tuple[int, int]) -> np.ndarray:
        """(rows, columns) bool: the cells of a rectangle that were observed up to a frame, that one included."""
        mask = np.zeros((cells[1], cells[0]), dtype=bool)
        for (x, y), first in self.first_frame.items():
            column, row = x - origin[0], y - origin[1]
            if first <= frame and 0 <= column < cells[0] and 0 <= row < cells[1]:
                mask[row, column] = True
        return mask

    def objects_at(self, frame: int, objects: Sequence[WorldObject]) -> List[Tuple[WorldObject, object]]:
        """Objects that were shown up to a frame, each with the pose it was last shown at; None for what stands."""
        shown = []
        for item in objects:
            count = int(np.searchsorted(self.objects_seen.get(item.id, []), frame, side="right"))
            if count >= SHOWN_FRAMES:
                shown.append((item, self.poses[item.id][count - 1] if item.id in self.poses else None))
        return shown


def look(frames: np.ndarray, camera: CameraModel, objects: Sequence[WorldObject], params: SightParams) -> Sight:
    """Go through the frames of a recording without noise.

    A cell is observed by a frame when a point of the floor lies in it, or metric_min_points that stand up. Points are
    pixels with depth within range and height within the band that do not lie behind a depth edge: those that the map
    lets vote. An object is shown where SHOWN_PX pixels of it lie within range.

    Args:
        frames: of FrameRecording.
        camera: its model.
        objects: of the world; WorldMotion tells where the moving ones are.
        params: SightParams.
    """
    sight, motion, rays = Sight(), WorldMotion(objects), _rays(camera)
    moving = {item.id for item in objects if item.motion is not None}
    for k, frame in enumerate(frames):
        depth_m = frame["depth_mm"].astype(np.float32) * np.float32(1e-3)
        in_range = (depth_m >= params.range_min_m) & (depth_m <= params.range_max_m)
        for cell in _observed_cells(frame["T_map_camera"], depth_m, in_range, rays, params):
            sight.first_frame.setdefault(cell, k)
        poses = motion.advance(float(frame["stamp_s"] - frames[0]["stamp_s"]), frame["p_map_base"])
        counts = np.bincount(frame["labels"][in_range])
        for label in np.flatnonzero(counts >= SHOWN_PX):
            sight.objects_seen.setdefault(int(label), []).append(k)
            if label in moving:
                sight.poses.setdefault(int(label), []).append(poses[int(label)])
        sight.path_m.append(np.array(frame["p_map_base"]))
    return sight


def _rays(camera: CameraModel) -> np.ndarray:
    """(h, w, 3) point of every pixel at depth 1 m, optical frame."""
    u, v = np.meshgrid(np.arange(camera.width_px), np.arange(camera.height_px))
    x, y = (u - camera.cx_px) / camera.fx_px, (v - camera.cy_px) / camera.fy_px
    return np.stack([x, y, np.ones_like(x)], axis=-1).astype(np.float32)


def _observed_cells(
    T_map_camera: np.ndarray, depth_m: np.ndarray, in_range: np.ndarray, rays: np.ndarray, params: SightParams
) -> List[Tuple[int, int]]:
    used = in_range & ~behind_edge(depth_m, params.depth_edge_ratio)
    depth_m = depth_m[used]
    points = rays[used] * depth_m[:, None] @ T_map_camera[:3, :3].T.astype(np.float32)
    height_m = points[:, 2] + np.float32(T_map_camera[2, 3] - params.floor_z_m)
    in_band = (height_m >= params.band_min_z_m) & (height_m <= params.band_max_z_m)
    standing = height_m[in_band] >= params.metric_min_height_m + params.metric_slope * depth_m[in_band]
    cells = np.floor((points[in_band, :2] + T_map_camera[:2, 3]) / params.resolution_m).astype(np.int64)
    if not len(cells):
        return []
    low = cells.min(axis=0)
    rows = int(cells[:, 1].max() - low[1]) + 1
    number = (cells[:, 0] - low[0]) * rows + (cells[:, 1] - low[1])
    size = int(number.max()) + 1
    voted = np.bincount(number[~standing], minlength=size) > 0
    voted |= np.bincount(number[standing], minlength=size) >= params.metric_min_points
    return [(int(k // rows + low[0]), int(k % rows + low[1])) for k in np.flatnonzero(voted)]


def behind_edge(depth_m: np.ndarray, ratio: float) -> np.ndarray:
    """(h, w) bool: a pixel beside, above or below lies nearer by more than this ratio."""
    behind, limit = np.zeros(depth_m.shape, dtype=bool), depth_m * (1.0 - ratio)
    for axis in (0, 1):
        for here, there in ((slice(1, None), slice(None, -1)), (slice(None, -1), slice(1, None))):
            index_here = (here, slice(None)) if axis == 0 else (slice(None), here)
            index_there = (there, slice(None)) if axis == 0 else (slice(None), there)
            other = depth_m[index_there]
            behind[index_here] |= (other > 0.0) & (other < limit[index_here])
    return behind

# SPDX-License-Identifier: BSD-3-Clause
"""Triangle meshes as they are drawn, with long triangles divided.

The software renderer walks over the whole bounding box of a triangle, and that of a wall beside the camera is the
whole picture: divided, such a wall takes a tenth of the time and looks the same.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Dict, List, Optional, Sequence

import numpy as np

from core_bringup.world_types import Surface

_LEAST_WALL_M = 0.01  # a patch less high than this, such as a marking, is drawn without walls
_BITS = np.array([1, 2, 4])
# By which of the edges 01, 12, 20 are halved: triangles over the corners 0, 1, 2 and the edges' midpoints 3, 4, 5.
_PATTERNS = {
    0: [[0, 1, 2]],
    1: [[0, 3, 2], [3, 1, 2]],
    2: [[0, 1, 4], [0, 4, 2]],
    4: [[0, 1, 5], [5, 1, 2]],
    3: [[3, 1, 4], [0, 3, 4], [0, 4, 2]],
    6: [[5, 4, 2], [0, 1, 4], [0, 4, 5]],
    5: [[0, 3, 5], [3, 1, 2], [3, 2, 5]],
    7: [[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]],
}


@dataclass(frozen=True)
class DrawnMesh:
    """Triangles with everything a corner has.

    Attributes:
        corners: (n, 3, 8) of each corner x, y, z [m], texture u, v, normal x, y, z.
        texture: PNG file on it, if any.
    """

    corners: np.ndarray
    texture: Optional[Path] = None

    def divide(self, longest_m: float, scale: Sequence[float] = (1.0, 1.0, 1.0)) -> DrawnMesh:
        """Halve edges until none is longer than longest_m, once the mesh is scaled along x, y, z.

        Two triangles that share an edge halve it alike, so that no gap opens between them.
        """
        done: List[np.ndarray] = []
        todo = self.corners
        while len(todo):
            following = todo[:, [1, 2, 0]]
            lengths_m = np.linalg.norm((following - todo)[:, :, :3] * np.asarray(scale, dtype=float), axis=2)
            codes = (lengths_m > longest_m) @ _BITS
            points = np.concatenate([todo, 0.5 * (todo + following)], axis=1)
            done.append(todo[codes == 0])
            parts = [points[codes == code][:, pattern] for code, patterns in _PATTERNS.items() if code
                     for pattern in patterns]  # fmt: skip
            todo = np.concatenate(parts)
        return DrawnMesh(np.concatenate([*done, todo]), self.texture)

    def scaled(self, scale: Sequence[float]) -> DrawnMesh:
        """Stretch along x, y, z; normals n become n / scale, of length 1."""
        corners = self.corners.copy()
        corners[:, :, :3] *= scale
        corners[:, :, 5:] /= scale
        corners[:, :, 5:] /= np.maximum(np.linalg.norm(corners[:, :, 5:], axis=2, keepdims=True), 1e-12)
        return DrawnMesh(corners, self.texture)

    def obj_text(self) -> str:
        """Text of an OBJ file without a material."""
        flat = self.corners.reshape(-1, 8)
        vertices, vertex_of = np.unique(flat[:, :3], axis=0, return_inverse=True)
        uvs, uv_of = np.unique(flat[:, 3:5], axis=0, return_inverse=True)
        normals, normal_of = np.unique(flat[:, 5:], axis=0, return_inverse=True)
        lines = []
        for word, rows in (("v", vertices), ("vt", uvs), ("vn", normals)):
            lines += [word + "".join(f" {value:.9g}" for value in row) for row in rows.tolist()]
        points = np.stack([vertex_of, uv_of, normal_of], axis=-1).reshape(-1, 9) + 1
        lines += ["f %d/%d/%d %d/%d/%d %d/%d/%d" % tuple(row) for row in points.tolist()]
        return "\n".join(lines) + "\n"


def read_mesh(path: Path) -> Optional[DrawnMesh]:
    """Read an OBJ file of triangles with texture coordinates, normals and one white, textured material.

    None for any other file.
    """
    rows: Dict[str, list] = {"v": [], "vt": [], "vn": [], "f": [], "mtllib": []}
    for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
        word, *parts = line.split() or [""]
        if word in rows:
            rows[word].append(parts)
    try:
        table = [np.array(rows[word], dtype=float)[:, :width] for word, width in (("v", 3), ("vt", 2), ("vn", 3))]
        index = np.array([[corner.split("/") for corner in face] for face in rows["f"]], dtype=int)
        texture = _read_texture(path.parent / rows["mtllib"][0][0])
    except (ValueError, IndexError, OSError):
        return None
    if texture is None or index.ndim != 3 or index.shape[1:] != (3, 3) or index.min() < 1:
        return None
    if any(index[:, :, k].max() > len(table[k]) for k in range(3)):
        return None
    return DrawnMesh(np.concatenate([table[k][index[:, :, k] - 1] for k in range(3)], axis=2), texture)


def _read_texture(path: Path) -> Optional[Path]:
    """Texture of an MTL file with one white material; None where it is none."""
    lines = [line.split() for line in path.read_text(encoding="utf-8").splitlines() if line.strip()]
    colors = [[float(value) for value in line[1:]] for line in lines if line[0] == "Kd"]
    textures = [path.parent / line[1] for line in lines if line[0] == "map_Kd"]
    return textures[0] if len(textures) == 1 and colors == [[1.0, 1.0, 1.0]] and textures[0].is_file() else None


def box_mesh(size_m: Sequence[float]) -> DrawnMesh:
    """A box of size (3,) around (0, 0, size_z / 2), each side with texture coordinates 0..1."""
    triangles = []
    for axis in range(3):
        for side in (-1.0, 1.0):
            normal = np.roll([side, 0.0, 0.0], axis)
            across = np.roll([0.0, 1.0, 0.0], axis)
            along = np.cross(normal, across)
            for corners in (((-1, -1), (1, -1), (1, 1)), ((-1, -1), (1, 1), (-1, 1))):
                points = [normal + a * across + b * along for a, b in corners]
                triangles.append(np.column_stack([points, 0.5 + 0.5 * np.array(corners), [normal] * 3]))
    corners = np.array(triangles)
    corners[:, :, :3] *= 0.5 * np.asarray(size_m, dtype=float)
    corners[:, :, 2] += 0.5 * float(size_m[2])
    return DrawnMesh(corners)


def surface_mesh(surface: Surface, floor_m: float = 0.0) -> DrawnMesh:
    """Triangles of a Surface, its lowest corner at z = 0, with walls to the floor where it is no mere marking.

    They are seen from above and from outside; texture coordinates count tiles from the lower corner of the polygon, and
    down the walls.

    Args:
        surface: Surface.
        floor_m: height of the floor [m].
    """
    corners = surface.corners_m - [0.0, 0.0, surface.z_m]
    tiles = (corners[:, :2] - corners[:, :2].min(axis=0)) / surface.texture_tile_m
    faces = [_fan(corners, tiles)]
    for i, k in enumerate(np.roll(np.arange(len(corners)), -1)):
        drop_m = corners[[i, k], 2] + surface.z_m - floor_m
        if drop_m.max() > _LEAST_WALL_M:
            low = corners[[i, k]] - np.column_stack([np.zeros((2, 2)), drop_m])
            along = np.array([0.0, np.linalg.norm(corners[k, :2] - corners[i, :2])]) / surface.texture_tile_m
            down = -drop_m / surface.texture_tile_m
            uv = np.column_stack([np.concatenate([along, along[::-1]]), np.concatenate([down, [0.0, 0.0]])])
            faces.append(_fan(np.vstack([low, corners[[k, i]]]), uv))
    return DrawnMesh(np.concatenate(faces))


def _fan(points: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Triangles of a flat convex face (n, 3), counter-clockwise from outside, with texture coordinates (n, 2)."""
    count = len(points)
    normal = np.cross(points[1] - points[0], points[2] - points[0])
    normal = normal / max(float(np.linalg.norm(normal)), 1e-12)
    table = np.column_stack([points, uv, np.broadcast_to(normal, (count, 3))])
    return table[[[0, k, k + 1] for k in range(1, count - 1)]]

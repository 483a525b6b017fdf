# SPDX-License-Identifier: BSD-3-Clause
"""The large flat faces of a mesh, which face_painter draws instead of the software renderer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import List, Tuple

import numpy as np

from core_bringup.drawn_mesh import DrawnMesh

_SAME = 1e-6  # what two corners, normals or texture coordinates may differ by and still count as one


@dataclass(frozen=True, eq=False)
class FlatFace:
    """A flat convex face with its texture laid flat on it, in the axes of its object.

    Attributes:
        corners_m: (4, 3) counter-clockwise from outside; a triangle has its last corner twice.
        normal: (3,) outward, of length 1.
        uv_map: (2, 4) texture coordinates of a point are uv_map @ (x, y, z, 1).
    """

    corners_m: np.ndarray
    normal: np.ndarray
    uv_map: np.ndarray

    def placed(self, position_m: np.ndarray, yaw_rad: float) -> FlatFace:
        """The face with its object's origin at position_m (3,) [m] and its heading at yaw_rad."""
        s, c = np.sin(yaw_rad), np.cos(yaw_rad)
        R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        linear = self.uv_map[:, :3] @ R.T
        uv_map = np.column_stack([linear, self.uv_map[:, 3] - linear @ position_m])
        return FlatFace(self.corners_m @ R.T + position_m, R @ self.normal, uv_map)


def find_flat_faces(mesh: DrawnMesh, least_m2: float) -> Tuple[List[FlatFace], np.ndarray]:
    """Find the faces of at least some area: triangles, or pairs that follow each other and make up a convex quad.

    Args:
        mesh: DrawnMesh.
        least_m2: area below which a face is left out [m^2].

    Returns:
        FlatFaces, and (n,) bool: which triangles of the mesh they cover.
    """
    p = mesh.corners[:, :, :3]
    cross = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    areas_m2 = 0.5 * np.linalg.norm(cross, axis=1)
    normals = cross / np.maximum(2.0 * areas_m2, 1e-12)[:, None]
    flat = (areas_m2 > _SAME) & (np.abs(mesh.corners[:, :, 5:] - normals[:, None]).max(axis=(1, 2)) < _SAME)
    faces, covered, k = [], np.zeros(len(p), dtype=bool), 0
    while k < len(p):
        count = 2 if k + 1 < len(p) and flat[k] and flat[k + 1] and _is_quad(mesh.corners[k : k + 2]) else 1
        if flat[k] and areas_m2[k : k + count].sum() >= least_m2:
            faces.append(_make_face(mesh.corners[k : k + count], normals[k]))
            covered[k : k + count] = True
        k += count
    return faces, covered


def _is_quad(pair: np.ndarray) -> bool:
    """Whether flat triangles (2, 3, 8) share the edge 0-2 / 0-1, a plane and a texture, and are convex together."""
    (a, b, c), (d, e, f) = pair
    if np.abs(a - d).max() > _SAME or np.abs(c - e).max() > _SAME or np.abs(a[5:] - f[5:]).max() > _SAME:
        return False
    uv_map = _fit_uv(pair[0], a[5:])
    corners_m = np.stack([a, b, c, f])[:, :3]
    sides = np.roll(corners_m, -1, axis=0) - corners_m
    turns = np.cross(sides, np.roll(sides, -1, axis=0)) @ a[5:]
    return bool(turns.min() >= 0.0 and np.abs(uv_map @ [*f[:3], 1.0] - f[3:5]).max() < 1e-4)


def _make_face(triangles: np.ndarray, normal: np.ndarray) -> FlatFace:
    corners_m = np.concatenate([triangles[0, :, :3], triangles[-1, 2:, :3]])
    return FlatFace(corners_m, normal, _fit_uv(triangles[0], normal))


def _fit_uv(triangle: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """uv_map (2, 4) of a triangle (3, 8): constant along the normal."""
    p, uv = triangle[:, :3], triangle[:, 3:5]
    linear = np.linalg.solve(np.stack([p[1] - p[0], p[2] - p[0], normal]), [uv[1] - uv[0], uv[2] - uv[0], [0.0, 0.0]]).T
    return np.column_stack([linear, uv[0] - linear @ p[0]])

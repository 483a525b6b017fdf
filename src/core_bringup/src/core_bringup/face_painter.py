# SPDX-License-Identifier: BSD-3-Clause
"""Draws large flat faces, such as floors and walls, into the images of PyBullet's software renderer.

That renderer takes about 200 ns for a pixel of a floor, because it walks over the whole bounding box of every triangle.
A flat convex face needs no such walk: what a pixel (u, v) shows of it is a quotient of linear functions of (u, v).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Dict, List, Optional, Sequence, Tuple

import cv2
import numpy as np

from core_bringup.camera import CameraModel
from core_bringup.drawn_mesh import DrawnMesh
from core_bringup.exceptions import BringupError
from core_bringup.flat_faces import FlatFace, find_flat_faces
from core_bringup.world_types import Lighting

_EDGE_PX = 1e-9  # a pixel this near an edge belongs to the faces on both sides
_TIE = 1.0 + 2e-5  # of two faces in one plane the first drawn one shows: that of the smaller object
_NEXT = [1, 2, 3, 0]


@dataclass
class _Group:
    """The faces of one label, and where they stand."""

    faces: List[FlatFace]
    texture: Optional[Path]
    color_rgb: Tuple[float, ...]
    position_m: np.ndarray
    yaw_rad: float


class FacePainter:
    """Flat faces in the world frame; the faces of a label are taken, placed and removed together.

    Colours are those of PyBullet's software renderer without shadows: with texel c, light l and the mirrored light r

        c (ambient + light_rgb (diffuse max(0, n . l) + specular max(0, r_z)^2)),      cut to 0..255
    """

    def __init__(self, camera: CameraModel, light: Lighting):
        """Start without faces."""
        self._camera, self._light = camera, light
        self._groups: Dict[int, _Group] = {}
        self._images: Dict[Optional[Path], np.ndarray] = {None: np.full((1, 1, 3), 255, dtype=np.uint8)}
        self._tables: Dict[tuple, np.ndarray] = {}
        self._K = np.array([[camera.fx_px, 0.0, camera.cx_px], [0.0, camera.fy_px, camera.cy_px], [0.0, 0.0, 1.0]])
        self._K_inverse = np.linalg.inv(self._K)
        self._stale = True

    def take(
        self,
        label: int,
        mesh: DrawnMesh,
        color_rgba: Sequence[float],
        least_m2: float = 0.0,
        scale: Sequence[float] = (1.0, 1.0, 1.0),
    ) -> DrawnMesh:
        """Take the flat faces out of a label's mesh, once a label; they stand at the world's origin until placed.

        Args:
            label: what their pixels will carry.
            mesh: DrawnMesh.
            color_rgba: (4,) in 0..1, by which the texture is multiplied; nothing is taken if the last is 0, unseen.
            least_m2: area below which a face is left where it is [m^2], because it is drawn no faster here.
            scale: (3,) factors that stretch the mesh.

        Returns:
            DrawnMesh of the other triangles, not stretched; the mesh itself if nothing was taken.

        Raises:
            BringupError: the texture cannot be read.
        """
        faces, taken = find_flat_faces(mesh.scaled(scale), least_m2)
        if not faces or color_rgba[3] == 0.0:
            return mesh
        if mesh.texture not in self._images:
            image = cv2.imread(str(mesh.texture), cv2.IMREAD_COLOR)
            if image is None:
                raise BringupError(f"texture {mesh.texture}: cannot be read; allowed: a PNG file")
            self._images[mesh.texture] = image[::-1, :, ::-1]
        self._groups[label] = _Group(faces, mesh.texture, tuple(color_rgba[:3]), np.zeros(3), 0.0)
        self._stale = True
        return replace(mesh, corners=mesh.corners[~taken])

    def place(self, label: int, position_m: Sequence[float], yaw_rad: float) -> None:
        """Put the origin of a label's faces, if it has any, to position_m (3,) [m] and their heading to yaw_rad."""
        if label in self._groups:
            group = self._groups[label]
            group.position_m, group.yaw_rad = np.array(position_m, dtype=float), float(yaw_rad)
            self._stale = True

    def remove(self, label: int) -> None:
        """Take the faces of a label away, if it has any."""
        self._stale |= self._groups.pop(label, None) is not None

    def paint(
        self,
        images: Tuple[np.ndarray, np.ndarray, np.ndarray],
        R_world_optical: np.ndarray,
        p_world_camera: np.ndarray,
    ) -> None:
        """Draw the faces wherever they are nearer than what the images show.

        Args:
            images: written to: colour (h, w) uint32, the four bytes red, green, blue, 255; nearness (h, w) float64,
                1 / depth [1/m]; labels (h, w) uint16. All contiguous.
            R_world_optical: (3, 3) axes of the camera: right, down, ahead.
            p_world_camera: (3,) [m].
        """
        if self._stale:
            self._collect()
        if not self._labels:
            return
        offsets_m = self._corners_m - p_world_camera
        # q = K R^T (p - c): the pixel of a corner is q / q_z, also for corners behind the camera.
        q = offsets_m @ (self._K @ R_world_optical.T).T
        distances_m = np.einsum("ij,ij->i", self._normals, offsets_m[:, 0])
        seen = np.flatnonzero((distances_m < -1e-9) & self._may_be_in_view(q))
        if not len(seen):
            return
        rays = R_world_optical @ self._K_inverse
        nearness = self._normals[seen] @ rays / distances_m[seen, None]
        origin_uv = self._uv_maps[seen, :, :3] @ p_world_camera + self._uv_maps[seen, :, 3]
        uv = self._uv_maps[seen, :, :3] @ rays + origin_uv[:, :, None] * nearness[:, None, :]
        first, last = self._find_spans(np.cross(q[seen][:, _NEXT], q[seen]), nearness)
        flat = tuple(image.reshape(-1) for image in images)
        for k, face in enumerate(seen):
            if np.any(first[k] <= last[k]):
                _fill(flat, first[k], last[k], nearness[k], uv[k], self._shades[face], self._labels[face])

    def _may_be_in_view(self, q: np.ndarray) -> np.ndarray:
        """(n,) bool, False for faces whose corners q (n, 4, 3) are all beyond one side of the view."""
        camera = self._camera
        u, v, z = q[..., 0], q[..., 1], q[..., 2]
        beyond = (u < 0, u > (camera.width_px - 1) * z, v < 0, v > (camera.height_px - 1) * z, z < camera.near_m,
                  z > camera.far_m)  # fmt: skip
        return ~np.any([side.all(axis=1) for side in beyond], axis=0)

    def _find_spans(self, edges: np.ndarray, nearness: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
        """First and last column (n, h) of every face in every row; first > last where it is not.

        A pixel is in a face if a u + b v + c >= 0 for its edges (n, 4, 3) and for near and far in its nearness (n, 3).
        """
        camera = self._camera
        near = np.array([0.0, 0.0, 1.0 / camera.near_m]) - nearness
        far = nearness - [0.0, 0.0, 1.0 / camera.far_m]
        a, b, c = np.moveaxis(np.concatenate([edges, near[:, None], far[:, None]], axis=1), -1, 0)
        a = np.where(a == 0.0, 1e-300, a)[:, :, None]
        with np.errstate(over="ignore"):
            bounds = -(b[:, :, None] * np.arange(camera.height_px) + c[:, :, None]) / a
        first = np.where(a > 0.0, bounds, 0.0).max(axis=1)
        last = np.where(a < 0.0, bounds, camera.width_px).min(axis=1)
        first = np.ceil(np.clip(first - _EDGE_PX, 0.0, camera.width_px)).astype(np.intp)
        return first, np.floor(np.clip(last + _EDGE_PX, -1.0, camera.width_px - 1)).astype(np.intp)

    def _collect(self) -> None:
        """Lay the faces out in arrays, in the world frame."""
        placed, self._labels, self._shades = [], [], []
        known, self._tables = self._tables, {}
        for label, group in self._groups.items():
            for face in group.faces:
                face = face.placed(group.position_m, group.yaw_rad)
                placed.append(face)
                self._labels.append(label)
                self._shades.append(self._shade(group, face.normal, known))
        if placed:
            self._corners_m = np.array([face.corners_m for face in placed])
            self._normals = np.array([face.normal for face in placed])
            self._uv_maps = np.array([face.uv_map for face in placed])
        self._stale = False

    def _shade(self, group: _Group, normal: np.ndarray, known: Dict[tuple, np.ndarray]) -> np.ndarray:
        """The texture (h, w) as uint32 pixels in this light, its first row at v = 0; known: those of before."""
        light = self._light
        to_light = np.asarray(light.direction, dtype=float) / np.linalg.norm(light.direction)
        facing = float(normal @ to_light)
        mirrored_z = float(2.0 * facing * normal[2] - to_light[2])
        lit = round(light.diffuse * max(0.0, facing) + light.specular * max(0.0, mirrored_z) ** 2, 6)
        key = (group.texture, group.color_rgb, lit)
        if key not in self._tables:
            self._tables[key] = known[key] if key in known else self._shade_texture(*key)
        return self._tables[key]

    def _shade_texture(self, texture: Optional[Path], color_rgb: Sequence[float], lit: float) -> np.ndarray:
        texels = np.floor(self._images[texture] * np.asarray(color_rgb, dtype=np.float32))
        shaded = texels * (self._light.ambient + lit * np.asarray(self._light.color_rgb, dtype=float))
        table = np.full((*shaded.shape[:2], 4), 255, dtype=np.uint8)
        table[:, :, :3] = np.clip(shaded, 0.0, 255.0)
        return table.view(np.uint32)[:, :, 0]


def _fill(
    images: Sequence[np.ndarray],
    first: np.ndarray,
    last: np.ndarray,
    nearness: np.ndarray,
    uv: np.ndarray,
    shade: np.ndarray,
    label: int,
) -> None:
    """Draw one face into flat images, in the columns first..last (h,) of every row.

    nearness (3,) and uv (2, 3), which is texture coordinates times nearness, are factors of the pixel's (u, v, 1).
    """
    color, shown, labels = images
    counts = np.maximum(last - first + 1, 0)
    width, total = len(color) // len(counts), int(counts.sum())
    row = np.repeat(np.arange(len(counts)), counts)
    column = np.arange(total) - np.repeat(np.cumsum(counts) - counts - first, counts)
    index = row * width + column
    w = nearness[0] * column
    w += (nearness[1] * np.arange(len(counts)) + nearness[2])[row]
    visible = np.flatnonzero(w > _TIE * shown[index])
    if len(visible) < total:
        row, column, index, w = row[visible], column[visible], index[visible], w[visible]
    shown[index] = w
    labels[index] = label
    if shade.size == 1:
        color[index] = shade[0, 0]
        return
    texel = [0, 0]
    for k in range(2):
        coordinate = uv[k, 0] * column
        coordinate += (uv[k, 1] * np.arange(len(counts)) + uv[k, 2])[row]
        coordinate /= w
        coordinate -= np.floor(coordinate)
        coordinate *= shade.shape[1 - k]
        texel[k] = coordinate.astype(np.intp)
    color[index] = np.take(shade, texel[1] * shade.shape[1] + texel[0], mode="clip")

# SPDX-License-Identifier: BSD-3-Clause
"""Free shapes for the makers: elliptical tubes, polygons with pictures. z up, counter-clockwise from outside."""

import numpy as np

from .mesh import triangulate


def unit(vectors):
    """Vectors (..., 3) at length one."""
    vectors = np.asarray(vectors, dtype=float)
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)


def add_polygon(mesh, points_m, uv):
    """Add a flat simple polygon (n, 3), counter-clockwise from outside, with texture coordinates (n, 2)."""
    points_m = np.asarray(points_m, dtype=float)
    edges = points_m[1:] - points_m[0]
    normal = unit(np.cross(edges[:-1], edges[1:]).sum(axis=0))
    right = unit(edges[0])
    for corners in triangulate(points_m @ np.stack([right, np.cross(normal, right)], axis=1)):
        mesh.add_triangle([points_m[j] for j in corners], [uv[j] for j in corners], [normal] * 3)


def project(points_m, origin_m, right, up, size_m, patch):
    """Texture coordinates (n, 2) of a flat picture of size_m (width, height) laid on points, filling a patch.

    origin_m is the picture's lower left corner, right and up are unit vectors; patch is (u0, v0, u1, v1).
    """
    offsets = np.asarray(points_m, dtype=float) - np.asarray(origin_m, dtype=float)
    u = np.clip(offsets @ np.asarray(right, dtype=float) / size_m[0], 0.0, 1.0)
    v = np.clip(offsets @ np.asarray(up, dtype=float) / size_m[1], 0.0, 1.0)
    u0, v0, u1, v1 = patch
    return np.stack([u0 + (u1 - u0) * u, v0 + (v1 - v0) * v], axis=1)


def _ring(centre_m, axis, front, radii_m, sides):
    """Points (sides + 1, 3) of an ellipse across axis: radii_m along front and beside it, starting at the back."""
    first = unit(np.asarray(front) - np.dot(front, axis) * np.asarray(axis))
    second = np.cross(axis, first)
    angle = np.pi + 2.0 * np.pi * np.arange(sides + 1) / sides
    return centre_m + radii_m[0] * np.cos(angle)[:, None] * first + radii_m[1] * np.sin(angle)[:, None] * second


def add_tube(mesh, path_m, radii_m, patch, sides=8, front=(1.0, 0.0, 0.0), axis=None, caps="both"):
    """Add a closed tube with smooth shading.

    Args:
        mesh: Mesh.
        path_m: (n, 3) centres.
        radii_m: (n,) or (n, 2) radii, along front and beside it.
        patch: (u0, v0, u1, v1); u runs round from the back, so the front is in the middle; v runs along the path.
        sides: corners of a ring.
        front: direction in which the middle of the patch lies.
        axis: (3,) normal of every ring; the path's own direction when None.
        caps: 'both', 'start', 'end' or 'none'.
    """
    path_m, radii_m = np.asarray(path_m, dtype=float), np.asarray(radii_m, dtype=float)
    if radii_m.ndim == 1:
        radii_m = np.stack([radii_m, radii_m], axis=1)
    steps = unit(np.diff(path_m, axis=0))
    directions = unit(np.vstack([steps[:1], steps[:-1] + steps[1:], steps[-1:]]))
    if axis is not None:
        directions = np.tile(unit(axis), (len(path_m), 1))
    rings = np.array([_ring(*ring, front, radii, sides) for ring, radii in zip(zip(path_m, directions), radii_m)])
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path_m, axis=0), axis=1))])
    u0, v0, u1, v1 = patch
    u = u0 + (u1 - u0) * np.arange(sides + 1) / sides
    v = v0 + (v1 - v0) * lengths / lengths[-1]
    _add_skin(mesh, rings, u, v)
    middle = 0.5 * (u0 + u1)
    if caps in ("both", "start"):
        add_polygon(mesh, rings[0][-2::-1], [(middle, v[0])] * sides)
    if caps in ("both", "end"):
        add_polygon(mesh, rings[-1][:-1], [(middle, v[-1])] * sides)


def _add_skin(mesh, rings, u, v):
    """The quads between rings (n, sides + 1, 3), with normals averaged over the faces at each point."""
    along = np.gradient(rings, axis=0)
    around = np.roll(rings[:, :-1], -1, axis=1) - np.roll(rings[:, :-1], 1, axis=1)
    around = np.concatenate([around, around[:, :1]], axis=1)
    normals = unit(np.cross(around, along))
    for i in range(len(rings) - 1):
        for j in range(rings.shape[1] - 1):
            corners = ((i, j), (i, j + 1), (i + 1, j + 1), (i + 1, j))
            for triangle in ((0, 1, 2), (0, 2, 3)):
                places = [corners[k] for k in triangle]
                points = [rings[place] for place in places]
                if np.linalg.norm(np.cross(points[1] - points[0], points[2] - points[0])) > 1e-9:
                    uv = [(u[column], v[row]) for row, column in places]
                    mesh.add_triangle(points, uv, [normals[place] for place in places])


def add_ellipsoid(mesh, centre_m, radii_m, patch, sides=8, rows=5, front=(1.0, 0.0, 0.0)):
    """Add an ellipsoid of radii_m along x, y, z, with the poles up and down; v of the patch runs from bottom to top."""
    angle = np.linspace(-0.5 * np.pi, 0.5 * np.pi, rows + 1)
    path = np.asarray(centre_m) + np.outer(np.sin(angle), (0.0, 0.0, radii_m[2]))
    radii = np.outer(np.maximum(np.cos(angle), 0.02), radii_m[:2])
    add_tube(mesh, path, radii, patch, sides, front, axis=(0.0, 0.0, 1.0), caps="none")


def add_wheel(mesh, centre_m, radius_m, width_m, face_patch, tread_patch, sides=14):
    """Add a wheel that turns about y; both faces show the whole face patch."""
    centre_m = np.asarray(centre_m, dtype=float)
    half = np.array([0.0, 0.5 * width_m, 0.0])
    add_tube(mesh, [centre_m - half, centre_m + half], [radius_m] * 2, tread_patch, sides, caps="none")
    angle = 2.0 * np.pi * np.arange(sides) / sides
    spokes = np.stack([np.cos(angle), np.zeros(sides), np.sin(angle)], axis=1)
    u0, v0, u1, v1 = face_patch
    uv = np.stack([u0 + (u1 - u0) * (0.5 + 0.5 * np.cos(angle)), v0 + (v1 - v0) * (0.5 + 0.5 * np.sin(angle))], axis=1)
    add_polygon(mesh, centre_m - half + radius_m * spokes, uv)
    add_polygon(mesh, (centre_m + half + radius_m * spokes)[::-1], uv[::-1])


def turn_z(points, angle_rad):
    """Points (..., 3) turned about z."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.asarray(points, dtype=float) @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])

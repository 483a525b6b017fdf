# SPDX-License-Identifier: BSD-3-Clause
"""Trees and a hedge."""

import numpy as np

from .mesh import Mesh
from .solids import add_ellipsoid, add_polygon, add_tube, project
from .textures import Atlas, make_rng, tileable_noise, write_model

BARK = (104, 78, 54)


def _leaves(rng, color, size_px=64):
    """Foliage: light leaves over dark gaps."""
    coarse, fine = tileable_noise(rng, size_px, 4), rng.standard_normal((size_px, size_px))
    tone = np.clip(1.0 + 0.16 * coarse + 0.16 * fine, 0.45, 1.5)[..., None]
    image = tone * np.array(color, dtype=float)
    image[rng.random((size_px, size_px)) < 0.04] = np.array(color) * 1.5 + (30, 24, 0)
    return image


def _bark(rng, size_px=32):
    stripes = 0.10 * rng.standard_normal((1, size_px, 1)) + 0.06 * rng.standard_normal((size_px, size_px, 1))
    return (1.0 + stripes) * np.array(BARK, dtype=float)


def _atlas(rng, color):
    return Atlas({"leaves": _leaves(rng, color), "bark": _bark(rng)}, 96)


def make_broadleaf(folder):
    """Write a round-crowned tree of 3 x 3 x 5 m."""
    rng = make_rng(41)
    atlas, mesh = _atlas(rng, (74, 122, 48)), Mesh()
    trunk = [(0, 0, 0), (0, 0, 0.12), (0.03, 0.01, 1.2), (0.0, 0.05, 2.6)]
    add_tube(mesh, trunk, [0.20, 0.145, 0.12, 0.09], atlas.patch("bark"), sides=7, caps="none")
    for x, y, z in ((0.55, 0.25, 2.9), (-0.5, 0.35, 3.0), (0.05, -0.6, 2.8)):
        mesh.add_tube([(0.03, 0.01, 1.5), (x, y, z)], [0.06, 0.03], atlas.patch("bark"), sides=4, caps=False)
    blobs = (
        (0, 0, 3.75, 1.15, 1.2),
        (0.65, 0.25, 3.15, 0.85, 0.8),
        (-0.6, 0.45, 3.25, 0.9, 0.8),
        (0.0, -0.65, 3.1, 0.9, 0.8),
    )
    for k, (x, y, z, wide, high) in enumerate(blobs):
        add_ellipsoid(
            mesh, (x, y, z), (wide, wide, high), atlas.patch("leaves"), 8, 5, front=(np.cos(k), np.sin(k), 0.0)
        )
    mesh.fit((3.0, 3.0, 5.0))
    write_model(folder, "tree_a", mesh, atlas)


def make_conifer(folder):
    """Write a conifer of 3 x 3 x 5 m."""
    atlas, mesh = _atlas(make_rng(42), (42, 88, 58)), Mesh()
    add_tube(mesh, [(0, 0, 0), (0, 0, 1.2)], [0.17, 0.13], atlas.patch("bark"), sides=7, caps="none")
    for low, high, radius in ((1.0, 2.3, 1.5), (1.65, 3.2, 1.22), (2.55, 4.1, 0.92), (3.4, 5.0, 0.60)):
        path, radii = [(0, 0, low), (0, 0, 0.5 * (low + high)), (0, 0, high)], [radius, 0.45 * radius, 0.02]
        add_tube(mesh, path, radii, atlas.patch("leaves"), sides=10, caps="start")
    mesh.fit((3.0, 3.0, 5.0))
    write_model(folder, "tree_b", mesh, atlas)


def make_hedge(folder, length_m=2.0, columns=8):
    """Write a clipped hedge of 2 x 0.6 x 1 m; its ends meet the next one."""
    rng = make_rng(43)
    atlas, mesh = _atlas(rng, (66, 116, 44)), Mesh()
    section = (
        (0.24, 0.0),
        (0.29, 0.35),
        (0.28, 0.85),
        (0.20, 0.98),
        (-0.20, 0.98),
        (-0.28, 0.85),
        (-0.29, 0.35),
        (-0.24, 0.0),
    )
    xs = np.linspace(-length_m / 2, length_m / 2, columns + 1)
    bumps = 1.0 + 0.05 * rng.standard_normal((columns + 1, len(section), 1))
    bumps[-1] = bumps[0]
    points = np.array([[(x, y, z) for y, z in section] for x in xs])
    points[..., 1:] *= bumps
    points[:, (0, -1), 2] = 0.0
    patch = atlas.patch("leaves")
    for i in range(columns):
        for j in range(len(section) - 1):
            quad = [points[i + 1, j], points[i, j], points[i, j + 1], points[i + 1, j + 1]]
            size = np.array([length_m / columns, np.linalg.norm(quad[2] - quad[1])])  # the texture shows 1 x 1 m
            low = rng.uniform(0.0, 1.0, 2) * (1.0 - size)
            mesh.add_quad(quad, atlas.patch("leaves", low, low + size))
    for end in (points[0][::-1], points[-1]):
        add_polygon(mesh, end, project(end, (0, -0.5, 0), (0, 1, 0), (0, 0, 1), (1.0, 1.05), patch))
    mesh.fit((2.0, 0.6, 1.0))
    write_model(folder, "hedge", mesh, atlas)


def make_all(folder):
    """Write the plants and their textures into a folder."""
    make_broadleaf(folder)
    make_conifer(folder)
    make_hedge(folder)

# SPDX-License-Identifier: BSD-3-Clause
"""Textures of the ground outdoors. Each repeats without a seam; the docstring says how wide a tile is meant to be."""

import numpy as np

from .textures import make_rng, tileable_noise, write_png


def _rough(rng, size_px, color, coarse, fine, octaves=4):
    """A colour with stains (deviation coarse) and grain (fine), in grey levels."""
    tone = coarse * tileable_noise(rng, size_px, octaves) + fine * rng.standard_normal((size_px, size_px))
    return np.array(color, dtype=float) + tone[..., None]


def asphalt(rng, size_px=256):
    """Dark grey with light and dark grains; 3 m."""
    image = _rough(rng, size_px, (84, 85, 88), 4.0, 5.0)
    grains = rng.random((size_px, size_px))
    image[grains < 0.04] += 26
    image[grains > 0.95] -= 22
    return image


def sidewalk(rng, size_px=256, slabs=4):
    """Square slabs of slightly different greys with dark joints; 2 m, so a slab has 0.5 m."""
    image = _rough(rng, size_px, (182, 178, 170), 3.0, 3.0)
    slab_px = size_px // slabs
    for row in range(slabs):
        for column in range(slabs):
            area = (slice(row * slab_px, (row + 1) * slab_px), slice(column * slab_px, (column + 1) * slab_px))
            image[area] += rng.uniform(-9.0, 9.0)
    for offset in (0, 1):
        image[offset::slab_px] = image[:, offset::slab_px] = np.array((122, 118, 110))
    return image


def grass(rng, size_px=256):
    """Blades in several greens, patches of darker turf; 2 m."""
    image = _rough(rng, size_px, (86, 134, 52), 7.0, 4.0)
    for _ in range(2600):
        start, length, angle = rng.uniform(0, size_px, 2), rng.integers(4, 11), rng.uniform(0, np.pi)
        cells = start + np.arange(length)[:, None] * np.array([np.sin(angle), np.cos(angle)])
        rows, columns = np.floor(cells).astype(int).T % size_px
        image[rows, columns] = np.array((74, 122, 40)) * rng.uniform(0.62, 1.45) + (rng.uniform(0, 18), 0, 0)
    return image


def curb_ramp(rng, size_px=256, domes=8):
    """Yellow tactile paving: rows of truncated domes, lit from one side; 1 m."""
    image = _rough(rng, size_px, (232, 182, 44), 3.0, 2.0)
    pitch = size_px // domes
    y, x = np.meshgrid(np.arange(size_px), np.arange(size_px), indexing="ij")
    dx, dy = (x % pitch - pitch / 2 + 0.5) / pitch, (y % pitch - pitch / 2 + 0.5) / pitch
    radius = np.hypot(dx, dy)
    image[(np.hypot(dx - 0.06, dy - 0.06) < 0.30)] *= 0.66
    image[radius < 0.28] = (246, 204, 84)
    image[radius < 0.19] = (255, 222, 112)
    image[[0, -1]] = image[:, [0, -1]] = np.array((168, 128, 30))
    return image


def crosswalk(rng, size_px=256):
    """White bars on asphalt, along the texture's y axis (v); one bar and one gap are a tile of 1 m."""
    image = asphalt(rng, size_px)
    worn = rng.random((size_px, size_px)) < 0.015
    bar = np.zeros((size_px, size_px), dtype=bool)
    bar[:, size_px // 4 : 3 * size_px // 4] = True
    paint = _rough(rng, size_px, (222, 222, 216), 3.0, 3.0)
    image[bar & ~worn] = paint[bar & ~worn]
    return image


def parking_line(rng, size_px=128):
    """White road paint with a little wear; 1 m."""
    image = _rough(rng, size_px, (222, 222, 216), 4.0, 4.0)
    worn = rng.random((size_px, size_px)) < 0.015
    image[worn] = (120, 120, 120)
    return image


def make_all(folder):
    """Write the textures of the ground outdoors into a folder."""
    (folder / "textures").mkdir(parents=True, exist_ok=True)
    for seed, paint in enumerate((asphalt, sidewalk, grass, curb_ramp, crosswalk, parking_line), start=61):
        write_png(folder / "textures" / f"{paint.__name__}.png", paint(make_rng(seed)))

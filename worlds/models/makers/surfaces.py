# SPDX-License-Identifier: BSD-3-Clause
"""Textures of the floors of the warehouse and the hospital; they repeat without a seam."""

import numpy as np

from makers.textures import make_rng, tileable_noise, write_png


def vinyl_texture(rng, size_px=256):
    """Pale speckled hospital floor with a welded seam along two edges."""
    image = np.zeros((size_px, size_px, 3)) + (178, 188, 186) + 2.5 * tileable_noise(rng, size_px, 3)[..., None]
    flecks = rng.random((size_px // 2, size_px // 2)).repeat(2, axis=0).repeat(2, axis=1)
    image[flecks < 0.05] = (162, 174, 173)
    image[flecks > 0.96] = (192, 200, 196)
    image[:2, :] = image[:, :2] = (150, 164, 162)
    return image


def carpet_texture(rng, size_px=256, tile_px=64):
    """Blue-grey carpet tiles, their pile turned by a quarter from one to the next."""
    y, x = np.mgrid[:size_px, :size_px]
    turned = (x // tile_px + y // tile_px) % 2 == 0
    pile = np.where(turned, x, y) % 4 < 2
    tone = np.where(turned, 1.0, 0.9) + np.where(pile, 0.05, -0.05) + 0.05 * rng.standard_normal((size_px, size_px))
    image = tone[..., None] * np.array([84.0, 98.0, 132.0])
    fleck = rng.random((size_px, size_px)) < 0.02
    image[fleck] = (150, 150, 120)
    return image


def floor_stripe_texture(size_px=128, stripes=2):
    """Yellow and black marking tape, diagonal."""
    y, x = np.mgrid[:size_px, :size_px]
    black = ((x + y) * stripes // (size_px // 2)) % 2 == 0
    return np.where(black[..., None], np.array([36.0, 36.0, 38.0]), np.array([246.0, 202.0, 24.0]))


def make_all(folder):
    """Write these textures into a folder."""
    textures = folder / "textures"
    textures.mkdir(parents=True, exist_ok=True)
    write_png(textures / "vinyl.png", vinyl_texture(make_rng("vinyl")))
    write_png(textures / "carpet.png", carpet_texture(make_rng("carpet")))
    write_png(textures / "floor_stripe.png", floor_stripe_texture())

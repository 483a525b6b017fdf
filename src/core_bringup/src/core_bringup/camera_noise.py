# SPDX-License-Identifier: BSD-3-Clause
"""Noise of a depth camera, the same bits for the same seed and stamp."""

from __future__ import annotations

from functools import lru_cache
from statistics import NormalDist
from typing import Tuple

import numpy as np

from core_bringup.world_types import CameraNoise

_QUANTILES = 4096  # values a normal number is rounded to; the farthest is 3.5 sigma
_UINT16 = 1 << 16


def add_camera_noise(
    color: np.ndarray, depth_m: np.ndarray, noise: CameraNoise, stamp_ns: int
) -> Tuple[np.ndarray, np.ndarray]:
    """Noisy copies of a colour and a depth image; the images themselves where the noise is off.

        color' = color + 255 color_sigma n,      rounded and cut to 0..255
        z'     = z + k z^2 n,                    k = depth_sigma_per_m2
        z'     = 0                               with probability depth_dropout

    n are independent normal numbers, drawn from (noise.seed, stamp_ns). NaN (nothing was hit) stays.

    Args:
        color: (h, w, 3) uint8.
        depth_m: (h, w) float32 [m].
        noise: CameraNoise.
        stamp_ns: stamp of the frame, >= 0.
    """
    if not noise.is_on:
        return color, depth_m
    bits = np.random.SFC64((noise.seed, stamp_ns))
    if noise.color_sigma > 0.0:
        color = _add_color_noise(color, 255.0 * noise.color_sigma, bits)
    if noise.depth_sigma_per_m2 > 0.0:
        n = _normal_table()[_draw_uint16(bits, depth_m.size) >> 4].reshape(depth_m.shape)
        n *= depth_m
        n *= depth_m
        n *= np.float32(noise.depth_sigma_per_m2)
        n += depth_m
        depth_m = np.maximum(n, 0.0, out=n)
    if noise.depth_dropout > 0.0:
        lost = _draw_uint16(bits, depth_m.size) < round(noise.depth_dropout * _UINT16)
        lost = lost.reshape(depth_m.shape) & (depth_m == depth_m)
        depth_m = np.where(lost, np.float32(0.0), depth_m)
    return color, depth_m


def _add_color_noise(color: np.ndarray, sigma: float, bits: np.random.SFC64) -> np.ndarray:
    """Noise in whole steps of a colour value, which is several times as fast as float."""
    steps = np.rint(sigma * _normal_table()).astype(np.int16)
    n = steps[_draw_uint16(bits, color.size) >> 4].reshape(color.shape)
    n += color
    return np.clip(n, 0, 255, out=n).astype(np.uint8)


def _draw_uint16(bits: np.random.SFC64, count: int) -> np.ndarray:
    return bits.random_raw((count + 3) // 4).view(np.uint16)[:count]


@lru_cache(maxsize=1)
def _normal_table() -> np.ndarray:
    """(4096,) float32, the quantiles of the normal distribution at (i + 1/2) / 4096."""
    inverse = NormalDist().inv_cdf
    return np.array([inverse((i + 0.5) / _QUANTILES) for i in range(_QUANTILES)], dtype=np.float32)

# SPDX-License-Identifier: BSD-3-Clause
"""Camera model and the images of one frame; rendering itself is in pybullet_renderer."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class CameraModel:
    """A pinhole camera without distortion.

    Source: [CORE] implementation details: the simulated camera has 500 x 320 px, fx 274.9, fy 376.7, cx 250, cy 160.
    Pixel (u, v) is centred at the integer: x = z (u - cx) / fx, y = z (v - cy) / fy in the optical frame.
    """

    width_px: int = 500
    height_px: int = 320
    fx_px: float = 274.9
    fy_px: float = 376.7
    cx_px: float = 250.0
    cy_px: float = 160.0
    near_m: float = 0.05
    far_m: float = 30.0

    def compute_horizontal_fov(self) -> float:
        """Horizontal opening [rad] that is in view on both sides of the axis.

        fov = 2 atan(min(cx + 1/2, width - 1/2 - cx) / fx)
        """
        narrower_px = min(self.cx_px + 0.5, self.width_px - 0.5 - self.cx_px)
        return 2.0 * math.atan(narrower_px / self.fx_px)


@dataclass(frozen=True)
class Frame:
    """Images of one instant, all registered to the colour image.

    Attributes:
        color: (h, w, 3) uint8 rgb.
        depth_m: (h, w) float32 distance along the optical axis [m], NaN where nothing was hit.
        labels: (h, w) uint16 object id of the world, 0 where nothing was hit or the robot itself is seen.
    """

    color: np.ndarray
    depth_m: np.ndarray
    labels: np.ndarray

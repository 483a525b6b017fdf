# SPDX-License-Identifier: BSD-3-Clause
"""The usual sound way out, to compare with: a sampled distance field lowered by a constant, one gradient row a disc."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt

from core_control.dynamics import compute_rotation, place_discs
from core_control.params import FilterParams
from core_control.proposal import scale_to_limits
from core_control.qp import VelocityQp
from core_control.types import FilterInputs


@dataclass(frozen=True)
class MarginResult:
    """The part of FilterResult that episodes look at."""

    u_safe: np.ndarray
    reason: str = ""


class MarginFilter:
    """Rows n . R (v + w S o_i) >= -alpha max(h(c_i) - r_i - margin, 0) with h and n from bilinear interpolation.

        margin = sqrt(2) cell + (lag + delay) |v|max

    Args:
        params: gain, discs, limits, lag and delay are used.
        cell_m: edge of a cell.
        slewed: keep the shipped filter's limits of acceleration too.

    Source: research notes of the project, design D4 there; no verifier; without slewed, no limits of acceleration.
    """

    def __init__(self, params: FilterParams, cell_m: float, slewed: bool = False):
        """Build the program."""
        self._params, self._discs = params, params.disc_array
        speed_mps = math.hypot(params.max_vx_mps, params.max_vy_mps)
        self._margin_m = math.sqrt(2.0) * cell_m + (params.lag_s + params.delay_s) * speed_mps
        self._qp = VelocityQp(len(self._discs), params.weights, True, "compiled")
        self._growth = params.accelerations * params.control_period_s if slewed else 2.0 * params.limits
        self.reset()

    def forget(self) -> None:
        """Nothing that reset() does not forget."""

    def reset(self) -> None:
        """Forget the field and the last command."""
        self._field, self._h_m, self._sent = None, None, np.zeros(3)

    def step(self, inputs: FilterInputs) -> MarginResult:
        """Decide one command."""
        if inputs.field is not self._field:
            self._field, self._h_m = inputs.field, compute_edges_distance(inputs.field)
        pose = inputs.pose
        R = compute_rotation(pose[2])
        a, b = [], []
        for (x, y, radius_m), centre in zip(self._discs, place_discs(pose[None], self._discs)[0]):
            h_m, gradient = self._interpolate(centre)
            a.append(np.append(R.T @ gradient, gradient @ (R @ np.array([-y, x]))))
            b.append(-self._params.alpha_per_s * max(h_m - radius_m - self._margin_m, 0.0))
        limits = self._params.limits
        lower = np.maximum(np.minimum(self._sent, 0.0) - self._growth, -limits)
        upper = np.minimum(np.maximum(self._sent, 0.0) + self._growth, limits)
        wanted = np.clip(scale_to_limits(inputs.u_nominal, limits), lower, upper)
        self._sent = self._qp.solve(wanted, np.array(a), np.array(b), (lower, upper))
        return MarginResult(self._sent)

    def _interpolate(self, point: np.ndarray):
        """h [m] and its gradient between the four nearest centres."""
        cell_m = self._field.grid.resolution_m
        s = (point - self._field.lo_m) / cell_m - 0.5
        ny, nx = self._h_m.shape
        i = np.clip(np.floor(s).astype(int), 0, [nx - 2, ny - 2])
        tx, ty = np.clip(s - i, 0.0, 1.0)
        (h00, h10), (h01, h11) = self._h_m[i[1] : i[1] + 2, i[0] : i[0] + 2]
        h = (h00 * (1 - tx) + h10 * tx) * (1 - ty) + (h01 * (1 - tx) + h11 * tx) * ty
        dx = (h10 - h00) * (1 - ty) + (h11 - h01) * ty
        dy = (h01 - h00) * (1 - tx) + (h11 - h10) * tx
        return float(h), np.array([dx, dy]) / cell_m


def compute_edges_distance(field) -> np.ndarray:
    """edt(safe) - edt(unsafe) at the centres [m], as most people write it; what lies outside the grid is unsafe."""
    unsafe = np.pad(field.unsafe, 1, constant_values=True)
    inside = distance_transform_edt(unsafe)
    outside = distance_transform_edt(~unsafe)
    return field.grid.resolution_m * (outside - inside)[1:-1, 1:-1]

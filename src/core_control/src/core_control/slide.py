# SPDX-License-Identifier: BSD-3-Clause
"""Rows that bound how far the filter may turn a command away from the direction that was asked for."""

from __future__ import annotations

import numpy as np

from core_control.types import NO_CELL, BarrierRows


def compute_slide_rows(u_nominal: np.ndarray, weights: np.ndarray, ratio: float) -> BarrierRows:
    """Four rows that let the filter add motion only in proportion to the progress that is left.

        z = W u,  t = W u_nominal / |W u_nominal|,  (t, e1, e2) orthonormal
        |e1 . z| <= ratio (t . z),   |e2 . z| <= ratio (t . z)

    A plain projection on a barrier slides along it for as long as the command pushes. With these rows a robot pushed
    against a barrier at less than atan(ratio) from its face follows it, and comes to rest where it meets it more
    squarely. u = 0 and u = u_nominal always satisfy them, so the barrier's own rows stay feasible.

    Args:
        u_nominal: (3,) wanted command [m/s, m/s, rad/s].
        weights: (3,) diagonal of W.
        ratio: > 0; large values switch the bound off.

    Returns:
        Four rows; none for u_nominal = 0, whose answer is 0.

    Differs from [CORE], which has no such bound.
    """
    wanted = weights * u_nominal
    length = float(np.linalg.norm(wanted))
    if length == 0.0:
        return BarrierRows.empty()
    t = wanted / length
    planar = np.hypot(t[0], t[1])
    e1 = np.array([-t[1], t[0], 0.0]) / planar if planar > 1e-9 else np.array([1.0, 0.0, 0.0])
    e2 = np.cross(t, e1)
    directions = np.array([ratio * t + e1, ratio * t - e1, ratio * t + e2, ratio * t - e2])
    return BarrierRows(directions * weights, np.zeros(4), np.full(4, NO_CELL), np.full((4, 2), np.nan))

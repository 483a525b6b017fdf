# SPDX-License-Identifier: BSD-3-Clause
"""Fits what a model predicts from one picture to the returns of a depth sensor: one scale, found by medians."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Optional, Union

import numpy as np

KINDS = ("metric", "relative", "disparity")
MAD_TO_SIGMA = 1.4826  # of a normal distribution
GRID = 4  # the image is divided into GRID x GRID cells to see whether the returns are spread
LINE_PAIRS, LINE_POINTS = 200, 2000  # tries, and points each is judged by, of the line of a disparity
LEAST_DISPARITY_RATIO = 1.3  # between near and far returns, for a line to be told from a constant


@dataclass(frozen=True)
class Prediction:
    """What a model says of one picture.

    Attributes:
        values: (h, w) float32; what is not finite, or not > 0, is not predicted.
        kind: ``metric`` [m] or ``relative`` (no unit): depth along the optical axis, larger is farther; ``disparity``
            (no unit): larger is nearer, 1 / depth up to a scale and a shift.
        confidence: (h, w) float32, larger is surer, of any range; None if the model gives none.
    """

    values: np.ndarray
    kind: str = "relative"
    confidence: Optional[np.ndarray] = None


@dataclass(frozen=True)
class FitLimits:
    """What a fit must meet; see DepthCompletionParams, which has the same names."""

    fit_min_m: float = 0.3
    fit_max_m: float = 8.0
    min_returns: int = 200
    min_cells: int = 4
    edge_step: float = 0.10
    gate: float = 0.10
    rounds: int = 3
    min_inlier_ratio: float = 0.6
    max_mad: float = 0.05


@dataclass(frozen=True)
class ScaleFit:
    """A scale that holds.

    Attributes:
        scale: s, metres per unit of the prediction.
        inlier_ratio: share of the returns with |log(s p / d)| within the gate, 0 to 1.
        mad: median of |log(s p / d)| over the inliers; 0.03 is 3 % of the distance.
        gate: the gate itself, largest |log(s p / d)| of an inlier.
        returns: how many returns were compared.
    """

    scale: float
    inlier_ratio: float
    mad: float
    gate: float
    returns: int


@dataclass(frozen=True)
class NoFit:
    """Why there is no scale, in words for a person."""

    reason: str


def find_edges(depth: np.ndarray, edge_step: float) -> np.ndarray:
    """Return (h, w) bool: pixels whose neighbour differs by more than edge_step in log(depth); NaN is no edge.

    A model draws the border of an object some pixels beside where the sensor sees it, and paints depths between the
    two sides that nothing has.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        log_depth = np.log(depth)
        across = np.abs(np.diff(log_depth, axis=1)) > edge_step
        down = np.abs(np.diff(log_depth, axis=0)) > edge_step
    edges = np.zeros(depth.shape, bool)
    edges[:, 1:] |= across
    edges[:, :-1] |= across
    edges[1:] |= down
    edges[:-1] |= down
    return edges


def select_returns(sensor_m: np.ndarray, depth: np.ndarray, confidence, limits: FitLimits) -> np.ndarray:
    """Return (h, w) bool: pixels where sensor and model can be compared.

    Args:
        sensor_m: (h, w) depth of the sensor [m].
        depth: (h, w) predicted depth, larger is farther; NaN where none.
        confidence: (h, w) or None; the less sure half is left out.
        limits: fit_min_m, fit_max_m and edge_step are read.
    """
    with np.errstate(invalid="ignore"):
        valid = (sensor_m >= limits.fit_min_m) & (sensor_m <= limits.fit_max_m) & (depth > 0.0) & np.isfinite(depth)
    valid &= ~find_edges(depth, limits.edge_step)
    if confidence is not None and valid.any():
        valid &= np.isfinite(confidence)
        valid &= confidence >= (np.median(confidence[valid]) if valid.any() else 0.0)
    return valid


def fit_scale(sensor_m: np.ndarray, depth: np.ndarray, valid: np.ndarray, limits: FitLimits) -> Union[ScaleFit, NoFit]:
    """Fit s so that s p agrees with the sensor.

        s = median(d_i / p_i), then up to ``rounds`` times over those with |log(s p_i / d_i)| < max(gate, 3 sigma),
        sigma = 1.4826 median |r_i - median r|, r_i = log(s p_i / d_i)

    Args:
        sensor_m: (h, w) d [m].
        depth: (h, w) p, larger is farther.
        valid: (h, w) bool, as from select_returns.
        limits: what the fit must meet.

    Source: [CORE] "median fitting", which is all it says. Differs: gating, and refusal where the fit does not hold.
    """
    returns = int(valid.sum())
    if returns < limits.min_returns:
        return NoFit(f"{returns} usable sensor returns, {limits.min_returns} are needed")
    cells = count_cells(valid)
    if cells < limits.min_cells:
        return NoFit(f"the sensor returns fill {cells} of {GRID * GRID} parts of the image, {limits.min_cells} needed")
    log_ratio = np.log(sensor_m[valid].astype(np.float64) / depth[valid])
    log_scale = np.median(log_ratio)
    for _ in range(limits.rounds):
        residual = np.abs(log_ratio - log_scale)
        gate = max(limits.gate, 3.0 * MAD_TO_SIGMA * np.median(residual))
        inliers = residual < gate
        log_scale = np.median(log_ratio[inliers])
    # The share is counted with the gate that sound returns have, or returns that agree with nothing would widen it.
    sound = np.abs(log_ratio - log_scale)[inliers]
    gate = max(limits.gate, 3.0 * MAD_TO_SIGMA * np.median(sound))
    inliers = np.abs(log_ratio - log_scale) < gate
    ratio, mad = inliers.mean(), np.median(np.abs(log_ratio - log_scale)[inliers])
    if ratio < limits.min_inlier_ratio:
        return NoFit(f"{ratio:.0%} of the sensor returns agree with the model, {limits.min_inlier_ratio:.0%} needed")
    if mad > limits.max_mad:
        return NoFit(f"model and sensor differ by {mad:.0%} in the median, at most {limits.max_mad:.0%} allowed")
    return ScaleFit(float(math.exp(log_scale)), float(ratio), float(mad), float(gate), returns)


def count_cells(valid: np.ndarray) -> int:
    """How many of GRID x GRID parts of the image hold at least 1 % of its valid pixels."""
    rows = np.array_split(np.arange(valid.shape[0]), GRID)
    columns = np.array_split(np.arange(valid.shape[1]), GRID)
    counts = [valid[r[0] : r[-1] + 1, c[0] : c[-1] + 1].sum() for r in rows for c in columns if len(r) and len(c)]
    return sum(1 for count in counts if count and count >= 0.01 * valid.sum())


def depth_of_prediction(sensor_m: np.ndarray, prediction: Prediction, limits: FitLimits) -> Union[np.ndarray, NoFit]:
    """Return (h, w) float64, predicted depth up to a scale, larger is farther, NaN where none.

    A disparity has a shift besides its scale, which only the sensor can tell; see fit_disparity.
    """
    values = prediction.values.astype(np.float64)
    values[~np.isfinite(values)] = np.nan
    if prediction.kind == "disparity":
        line = fit_disparity(sensor_m, values, limits)
        if isinstance(line, NoFit):
            return line
        values = line[0] * values + line[1]
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(values > 0.0, 1.0 / values, np.nan)
    with np.errstate(invalid="ignore"):
        return np.where(values > 0.0, values, np.nan)


def fit_disparity(sensor_m: np.ndarray, values: np.ndarray, limits: FitLimits):
    """Return (a, b) of 1/d = a p + b, a > 0, by the least median of |log(d (a p + b))| over pairs, or NoFit.

    Args:
        sensor_m: (h, w) d [m].
        values: (h, w) p, larger is nearer; NaN where none.
        limits: fit_min_m, fit_max_m and min_returns are read.
    """
    with np.errstate(invalid="ignore"):
        valid = (sensor_m >= limits.fit_min_m) & (sensor_m <= limits.fit_max_m) & np.isfinite(values)
    d, p = sensor_m[valid].astype(np.float64), values[valid]
    if d.size < limits.min_returns:
        return NoFit(f"{d.size} usable sensor returns, {limits.min_returns} are needed")
    low, high = np.percentile(d, (10, 90))
    if high < LEAST_DISPARITY_RATIO * low:
        return NoFit(f"the returns lie between {low:.1f} and {high:.1f} m, too much alike to find the model's shift")
    draw = np.random.RandomState(0)  # the same picture gives the same line
    chosen = draw.choice(d.size, min(LINE_POINTS, d.size), replace=False)
    d, p = d[chosen], p[chosen]
    i, j = draw.randint(0, d.size, (2, LINE_PAIRS))
    with np.errstate(divide="ignore", invalid="ignore"):
        a = (1.0 / d[i] - 1.0 / d[j]) / (p[i] - p[j])
    a, i = a[np.isfinite(a) & (a > 0.0)], i[np.isfinite(a) & (a > 0.0)]
    if a.size == 0:
        return NoFit("what the model calls near is not near for the sensor")
    b = 1.0 / d[i] - a * p[i]
    best = np.argmin([np.median(_disparity_residual(d, p, *line)) for line in zip(a, b)])
    line = a[best], b[best]
    for _ in range(2):
        residual = _disparity_residual(d, p, *line)
        near = residual < max(limits.gate, 3.0 * MAD_TO_SIGMA * np.median(residual))
        # Weighted with d: an error of the distance counts in proportion to the distance.
        design = np.stack([p[near] * d[near], d[near]], axis=1)
        solved = np.linalg.lstsq(design, np.ones(near.sum()), rcond=None)[0]
        if not solved[0] > 0.0:
            break
        line = solved[0], solved[1]
    return line


def _disparity_residual(d, p, a, b):
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.nan_to_num(np.abs(np.log(d * (a * p + b))), nan=np.inf, posinf=np.inf)

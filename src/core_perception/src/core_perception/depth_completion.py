# SPDX-License-Identifier: BSD-3-Clause
"""Fills holes of a depth image with what a model predicts, scaled to the sensor, where returns around it vouch for it.

A value of the sensor is never replaced, not even one the model contradicts. A hole is filled only if, around it, the
sensor has returns, they agree with the scaled prediction, and the value lies between theirs; everything else stays a
hole, which the map takes for unknown. So a filled pixel interpolates what the sensor measured; it extrapolates nothing.
"""

from __future__ import annotations

import enum
import math
from collections import deque
from dataclasses import dataclass, field
from typing import Deque, Optional, Tuple, Union

import cv2
import numpy as np

from core_perception.exceptions import EvidenceError
from core_perception.scale_fit import (
    FitLimits,
    NoFit,
    Prediction,
    ScaleFit,
    depth_of_prediction,
    find_edges,
    fit_scale,
    select_returns,
)

SHAPE_TOLERANCE = 0.02  # of the ratio of width to height; as semantic_map has it
LEAST_FITS_TO_JUDGE = 3
PLAUSIBLE_METRIC_SCALE = 1.5  # a model that speaks of metres should need less than this, or its reciprocal


class Outcome(enum.Enum):
    """What became of a frame."""

    FILLED = "filled"  # with a scale of this frame
    KEPT_SCALE = "filled with the last scale"
    PASSED = "passed unchanged"


@dataclass(frozen=True)
class CompletionLimits:
    """What a filled value must meet; see DepthCompletionParams, which has the same names."""

    fit: FitLimits = field(default_factory=FitLimits)
    scale_jump: float = 0.2
    scale_window: int = 9
    keep_scale_s: float = 2.0
    support_radius: float = 0.05
    support_returns: int = 8
    support_ratio: float = 0.7
    support_range: float = 0.1


@dataclass(frozen=True)
class Completion:
    """One completed frame.

    Attributes:
        depth_m: (h, w) float32 [m]; NaN where nothing is known.
        outcome: what was done.
        reason: why it was not filled with a scale of its own; empty if it was.
        fit: of this frame; None if there is none.
        scale: the one used; None if none.
        filled: how many pixels were filled.
        holes: how many pixels the sensor left open.
    """

    depth_m: np.ndarray
    outcome: Outcome
    reason: str = ""
    fit: Optional[ScaleFit] = None
    scale: Optional[float] = None
    filled: int = 0
    holes: int = 0


def find_holes(depth_m: np.ndarray) -> np.ndarray:
    """Return (h, w) bool: where the sensor says nothing (NaN or 0).

    Plus and minus infinity are words of the sensor (nothing in range, too near; REP 117) and no holes.
    """
    return np.isnan(depth_m) | (depth_m == 0.0)


def pass_unchanged(depth_m: np.ndarray, reason: str) -> Completion:
    """The sensor's depth as it is, NaN where it is 0."""
    holes = find_holes(depth_m)
    unchanged = np.where(holes, np.float32(np.nan), depth_m).astype(np.float32)
    return Completion(unchanged, Outcome.PASSED, reason, holes=int(holes.sum()))


class ScaleMemory:
    """Refuses a scale that jumps away from a slow median, and keeps the last one for a while."""

    def __init__(self, limits: CompletionLimits):
        """Start without a scale."""
        self._limits = limits
        self._log_scales: Deque[float] = deque(maxlen=limits.scale_window)
        self._scale: Optional[float] = None
        self._scale_s = self._now_s = -math.inf

    def take(self, fit: Union[ScaleFit, NoFit], now_s: float) -> Tuple[Optional[float], str]:
        """Return the scale to use and why it is not that of the fit; None if there is none to use.

        A fit that jumps enters the median all the same, so that a change that lasts is believed after half a window.

        Args:
            fit: of this frame.
            now_s: stamp of the frame [s]; one that goes back forgets everything.
        """
        if now_s < self._now_s:
            self._log_scales.clear()
            self._scale, self._scale_s = None, -math.inf
        self._now_s = now_s
        reason = fit.reason if isinstance(fit, NoFit) else self._judge(fit)
        if not reason:
            self._scale, self._scale_s = fit.scale, now_s
            return fit.scale, ""
        if self._scale is not None and now_s - self._scale_s <= self._limits.keep_scale_s:
            return self._scale, reason
        return None, reason

    def _judge(self, fit: ScaleFit) -> str:
        usual = np.median(self._log_scales) if len(self._log_scales) >= LEAST_FITS_TO_JUDGE else None
        self._log_scales.append(math.log(fit.scale))
        if usual is None or abs(math.log(fit.scale) - usual) <= math.log1p(self._limits.scale_jump):
            return ""
        return f"the scale jumped from {math.exp(usual):.3g} to {fit.scale:.3g}"


class DepthCompleter:
    """Completes frame after frame."""

    def __init__(self, limits: CompletionLimits):
        """Start without a scale.

        Args:
            limits: what fit and filled values must meet.
        """
        self._limits = limits
        self._memory = ScaleMemory(limits)

    def complete(self, sensor_m: np.ndarray, prediction: Prediction, stamp_s: float) -> Completion:
        """Fill what the sensor left open, where its returns vouch for the prediction.

        Args:
            sensor_m: (h, w) float32 depth along the optical axis [m]; NaN or 0 where the sensor has none.
            prediction: of the colour image this depth is registered to; any size of the same shape.
            stamp_s: of the frame [s].

        Returns:
            Completion; never None. Whatever fails, the sensor's values come back, and the reason.

        Raises:
            EvidenceError: the images are not of one shape.

        Source: [CORE] implementation details (median fitting). Differs: values of the sensor stay, the fit may be
            refused, and every filled value is vouched for.
        """
        limits = self._limits.fit
        prediction = resize_prediction(prediction, sensor_m.shape)
        depth = depth_of_prediction(sensor_m, prediction, limits)
        if isinstance(depth, NoFit):
            return pass_unchanged(sensor_m, depth.reason)
        valid = select_returns(sensor_m, depth, prediction.confidence, limits)
        fit = fit_scale(sensor_m, depth, valid, limits)
        if prediction.kind == "disparity":  # its scale and shift are those of one picture: nothing to keep or compare
            scale, reason = (None, fit.reason) if isinstance(fit, NoFit) else (fit.scale, "")
        else:
            scale, reason = self._memory.take(fit, stamp_s)
        if scale is None:
            return pass_unchanged(sensor_m, reason)
        gate = limits.gate if isinstance(fit, NoFit) else fit.gate
        return self._fill(sensor_m, scale * depth, prediction.confidence, (fit, scale, reason, gate))

    def _fill(self, sensor_m, predicted_m, confidence, scaling) -> Completion:
        fit, scale, reason, gate = scaling
        limits = self._limits
        holes = find_holes(sensor_m)
        compared = ~holes & (sensor_m >= limits.fit.fit_min_m) & (sensor_m <= limits.fit.fit_max_m)
        with np.errstate(invalid="ignore", divide="ignore"):
            compared &= predicted_m > 0.0
            inliers = compared & (np.abs(np.log(predicted_m / sensor_m)) < gate)
            fills = holes & (predicted_m >= limits.fit.fit_min_m) & (predicted_m <= limits.fit.fit_max_m)
        fills &= ~find_edges(predicted_m, limits.fit.edge_step)
        if confidence is not None:
            fills &= np.isfinite(confidence)
            if inliers.any():  # as sure as the model is where the sensor bears it out
                fills &= confidence >= np.nanpercentile(confidence[inliers], 10)
        fills &= find_supported(sensor_m, predicted_m, compared, inliers, limits)
        depth_m = np.where(holes, np.float32(np.nan), sensor_m).astype(np.float32)
        depth_m[fills] = predicted_m[fills]
        outcome = Outcome.KEPT_SCALE if reason else Outcome.FILLED
        fit = None if isinstance(fit, NoFit) else fit
        return Completion(depth_m, outcome, reason, fit, scale, int(fills.sum()), int(holes.sum()))


def find_supported(sensor_m, predicted_m, compared, inliers, limits: CompletionLimits) -> np.ndarray:
    """Return (h, w) bool: pixels whose predicted value the returns around them vouch for.

        n_inlier >= support_returns,  n_inlier >= support_ratio * n_compared,
        (1 - support_range) min d <= value <= (1 + support_range) max d      over the inliers of the square around it

    Args:
        sensor_m: (h, w) depth of the sensor [m].
        predicted_m: (h, w) scaled prediction [m], NaN where none.
        compared: (h, w) bool: the sensor has a return that can be compared.
        inliers: (h, w) bool: and it agrees.
        limits: support_radius is a part of the image's width.
    """
    side = 2 * max(1, round(limits.support_radius * sensor_m.shape[1])) + 1
    square = {"ksize": (side, side), "normalize": False, "borderType": cv2.BORDER_CONSTANT}
    inlier_count = cv2.boxFilter(inliers.astype(np.float32), cv2.CV_32F, **square)
    compared_count = cv2.boxFilter(compared.astype(np.float32), cv2.CV_32F, **square)
    kernel = np.ones((side, side), np.uint8)
    nearest_m = cv2.erode(np.where(inliers, sensor_m, np.inf).astype(np.float32), kernel)
    farthest_m = cv2.dilate(np.where(inliers, sensor_m, 0.0).astype(np.float32), kernel)
    # Sums of ones are whole numbers, but a box filter that slides may be off by a rounding error.
    supported = np.rint(inlier_count) >= limits.support_returns
    supported &= inlier_count >= limits.support_ratio * compared_count - 1e-3
    with np.errstate(invalid="ignore"):
        supported &= predicted_m >= (1.0 - limits.support_range) * nearest_m
        supported &= predicted_m <= (1.0 + limits.support_range) * farthest_m
    return supported


def resize_prediction(prediction: Prediction, shape: Tuple[int, int]) -> Prediction:
    """The prediction at the size of the depth image.

    Raises:
        EvidenceError: it has another shape, no pixel, or its confidence another size.
    """
    values, confidence = np.asarray(prediction.values, np.float32), prediction.confidence
    height_px, width_px = shape
    if values.ndim != 2 or values.size == 0 or 0 in shape:
        raise EvidenceError(f"prediction: got shape {values.shape} for a depth image of {width_px} x {height_px}")
    if confidence is not None and np.shape(confidence) != values.shape:
        raise EvidenceError(f"prediction: confidence is {np.shape(confidence)}, the prediction {values.shape}")
    if abs(values.shape[1] * height_px - values.shape[0] * width_px) > SHAPE_TOLERANCE * values.shape[1] * height_px:
        raise EvidenceError(
            f"prediction: got {values.shape[1]} x {values.shape[0]} for a depth image of {width_px} x {height_px};"
            " allowed the same shape"
        )
    if values.shape == tuple(shape):
        return Prediction(values, prediction.kind, confidence)

    def resize(image):
        return cv2.resize(np.asarray(image, np.float32), (width_px, height_px), interpolation=cv2.INTER_LINEAR)

    return Prediction(resize(values), prediction.kind, None if confidence is None else resize(confidence))


def is_plausible_metric(scale: float) -> bool:
    """Whether a model that speaks of metres needs no more than this scale."""
    return 1.0 / PLAUSIBLE_METRIC_SCALE <= scale <= PLAUSIBLE_METRIC_SCALE

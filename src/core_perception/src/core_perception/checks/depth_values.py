# SPDX-License-Identifier: BSD-3-Clause
"""Are the numbers of the depth images distances in the unit their encoding says?"""

from __future__ import annotations

from typing import Sequence

import numpy as np

from core_perception.checks.base import CheckFrame, Finding, Level, Outcome

CHECK = "depth values"
LEAST_SHARE = 0.05
LEAST_SPREAD = 1e-3  # of the median; even a wall at right angles has noise or a corner
PLAUSIBLE_M = (0.15, 20.0)  # of the median
LARGEST_BYTE = 255
MM_PER_M = 1000.0
SAMPLES_PER_FRAME = 20000


def check_depth_values(frames: Sequence[CheckFrame]) -> Outcome:
    """Look at how many pixels hold a distance, how large they are and whether they differ.

    Args:
        frames: at least one.
    """
    pixels = sum(frame.depth.size for frame in frames)
    share = sum(int(_is_valid(frame.depth).sum()) for frame in frames) / pixels
    valid = np.concatenate([_sample(frame.depth[_is_valid(frame.depth)]) for frame in frames]).astype(np.float64)
    is_mm = frames[0].depth.dtype == np.uint16
    encoding = "16UC1" if is_mm else "32FC1"
    if valid.size == 0:
        sentence = (
            f"The depth images hold no distance: every pixel of {len(frames)} images is 0 or not a number. "
            "Check that the depth stream is switched on, that nothing covers it, and that the topic is the depth image."
        )
        return Outcome(CHECK, (Finding("depth_empty", Level.ERROR, sentence),), "0 % of the pixels hold a distance")
    median_m = float(np.median(valid)) / (MM_PER_M if is_mm else 1.0)
    findings = [*_check_unit(valid, median_m, is_mm), *_check_spread(valid, median_m)]
    if share < LEAST_SHARE:
        sentence = (
            f"Only {share:.1%} of the depth pixels hold a distance, so most of the ground stays unknown and the robot "
            "will hardly move. Check the sensor's range and light, or fill the gaps with depth_completion."
        )
        findings.append(Finding("depth_sparse", Level.WARNING, sentence))
    negative = sum(int((frame.depth < 0).sum()) for frame in frames) / pixels
    if negative > 0.01:
        sentence = f"{negative:.0%} of the depth pixels are negative. {encoding} must be metres along the optical axis."
        findings.append(Finding("depth_negative", Level.WARNING, sentence))
    return Outcome(CHECK, tuple(findings), f"{share:.0%} of the pixels hold a distance, median {median_m:.2f} m")


def _is_valid(depth: np.ndarray) -> np.ndarray:
    with np.errstate(invalid="ignore"):
        return np.isfinite(depth) & (depth > 0)


def _sample(depth: np.ndarray) -> np.ndarray:
    flat = depth.ravel()
    return flat[:: max(1, flat.size // SAMPLES_PER_FRAME)]


def _check_unit(valid, median_m, is_mm):
    if is_mm and valid.max() <= LARGEST_BYTE:
        sentence = (
            f"The depth images are 16UC1, which means millimetres, but no value exceeds {valid.max():.0f}: they look "
            "like metres or an 8-bit picture. Have the driver publish millimetres, or 32FC1 in metres."
        )
        return [Finding("depth_unit", Level.ERROR, sentence)]
    if not is_mm and median_m > PLAUSIBLE_M[0] * MM_PER_M:
        sentence = (
            f"The depth images are 32FC1, which means metres, but their median is {median_m:.0f}: they look like "
            "millimetres. Divide by 1000, or publish them as 16UC1."
        )
        return [Finding("depth_unit", Level.ERROR, sentence)]
    if not PLAUSIBLE_M[0] <= median_m <= PLAUSIBLE_M[1]:
        sentence = (
            f"The median of the depth images is {median_m:.3g} m, which no depth camera sees at a robot. "
            "Check the driver's depth unit (CORE takes 16UC1 for millimetres and 32FC1 for metres)."
        )
        return [Finding("depth_unit", Level.WARNING, sentence)]
    return []


def _check_spread(valid, median_m):
    low, high = np.percentile(valid, (1, 99))
    if high - low > LEAST_SPREAD * high:
        return []
    sentence = (
        f"Every depth pixel says the same, {median_m:.3f} m. A real scene never does: check that the sensor runs and "
        "that the topic is not a placeholder."
    )
    return [Finding("depth_constant", Level.ERROR, sentence)]

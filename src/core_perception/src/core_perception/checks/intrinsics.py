# SPDX-License-Identifier: BSD-3-Clause
"""Can these intrinsics be those of these images?"""

from __future__ import annotations

import math
from typing import List, Optional, Tuple

import numpy as np

from core_perception.checks.base import CameraInfo, Finding, Level, Outcome

CHECK = "intrinsics"
SHAPE_TOLERANCE = 0.02  # as semantic_map has it
CENTER_TOLERANCE = 0.10  # of width and height; real cameras stay below half of it
FOCAL_RATIO_TOLERANCE = 0.05  # of fx / fy; pixels are square
LARGEST_FOCAL_RATIO = 1.5
FAR_SMALLER = 0.4  # an error of the height below this part of fx / fy cannot come from fy
FOV_DEG = (15.0, 140.0)  # 140 is where semantic_map refuses
DISTORTION_PX = 1.0
SQUARE_DISTORTION_MODELS = ("plumb_bob", "rational_polynomial")


def check_intrinsics(
    info: Optional[CameraInfo],
    depth_size_px: Tuple[int, int],
    color_size_px: Optional[Tuple[int, int]] = None,
    height_ratio: Optional[float] = None,
) -> Outcome:
    """Look at sizes, focal lengths, principal point, field of view and distortion.

    Args:
        info: camera_info; None if none came.
        depth_size_px: width and height of the depth images.
        color_size_px: of the colour images; None if none came.
        height_ratio: of check_floor, through these intrinsics; a wrong fy would show in it.
    """
    if info is None:
        sentence = (
            "No camera_info came, 0 messages, so no pixel can be placed. Start the driver's calibration, or remap "
            "camera/color/camera_info to where it is published."
        )
        return Outcome(CHECK, (Finding("info_missing", Level.ERROR, sentence),), "nothing came")
    findings: List[Finding] = []
    if not info.is_usable:
        fx, fy = (info.K[0], info.K[4]) if len(info.K) == 9 else (math.nan, math.nan)
        sentence = (
            f"camera_info has fx = {fx:g} and fy = {fy:g} px for {info.width_px} x {info.height_px} images: the "
            "camera is not calibrated. Calibrate it, or load its calibration into the driver."
        )
        return Outcome(CHECK, (Finding("intrinsics_missing", Level.ERROR, sentence),), "not calibrated")
    findings += _check_sizes(info, depth_size_px, color_size_px)
    if not any(finding.code == "size_shape" for finding in findings):
        findings += _check_center(info)
    findings += _check_focal_lengths(info, height_ratio)
    findings += _check_distortion(info)
    across, down = (
        2.0 * math.degrees(math.atan(n / 2.0 / f)) for n, f in ((info.width_px, info.K[0]), (info.height_px, info.K[4]))
    )
    measured = f"{info.width_px} x {info.height_px} px, {across:.0f} x {down:.0f} degrees"
    return Outcome(CHECK, tuple(findings), measured)


def _check_sizes(info, depth_size_px, color_size_px):
    findings, meant = [], info.image_size_px
    part = (
        f" (binning {info.binning[0]} x {info.binning[1]}, region of interest at {info.roi[:2]})"
        if info.is_part
        else ""
    )
    for name, size in (("depth", depth_size_px), ("colour", color_size_px)):
        if size is None or size == meant:
            continue
        sizes = f"The {name} images are {size[0]} x {size[1]}, camera_info is for {meant[0]} x {meant[1]}{part}"
        if info.is_part or abs(meant[0] * size[1] - meant[1] * size[0]) > SHAPE_TOLERANCE * meant[0] * size[1]:
            sentence = (
                f"{sizes}: another shape, so one of them is cropped and no frame will be used. "
                "Take camera_info and images from the same stream."
            )
            findings.append(Finding("size_shape", Level.ERROR, sentence))
        else:
            sentence = (
                f"{sizes}: the intrinsics are scaled by {size[0] / meant[0]:.3g}, which is right if the whole "
                "image was resized."
            )
            findings.append(Finding("size_scaled", Level.NOTE, sentence))
    return findings


def _check_center(info):
    cx, cy = info.K[2], info.K[5]
    off_x, off_y = (cx - (info.width_px - 1) / 2.0) / info.width_px, (cy - (info.height_px - 1) / 2.0) / info.height_px
    if max(abs(off_x), abs(off_y)) <= CENTER_TOLERANCE:
        return []
    sentence = (
        f"The principal point ({cx:.0f}, {cy:.0f}) lies {abs(off_x):.0%} of the width and {abs(off_y):.0%} of the "
        f"height from the middle of a {info.width_px} x {info.height_px} image: the intrinsics look like those of "
        "another resolution or crop. Take the camera_info of this very stream."
    )
    return [Finding("center_off", Level.WARNING, sentence)]


def _check_focal_lengths(info, height_ratio):
    fx, fy = info.K[0], info.K[4]
    findings = []
    for word, pixels, focal in (("wide", info.width_px, fx), ("high", info.height_px, fy)):
        degrees = 2.0 * math.degrees(math.atan(pixels / 2.0 / focal))
        if not FOV_DEG[0] <= degrees <= FOV_DEG[1]:
            sentence = (
                f"With a focal length of {focal:.0f} px the image would be {degrees:.0f} degrees {word}, which is not "
                f"plausible (between {FOV_DEG[0]:.0f} and {FOV_DEG[1]:.0f}). Check that K is in pixels of this "
                "resolution."
            )
            findings.append(Finding("fov", Level.WARNING, sentence))
    ratio = fx / fy
    if not findings and abs(ratio - 1.0) > FOCAL_RATIO_TOLERANCE:
        is_possible = 1.0 / LARGEST_FOCAL_RATIO <= ratio <= LARGEST_FOCAL_RATIO
        is_borne_out = is_possible and height_ratio is not None and _is_far_smaller(height_ratio, ratio)
        advice = (
            "The floor lies where tf says, which bears fy out; check fx if regions are too wide or too narrow."
            if is_borne_out
            else "Was the image stretched, or a number mistyped? Take the camera_info of this very stream."
        )
        sentence = f"fx is {fx:.1f} and fy {fy:.1f} px, ratio {ratio:.2f}: the pixels would not be square. {advice}"
        findings.append(Finding("focal_ratio", Level.NOTE if is_borne_out else Level.WARNING, sentence))
    return findings


def _is_far_smaller(ratio, other_ratio) -> bool:
    return abs(math.log(ratio)) < FAR_SMALLER * abs(math.log(other_ratio))


def _check_distortion(info):
    if not any(info.D):
        return []
    words = f"camera_info tells of {info.distortion_model or 'unnamed'} distortion"
    if info.distortion_model in SQUARE_DISTORTION_MODELS:
        words += f" that moves the corners of the image by up to {compute_distortion_px(info):.0f} px"
    else:
        words += f" (coefficients {', '.join(f'{d:.3g}' for d in info.D)})"
    sentence = (
        f"{words}, and semantic_map refuses such images unless it is told what they are: set its parameter rectify if "
        "they are raw, or ignore_distortion if they are rectified already; otherwise rectify them (image_proc)."
    )
    return [Finding("distortion", Level.WARNING, sentence)]


def compute_distortion_px(info: CameraInfo) -> float:
    """How far distortion moves the corners of the image, at most [px].

        x_d = x (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6) + tangential part

    Source: sensor_msgs/CameraInfo (OpenCV's model); D = k1 k2 p1 p2 k3 k4 k5 k6.
    """
    k1, k2, p1, p2, k3, k4, k5, k6 = (tuple(info.D) + (0.0,) * 8)[:8]
    farthest_px = 0.0
    for u in (0.0, info.width_px - 1.0):
        for v in (0.0, info.height_px - 1.0):
            x, y = (u - info.K[2]) / info.K[0], (v - info.K[5]) / info.K[4]
            r2 = x * x + y * y
            radial = (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)))
            dx = x * (radial - 1.0) + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
            dy = y * (radial - 1.0) + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
            farthest_px = max(farthest_px, float(np.hypot(dx * info.K[0], dy * info.K[4])))
    return farthest_px

# SPDX-License-Identifier: BSD-3-Clause
"""Does the floor that the depth images show lie where tf says that the ground is?"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import List, Optional, Sequence, Union

import numpy as np

from core_perception.checks.base import CameraInfo, CheckFrame, Finding, Level, Outcome

CHECK = "floor"
MAX_FRAMES = 10
RANGE_M = (0.3, 6.0)
LOWER_PART = 0.6  # of the image, in which the floor is looked for
POINTS, TRIES = 3000, 300
NOISE_M, NOISE_PER_M = 0.015, 0.01  # distance of an inlier from the plane: NOISE_M + NOISE_PER_M z
UPRIGHT_DEG = 30.0  # a plane tilted more against tf's up is no floor
LEAST_SUPPORT = 0.15  # share of the points of the lower part
LEAST_POINTS = 300
DOMINANT_SUPPORT = 0.3
STEP_M = 0.15  # a plane this much lower may be the floor under a table
SCALE_HINT = 1.25


@dataclass(frozen=True)
class Plane:
    """up . p = -height_m in the optical frame.

    Attributes:
        up: (3,) unit normal towards the camera.
        height_m: distance of the camera from it [m].
        support: share of the points that lie on it.
    """

    up: np.ndarray
    height_m: float
    support: float


@dataclass(frozen=True)
class FloorLimits:
    """How far floor and tf may differ.

    Attributes:
        height_m: of the floor [m].
        tilt_deg: of its normal.
        floor_z_m: height of the floor in the fixed frame [m].
    """

    height_m: float = 0.05
    tilt_deg: float = 2.0
    floor_z_m: float = 0.0


def check_floor(
    frames: Sequence[CheckFrame], info: Optional[CameraInfo], limits: Optional[FloorLimits] = None, seed: int = 0
) -> Outcome:
    """Fit the floor in frames with a pose and compare it with tf; medians over the frames decide.

    Args:
        frames: those without a pose are left out.
        info: intrinsics, any size of the same shape as the depth images.
        limits: how far floor and tf may differ.
        seed: of the random tries.
    """
    limits = limits or FloorLimits()
    posed = [frame for frame in frames if frame.T_map_camera is not None]
    if not posed or info is None or not info.is_usable:
        missing = "no camera pose from tf" if not posed else "no intrinsics"
        return Outcome(CHECK, unchecked=missing)
    posed = posed[:: max(1, len(posed) // MAX_FRAMES)][:MAX_FRAMES]
    random = np.random.RandomState(seed)
    seen = [look_for_floor(frame, info, random) for frame in posed]
    planes = [(plane, frame) for plane, frame in zip(seen, posed) if isinstance(plane, Plane)]
    askew = [angle for angle in seen if isinstance(angle, float)]
    if 2 * len(askew) >= len(posed) and len(askew) > len(planes):
        return _report_axes(float(np.median(askew)))
    if 2 * len(planes) <= len(posed):
        return Outcome(
            CHECK, unchecked=f"no floor in the lower part of {len(posed) - len(planes)} of {len(posed)} images"
        )
    return _compare(planes, limits)


def look_for_floor(frame: CheckFrame, info: CameraInfo, random) -> Union[Plane, float, None]:
    """Return the floor; or the angle [degrees] by which a floor-like plane is off tf's up; or None.

    A plane that fills the lower part of the image and rises towards its top is floor-like whatever tf says.
    """
    points = select_points(frame.depth_m, info, random)
    if len(points) < LEAST_POINTS:
        return None
    up = frame.T_map_camera[:3, :3].T @ np.array([0.0, 0.0, 1.0])
    floor = find_plane(points, random, up)
    if floor is not None:
        return floor
    dominant = find_plane(points, random, np.array([0.0, -1.0, 0.0]))
    if dominant is None or dominant.support < DOMINANT_SUPPORT:
        return None
    return math.degrees(math.acos(np.clip(dominant.up @ up, -1.0, 1.0)))


def select_points(depth_m: np.ndarray, info: CameraInfo, random) -> np.ndarray:
    """Return (n, 3) points of the lower part of the image in the optical frame [m], at most POINTS."""
    height_px, width_px = depth_m.shape
    first_row = round((1.0 - LOWER_PART) * height_px)
    lower_m = depth_m[first_row:]
    known_m = lower_m[np.isfinite(lower_m)]
    if known_m.size == 0:
        return np.zeros((0, 3))
    # Wider where all distances are too large or too small, so that the floor tells by how much.
    middle_m = float(np.median(known_m))
    nearest_m, farthest_m = min(RANGE_M[0], 0.5 * middle_m), max(RANGE_M[1], 1.5 * middle_m)
    with np.errstate(invalid="ignore"):
        v, u = np.nonzero((lower_m >= nearest_m) & (lower_m <= farthest_m))
    if v.size > POINTS:
        chosen = random.choice(v.size, POINTS, replace=False)
        v, u = v[chosen], u[chosen]
    K = info.matrix_at(width_px, height_px)
    z = lower_m[v, u].astype(np.float64)
    return np.stack([z * (u - K[0, 2]) / K[0, 0], z * (v + first_row - K[1, 2]) / K[1, 1], z], axis=1)


def find_plane(points: np.ndarray, random, up: np.ndarray) -> Optional[Plane]:
    """Return the lowest well supported plane within UPRIGHT_DEG of up, by RANSAC and least squares; or None.

    A plane under the one with most points (the floor under a table) is looked for among the points below it alone.

    Args:
        points: (n, 3) in the optical frame [m], n >= 3.
        random: RandomState.
        up: (3,) unit vector in the optical frame.
    """
    found, below = None, points
    while len(below) >= max(LEAST_SUPPORT * len(points), 3):
        plane = _find_largest(below, random, up)
        if plane is None:
            break
        support = plane.support * len(below) / len(points)
        if support < LEAST_SUPPORT:
            break
        found = Plane(plane.up, plane.height_m, support)
        below = below[below @ plane.up + plane.height_m < -STEP_M]
    return found


def _find_largest(points, random, up) -> Optional[Plane]:
    corners = points[random.randint(0, len(points), (TRIES, 3))]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    normals = normals[lengths > 1e-9] / lengths[lengths > 1e-9, None]
    normals *= np.sign(normals @ up + 1e-12)[:, None]
    heights = -np.einsum("ij,ij->i", normals, corners[lengths > 1e-9, 0])
    upright = (normals @ up > math.cos(math.radians(UPRIGHT_DEG))) & (heights > 0.0)
    normals, heights = normals[upright], heights[upright]
    if len(normals) == 0:
        return None
    tolerance_m = NOISE_M + NOISE_PER_M * points[:, 2]
    best = int(np.argmax((np.abs(normals @ points.T + heights[:, None]) < tolerance_m).sum(axis=1)))
    plane = _refine(points, tolerance_m, normals[best], heights[best])
    # Least squares turns a strip of a wall back into the wall.
    return plane if plane is not None and plane.up @ up > math.cos(math.radians(UPRIGHT_DEG)) else None


def _refine(points, tolerance_m, normal, height_m) -> Optional[Plane]:
    for _ in range(3):
        near = np.abs(points @ normal + height_m) < tolerance_m
        if near.sum() < 10:
            return None
        # Far points are noisier; the weight is that of their tolerance.
        weights = 1.0 / tolerance_m[near] ** 2
        middle = np.average(points[near], axis=0, weights=weights)
        centred = points[near] - middle
        _, vectors = np.linalg.eigh((centred * weights[:, None]).T @ centred)
        normal = vectors[:, 0] * np.sign(vectors[:, 0] @ normal)
        height_m = -float(middle @ normal)
    support = float((np.abs(points @ normal + height_m) < tolerance_m).mean())
    return Plane(normal, height_m, support)


def _compare(planes, limits: FloorLimits) -> Outcome:
    rises_m, tilts, pitches, rolls, ratios = [], [], [], [], []
    for plane, frame in planes:
        up = frame.T_map_camera[:3, :3].T @ np.array([0.0, 0.0, 1.0])
        expected_m = frame.T_map_camera[2, 3] - limits.floor_z_m
        rises_m.append(expected_m - plane.height_m)
        ratios.append(plane.height_m / expected_m if expected_m > 0.05 else 1.0)
        tilts.append(math.degrees(math.acos(np.clip(plane.up @ up, -1.0, 1.0))))
        turn = np.degrees(np.cross(up, plane.up))  # small angles: turns tf's up into the floor's
        pitches.append(turn[0])
        rolls.append(-turn[2])
    rise_m, tilt = float(np.median(rises_m)), float(np.median(tilts))
    pitch, roll, ratio = float(np.median(pitches)), float(np.median(rolls)), float(np.median(ratios))
    findings: List[Finding] = []
    if abs(rise_m) > limits.height_m:
        findings.append(Finding("floor_height", Level.WARNING, _say_height(rise_m, ratio)))
    if tilt > limits.tilt_deg:
        findings.append(Finding("floor_tilt", Level.WARNING, _say_tilt(tilt, pitch, roll)))
    measured = f"the floor lies {rise_m:+.3f} m from where tf says and is tilted {tilt:.1f} degrees against it"
    is_level = tilt <= limits.tilt_deg
    return Outcome(CHECK, tuple(findings), measured, height_ratio=ratio if is_level else None)


def _say_height(rise_m, ratio) -> str:
    where = "above" if rise_m > 0 else "below"
    advice = (
        "Correct the height of the camera in the robot's description, or floor_z_m where the floor is not at z = 0."
    )
    if not 1.0 / SCALE_HINT < ratio < SCALE_HINT:
        advice = (
            f"The camera looks {ratio:.2f} times as high as tf has it: if distances are wrong by that factor too, it "
            "is the depth unit or fy; otherwise correct the height of the camera in the robot's description."
        )
    return f"The floor lies {abs(rise_m):.2f} m {where} where tf says. {advice}"


def _say_tilt(tilt, pitch, roll) -> str:
    parts = []
    if abs(pitch) >= abs(roll) / 3.0:
        parts.append(f"looks {abs(pitch):.1f} degrees further {'down' if pitch > 0 else 'up'}")
    if abs(roll) > abs(pitch) / 3.0:
        parts.append(f"is rolled {abs(roll):.1f} degrees further to the {'right' if roll > 0 else 'left'}")
    return (
        f"The floor is tilted {tilt:.1f} degrees against tf: the camera {' and '.join(parts)} than tf says. "
        "Correct its mounting angles in the robot's description, unless the robot stands before a ramp."
    )


def _report_axes(angle) -> Outcome:
    sentence = (
        f"The plane in the lower part of the images, which looks like the floor, stands {angle:.0f} degrees away from "
        "tf's up. Check that the frame_id of the images is the optical frame (z forward, x right, y down) and not "
        "the body frame of the camera, and that the camera is not mounted upside down."
    )
    return Outcome(CHECK, (Finding("floor_axes", Level.ERROR, sentence),), f"tilted {angle:.0f} degrees against tf")

# SPDX-License-Identifier: BSD-3-Clause
"""Grounding as printed in [CORE], written the short way with numpy and OpenCV: what bench grounding compares with."""

from __future__ import annotations

from typing import Any, Mapping, Sequence

import cv2
import numpy as np

from core_bringup.evaluation.frame_recording import RecordingHeader
from core_perception.predicates import Operator, Predicate, Verdict

SITE_M = 200.0  # edge of the square of counts, the origin in its middle


class PlainGrounding:
    """Masks, projection of all points at once, counts of a 2-D grid, two distance transforms of the window.

    Args:
        header: camera, classes and predicates of the recording.
        params: section semantic_map of a profile.
    """

    def __init__(self, header: RecordingHeader, params: Mapping[str, Any]):
        self._header, self._params = header, params
        cells = round(SITE_M / params["resolution_m"])
        self._n_safe = np.zeros((cells, cells), np.int64)
        self._n_unsafe = np.zeros((cells, cells), np.int64)
        camera = header.camera
        v, u = np.mgrid[0 : camera.height_px, 0 : camera.width_px]
        self._ray_x, self._ray_y = (u - camera.cx_px) / camera.fx_px, (v - camera.cy_px) / camera.fy_px
        side_px = int(params["kernel_px"])
        self._kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side_px, side_px))

    def update(self, frame: np.void) -> np.ndarray:
        """Add a frame of the recording; signed distance (n, n) [m] of the window around the robot."""
        safe = draw_safe_mask(frame["labels"], self._header.classes, self._header.predicates, self._kernel)
        z_m = frame["depth_mm"] / 1000.0
        used = (z_m >= self._params["range_min_m"]) & (z_m <= self._params["range_max_m"])
        points = np.stack([self._ray_x * z_m, self._ray_y * z_m, z_m], axis=-1)[used]
        T = frame["T_map_camera"]
        points = points @ T[:3, :3].T + T[:3, 3]
        half = self._n_safe.shape[0] // 2
        cells = np.floor(points[:, :2] / self._params["resolution_m"]).astype(int) + half
        is_safe = safe[used] > 0
        np.add.at(self._n_safe, (cells[is_safe, 1], cells[is_safe, 0]), 1)
        np.add.at(self._n_unsafe, (cells[~is_safe, 1], cells[~is_safe, 0]), 1)
        return self._measure(frame["p_map_base"])

    def _measure(self, p_map_base: np.ndarray) -> np.ndarray:
        cell_m, half = self._params["resolution_m"], self._n_safe.shape[0] // 2
        n = round(self._params["window_m"] / cell_m)
        x0, y0 = np.floor(p_map_base / cell_m).astype(int) - n // 2 + half
        n_safe, n_unsafe = (counts[y0 : y0 + n, x0 : x0 + n] for counts in (self._n_safe, self._n_unsafe))
        total = n_safe + n_unsafe
        share = n_safe / np.maximum(total, 1)
        safe = np.where(total > 0, share >= self._params["tau"], not self._params["unknown_is_unsafe"]).astype(np.uint8)
        to_unsafe, to_safe = (cv2.distanceTransform(m, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) for m in (safe, 1 - safe))
        return (to_unsafe - to_safe) * cell_m


def draw_safe_mask(
    labels: np.ndarray, classes: Mapping[int, str], predicates: Sequence[Predicate], kernel: np.ndarray
) -> np.ndarray:
    """I_safe = (union of safe sets) minus (union of unsafe sets), (h, w) uint8 of 0 or 255.

    Source: [CORE] semantic grounding and appendix, spatial operators.
    """
    sets = {verdict: np.zeros(labels.shape, np.uint8) for verdict in Verdict}
    for predicate in predicates:
        ids = [label for label, name in classes.items() if name == predicate.class_name]
        mask = np.isin(labels, ids).astype(np.uint8) * 255
        if predicate.operator == Operator.AROUND:
            mask = cv2.dilate(mask, kernel)
        elif predicate.operator == Operator.BETWEEN and mask.any():
            hull = cv2.convexHull(cv2.findNonZero(mask))
            cv2.fillConvexPoly(mask, hull, 255)
        sets[predicate.verdict] |= mask
    return np.where(sets[Verdict.UNSAFE] > 0, 0, sets[Verdict.SAFE]).astype(np.uint8)

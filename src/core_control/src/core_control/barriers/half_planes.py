# SPDX-License-Identifier: BSD-3-Clause
"""Barrier of profile `core`: the footprint's discs against unsafe cells, one half-plane per cell that matters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import List, Tuple, Union

import numpy as np

from core_control.dynamics import compute_rotation, place_discs
from core_control.safety_field import Boxes, SafetyField
from core_control.types import NO_CELL, BarrierRows, Clearance

# Below this distance [m] the direction to a point is not trusted.
TINY_M = 1e-9


@dataclass(frozen=True)
class Plane:
    """Half-plane {x : normal . (x - point_m) >= 0} that leaves a whole box outside."""

    normal: np.ndarray
    point_m: np.ndarray
    distance_m: float
    cell: int


def select_planes(centre: np.ndarray, boxes: Boxes, count: int) -> List[Plane]:
    """Half-planes that separate a point from convex boxes, nearest box first.

        y = nearest point of the box,  n = (c - y) / |c - y|,  dist(x, box) - growth >= n . (x - y) - growth for every x

    A box that lies wholly behind a plane already taken is dropped, so that the smallest distance stays guarded.

    Args:
        centre: (2,) c [m], outside every box.
        boxes: boxes to keep away from.
        count: largest number of planes; farther boxes are left out beyond it.

    Source: greedy decomposition of Liu et al., RA-L 2017 (safe flight corridors), seeded with the robot's position.
    """
    nearest = boxes.compute_nearest(centre[None])[0]
    gap = centre - nearest
    distance = np.sqrt(np.einsum("nd,nd->n", gap, gap))
    clearance = distance - boxes.growth_m
    left = np.ones(len(boxes), dtype=bool)
    planes: List[Plane] = []
    for j in np.argsort(clearance, kind="stable"):
        if not left[j] or distance[j] < TINY_M:
            continue
        normal = gap[j] / distance[j]
        planes.append(Plane(normal, nearest[j], float(clearance[j]), int(boxes.cell[j])))
        if len(planes) == count:
            break
        left &= ~_is_behind(boxes, normal, float(normal @ nearest[j] + boxes.growth_m[j]))
    return planes


def _is_behind(boxes: Boxes, normal: np.ndarray, offset_m: float) -> np.ndarray:
    """Whether boxes, grown, lie wholly in normal . x <= offset."""
    corner = np.where(normal > 0.0, boxes.hi, boxes.lo)
    reach = np.where(normal == 0.0, 0.0, corner) @ normal
    return reach + boxes.growth_m <= offset_m + TINY_M


class HalfPlaneBarrier:
    """Rows and clearance of a footprint made of discs.

    Args:
        discs: (k, 3) x [m], y [m] in base_link, radius [m].
        alpha_per_s: class-K gain; gamma = alpha dt must be <= 1.
        margin_m: clearance below which no row lets the clearance shrink; one for all discs, or one for each.
        limits: (3,) largest magnitudes of the command; rows that no command within them can break are left out.
        rows_per_disc: largest number of rows for one disc.
    """

    def __init__(
        self,
        discs: np.ndarray,
        alpha_per_s: float,
        margin_m: Union[float, np.ndarray],
        limits: np.ndarray,
        rows_per_disc: int,
    ):
        """Keep the figures and find how far away a cell can matter."""
        self._discs, self._alpha_per_s = discs, alpha_per_s
        self._margin_m = np.broadcast_to(margin_m, len(discs))
        self._rows_per_disc = rows_per_disc
        lever_m = np.hypot(discs[:, 0], discs[:, 1])
        disc_speed_mps = np.hypot(limits[0], limits[1]) + limits[2] * lever_m
        self._reach_m = discs[:, 2] + self._margin_m + disc_speed_mps / alpha_per_s

    @property
    def rows_per_disc(self) -> int:
        """Largest number of rows compute_rows can return for one disc."""
        # A disc that knows no way out has four, whatever the parameter says.
        return max(self._rows_per_disc, 4)

    def compute_clearance(self, field: SafetyField, pose: np.ndarray) -> Clearance:
        """Smallest clearance of the footprint, its gradient and the point that decides.

            h(x) = min_i d(c_i) - r_i,   grad h = (c - y) / |c - y| outside the unsafe set, (y - c) / |y - c| inside

        Args:
            field: safety field.
            pose: (3,) x [m], y [m], yaw [rad] of base_link in the field's frame.
        """
        centres = place_discs(pose[None], self._discs)[0]
        clearances = field.compute_signed_distance(centres) - self._discs[:, 2]
        i = int(np.argmin(clearances))
        normal, point, cell = _look_at(field, centres[i])
        return Clearance(float(clearances[i]), normal, cell, point)

    def compute_rows(self, field: SafetyField, pose: np.ndarray) -> BarrierRows:
        """Conditions that keep every disc off every unsafe square.

            n . R (v + w S o_i) >= -alpha max(d_ij - r_i - margin, 0)
            a = [R'n ; n . R S o_i],  b = -alpha max(d_ij - r_i - margin, 0),  S = [0 -1; 1 0]

        b is never positive: u = 0 is always allowed, and with less clearance than the margin only commands pass that do
        not come closer. A disc whose centre lies inside the unsafe set gets one row, away from it.

        Args:
            field: safety field.
            pose: (3,) pose the command acts from: where the robot would come to rest if it stopped now.

        Returns:
            At most rows_per_disc rows for each disc.

        Source: [CORE] control synthesis QP; research note A2.2. Differs: convex cells instead of one sampled gradient,
        the footprint instead of a point, b clamped for h < margin.
        """
        R = compute_rotation(pose[2])
        centres = place_discs(pose[None], self._discs)[0]
        inside = field.is_inside(centres)
        near = field.unsafe_boxes.compute_distance(centres) <= self._reach_m[:, None]
        parts = []
        for i, centre in enumerate(centres):
            if inside[i]:
                planes = self._make_exit_planes(field, centre)
            else:
                planes = select_planes(centre, field.unsafe_boxes.take(near[i]), self._rows_per_disc)
            parts.append(self._make_rows(planes, i, R))
        return BarrierRows.concatenate(parts)

    @staticmethod
    def _make_exit_planes(field: SafetyField, centre: np.ndarray) -> List[Plane]:
        exit_point = field.find_exit(centre)
        gap = None if exit_point is None else exit_point - centre
        if gap is not None and np.linalg.norm(gap) >= TINY_M:
            return [Plane(gap / np.linalg.norm(gap), exit_point, 0.0, NO_CELL)]
        # No way out is known: four planes through the centre let it move nowhere.
        return [Plane(n, centre, 0.0, NO_CELL) for n in np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])]

    def _make_rows(self, planes: List[Plane], i: int, R: np.ndarray) -> BarrierRows:
        if not planes:
            return BarrierRows.empty()
        x, y, radius_m = self._discs[i]
        normals = np.array([plane.normal for plane in planes])
        slack_m = np.array([plane.distance_m for plane in planes]) - radius_m - self._margin_m[i]
        lever = R @ np.array([-y, x])
        return BarrierRows(
            np.column_stack([normals @ R, normals @ lever]),
            -self._alpha_per_s * np.maximum(slack_m, 0.0),
            np.array([plane.cell for plane in planes]),
            np.array([plane.point_m for plane in planes]),
        )


def _look_at(field: SafetyField, centre: np.ndarray) -> Tuple[np.ndarray, np.ndarray, int]:
    """Gradient of the signed distance, nearest border point and its cell, seen from one point."""
    if field.is_inside(centre[None])[0]:
        point = field.find_exit(centre)
        cell = field.find_cell(centre)
        index = NO_CELL if cell is None else cell[0] * field.unsafe.shape[1] + cell[1]
        if point is None:
            return np.zeros(2), np.full(2, np.nan), index
        return _normalise(point - centre), point, index
    boxes = field.unsafe_boxes
    j = int(np.argmin(boxes.compute_distance(centre[None])[0]))
    point = boxes.compute_nearest(centre[None])[0, j]
    return _normalise(centre - point), point, int(boxes.cell[j])


def _normalise(vector: np.ndarray) -> np.ndarray:
    length = float(np.linalg.norm(vector))
    return vector / length if length >= TINY_M else np.zeros(2)

# SPDX-License-Identifier: BSD-3-Clause
"""Do objects of one class, as they stand on the ground, close the way between them?

Positions are (n, 2) on the ground plane [m]; pixels would distort the spacing. A cluster (single link) is classified as

    LINE    on one straight line, evenly spaced; of six, one may be off it blocks
    ARC     four on a chain that turns to one side only, evenly spaced     blocks
    RING    on a closed outline, evenly spaced                             blocks
    CORNER  on two straight rows that share an end                         blocks
    LANE    two parallel rows wide enough to pass between, nothing between
            their ends: a portal, also where a gap in a row is as wide     does not
    SCATTER anything else                                                  does not
    FEW     fewer than three objects                                       does not

Evenly spaced means a coefficient of variation of the gaps below a limit. Source: [CORE] prompt, grouped-barrier rule
("a line, curve, or perimeter" blocks; scattered objects or an intended portal do not). The geometry is ours; its rates:
``test/arrangement_test.py``.
"""

from __future__ import annotations

import enum
from typing import List, Optional, Tuple

import numpy as np


class Arrangement(enum.Enum):
    """Shape in which the objects of one cluster stand."""

    FEW = "few"
    LINE = "line"
    ARC = "arc"
    RING = "ring"
    CORNER = "corner"
    LANE = "lane"
    SCATTER = "scatter"

    @property
    def blocks(self) -> bool:
        """Whether the shape closes the way between its members."""
        return self in (Arrangement.LINE, Arrangement.ARC, Arrangement.RING, Arrangement.CORNER)


LINK_M = 2.5
DUPLICATE_M = 0.30  # nearer than this, two held instances are one object seen twice (a cone's base is 0.36 m wide)
# Few points stand in a shape by chance far more often than many. Number of points (the last for more) -> limits; those
# in metres are two to three times the position error of a map (0.06 m).
# For a line -> largest distance from it [m], the same as a share of its length, variation of the gaps.
LINE_LIMITS = {3: (0.085, 0.042, 0.17), 4: (0.145, 0.06, 0.36), 5: (0.18, 0.06, 0.40), 6: (0.22, 0.06, 0.45)}
ROW_LIMITS = (0.25, 0.08, 0.45)  # the same for a row of a lane, whose other row speaks for it
# For an arc -> largest variation of the gaps, their deviation [m], backward turn [deg], distance from the circle over
# the gap, the same [m].
ARC_LIMITS = {4: (0.20, 0.14, 5.0, 0.12, 0.09), 5: (0.25, 0.25, 12.0, 0.12, 0.12), 6: (0.35, 0.35, 22.0, 0.15, 0.20)}
# For a ring -> largest variation of the gaps, their deviation [m], backward turn [deg], forward turn [deg].
RING_LIMITS = {
    4: (0.12, 0.15, 8.0, 105.0),
    5: (0.17, 0.20, 8.0, 105.0),
    6: (0.20, 0.20, 15.0, 115.0),
    7: (0.25, 0.20, 22.0, 120.0),
    8: (0.30, 0.20, 32.0, 130.0),
}
# For a corner -> largest distance from the fitted line of a row [m], variation of the gaps of both rows.
CORNER_LIMITS = {5: (0.12, 0.20), 6: (0.15, 0.25), 7: (0.20, 0.35)}
MIN_LANE_WIDTH_M = 0.9
MIN_LANE_ASPECT = 0.5  # row distance over the gap in a row


def cluster(positions_m: np.ndarray, link_m: float = LINK_M) -> List[np.ndarray]:
    """Group points by single link: two points nearer than link_m share a group.

    Args:
        positions_m: (n, 2) points on the ground [m]; n may be 0.
        link_m: largest distance of neighbours [m], > 0.

    Returns:
        Sorted index arrays, ordered by their first index.

    Raises:
        ValueError: wrong shape or a non-finite coordinate.
    """
    points = _checked(positions_m)
    near = _distances(points) <= link_m
    group = np.arange(len(points))
    for i, j in np.argwhere(near):
        if group[i] != group[j]:
            group[group == max(group[i], group[j])] = min(group[i], group[j])
    return [np.flatnonzero(group == g) for g in np.unique(group)]


def classify(positions_m: np.ndarray) -> Arrangement:
    """Classify one cluster; the answer depends neither on the order of the points nor on where they are.

    Args:
        positions_m: (n, 2) points of one cluster on the ground [m].

    Raises:
        ValueError: wrong shape or a non-finite coordinate.
    """
    points = _without_duplicates(_checked(positions_m))
    if len(points) < 3:
        return Arrangement.FEW
    if is_line(points):
        return Arrangement.LINE
    if len(points) == 3:
        return Arrangement.SCATTER
    if _is_lane(points):
        return Arrangement.LANE
    for shape, test in ((Arrangement.CORNER, _is_corner), (Arrangement.RING, _is_ring), (Arrangement.ARC, _is_arc)):
        if test(points):
            return shape
    return Arrangement.LINE if _is_line_but_one(points) else Arrangement.SCATTER


def is_line(points: np.ndarray) -> bool:
    """Whether points (n >= 3, 2) [m] stand on a straight line with even gaps; three must do so more exactly."""
    return _is_straight(points, *_limits(LINE_LIMITS, len(points)))


def _limits(limits, count):
    return limits[min(count, max(limits))]


def _is_straight(points, residual_m, residual_share, max_cv):
    """PCA: largest distance from the axis, the same against the length, variation of the gaps along it."""
    along, across = _principal_coordinates(points)
    length_m = along.max() - along.min()
    return bool(
        np.abs(across).max() <= min(residual_m, residual_share * length_m) and _cv(np.diff(np.sort(along))) <= max_cv
    )


def _is_line_but_one(points):
    """Five or more on a line and one beside it: another object, or one that the map holds twice."""
    return len(points) >= 6 and any(is_line(np.delete(points, k, axis=0)) for k in range(len(points)))


def _is_row(points):
    return len(points) == 2 or _is_straight(points, *ROW_LIMITS)


def _checked(positions_m):
    points = np.asarray(positions_m, dtype=float)
    if points.ndim != 2 or points.shape[1] != 2:
        raise ValueError(f"positions: got shape {points.shape}, allowed (n, 2)")
    if not np.isfinite(points).all():
        raise ValueError("positions: got a non-finite coordinate, allowed finite metres")
    return points


def _without_duplicates(points):
    return np.array([points[group].mean(axis=0) for group in cluster(points, DUPLICATE_M)]).reshape(-1, 2)


def _distances(points):
    return np.linalg.norm(points[:, None, :] - points[None, :, :], axis=2)


def _cv(gaps):
    return float(np.std(gaps) / max(np.mean(gaps), 1e-9))


def _principal_coordinates(points):
    centred = points - points.mean(axis=0)
    _, _, axes = np.linalg.svd(centred, full_matrices=False)
    return centred @ axes[0], (centred @ axes[1] if len(axes) > 1 else np.zeros(len(points)))


def _turns_rad(path, closed):
    """Signed turning angle at the corners of an ordered path (n, 2): n of a closed path, n - 2 of an open one."""
    steps = np.diff(np.vstack([path, path[:2]]) if closed else path, axis=0)
    cross = steps[:-1, 0] * steps[1:, 1] - steps[:-1, 1] * steps[1:, 0]
    return np.arctan2(cross, np.sum(steps[:-1] * steps[1:], axis=1))


def _chain(points) -> Optional[np.ndarray]:
    """Points in the order of their minimum spanning tree (Prim) if that is one path, otherwise None."""
    distances, count = _distances(points), len(points)
    neighbours = {i: [] for i in range(count)}
    parent, to_tree = np.zeros(count, int), distances[0].copy()
    to_tree[0] = np.inf
    for _ in range(count - 1):
        new = int(np.argmin(to_tree))
        neighbours[new].append(int(parent[new]))
        neighbours[int(parent[new])].append(new)
        nearer = (distances[new] < to_tree) & np.isfinite(to_tree)
        parent[nearer], to_tree[nearer] = new, distances[new][nearer]
        to_tree[new] = np.inf
    if max(len(n) for n in neighbours.values()) > 2:
        return None
    order = [next(i for i in range(count) if len(neighbours[i]) == 1)]
    while len(order) < count:
        order.append(next(j for j in neighbours[order[-1]] if j not in order[-2:]))
    return points[order]


def _gaps(path):
    return np.linalg.norm(np.diff(path, axis=0), axis=1)


def _is_arc(points):
    """A chain near a circle that turns to one side, less than 75 degrees a step, evenly spaced; see ARC_LIMITS."""
    path = _chain(points)
    if path is None:
        return False
    max_cv, max_std_m, slack_deg, max_residual, max_residual_m = _limits(ARC_LIMITS, len(path))
    gaps = _gaps(path)
    even = _cv(gaps) <= max_cv and np.std(gaps) <= max_std_m
    turns = _turns_rad(path, closed=False)
    turns = turns * np.sign(turns.sum())
    one_sided = (
        turns.min() > -np.deg2rad(slack_deg) and turns.max() < np.deg2rad(75.0) and turns.sum() > np.deg2rad(15.0)
    )
    return bool(even and one_sided and _circle_residual_m(path) < min(max_residual_m, max_residual * gaps.mean()))


def _circle_residual_m(points):
    """Largest distance from the circle x^2 + y^2 = a x + b y + c, fitted by linear least squares [m]."""
    centred = points - points.mean(axis=0)
    rows = np.column_stack([centred, np.ones(len(points))])
    a, b, c = np.linalg.lstsq(rows, (centred**2).sum(axis=1), rcond=None)[0]
    radius = np.sqrt(max(c + (a * a + b * b) / 4.0, 0.0))
    return float(np.abs(np.linalg.norm(centred - [a / 2.0, b / 2.0], axis=1) - radius).max())


def _is_ring(points):
    """A closed convex outline with even gaps; RING_LIMITS by number, as any four points are nearly an outline."""
    centred = points - points.mean(axis=0)
    path = points[np.argsort(np.arctan2(centred[:, 1], centred[:, 0]))]
    gaps = _gaps(np.vstack([path, path[:1]]))
    turns = _turns_rad(path, closed=True)
    max_cv, max_std_m, slack_deg, max_turn_deg = _limits(RING_LIMITS, len(points))
    around = abs(turns.sum() - 2.0 * np.pi) < 1e-6
    in_range = turns.min() > -np.deg2rad(slack_deg) and turns.max() < np.deg2rad(max_turn_deg)
    return bool(around and in_range and _cv(gaps) <= max_cv and np.std(gaps) <= max_std_m)


def _is_corner(points):
    """Two straight, evenly spaced rows of three or more that share an end and meet at 50 to 130 degrees."""
    path = _chain(points)
    if path is None or len(path) < 5:
        return False
    residual_m, max_cv = _limits(CORNER_LIMITS, len(path))
    if _cv(_gaps(path)) > max_cv:
        return False
    for k in range(2, len(path) - 2):
        first, second = path[0] - path[k], path[-1] - path[k]
        cosine = float(first @ second / max(np.linalg.norm(first) * np.linalg.norm(second), 1e-9))
        rows = (path[: k + 1], path[k:])
        if abs(cosine) < np.cos(np.deg2rad(50.0)) and all(
            _is_straight(row, residual_m, ROW_LIMITS[1], max_cv) for row in rows
        ):
            return True
    return False


def _is_lane(points):
    """Two parallel rows, wide enough apart and beside each other for most of their length; at least five objects."""
    return any(_rows_are_lane(*rows) for rows in _row_splits(points))


def _row_splits(points):
    """Split in two rows at the largest step across a direction: those from each point to its two nearest neighbours."""
    for i, j in {
        (min(i, j), max(i, j)) for i, nearest in enumerate(np.argsort(_distances(points), axis=1)) for j in nearest[1:3]
    }:
        direction = (points[j] - points[i]) / np.linalg.norm(points[j] - points[i])
        across = points @ np.array([-direction[1], direction[0]])
        order = np.argsort(across)
        cut = int(np.argmax(np.diff(across[order]))) + 1
        yield points[order[:cut]], points[order[cut:]]


def _rows_are_lane(first, second):
    if min(len(first), len(second)) < 2 or len(first) + len(second) < 5:
        return False
    if not (_is_row(first) and _is_row(second)):
        return False
    directions = [_row_direction(row) for row in (first, second)]
    if abs(directions[0] @ directions[1]) < np.cos(np.deg2rad(15.0)):
        return False
    axis = _row_direction(max((first, second), key=len))
    width_m = abs(np.array([-axis[1], axis[0]]) @ (second.mean(axis=0) - first.mean(axis=0)))
    spans = [np.sort(row @ axis) for row in (first, second)]
    gap_m = max(float(np.median(np.diff(span))) for span in spans)
    length_m = max(span[-1] - span[0] for span in spans)
    overlap_m = min(span[-1] for span in spans) - max(span[0] for span in spans)
    wide = width_m >= max(MIN_LANE_WIDTH_M, MIN_LANE_ASPECT * gap_m)
    return bool(wide and overlap_m >= 0.4 * length_m)


def _row_direction(row) -> Tuple[float, float]:
    _, _, axes = np.linalg.svd(row - row.mean(axis=0), full_matrices=False)
    return axes[0]

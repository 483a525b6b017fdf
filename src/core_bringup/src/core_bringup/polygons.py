# SPDX-License-Identifier: BSD-3-Clause
"""Plane geometry of polygons (n, 2), in metres, corners in order."""

from __future__ import annotations

import numpy as np

_TOUCH_AREA_M2 = 1e-9  # polygons that share less than this only touch


def polygon_area_m2(polygon_m: np.ndarray) -> float:
    """Signed area of a polygon (n, 2), shoelace formula: positive when counter-clockwise."""
    x, y = polygon_m[:, 0], polygon_m[:, 1]
    return 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def rectangle(center_m: np.ndarray, yaw_rad: float, length_m: float, width_m: float) -> np.ndarray:
    """Corners (4, 2), counter-clockwise, of a rectangle whose length lies along the direction yaw_rad."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    half = 0.5 * np.array([[-length_m, -width_m], [length_m, -width_m], [length_m, width_m], [-length_m, width_m]])
    return np.asarray(center_m, dtype=float) + half @ np.array([[c, s], [-s, c]])


def convex_hull(points_m: np.ndarray) -> np.ndarray:
    """Corners (k, 2), counter-clockwise from the leftmost, of the convex hull of points (n, 2) that lie on no line.

    A point within rounding of the line between two corners is no corner.
    Source: Andrew, Another efficient algorithm for convex hulls in two dimensions, IPL 9(5), 1979.
    """
    points = np.unique(np.asarray(points_m, dtype=float), axis=0)
    chains = []
    for ordered in (points, points[::-1]):
        chain: list = []
        for point in ordered:
            while len(chain) > 1 and _cross(chain[-1] - chain[-2], point - chain[-1]) <= _TOUCH_AREA_M2:
                chain.pop()
            chain.append(point)
        chains += chain[:-1]
    return np.array(chains)


def grow_convex(polygon_m: np.ndarray, radius_m: float, steps: int) -> np.ndarray:
    """Outline (k, 2) of the points within a distance of a convex counter-clockwise polygon (n, 2).

    Arcs become inscribed polygons, with that many sides in a full turn.
    """
    edges = np.roll(polygon_m, -1, axis=0) - polygon_m
    after = np.arctan2(-edges[:, 0], edges[:, 1])  # direction of the outward normal of the edge that follows a corner
    turns = np.mod(after - np.roll(after, 1), 2.0 * np.pi)
    grown = []
    for corner, end, turn in zip(polygon_m, after, turns):
        angles = end - turn * np.linspace(1.0, 0.0, int(np.ceil(turn / (2.0 * np.pi) * steps - 1e-9)) + 1)
        grown.append(corner + radius_m * np.column_stack([np.cos(angles), np.sin(angles)]))
    return np.concatenate(grown)


def is_convex_ccw(polygon_m: np.ndarray) -> bool:
    """Whether a polygon (n, 2) turns strictly left at every vertex and goes round once."""
    edges = np.roll(polygon_m, -1, axis=0) - polygon_m
    following = np.roll(edges, -1, axis=0)
    cross = _cross(edges, following)
    if np.any(cross <= 1e-12):
        return False
    turns = np.arctan2(cross, np.sum(edges * following, axis=1))
    return bool(abs(turns.sum() - 2.0 * np.pi) < 1e-6)


def is_simple(polygon_m: np.ndarray) -> bool:
    """Whether no two edges of a polygon (n, 2) that are not neighbours touch."""
    n = len(polygon_m)
    for i in range(n):
        for j in range(i + 1, n):
            neighbours = j == i + 1 or (i == 0 and j == n - 1)
            if not neighbours and _segments_touch(*polygon_m[[i, (i + 1) % n, j, (j + 1) % n]]):
                return False
    return True


def contains_point(polygon_m: np.ndarray, point_m: np.ndarray) -> bool:
    """Whether a point (2,) lies in a simple polygon (n, 2), border included.

    A ray from the point along +x crosses the border an odd number of times from inside.
    """
    if point_distance_m(polygon_m, point_m) == 0.0:
        return True
    a, b = polygon_m, np.roll(polygon_m, -1, axis=0)
    straddles = (a[:, 1] > point_m[1]) != (b[:, 1] > point_m[1])
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing_x = a[:, 0] + (point_m[1] - a[:, 1]) * (b[:, 0] - a[:, 0]) / (b[:, 1] - a[:, 1])
    return bool(np.count_nonzero(straddles & (point_m[0] < crossing_x)) % 2)


def point_distance_m(polygon_m: np.ndarray, point_m: np.ndarray) -> float:
    """Distance from a point (2,) to the border of a polygon (n, 2)."""
    return float(_points_to_border(np.asarray(point_m, dtype=float)[None, :], polygon_m).min())


def signed_clearance_m(convex_m: np.ndarray, polygon_m: np.ndarray) -> float:
    """Distance between two polygons, or minus the depth of penetration where they overlap.

        apart:    min |a - b|,  a in the one, b in the other
        overlap:  - min |t|,  t a translation of the first after which they only touch

    Args:
        convex_m: (n, 2) convex, counter-clockwise.
        polygon_m: (m, 2) simple, counter-clockwise.
    """
    if abs(polygon_area_m2(clip_to_convex(polygon_m, convex_m))) > _TOUCH_AREA_M2:
        depth = _depth_convex_m if is_convex_ccw(polygon_m) else _depth_any_m
        return -depth(convex_m, polygon_m)
    return float(min(_points_to_border(convex_m, polygon_m).min(), _points_to_border(polygon_m, convex_m).min()))


def clip_to_convex(subject_m: np.ndarray, clip_m: np.ndarray) -> np.ndarray:
    """Part of a polygon (n, 2) inside a convex counter-clockwise one (m, 2); (0, 2) when there is none.

    Parts that fall apart stay joined along the border of clip_m, which leaves the area right.
    Source: Sutherland and Hodgman, Reentrant polygon clipping, Communications of the ACM 17(1), 1974.
    """
    result = np.asarray(subject_m, dtype=float)
    for a, b in zip(clip_m, np.roll(clip_m, -1, axis=0)):
        if len(result) == 0:
            break
        side = _cross(b - a, result - a)
        following, side_next = np.roll(result, -1, axis=0), np.roll(side, -1)
        kept = []
        for p, q, s, t in zip(result, following, side, side_next):
            if s >= 0.0:
                kept.append(p)
            if (s > 0.0 > t) or (s < 0.0 < t):
                kept.append(p + (q - p) * (s / (s - t)))
        result = np.array(kept).reshape(-1, 2)
    return result


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _points_to_border(points_m: np.ndarray, polygon_m: np.ndarray) -> np.ndarray:
    """Distance (k, n) of every point (k, 2) to every edge of a polygon (n, 2)."""
    a = polygon_m[None, :, :]
    edge = np.roll(polygon_m, -1, axis=0)[None, :, :] - a
    to_point = points_m[:, None, :] - a
    share = np.clip(np.sum(to_point * edge, axis=2) / np.sum(edge * edge, axis=2), 0.0, 1.0)
    return np.linalg.norm(to_point - share[..., None] * edge, axis=2)


def _depth_convex_m(first_m: np.ndarray, second_m: np.ndarray) -> float:
    """Depth of penetration of two convex polygons: the smallest overlap along any edge normal."""
    edges = np.concatenate([np.roll(p, -1, axis=0) - p for p in (first_m, second_m)])
    normals = np.stack([edges[:, 1], -edges[:, 0]], axis=1) / np.linalg.norm(edges, axis=1)[:, None]
    first, second = normals @ first_m.T, normals @ second_m.T
    overlap = np.minimum(first.max(1) - second.min(1), second.max(1) - first.min(1))
    return float(overlap.min())


def _depth_any_m(convex_m: np.ndarray, polygon_m: np.ndarray) -> float:
    """Depth of penetration of a convex polygon in a simple one.

    The translations that leave them just touching are the border of the Minkowski sum polygon + (-convex). It is made
    of parts of the segments (edge of one) - (vertex of the other), so the shortest such translation is the point of
    one of the segments nearest to zero, or a crossing of two of them.
    """
    polygon_next_m, convex_next_m = np.roll(polygon_m, -1, axis=0), np.roll(convex_m, -1, axis=0)
    start = np.tile((polygon_m[:, None] - convex_m).reshape(-1, 2), (2, 1))
    ends = (polygon_next_m[:, None] - convex_m), (polygon_m[:, None] - convex_next_m)
    along = np.concatenate([end.reshape(-1, 2) for end in ends]) - start
    share = np.clip(-np.sum(start * along, axis=1) / np.sum(along * along, axis=1), 0.0, 1.0)
    candidates = np.concatenate([start + share[:, None] * along, _crossings(start, along)])
    for shift in candidates[np.argsort(np.linalg.norm(candidates, axis=1))]:
        if abs(polygon_area_m2(clip_to_convex(polygon_m, convex_m + shift))) <= _TOUCH_AREA_M2:
            return float(np.linalg.norm(shift))
    raise ValueError("polygons that no translation separates: a corner is not finite")


def _crossings(start: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Points (k, 2) where any two of the segments start + s along, 0 <= s <= 1, cross."""
    offset = start[None, :, :] - start[:, None, :]
    denominator = _cross(along[:, None, :], along[None, :, :])
    with np.errstate(divide="ignore", invalid="ignore"):
        s = _cross(offset, along[None, :, :]) / denominator
        t = _cross(offset, along[:, None, :]) / denominator
    i, j = np.nonzero((s >= 0.0) & (s <= 1.0) & (t >= 0.0) & (t <= 1.0))
    return start[i] + s[i, j][:, None] * along[i]


def _side(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> float:
    return float(np.sign(_cross(b - a, c - a)))


def _segments_touch(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> bool:
    apart = np.any(np.maximum(a, b) < np.minimum(c, d)) or np.any(np.maximum(c, d) < np.minimum(a, b))
    return bool(not apart and _side(a, b, c) * _side(a, b, d) <= 0 and _side(c, d, a) * _side(c, d, b) <= 0)

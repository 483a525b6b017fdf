# SPDX-License-Identifier: BSD-3-Clause
"""Seeded synthetic arrangements of cone-like objects on the ground, with the position error of a map [m]."""

import numpy as np

JITTER_M = 0.06


def _place(points, rng):
    angle = rng.uniform(0.0, 2.0 * np.pi)
    rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    points = np.asarray(points, dtype=float) @ rotation.T + rng.uniform(-5.0, 5.0, 2)
    return rng.permutation(points + rng.normal(0.0, JITTER_M, points.shape))


def line(rng, count=None):
    count = count or rng.integers(4, 9)
    along = np.cumsum(rng.uniform(0.85, 1.15, count) * rng.uniform(0.8, 1.9))
    return _place(np.column_stack([along, 0.0 * along]), rng)


def line_with_stray(rng):
    points = line(rng, rng.integers(5, 9))
    stray = points[rng.integers(len(points))] + rng.choice([-1, 1], 2) * rng.uniform(0.4, 0.9, 2)
    return np.vstack([points, stray])


def line_of_three(rng):
    return line(rng, 3)


def arc(rng):
    count, turn = rng.integers(4, 9), np.deg2rad(rng.uniform(45.0, 200.0))
    gap = rng.uniform(0.8, 1.8)
    radius = gap * (count - 1) / turn
    angles = np.linspace(0.0, turn, count) + rng.normal(0.0, 0.03 * turn / count, count)
    return _place(radius * np.column_stack([np.cos(angles), np.sin(angles)]), rng)


def ring(rng):
    count, gap = rng.integers(5, 12), rng.uniform(0.8, 1.8)
    angles = 2.0 * np.pi * (np.arange(count) + rng.uniform(-0.06, 0.06, count)) / count
    return _place(gap * count / (2.0 * np.pi) * np.column_stack([np.cos(angles), np.sin(angles)]), rng)


def square(rng):
    gap, side = rng.uniform(0.8, 1.8), rng.integers(1, 4)
    steps = np.concatenate([np.tile(d, (side, 1)) for d in ((1, 0), (0, 1), (-1, 0), (0, -1))])
    return _place(gap * np.cumsum(steps, axis=0), rng)


def corner(rng):
    gap, a, b = rng.uniform(0.8, 1.8), rng.integers(2, 5), rng.integers(2, 5)
    opening = np.deg2rad(rng.uniform(75.0, 105.0))
    first = np.outer(np.arange(1, a + 1), [1.0, 0.0])
    second = np.outer(np.arange(1, b + 1), [np.cos(opening), np.sin(opening)])
    return _place(gap * np.vstack([[[0.0, 0.0]], first, second]), rng)


def lane(rng):
    """Two rows of three to six, 1.0 to 2.5 m apart, whatever the gaps in a row."""
    gap, count, width = rng.uniform(0.8, 1.6), rng.integers(3, 7), rng.uniform(1.0, 2.5)
    x = gap * np.arange(count)
    x_other = x[: max(2, count - rng.integers(0, 2))] + rng.uniform(-0.3, 0.3) * gap
    first, second = np.column_stack([x, 0.0 * x]), np.column_stack([x_other, 0.0 * x_other + width])
    return _place(np.vstack([first, second]), rng)


def scatter_of(rng, count, side_m, clearance_m=0.4):
    """As many objects at places drawn evenly in a square, none nearer to another than the clearance."""
    points = []
    while len(points) < count:
        candidate = rng.uniform(0.0, side_m, 2)
        if all(np.linalg.norm(candidate - p) > clearance_m for p in points):
            points.append(candidate)
    return _place(points, rng)


def scatter(rng):
    return scatter_of(rng, rng.integers(4, 11), 6.0)


def dense_scatter(rng):
    return scatter_of(rng, rng.integers(4, 11), 3.0)


def scatter_of_three(rng):
    return scatter_of(rng, 3, 4.0)


GENERATORS = {
    "line": line,
    "line_with_stray": line_with_stray,
    "line_of_three": line_of_three,
    "arc": arc,
    "ring": ring,
    "square": square,
    "corner": corner,
    "lane": lane,
    "scatter": scatter,
    "dense_scatter": dense_scatter,
    "scatter_of_three": scatter_of_three,
}

# SPDX-License-Identifier: BSD-3-Clause
"""View of one safety grid: unsafe cells as boxes, exact signed distance to their union, and the cause of each cell.

The unsafe set is the union of the squares of cells that are UNSAFE, or UNKNOWN where unknown counts as unsafe, and of
everything outside the grid (four half-planes, kept as boxes with infinite edges). Only cells on the border of the set
are kept: the nearest point of the set, seen from outside it, always lies on one of them.
"""

from __future__ import annotations

import math
from typing import Optional, Tuple

import numpy as np

from core_control.exceptions import GridError
from core_control.types import NO_CELL, Cause, CellState, SafetyGridData

UNKNOWN_CAUSE = Cause("UNKNOWN", "")


class Boxes:
    """Axis-aligned boxes [lo, hi], (n, 2) each [m]; edges may be infinite.

    Args:
        lo: (n, 2) lower corners.
        hi: (n, 2) upper corners.
        cell: (n,) flat index of the grid cell a box is, NO_CELL for the outside of the grid.
        growth_m: (n,) how far what is in a box may have come out of it; 0 for every box when left out.
    """

    def __init__(self, lo: np.ndarray, hi: np.ndarray, cell: np.ndarray, growth_m: Optional[np.ndarray] = None):
        """Keep the arrays."""
        self.lo, self.hi, self.cell = lo, hi, cell
        self.growth_m = np.zeros(len(cell)) if growth_m is None else growth_m

    def __len__(self) -> int:
        return len(self.cell)

    def take(self, chosen: np.ndarray) -> Boxes:
        """The boxes of a mask or an index array."""
        return Boxes(self.lo[chosen], self.hi[chosen], self.cell[chosen], self.growth_m[chosen])

    def compute_nearest(self, points: np.ndarray) -> np.ndarray:
        """Nearest point of every box, y = min(max(p, lo), hi): points (m, 2) -> (m, n, 2)."""
        return np.minimum(np.maximum(points[:, None, :], self.lo), self.hi)

    def compute_distance(self, points: np.ndarray) -> np.ndarray:
        """Distance |p - y| - growth to every box [m], -growth inside: points (m, 2) -> (m, n)."""
        x, y = points[:, :1], points[:, 1:]
        dx = np.maximum(np.maximum(self.lo[:, 0] - x, x - self.hi[:, 0]), 0.0)
        dy = np.maximum(np.maximum(self.lo[:, 1] - y, y - self.hi[:, 1]), 0.0)
        return np.sqrt(dx * dx + dy * dy) - self.growth_m

    def compute_smallest_distance(self, points: np.ndarray) -> np.ndarray:
        """Distance to the nearest box [m], +inf without boxes: points (m, 2) -> (m,).

        Only boxes that can be nearest to one of the points are looked at for all of them: with s the largest distance
        from the first point p to the others, a box nearest to any of them is at most dist(p) + 2 s away from p.
        """
        if not len(self):
            return np.full(len(points), np.inf)
        first = self.compute_distance(points[:1])[0]
        spread = np.sqrt(np.max(np.sum((points - points[0]) ** 2, axis=1)))
        # Negated, so that a point that is not finite keeps every box.
        near = ~(first > first.min() + 2.0 * spread)
        return self.take(near).compute_distance(points).min(axis=1)


class SafetyField:
    """Signed distance and causes of one safety grid.

    Args:
        grid: the grid as received.

    Raises:
        GridError: array shapes differ, the cell size is not positive, or a state value is unknown.
    """

    def __init__(self, grid: SafetyGridData):
        """Check the grid and find the cells on the border of the unsafe set."""
        _check(grid)
        self.grid = grid
        self.unsafe = grid.state == CellState.UNSAFE
        if grid.unknown_is_unsafe:
            self.unsafe = self.unsafe | (grid.state == CellState.UNKNOWN)
        self.is_finite = not bool(np.isnan(grid.h_m).any() or np.isneginf(grid.h_m[~self.unsafe]).any())
        self._padded = np.pad(self.unsafe, 1, constant_values=True)
        ny, nx = self.unsafe.shape
        self.lo_m = np.asarray(grid.origin_m, dtype=float)
        self.hi_m = self.lo_m + grid.resolution_m * np.array([nx, ny])
        self.unsafe_boxes = self._make_unsafe_boxes()
        self._safe_boxes: Optional[Boxes] = None
        self._slow_boxes: Optional[Boxes] = None
        self._mobile_boxes: Optional[Boxes] = None
        self.growth_m = 0.0  # of what moves

    def _make_unsafe_boxes(self) -> Boxes:
        padded = self._padded
        all_neighbours = padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:]
        inner = self._cell_boxes(self.unsafe & ~all_neighbours)
        inf = math.inf
        (x0, y0), (x1, y1) = self.lo_m, self.hi_m
        outer_lo = np.array([[-inf, -inf], [x1, -inf], [-inf, -inf], [-inf, y1]])
        outer_hi = np.array([[x0, inf], [inf, inf], [inf, y0], [inf, inf]])
        return Boxes(
            np.concatenate([inner.lo, outer_lo]),
            np.concatenate([inner.hi, outer_hi]),
            np.concatenate([inner.cell, np.full(4, NO_CELL)]),
        )

    def _cell_boxes(self, mask: np.ndarray) -> Boxes:
        iy, ix = np.nonzero(mask)
        lo = self.lo_m + self.grid.resolution_m * np.stack([ix, iy], axis=-1)
        return Boxes(lo, lo + self.grid.resolution_m, iy * mask.shape[1] + ix)

    @property
    def safe_boxes(self) -> Boxes:
        """Safe cells on the border of the unsafe set; found when first asked for, they matter inside it only."""
        if self._safe_boxes is None:
            padded = self._padded
            any_neighbour = padded[:-2, 1:-1] | padded[2:, 1:-1] | padded[1:-1, :-2] | padded[1:-1, 2:]
            self._safe_boxes = self._cell_boxes(~self.unsafe & any_neighbour)
        return self._safe_boxes

    @property
    def slow_boxes(self) -> Boxes:
        """Cells with a speed cap below that of a neighbour; found when first asked for.

        What reaches a cell that is left out lies in it or crosses a neighbour whose cap is no larger.
        """
        if self._slow_boxes is None:
            caps = self.grid.speed_cap_mps
            if caps is None:
                self._slow_boxes = self._cell_boxes(np.zeros_like(self.unsafe))
            else:
                padded = np.pad(np.where(np.isnan(caps), np.inf, caps), 1, constant_values=np.inf)
                sides = (padded[:-2, 1:-1], padded[2:, 1:-1], padded[1:-1, :-2], padded[1:-1, 2:])
                self._slow_boxes = self._cell_boxes(caps < np.maximum.reduce(sides))
        return self._slow_boxes

    @property
    def mobile_boxes(self) -> Boxes:
        """Unsafe cells of what moves, on the border of all of these; found when first asked for."""
        if self._mobile_boxes is None:
            causes = self.grid.causes
            moves = np.array([*(cause.mobile for cause in causes), False])
            mobile = self.unsafe & moves[np.minimum(self.grid.cause, len(causes))]
            padded = np.pad(mobile, 1)
            inner = padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:]
            self._mobile_boxes = self._cell_boxes(mobile & ~inner)
        return self._mobile_boxes

    def grow(self, growth_m: float) -> SafetyField:
        """The same field, where what moves may have come out of its cells by a distance.

            d(p) = min(d_now(p), min over mobile cells of dist(p, cell) - growth)

        Still 1-Lipschitz; without mobile cells or growth it is this very field.

        Args:
            growth_m: speed of what moves times the age of the grid, finite.
        """
        mobile = self.mobile_boxes
        if growth_m <= 0.0 or not len(mobile):
            return self
        return GrownField(self, mobile, growth_m)

    def compute_centre(self, iy: np.ndarray, ix: np.ndarray) -> np.ndarray:
        """Centres of cells [m]: index arrays (n,) -> (n, 2)."""
        return self.lo_m + self.grid.resolution_m * (np.stack([ix, iy], axis=-1) + 0.5)

    def find_cell(self, point: np.ndarray) -> Optional[Tuple[int, int]]:
        """Row and column of the cell that holds a point (2,) [m]; None outside the grid."""
        # Compared before it becomes an integer: a point may lie farther away than an integer can say, or be NaN.
        ix, iy = np.floor((np.asarray(point) - self.lo_m) / self.grid.resolution_m)
        ny, nx = self.unsafe.shape
        return (int(iy), int(ix)) if 0 <= ix < nx and 0 <= iy < ny else None

    def find_boxes_near(self, point: np.ndarray, reach_m: float) -> Boxes:
        """The unsafe boxes that come within a reach [m] of a point (2,)."""
        # Negated, so that a point that is not finite keeps every box.
        return self.unsafe_boxes.take(~(self.unsafe_boxes.compute_distance(point[None])[0] > reach_m))

    def compute_signed_distance(self, points: np.ndarray) -> np.ndarray:
        """Signed distance to the border of the unsafe set [m].

            d(p) = dist(p, U) outside U,   -dist(p, complement of U) inside;   |d(p) - d(q)| <= |p - q|

        Cells that have grown (see grow) lower it further.

        Args:
            points: (m, 2) [m].

        Returns:
            (m,); -inf where no safe cell exists.
        """
        distance = self.unsafe_boxes.compute_smallest_distance(points)
        inside = self.is_inside(points)
        if inside.any():
            depth = self.safe_boxes.compute_smallest_distance(points[inside])
            distance[inside] = np.minimum(distance[inside], -depth)
        return distance

    def is_inside(self, points: np.ndarray) -> np.ndarray:
        """Whether points (m, 2) lie in the unsafe set -> (m,) bool; outside the grid counts as inside the set."""
        index = np.floor((points - self.lo_m) / self.grid.resolution_m)
        # fmax takes what is not a number for the outside.
        ix, iy = np.minimum(np.fmax(index, -1.0), self.unsafe.shape[::-1]).astype(np.intp).T + 1
        return self._padded[iy, ix]

    def find_exit(self, point: np.ndarray) -> Optional[np.ndarray]:
        """Nearest point (2,) of a safe cell, seen from a point inside the unsafe set; None where none exists."""
        safe = self.safe_boxes
        if not len(safe):
            return None
        nearest = safe.compute_nearest(point[None])[0]
        return nearest[np.argmin(np.linalg.norm(nearest - point, axis=1))]

    def get_cause(self, cell: int) -> Cause:
        """Cause of a cell by its flat index; UNKNOWN outside the grid and for cells nothing is known of."""
        if cell == NO_CELL:
            return UNKNOWN_CAUSE
        iy, ix = divmod(int(cell), self.unsafe.shape[1])
        index = int(self.grid.cause[iy, ix])
        if index < len(self.grid.causes):
            return self.grid.causes[index]
        return UNKNOWN_CAUSE if self.grid.state[iy, ix] == CellState.UNKNOWN else Cause()


class GrownField(SafetyField):
    """A field whose mobile cells have grown; everything else is that of the field it was made from.

    Args:
        field: the field as received.
        mobile: its cells of what moves.
        growth_m: how far that may have come out of them.
    """

    def __init__(self, field: SafetyField, mobile: Boxes, growth_m: float):
        """Take the field's own, and boxes of both kinds."""
        vars(self).update(vars(field))
        self._field, self.growth_m, fixed = field, growth_m, field.unsafe_boxes
        self.unsafe_boxes = Boxes(
            np.concatenate([mobile.lo, fixed.lo]),
            np.concatenate([mobile.hi, fixed.hi]),
            np.concatenate([mobile.cell, fixed.cell]),
            np.concatenate([np.full(len(mobile), growth_m), fixed.growth_m]),
        )

    @property
    def safe_boxes(self) -> Boxes:
        """Those of the field it was made from, which keeps them from tick to tick."""
        return self._field.safe_boxes


def _check(grid: SafetyGridData) -> None:
    if not (math.isfinite(grid.resolution_m) and grid.resolution_m > 0.0):
        raise GridError(f"cell size {grid.resolution_m} m is not positive")
    if not np.isfinite(grid.origin_m).all():
        raise GridError("origin is not finite")
    if grid.state.ndim != 2 or grid.state.size == 0:
        raise GridError(f"state has shape {grid.state.shape}, not (ny, nx) with at least one cell")
    for name in ("h_m", "cause"):
        shape = getattr(grid, name).shape
        if shape != grid.state.shape:
            raise GridError(f"{name} has shape {shape}, state {grid.state.shape}")
    caps = grid.speed_cap_mps
    if caps is not None and caps.shape != grid.state.shape:
        raise GridError(f"speed_cap_mps has shape {caps.shape}, state {grid.state.shape}")
    if caps is not None and not (np.isnan(caps) | ((caps >= 0.0) & np.isfinite(caps))).all():
        raise GridError("speed_cap_mps holds a value that is neither NaN nor finite and >= 0")
    if int(grid.state.max()) > max(CellState):
        raise GridError(f"state value {int(grid.state.max())} is not known")

# SPDX-License-Identifier: BSD-3-Clause
"""Everything the safety grid ever said about a place, for the top-down picture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Optional, Tuple

import numpy as np

SAFE, UNSAFE, UNKNOWN = 0, 1, 2  # states of core_msgs/SafetyGrid
# Rules that close a region of the ground; the others (NEAR, METRIC, ...) mark a thing that stands there.
REGION_OPERATORS = ("BETWEEN(", "AROUND(", "ON(")


@dataclass(frozen=True)
class GridSnapshot:
    """One core_msgs/SafetyGrid.

    Attributes:
        stamp_ns: stamp of the depth image last added [ns].
        resolution_m: edge of a cell [m].
        origin_m: lower left corner of cell (0, 0) [m], odom frame.
        n_safe, n_unsafe: (rows, columns) votes; row index grows with y, column index with x.
        h_m: (rows, columns) signed distance [m].
        state: (rows, columns) SAFE, UNSAFE or UNKNOWN.
        cause: (rows, columns) index into rules; larger than any index where there is none.
        rules: rule of every cause, for example BETWEEN(traffic_cone).
        classes: class of every cause, empty for none; as long as rules, or empty when nobody asks.
        unknown_is_unsafe: the filter keeps out of unknown cells too.
    """

    stamp_ns: int
    resolution_m: float
    origin_m: Tuple[float, float]
    n_safe: np.ndarray
    n_unsafe: np.ndarray
    h_m: np.ndarray
    state: np.ndarray
    cause: np.ndarray
    rules: Tuple[str, ...] = ()
    unknown_is_unsafe: bool = True
    classes: Tuple[str, ...] = ()

    @property
    def closed(self) -> np.ndarray:
        """(rows, columns) bool: cells that a region rule makes unsafe, whatever was seen there."""
        indices = [i for i, rule in enumerate(self.rules) if rule.startswith(REGION_OPERATORS)]
        return (self.state == UNSAFE) & np.isin(self.cause, indices)

    @property
    def semantic(self) -> np.ndarray:
        """(rows, columns) bool: cells that are unsafe by a predicate, or for want of one for a class that was seen."""
        classes = self.classes or ("",) * len(self.rules)
        named = [
            i for i, (rule, name) in enumerate(zip(self.rules, classes)) if "(" in rule or (rule == "NOT_SAFE" and name)
        ]
        return (self.state == UNSAFE) & np.isin(self.cause, named)

    @property
    def region_rules(self) -> Tuple[str, ...]:
        """Region rules that make at least one cell unsafe, sorted."""
        return tuple(sorted({self.rules[i] for i in np.unique(self.cause[self.closed])}))


class GridHistory:
    """The newest value of every cell over a whole run, on a canvas that grows with the grids it is given."""

    def __init__(self):
        """Start with an empty canvas."""
        self._resolution_m: Optional[float] = None
        self._first_cell = (0, 0)  # (x, y) index of the canvas' lower left cell, counted from the odom origin
        self._offset_m = (0.0, 0.0)  # of cell borders against whole multiples of the resolution
        self._stamp_ns = -1
        self.p_unsafe = np.zeros((0, 0))
        self.h_m = np.zeros((0, 0))
        self.semantic = np.zeros((0, 0), dtype=bool)

    @property
    def empty(self) -> bool:
        """No grid was added yet."""
        return self._resolution_m is None

    @property
    def extent_m(self) -> Tuple[float, float, float, float]:
        """(x_min, x_max, y_min, y_max) of the canvas [m], odom frame."""
        rows, columns = self.p_unsafe.shape
        x_m = self._first_cell[0] * self._resolution_m + self._offset_m[0]
        y_m = self._first_cell[1] * self._resolution_m + self._offset_m[1]
        return x_m, x_m + columns * self._resolution_m, y_m, y_m + rows * self._resolution_m

    def add(self, grid: GridSnapshot) -> None:
        """Overwrite what the grid covers; a cell it has no vote on keeps the probability it had.

        p_unsafe = n_unsafe / (n_safe + n_unsafe), and 1 where a region rule closes the cell: safe votes are void there.

        Raises:
            ValueError: the resolution differs from that of the grids before.
        """
        if self.empty:
            self._resolution_m = grid.resolution_m
            self._offset_m = tuple(o - round(o / grid.resolution_m) * grid.resolution_m for o in grid.origin_m)
            self._first_cell = self._cell_of(grid)
        if abs(grid.resolution_m - self._resolution_m) > 1e-9:
            raise ValueError(f"resolution changed from {self._resolution_m} to {grid.resolution_m} m")
        if grid.stamp_ns <= self._stamp_ns:
            return
        self._stamp_ns = grid.stamp_ns
        window = self._window_for(self._cell_of(grid), grid.state.shape)
        votes = grid.n_safe.astype(float) + grid.n_unsafe
        known = (votes > 0) | (grid.state == UNSAFE)
        p_unsafe = np.where((votes > 0) & ~grid.closed, grid.n_unsafe / np.maximum(votes, 1.0), 1.0)
        self.p_unsafe[window] = np.where(known, p_unsafe, self.p_unsafe[window])
        self.h_m[window] = grid.h_m
        self.semantic[window] = np.where(known, grid.semantic, self.semantic[window])

    def _cell_of(self, grid: GridSnapshot) -> Tuple[int, int]:
        return tuple(int(round((o - d) / grid.resolution_m)) for o, d in zip(grid.origin_m, self._offset_m))

    def _window_for(self, cell: Tuple[int, int], shape: Tuple[int, int]) -> Tuple[slice, slice]:
        """Slices of the canvas that the grid covers; the canvas is enlarged where it does not reach."""
        rows, columns = self.p_unsafe.shape
        left, low = (max(f - c, 0) if rows else 0 for f, c in zip(self._first_cell, cell))
        column, row = cell[0] - self._first_cell[0] + left, cell[1] - self._first_cell[1] + low
        right, high = max(column + shape[1] - columns - left, 0), max(row + shape[0] - rows - low, 0)
        if left or low or right or high:
            pad = ((low, high), (left, right))
            self.p_unsafe = np.pad(self.p_unsafe, pad, constant_values=np.nan)
            self.h_m = np.pad(self.h_m, pad, constant_values=np.nan)
            self.semantic = np.pad(self.semantic, pad, constant_values=False)
            self._first_cell = (self._first_cell[0] - left, self._first_cell[1] - low)
        return slice(row, row + shape[0]), slice(column, column + shape[1])

# SPDX-License-Identifier: BSD-3-Clause
"""A safety grid against the true unsafe regions: overlap, and how far its border lies on the wrong side.

Truth T, sampled SAMPLES x SAMPLES times a cell (true_regions); a *cell* is truly unsafe when any of its samples is. A
cell that T only touches, its border running along the cell's edge (within half a sample), has no true side: it is
undecided and left out of the overlap. Called unsafe U: state unsafe, or unknown where the profile takes that for
unsafe. Observed O: cells that a frame gave a vote-giving point (sight).

    iou                = |T and U| / |T or U|           cells of O that are decided
    iou_strict         = the same                       cells of O; undecided ones count as truly safe
    optimistic_share   = |T and not U| / |T|            cells of O that are decided, as is
    pessimistic_share  = |U and not T| / |not T|

Depth of optimism at a true place p: how far the map would let a point go beyond the true border there, which is what a
robot feels of the map,

    depth(p) = distance from p to the nearest square of a cell called unsafe, in cells     0 where p's cell is called so

taken at every sample of the border of T (a sample of T beside one that is not) whose cell is observed. A border that
lies one row of cells too far in has depth 1; a missed object has the distance to the next thing that is closed. The
same over all samples of T tells of holes inside a region, which a robot cannot reach from outside when its border is
closed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Dict, List, Mapping, Optional, Sequence, Tuple

import cv2
import numpy as np

from core_bringup.evaluation.grid_file import DecidedGrid
from core_bringup.evaluation.true_regions import SAMPLES, Raster

Rectangle = Tuple[Tuple[int, int], Tuple[int, int]]  # origin (x, y) and size (columns, rows) in cells


@dataclass(frozen=True)
class Comparison:
    """One map against the truth, over a rectangle of cells; arrays are (rows, columns).

    Attributes:
        raster: of the truth.
        truth: samples that are truly unsafe.
        truth_cell: cells that hold one.
        undecided: cells that the truth only touches.
        unsafe: cells called unsafe.
        observed: cells that count.
        depth: distance of every sample to the nearest cell called unsafe, in cells.
        border: samples of the border of the truth in cells that count.
    """

    raster: Raster
    truth: np.ndarray
    truth_cell: np.ndarray
    undecided: np.ndarray
    unsafe: np.ndarray
    observed: np.ndarray
    depth: np.ndarray
    border: np.ndarray

    def counts(self) -> Dict[str, int]:
        """Numbers of cells and of border samples, which add up over maps."""
        seen, truth, unsafe = self.observed & ~self.undecided, self.truth_cell, self.unsafe
        pessimistic = seen & ~truth & unsafe
        beside = cv2.dilate(truth.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool)
        return {
            "observed": _count(self.observed),
            "undecided": _count(self.observed & self.undecided),
            "undecided_unsafe": _count(self.observed & self.undecided & unsafe),
            "both": _count(seen & truth & unsafe),
            "optimistic": _count(seen & truth & ~unsafe),
            "pessimistic": _count(pessimistic),
            "pessimistic_beside": _count(pessimistic & beside),
            "border": _count(self.border),
            "border_within_1": _count(self.border & (self.depth <= 1.0)),
        }

    def worst(self, everywhere: bool = False) -> Optional[Tuple[float, np.ndarray, Tuple[int, int]]]:
        """Largest depth in cells, its place (2,) [m] and its sample (row, column); None without a place to measure.

        Args:
            everywhere: in all of the observed truth, not only on its border.
        """
        samples = self.truth & expand(self.observed) if everywhere else self.border
        if not samples.any():
            return None
        row, column = np.unravel_index(int(np.argmax(np.where(samples, self.depth, -1.0))), samples.shape)
        x_m, y_m = self.raster.axes_m()
        return float(self.depth[row, column]), np.array([x_m[column], y_m[row]]), (int(row), int(column))


def compare(raster: Raster, truth: np.ndarray, unsafe: np.ndarray, observed: np.ndarray) -> Comparison:
    """Compare a map with the truth.

    Args:
        raster: of the truth.
        truth: (rows * SAMPLES, columns * SAMPLES) bool.
        unsafe: (rows, columns) bool.
        observed: (rows, columns) bool.
    """
    seen = expand(observed)
    cells = any_of_cell(truth)
    touched = any_of_cell(cv2.dilate(truth.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool))
    border = border_samples(truth) & seen
    return Comparison(raster, truth, cells, touched & ~cells, unsafe, observed, depth_cells(unsafe), border)


def expand(cells: np.ndarray) -> np.ndarray:
    """Samples of cells, each with the value of its cell."""
    return cells.repeat(SAMPLES, axis=0).repeat(SAMPLES, axis=1)


def any_of_cell(samples: np.ndarray) -> np.ndarray:
    """Cells that hold a sample which is set."""
    rows, columns = samples.shape
    return samples.reshape(rows // SAMPLES, SAMPLES, columns // SAMPLES, SAMPLES).any(axis=(1, 3))


def border_samples(truth: np.ndarray) -> np.ndarray:
    """Samples that are set and have one beside, above or below that is not; the raster's edge is no border."""
    padded = np.pad(truth, 1, mode="edge")
    inner = padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:]
    return truth & ~inner


def depth_cells(unsafe: np.ndarray) -> np.ndarray:
    """Distance from every sample to the nearest square of an unsafe cell, in cells; 0 inside.

    Without such a cell it is the diagonal of the rectangle everywhere.
    """
    if not unsafe.any():
        return np.full(tuple(SAMPLES * n for n in unsafe.shape), np.hypot(*unsafe.shape), np.float32)
    free = (~expand(unsafe)).astype(np.uint8)
    steps = cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    # From sample to sample; the border of the square lies half a step before its first sample.
    return np.maximum(steps - 0.5, 0.0) / SAMPLES


class GridCollage:
    """The newest decision about every cell, of all grids of a walk whose window moves with the robot."""

    def __init__(self, grids: Sequence[DecidedGrid]):
        """Take all grids, in order; at least one."""
        self._grids = list(grids)

    @property
    def grids(self) -> List[DecidedGrid]:
        """All grids, in order."""
        return self._grids

    @property
    def rectangle(self) -> Rectangle:
        """The smallest one that holds every window."""
        low = np.min([g.origin for g in self._grids], axis=0)
        high = np.max([np.add(g.origin, g.unsafe.shape[::-1]) for g in self._grids], axis=0)
        return (int(low[0]), int(low[1])), (int(high[0] - low[0]), int(high[1] - low[1]))

    def join(self) -> Tuple[np.ndarray, np.ndarray]:
        """(rows, columns) bool: called unsafe; and the number of the grid that said so, -1 for none."""
        origin, cells = self.rectangle
        unsafe = np.zeros(cells[::-1], dtype=bool)
        number = np.full(cells[::-1], -1)
        for k, grid in enumerate(self._grids):
            part = _window(grid, origin)
            unsafe[part] = grid.unsafe
            number[part] = k
        return unsafe, number

    def embed(self, grid: DecidedGrid) -> Tuple[np.ndarray, np.ndarray]:
        """(rows, columns) bool over the whole rectangle: called unsafe by one grid; and inside its window."""
        origin, cells = self.rectangle
        unsafe, within = np.zeros(cells[::-1], dtype=bool), np.zeros(cells[::-1], dtype=bool)
        part = _window(grid, origin)
        unsafe[part], within[part] = grid.unsafe, True
        return unsafe, within

    def rule_at(self, number: np.ndarray, row: int, column: int) -> str:
        """Rule the map gives for a cell of the joined map."""
        k = int(number[row, column])
        if k < 0:
            return ""
        grid, (origin, _) = self._grids[k], self.rectangle
        return grid.cause_at(row + origin[1] - grid.origin[1], column + origin[0] - grid.origin[0])


def _window(grid: DecidedGrid, origin: Tuple[int, int]) -> Tuple[slice, slice]:
    rows, columns = grid.unsafe.shape
    x, y = grid.origin[0] - origin[0], grid.origin[1] - origin[1]
    return slice(y, y + rows), slice(x, x + columns)


def figures(counts: Mapping[str, int]) -> Dict[str, Any]:
    """Shares of added up counts; None where there is nothing to divide by."""
    truth = counts["both"] + counts["optimistic"]
    union = truth + counts["pessimistic"]
    return {
        "iou": _share(counts["both"], union),
        "iou_strict": _share(counts["both"], union + counts["undecided_unsafe"]),
        "optimistic_share": _share(counts["optimistic"], truth),
        "pessimistic_share": _share(counts["pessimistic"], counts["observed"] - counts["undecided"] - truth),
        "pessimistic_beside_truth": _share(counts["pessimistic_beside"], counts["pessimistic"]),
        "border_within_1_cell": _share(counts["border_within_1"], counts["border"]),
    }


def add_counts(all_counts: Sequence[Mapping[str, int]]) -> Dict[str, int]:
    """Sums of counts."""
    return {name: sum(counts[name] for counts in all_counts) for name in all_counts[0]}


def _share(part: int, whole: int) -> Optional[float]:
    return round(part / whole, 5) if whole else None


def _count(mask: np.ndarray) -> int:
    return int(np.count_nonzero(mask))

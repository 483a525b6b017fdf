# SPDX-License-Identifier: BSD-3-Clause
"""What was in force at any moment of a run: every decision of the safety grid, packed, and every set of predicates."""

from __future__ import annotations

import bisect
import zlib
from dataclasses import dataclass
from typing import List, Mapping, Optional, Sequence, Tuple

import numpy as np

from core_bringup.evaluation.grid_history import UNKNOWN, UNSAFE, GridSnapshot
from core_perception.predicates import Predicate


@dataclass(frozen=True)
class GridDecision:
    """State and cause of the cells of one safety grid.

    Attributes:
        stamp_ns: stamp of the depth image last added [ns].
        resolution_m, origin_m, shape: as in GridSnapshot.
        rules, classes: of every cause.
        unknown_is_unsafe: the filter keeps out of unknown cells too.
        packed: state (uint8) and cause (uint16) of the cells, deflated.
    """

    stamp_ns: int
    resolution_m: float
    origin_m: Tuple[float, float]
    shape: Tuple[int, int]
    rules: Tuple[str, ...]
    classes: Tuple[str, ...]
    unknown_is_unsafe: bool
    packed: bytes

    @classmethod
    def pack(cls, grid: GridSnapshot) -> GridDecision:
        """Keep what decides, a few kilobytes a grid."""
        data = grid.state.astype(np.uint8).tobytes() + grid.cause.astype("<u2").tobytes()
        classes = grid.classes or ("",) * len(grid.rules)
        return cls(
            grid.stamp_ns, grid.resolution_m, grid.origin_m, grid.state.shape, grid.rules, classes,
            grid.unknown_is_unsafe, zlib.compress(data, 1),
        )  # fmt: skip

    def unpack(self) -> Tuple[np.ndarray, np.ndarray]:
        """State (rows, columns) uint8 and cause (rows, columns) uint16."""
        data, cells = zlib.decompress(self.packed), self.shape[0] * self.shape[1]
        state = np.frombuffer(data, np.uint8, cells).reshape(self.shape)
        return state, np.frombuffer(data, "<u2", cells, cells).reshape(self.shape)

    def unsafe_at(self, points_m: np.ndarray, causes: Optional[Sequence[int]] = None) -> np.ndarray:
        """(n,) bool: whether the filter keeps out of the cell of each point (n, 2); points outside the grid are not.

        Args:
            points_m: places in the frame of the grid.
            causes: count only cells of these causes, as indices into rules; None: every cause.
        """
        state, cause = self.unpack()
        columns, rows = np.floor((points_m - np.asarray(self.origin_m)) / self.resolution_m).astype(int).T
        inside = (rows >= 0) & (rows < self.shape[0]) & (columns >= 0) & (columns < self.shape[1])
        result = np.zeros(len(points_m), dtype=bool)
        kept = state[rows[inside], columns[inside]]
        unsafe = (kept == UNSAFE) | ((kept == UNKNOWN) & self.unknown_is_unsafe)
        result[inside] = unsafe if causes is None else unsafe & np.isin(cause[rows[inside], columns[inside]], causes)
        return result

    def causes_of(self, predicates: Sequence[Predicate], class_of_name: Mapping[str, str]) -> List[int]:
        """Indices of the causes that one of these unsafe predicates has: OPERATOR(class), or for ON also NOT_SAFE.

        Args:
            predicates: in the classes of the world.
            class_of_name: other names of these classes, which the grid may use.
        """
        wanted = {(p.operator.name, p.class_name) for p in predicates}
        causes = []
        for i, (rule, name) in enumerate(zip(self.rules, self.classes)):
            operator, _, inner = ("ON", "", name) if rule == "NOT_SAFE" else rule.rstrip(")").partition("(")
            if (operator, class_of_name.get(inner, inner)) in wanted:
                causes.append(i)
        return causes


class Timeline:
    """Things in force from their stamp on until the next one's; the newest at a moment is looked up by its stamp."""

    def __init__(self):
        """Start empty."""
        self.stamps_ns: List[int] = []
        self.items: List[object] = []

    def __len__(self) -> int:
        """Return the number of items."""
        return len(self.items)

    def add(self, stamp_ns: int, item: object) -> None:
        """Append; one that is not newer than the last is dropped."""
        if not self.stamps_ns or stamp_ns > self.stamps_ns[-1]:
            self.stamps_ns.append(stamp_ns)
            self.items.append(item)

    def at(self, stamp_ns: int) -> Optional[object]:
        """The newest item not younger than stamp_ns, or None."""
        index = bisect.bisect_right(self.stamps_ns, stamp_ns)
        return self.items[index - 1] if index else None


class RunLog:
    """Grids and predicates of a run, bounded in memory: some 3 kB a grid, and predicates only where they change."""

    def __init__(self):
        """Start empty."""
        self.grids = Timeline()
        self.predicates = Timeline()
        self.latencies_s: List[float] = []
        self._image_stamp_ns = 0

    def add_grid(self, grid: GridSnapshot) -> None:
        """Add a safety grid."""
        self.grids.add(grid.stamp_ns, GridDecision.pack(grid))

    def add_predicates(self, stamp_ns: int, predicates: Tuple[Predicate, ...]) -> None:
        """Add the predicates in force from stamp_ns on."""
        if not len(self.predicates) or self.predicates.items[-1] != predicates:
            self.predicates.add(stamp_ns, predicates)

    def add_latency(self, image_stamp_ns: int, latency_s: float) -> None:
        """Note the latency of an answer, once for each image that was answered; 0 stands for no image yet."""
        if image_stamp_ns and image_stamp_ns != self._image_stamp_ns:
            self._image_stamp_ns = image_stamp_ns
            self.latencies_s.append(latency_s)

    def predicates_at(self, stamp_ns: int) -> Tuple[Predicate, ...]:
        """Predicates in force at a moment; empty before the first."""
        return self.predicates.at(stamp_ns) or ()

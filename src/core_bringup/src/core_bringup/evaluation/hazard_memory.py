# SPDX-License-Identifier: BSD-3-Clause
"""Whether a hazard that a map once closed stays closed, grid by grid.

Core of a hazard: the cells whose centre lies in its true region. Of a BETWEEN the hull; of an AROUND the ground within
its radius less one cell, which is how far a map may be off at its rim. A hazard is *confirmed* by the first grid that
holds all its core and calls every cell of it unsafe, on evidence: unknown is not enough. From then on a core cell is
*open* when it counts neither as unsafe nor as unknown where that is unsafe, or h > 0 there, and the barrier has an
opening. Cells that the window does not hold are not looked at.

Passage: a rectangle across the way that one of the hazards closes, its y edges walls. It is *passable* when a disc as
wide as the robot finds a way on ground that is not called unsafe from its low x edge to its high one, *threaded* when
a point does. Ground never seen counts as open, so that no barrier is credited with what is merely unknown.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Dict, List, Mapping, Optional, Sequence, Tuple

import cv2
import numpy as np

from core_bringup.evaluation.grid_file import UNSAFE, DecidedGrid
from core_bringup.evaluation.true_regions import TrueRegion

PASSAGE_STEP_M = 0.05


@dataclass(frozen=True)
class Drift:
    """Where odometry takes the world to be: p_odom = R(yaw) p_world + shift."""

    shift_m: Tuple[float, float] = (0.0, 0.0)
    yaw_rad: float = 0.0

    def apply(self, points_m: np.ndarray) -> np.ndarray:
        """Points (n, 2) of the world in the odometry frame."""
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        return points_m @ np.array([[c, s], [-s, c]]) + np.asarray(self.shift_m)

    def offset_m(self, point_m: Sequence[float]) -> float:
        """How far it has moved a place (2,)."""
        point_m = np.asarray(point_m, dtype=float)
        return float(np.linalg.norm(self.apply(point_m[None])[0] - point_m))

    def matrix(self) -> np.ndarray:
        """T_odom_world (4, 4)."""
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        T_odom_world = np.eye(4)
        T_odom_world[:2, :2] = [[c, -s], [s, c]]
        T_odom_world[:2, 3] = self.shift_m
        return T_odom_world


NO_DRIFT = Drift()


@dataclass(frozen=True)
class Passage:
    """Rectangle from low_m to high_m (2,) [m], world frame, walked through along x."""

    low_m: Tuple[float, float]
    high_m: Tuple[float, float]
    robot_width_m: float

    def points_m(self) -> np.ndarray:
        """(rows, columns, 2) samples PASSAGE_STEP_M apart; rows along y."""
        x_m, y_m = (
            np.arange(low + 0.5 * PASSAGE_STEP_M, high, PASSAGE_STEP_M) for low, high in zip(self.low_m, self.high_m)
        )
        return np.stack(np.meshgrid(x_m, y_m), axis=-1)

    def find_ways(self, closed: np.ndarray) -> Tuple[bool, bool]:
        """Whether it is passable and whether it is threaded, for samples (rows, columns) that are closed or not."""
        walled = np.pad(closed, ((1, 1), (0, 0)), constant_values=True)
        steps = cv2.distanceTransform((~walled).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
        clearance_m = (steps - 0.5) * PASSAGE_STEP_M
        return _crosses(clearance_m >= 0.5 * self.robot_width_m), _crosses(~walled)


def _crosses(free: np.ndarray) -> bool:
    """Whether free samples, over edges and corners, join the first column with the last."""
    _, labels = cv2.connectedComponents(free.astype(np.uint8), connectivity=8)
    return bool(set(labels[:, 0]) & set(labels[:, -1]) - {0})


@dataclass(frozen=True)
class GridCheck:
    """What one grid says of the hazards; places in the odometry frame.

    Attributes:
        frame: number of the frame.
        open_cells: open core cells of the hazards that are confirmed.
        gap_m: longer side of the largest group of them that hang together.
        first_open_m: (2,) centre of one, or None.
        passable, threaded: of the passage; None while its hazard is not confirmed or the window does not hold it.
    """

    frame: int
    open_cells: int
    gap_m: float
    first_open_m: Optional[np.ndarray]
    passable: Optional[bool]
    threaded: Optional[bool]

    @property
    def is_open(self) -> bool:
        """Whether the barrier fails here."""
        return self.open_cells > 0 or bool(self.passable)


@dataclass
class HazardWatch:
    """Checks the grids of a walk in order.

    Attributes:
        cores: name -> region of the world whose cells must stay unsafe.
        passage: that the first of them closes, or None.
        resolution_m: of the grids.
        confirmed: name -> frame that confirmed it, in order.
    """

    cores: Mapping[str, TrueRegion]
    passage: Optional[Passage]
    resolution_m: float
    confirmed: Dict[str, int] = field(default_factory=dict)

    def check(self, grid: DecidedGrid, drift: Drift = NO_DRIFT) -> GridCheck:
        """Look at the next grid.

        Args:
            grid: of the map.
            drift: of the odometry at its frame.
        """
        open_mask = np.zeros(grid.unsafe.shape, dtype=bool)
        for name, core in self.cores.items():
            inside, whole = core_cells(core, grid, self.resolution_m, drift)
            if name not in self.confirmed and whole and (grid.state[inside] == UNSAFE).all():
                self.confirmed[name] = grid.frame
            if name in self.confirmed:
                open_mask |= inside & ~(grid.unsafe & (grid.h_m <= 0.0))
        closes = self.passage is not None and next(iter(self.cores)) in self.confirmed
        ways = self._find_ways(grid, drift) if closes else (None, None)
        return GridCheck(grid.frame, *self._describe(open_mask, grid), *ways)

    def _describe(self, open_mask: np.ndarray, grid: DecidedGrid) -> Tuple[int, float, Optional[np.ndarray]]:
        if not open_mask.any():
            return 0, 0.0, None
        _, _, stats, _ = cv2.connectedComponentsWithStats(open_mask.astype(np.uint8), connectivity=8)
        sides = stats[1:, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]]
        row, column = np.argwhere(open_mask)[0]
        place_m = (np.array([column, row]) + grid.origin + 0.5) * self.resolution_m
        return int(np.count_nonzero(open_mask)), float(sides.max()) * self.resolution_m, place_m

    def _find_ways(self, grid: DecidedGrid, drift: Drift) -> Tuple[Optional[bool], Optional[bool]]:
        points_m = self.passage.points_m()
        cells = np.floor(drift.apply(points_m.reshape(-1, 2)) / self.resolution_m).astype(int) - grid.origin
        rows, columns = grid.state.shape
        if cells.min() < 0 or (cells >= (columns, rows)).any():
            return None, None
        closed = grid.state[cells[:, 1], cells[:, 0]] == UNSAFE
        return self.passage.find_ways(closed.reshape(points_m.shape[:2]))


def core_cells(
    core: TrueRegion, grid: DecidedGrid, resolution_m: float, drift: Drift = NO_DRIFT
) -> Tuple[np.ndarray, bool]:
    """(rows, columns) bool: the cells whose centre a region covers; and whether the window holds all of them."""
    moved = TrueRegion(core.rule, drift.apply(core.polygon_m), core.radius_m)
    low, high = (np.floor(v / resolution_m).astype(int) for v in moved.bounds_m())
    x, y = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
    centres_m = (np.stack([x, y], axis=-1).reshape(-1, 2) + 0.5) * resolution_m
    cells = centres_m[moved.covers(centres_m)] / resolution_m - 0.5 - grid.origin
    cells = np.rint(cells).astype(int)
    rows, columns = grid.unsafe.shape
    held = (cells >= 0).all(axis=1) & (cells < (columns, rows)).all(axis=1)
    mask = np.zeros(grid.unsafe.shape, dtype=bool)
    mask[cells[held, 1], cells[held, 0]] = True
    return mask, bool(held.all())


def summarise_round(number: int, checks: Sequence[GridCheck]) -> Dict[str, Any]:
    """Figures of the grids of one round."""
    return {
        "round": number,
        "frames": len(checks),
        "open_frames": sum(check.is_open for check in checks),
        "open_cells": max((check.open_cells for check in checks), default=0),
        "longest_gap_m": round(max((check.gap_m for check in checks), default=0.0), 3),
        "passable_frames": sum(bool(check.passable) for check in checks),
        "threaded_frames": sum(bool(check.threaded) for check in checks),
    }


def count_openings(checks: Sequence[GridCheck]) -> int:
    """How often the barrier went from closed to open."""
    states: List[bool] = [False, *(check.is_open for check in checks)]
    return sum(after and not before for before, after in zip(states, states[1:]))

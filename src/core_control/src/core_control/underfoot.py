# SPDX-License-Identifier: BSD-3-Clause
"""Cells that turned unsafe while the robot stood on them: they stop it for a moment, but they do not lock it.

A cell that lies wholly under the body cannot be an obstacle that the robot will run into: it stands there. Such cells
are *exempt*, and the filter may leave them out of one of the two programs it solves (hold.py). Why this is sound:

1. A cell becomes exempt only at the tick at which it turns unsafe, and only if it is wholly under the body then. It
   stays exempt while it is unsafe and until the footprint has left it, so that the robot is not stopped half-way off
   it; from then on it has rows like any other, which let the robot go on, but not come closer. So the set only loses
   cells, unless new ones turn unsafe wholly under the body.
2. Every other unsafe cell keeps its rows and its place in the verifier, also those that are partly under the body. In
   an unsafe region larger than the body its neighbours hold the robot as before.
3. hold.py lets the body enter no cell that it is not on already, exempt or not: a cell it has walked off is not walked
   on again.

By 1 to 3 the set of unsafe cells under the body can only shrink, but for what the map newly calls unsafe there.

A cell of the map flickers now and then. While one that is new has been seen in no more than underfoot_grids grids, the
robot stands; if it is gone by then, the robot goes on by itself. Grids are counted for a place until the footprint has
left it, so that a place that flickers is stood out once, not each time.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Dict, Optional, Set, Tuple

import numpy as np

from core_control.body import Body, find_unsafe_near
from core_control.dynamics import place_discs
from core_control.params import FilterParams
from core_control.safety_field import SafetyField
from core_control.types import CellState

# Column and row of a cell counted from the first grid's corner: stays the same when the corner of the grid moves.
Place = Tuple[int, int]
# Share of a cell by which the corners of two grids may be out of step.
STEP_SLACK = 1e-3


class Underfoot:
    """Keeps the exempt cells from tick to tick.

    Args:
        params: parameters of the filter.
        body: outline of the robot.
    """

    def __init__(self, params: FilterParams, body: Body):
        """Start with no cell."""
        self._body, self._discs = body, params.disc_array
        self._grids = params.underfoot_grids
        self.reset()

    def reset(self) -> None:
        """Forget every cell; those under the body count as newly unsafe in the next grid."""
        self._field: Optional[SafetyField] = None
        self._corner_m = np.zeros(2)
        self._exempt: Set[Place] = set()
        self._counts: Dict[Place, int] = {}
        self._cleared: Tuple[Optional[SafetyField], frozenset, Optional[SafetyField]] = (None, frozenset(), None)

    def __len__(self) -> int:
        return len(self._exempt)

    def update(self, field: SafetyField, pose: np.ndarray) -> None:
        """Take the field and the pose of a tick; to be called at every tick at which both are known.

        Args:
            field: of the newest grid.
            pose: (3,) of base_link in its frame.
        """
        if field is not self._field:
            self._take_grid(field, pose, self._align(field))
        if self._counts:
            left = self._find_left(field, pose)
            self._exempt -= left
            self._counts = {place: count for place, count in self._counts.items() if place not in left}

    def _align(self, field: SafetyField) -> bool:
        """Whether the cells of the new grid are those of the last one; else each place becomes the cell it lies in."""
        before, corner_m, self._corner_m = self._field, self._corner_m, field.lo_m
        if before is None:
            return True
        cell_m = before.grid.resolution_m
        steps = (field.lo_m - corner_m) / cell_m
        if cell_m == field.grid.resolution_m and np.all(np.abs(steps - np.round(steps)) <= STEP_SLACK):
            self._corner_m = corner_m
            return True

        def move(place: Place) -> Place:
            centre = corner_m + (np.array(place) + 0.5) * cell_m
            ix, iy = np.floor((centre - field.lo_m) / field.grid.resolution_m).astype(int)
            return int(ix), int(iy)

        self._exempt = {move(place) for place in self._exempt}
        self._counts = {move(place): count for place, count in self._counts.items()}
        return False

    def _take_grid(self, field: SafetyField, pose: np.ndarray, aligned: bool) -> None:
        before, self._field = self._field, field
        iy, ix = find_unsafe_near(field, pose[None], self._body.reach_m)
        centres = field.compute_centre(iy, ix)
        covered = self._body.covers(pose, centres, field.grid.resolution_m)
        self._exempt = {place for place in self._exempt if self._is_unsafe(place)}
        if not aligned:
            # A cell that is not the one that turned unsafe under the body must lie wholly under it itself.
            self._exempt &= self._find_places(centres[covered])
        if covered.any():
            # What lay outside of the grid before was unsafe before.
            turned = covered if before is None else covered & ~before.is_inside(centres)
            self._exempt |= self._find_places(centres[turned])
        if before is None or before.grid.stamp_s != field.grid.stamp_s or field.grid.stamp_s == 0.0:
            for place in self._exempt:
                self._counts[place] = self._counts.get(place, 0) + 1
        else:
            for place in self._exempt:
                self._counts.setdefault(place, 1)

    def _find_places(self, centres: np.ndarray) -> Set[Place]:
        places = np.floor((centres - self._corner_m) / self._field.grid.resolution_m).astype(int)
        return {(ix, iy) for ix, iy in places.tolist()}

    def _find_left(self, field: SafetyField, pose: np.ndarray) -> Set[Place]:
        """Places the footprint has left."""
        places = list(self._counts)
        cell_m = field.grid.resolution_m
        lo = self._corner_m + np.array(places) * cell_m
        centres = place_discs(pose[None], self._discs)[0]
        gap = centres[:, None] - np.clip(centres[:, None], lo, lo + cell_m)
        clearance = np.min(np.hypot(gap[..., 0], gap[..., 1]) - self._discs[:, 2, None], axis=0)
        return {place for place, clearance_m in zip(places, clearance) if clearance_m >= 0.0}

    def find_new(self) -> Optional[int]:
        """Flat index in the newest grid of a cell that has not been seen in more than underfoot_grids grids yet."""
        for place in sorted(self._exempt):
            if self._counts[place] <= self._grids:
                return self._find_index(place)
        return None

    def clear_field(self) -> SafetyField:
        """The newest field as it would be if the exempt cells were safe; the field itself while there are none."""
        if not self._exempt:
            return self._field
        field, exempt, cleared = self._cleared
        if field is not self._field or exempt != self._exempt:
            cleared = clear_cells(self._field, [self._find_index(place) for place in self._exempt])
            self._cleared = (self._field, frozenset(self._exempt), cleared)
        return cleared

    def _find_index(self, place: Place) -> Optional[int]:
        """Flat index of a place in the newest grid; None outside of it."""
        cell = self._field.find_cell(self._corner_m + (np.array(place) + 0.5) * self._field.grid.resolution_m)
        return None if cell is None else cell[0] * self._field.unsafe.shape[1] + cell[1]

    def _is_unsafe(self, place: Place) -> bool:
        index = self._find_index(place)
        return index is not None and bool(self._field.unsafe.flat[index])


def clear_cells(field: SafetyField, cells: list) -> SafetyField:
    """The field with some cells made safe, by their flat indices."""
    state = np.array(field.grid.state)
    state.flat[cells] = CellState.SAFE
    return SafetyField(replace(field.grid, state=state))

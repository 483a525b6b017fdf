# SPDX-License-Identifier: BSD-3-Clause
"""Which three camera frames of a run are worth keeping: first sight of a barrier, the moment of braking, the end."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Dict, Generic, List, Optional, Tuple, TypeVar

import numpy as np

from core_bringup.evaluation.grid_history import GridSnapshot
from core_bringup.evaluation.metrics import filter_intervenes
from core_bringup.evaluation.records import OdometrySample, TickRecord
from core_perception.predicates import Predicate

BUFFER_NS = 3_000_000_000  # frames, poses and grids older than this are dropped unless they were chosen
T = TypeVar("T")


class StampedBuffer(Generic[T]):
    """The newest BUFFER_NS of one stream, looked up by stamp."""

    def __init__(self):
        """Start empty."""
        self._items: Dict[int, T] = {}

    def add(self, stamp_ns: int, item: T) -> None:
        """Keep an item and drop what has become too old."""
        self._items[stamp_ns] = item
        for old in [s for s in self._items if s < stamp_ns - BUFFER_NS]:
            del self._items[old]

    def at_or_before(self, stamp_ns: int) -> Optional[T]:
        """The newest item not younger than stamp_ns, else the oldest one, else None."""
        older = [s for s in self._items if s <= stamp_ns]
        key = max(older) if older else min(self._items, default=None)
        return None if key is None else self._items[key]


@dataclass(frozen=True)
class ColorImage:
    """A colour image: (h, w, 3) uint8 rgb, stamp [ns]."""

    stamp_ns: int
    rgb: np.ndarray


@dataclass(frozen=True)
class KeyFrame:
    """A chosen frame with what is needed to draw over it.

    Attributes:
        title: why it was chosen.
        image: the colour image.
        depth_m: (h, w) depth along the optical axis [m], NaN where there is none; None if no depth image came.
        odometry: pose of the robot at the image.
        grid: the safety grid of that frame; None while there was none.
        record: the tick at which it was chosen.
        predicates: what the reasoner had stated by then.
    """

    title: str
    image: ColorImage
    depth_m: Optional[np.ndarray]
    odometry: Optional[OdometrySample]
    grid: Optional[GridSnapshot]
    record: Optional[TickRecord]
    predicates: Tuple[Predicate, ...] = ()


class KeyFrameKeeper:
    """Chooses key frames from the ticks and takes their images from short buffers.

    A choice is made by stamps alone; its images are taken SETTLE_NS later, when all of them have arrived.
    """

    SETTLE_NS = 500_000_000

    def __init__(self):
        """Start with empty buffers."""
        self._images: StampedBuffer[ColorImage] = StampedBuffer()
        self._depths: StampedBuffer[np.ndarray] = StampedBuffer()
        self._odometry: StampedBuffer[OdometrySample] = StampedBuffer()
        self._grids: StampedBuffer[GridSnapshot] = StampedBuffer()
        self._predicates: StampedBuffer[Tuple[Predicate, ...]] = StampedBuffer()
        self._waiting: Dict[str, TickRecord] = {}
        self._chosen: Dict[str, KeyFrame] = {}
        self._closest_m = math.inf
        self._barrier_stamp_ns: Optional[int] = None
        self._barrier_rule = ""
        self._last: Optional[TickRecord] = None

    def add_image(self, image: ColorImage) -> None:
        """Add a colour image."""
        self._images.add(image.stamp_ns, image)

    def add_depth(self, stamp_ns: int, depth_m: np.ndarray) -> None:
        """Add a depth image [m]."""
        self._depths.add(stamp_ns, depth_m)

    def add_grid(self, grid: GridSnapshot) -> None:
        """Add a safety grid; the first one with a closed region marks the first sight."""
        self._grids.add(grid.stamp_ns, grid)
        rules = grid.region_rules
        if rules and (self._barrier_stamp_ns is None or grid.stamp_ns < self._barrier_stamp_ns):
            self._barrier_stamp_ns, self._barrier_rule = grid.stamp_ns, rules[0]

    def add_predicates(self, stamp_ns: int, predicates: Tuple[Predicate, ...]) -> None:
        """Add the predicates in force from stamp_ns on."""
        self._predicates.add(stamp_ns, predicates)

    def add_record(self, record: TickRecord) -> None:
        """Judge a tick: is it the first sight, the first intervention, or closer to the region than any before?"""
        if self._last is None:
            self._want("start", record, once=True)
        self._last = record
        now_ns = record.odometry.stamp_ns
        self._odometry.add(now_ns, record.odometry)
        if self._barrier_stamp_ns is not None and now_ns >= self._barrier_stamp_ns:
            self._want("sight", record, once=True)
        if filter_intervenes(record) and record.filter.binding_rule:
            self._want("braking", record, once=True)
        clearance_m = min(record.truth.clearance_m, record.truth.obstacle_clearance_m)
        if clearance_m < self._closest_m and not record.truth.inside:
            self._closest_m = clearance_m
            self._want("closest", record, once=False)
        for slot in [s for s, r in self._waiting.items() if now_ns - r.odometry.stamp_ns >= self.SETTLE_NS]:
            self._take(slot)

    def close(self) -> List[KeyFrame]:
        """The three frames in order of time; fewer when fewer images than that were seen."""
        for slot in list(self._waiting):
            self._take(slot)
        if self._last is not None:
            self._waiting["final"] = self._last
            self._take("final")
        second = "braking" if "braking" in self._chosen else "closest"
        first = "sight" if "sight" in self._chosen else "start"
        return [self._chosen[slot] for slot in (first, second, "final") if slot in self._chosen]

    def _want(self, slot: str, record: TickRecord, once: bool) -> None:
        if slot in self._waiting or (once and slot in self._chosen):
            return
        self._waiting[slot] = record

    def _take(self, slot: str) -> None:
        record = self._waiting.pop(slot)
        image = self._images.at_or_before(record.odometry.stamp_ns)
        if image is None:
            return
        frame = KeyFrame(
            self._title(slot, record),
            image,
            self._depths.at_or_before(image.stamp_ns),
            self._odometry.at_or_before(image.stamp_ns),
            self._grids.at_or_before(image.stamp_ns),
            record,
            self._predicates.at_or_before(image.stamp_ns) or (),
        )
        self._chosen[slot] = frame

    def _title(self, slot: str, record: TickRecord) -> str:
        titles = {
            "start": "start",
            "sight": f"first sight: {self._barrier_rule}",
            "braking": f"braking begins: {record.filter.binding_rule}",
            "closest": "closest approach",
            "final": "end",
        }
        return titles[slot]

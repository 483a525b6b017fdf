# SPDX-License-Identifier: BSD-3-Clause
"""What a trial is judged by: one record per tick, joined by stamp from three streams."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Dict, List, Optional, Tuple

from core_bringup.exceptions import BringupError

# Order of core_msgs/FilterState.
MODE_NAMES = ("NOMINAL", "FILTERED", "HOLD", "STOPPED", "DISABLED", "ESCAPE", "OVERRIDE")
# A complete record this many ticks ahead of the one awaited proves a loss: every stream keeps its own order.
MAX_TICKS_AHEAD = 50
# Without lock-step: a robot sample waits this long in ROS time for the filter's state, then takes the one before it.
MAX_FILTER_LAG_S = 1.0

Vector2 = Tuple[float, float]
Vector3 = Tuple[float, float, float]


class LostRecordError(BringupError):
    """A tick never arrived, so neither the outcome nor the hash of the run can be trusted."""


@dataclass(frozen=True)
class OdometrySample:
    """Pose odom -> base_link [m, quaternion x y z w] and twist [m/s, rad/s] in base_link at stamp_ns [ns, sim time]."""

    stamp_ns: int
    p_odom_base: Vector3
    q_odom_base: Tuple[float, float, float, float]
    v_base: Vector3
    w_base: Vector3


@dataclass(frozen=True)
class FilterSample:
    """The fields of core_msgs/FilterState a trial is judged by; mode is one of MODE_NAMES."""

    stamp_ns: int
    tick: int
    mode: str
    u_nominal: Vector3
    u_safe: Vector3
    h_m: float = float("nan")
    reason: str = ""
    binding_rule: str = ""
    binding_class: str = ""
    constraints_age_s: float = float("nan")
    grid_age_s: float = float("nan")
    solve_time_s: float = float("nan")
    binding_point_m: Vector2 = (float("nan"), float("nan"))


@dataclass(frozen=True)
class TruthSample:
    """The fields of core_msgs/Violation; clearance_m is +inf where the task has no unsafe region."""

    stamp_ns: int
    inside: bool
    base_inside: bool
    clearance_m: float
    obstacle_clearance_m: float
    fallen: bool = False
    region: str = ""


@dataclass(frozen=True)
class TickRecord:
    """One tick: where the robot is, what the filter did, and what was true."""

    odometry: OdometrySample
    filter: FilterSample
    truth: TruthSample

    @property
    def time_s(self) -> float:
        """Stamp of the tick [s]."""
        return self.odometry.stamp_ns * 1e-9

    @property
    def position_m(self) -> Vector2:
        """Base point on the ground [m], odom frame."""
        return self.odometry.p_odom_base[:2]


class TickJoiner:
    """Joins the three streams into tick records, the same whatever order the streams arrive in.

    Under lock-step all three samples carry the tick's stamp, and records leave in the order of their tick numbers.
    Otherwise a robot sample is joined with the newest filter state that is not younger than it.

    Args:
        lockstep: join by equal stamps.
        first_tick: number of the first tick of a run (lock-step only); the world's schedule begins with 1.
    """

    def __init__(self, lockstep: bool, first_tick: int = 1):
        """Start empty."""
        self._lockstep = lockstep
        self._next_tick = first_tick
        self._odometry: Dict[int, OdometrySample] = {}
        self._truth: Dict[int, TruthSample] = {}
        self._filter: Dict[int, FilterSample] = {}
        self._last_stamp_ns = -1

    def add_odometry(self, sample: OdometrySample) -> None:
        """Add one robot sample; an old or repeated stamp is ignored."""
        self._add(self._odometry, sample)

    def add_truth(self, sample: TruthSample) -> None:
        """Add one ground truth sample; an old or repeated stamp is ignored."""
        self._add(self._truth, sample)

    def add_filter(self, sample: FilterSample) -> None:
        """Add one filter state; a repeated stamp is ignored, and under lock-step an old one too."""
        if self._lockstep:
            self._add(self._filter, sample)
        else:
            self._filter.setdefault(sample.stamp_ns, sample)

    def _add(self, stream: dict, sample) -> None:
        if sample.stamp_ns > self._last_stamp_ns:
            stream.setdefault(sample.stamp_ns, sample)

    def take(self) -> List[TickRecord]:
        """Records that are complete and whose predecessors have all been taken.

        Raises:
            LostRecordError: lock-step only, MAX_TICKS_AHEAD complete records wait for one that has not come.
        """
        return self._take_exact() if self._lockstep else self._take_as_of()

    def _take_exact(self) -> List[TickRecord]:
        common = self._odometry.keys() & self._truth.keys() & self._filter.keys()
        by_tick = {self._filter[stamp].tick: stamp for stamp in common}
        records = []
        while self._next_tick in by_tick:
            records.append(self._pop(by_tick.pop(self._next_tick)))
            self._next_tick += 1
        if len(by_tick) > MAX_TICKS_AHEAD:
            raise LostRecordError(f"tick {self._next_tick} never arrived, while tick {max(by_tick)} has")
        return records

    def _pop(self, stamp_ns: int) -> TickRecord:
        self._last_stamp_ns = max(self._last_stamp_ns, stamp_ns)
        return TickRecord(self._odometry.pop(stamp_ns), self._filter.pop(stamp_ns), self._truth.pop(stamp_ns))

    def _take_as_of(self) -> List[TickRecord]:
        records = []
        newest_filter_ns = max(self._filter, default=-1)
        newest_truth_ns = max(self._truth, default=-1)
        for stamp in sorted(self._odometry.keys() & self._truth.keys()):
            waited_s = (newest_truth_ns - stamp) * 1e-9
            if newest_filter_ns < stamp and waited_s < MAX_FILTER_LAG_S:
                break
            odometry, truth = self._odometry.pop(stamp), self._truth.pop(stamp)
            state = self._filter_as_of(stamp)
            if state is not None:
                records.append(TickRecord(odometry, state, truth))
            self._last_stamp_ns = stamp
        return records

    def _filter_as_of(self, stamp_ns: int) -> Optional[FilterSample]:
        older = [stamp for stamp in self._filter if stamp <= stamp_ns]
        if not older:
            return None
        newest = max(older)
        for stamp in older:
            if stamp != newest:
                del self._filter[stamp]
        return self._filter[newest]

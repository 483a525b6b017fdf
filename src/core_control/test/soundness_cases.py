# SPDX-License-Identifier: BSD-3-Clause
"""Episodes that try to drive a robot into unsafe cells, and the count of those that succeed; for tests and benches.

Random grids, nominal commands that are random or aimed at the nearest hazard, an exact plant, the shipped
``CbfFilter.step`` and nothing else. The truth is the robot's rectangle (or point) against the unsafe squares, ten times
in a control period.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, field, replace
from typing import Dict, List, Set, Tuple

import numpy as np
from control_support import (
    LENGTH_M,
    WIDTH_M,
    Driver,
    Plant,
    draw_safe_pose,
    make_grid,
    make_inputs,
    make_random_mask,
    start_anew,
)
from margin_filter import MarginFilter
from scipy.ndimage import distance_transform_edt

from core_control.barriers.half_planes import HalfPlaneBarrier
from core_control.cbf_filter import CbfFilter
from core_control.params import FilterParams
from core_control.proposal import scale_to_limits
from core_control.safety_field import SafetyField

CELLS, CELL_M = 60, 0.2
EPISODE_STEPS = 500
GRID_EVERY = 2  # ticks between two grids of a map that is revealed
SIGHT_M, REVEAL_SHARE, FLICKER_SHARE = 3.0, 0.2, 0.02
WRONG_LAG_S = 0.1
UNCHANGED = 1e-6  # m/s, rad/s: what a solver's rounding may change


@dataclass(frozen=True)
class Case:
    """What is driven, and by which parameters of the filter.

    Attributes:
        half_m: half length and width of the robot [m]; zeros for a point.
        params: changes to the profile's parameters.
        lag_s, delay_s: of the plant.
        lag_error_s: the plant's lag is wrong by plus or minus this, by turns.
        revealed: the map is revealed as the robot goes, and flickers.
    """

    half_m: Tuple[float, float] = (LENGTH_M / 2.0, WIDTH_M / 2.0)
    params: Dict[str, object] = field(default_factory=dict)
    lag_s: float = 0.0
    delay_s: float = 0.0
    lag_error_s: float = 0.0
    revealed: bool = False


# 1e-3 m: a disc needs a radius.
POINT = {"discs": [[0.0, 0.0, 1e-3]], "lag_s": 0.0}
LAG = {"lag_s": 0.3, "delay_s": 0.1}
CASES = {
    "point": Case((0.0, 0.0), POINT),
    "footprint": Case(params={"lag_s": 0.0}),
    "footprint_lag": Case(params=LAG, lag_s=0.3, delay_s=0.1),
    "footprint_lag_wrong_tau": Case(params=LAG, lag_s=0.3, delay_s=0.1, lag_error_s=WRONG_LAG_S),
    "revealed_map": Case(params={"lag_s": 0.08}, lag_s=0.08, revealed=True),
}
PROFILES = {
    "core": {"profile": "core"},
    "paper": {"profile": "paper", "alpha_per_s": 0.25, "output_rate_hz": 10.0, "max_vx_mps": 0.5},
}
DESIGNS = {
    "shipped": CbfFilter,
    "reference": lambda params: MarginFilter(params, CELL_M),
    "reference_slewed": lambda params: MarginFilter(params, CELL_M, slewed=True),
}


def make_case_params(case: Case, profile: str) -> FilterParams:
    """Parameters of the filter for a case; with a wrong lag both margins grow by |error| |v|max."""
    params = FilterParams.from_dict({**PROFILES[profile], **case.params})
    extra_m = case.lag_error_s * math.hypot(params.max_vx_mps, params.max_vy_mps)
    return replace(
        params, margin_m=params.margin_m + extra_m, verifier_margin_m=params.verifier_margin_m + extra_m
    )  # fmt: skip


class KnownMap:
    """What the filter is told of a world: all of it, or what has been revealed, with cells that flicker.

    A hazard is revealed as a whole the first time half a second of luck in sight of it says so: it may appear right
    before the robot. While it is hidden its cells are safe. Every grid, a share of the cells near the robot shows the
    opposite of what it is.
    """

    def __init__(self, truth: np.ndarray, revealed: bool, profile: str, rng: np.random.Generator):
        self._truth, self._revealed, self._profile, self._rng = truth, revealed, profile, rng
        self.field = self._make_field(truth)
        iy, ix, self._starts = _sort_into_parts(truth)
        self._cells, self._centres = (iy, ix), self.field.compute_centre(iy, ix)
        self._shown = np.zeros(len(self._starts), dtype=bool)

    def look(self, tick: int, pose: np.ndarray) -> bool:
        """Renew the field at a tick; whether it was renewed."""
        if not self._revealed or tick % GRID_EVERY:
            return False
        if len(self._starts):
            away_m = np.minimum.reduceat(np.hypot(*(self._centres - pose[:2]).T), self._starts)
            near = away_m <= SIGHT_M
            self._shown[near] |= self._rng.random(np.count_nonzero(near)) < REVEAL_SHARE
        known = np.zeros_like(self._truth)
        sizes = np.diff(self._starts, append=len(self._centres))
        known[self._cells] = np.repeat(self._shown, sizes)
        known ^= self._rng.random(known.shape) < FLICKER_SHARE * self._rng.integers(0, 2)
        self.field = self._make_field(known)
        return True

    _grids = 0  # the filter tells grids apart by their stamps

    def _make_field(self, unsafe: np.ndarray) -> SafetyField:
        self._grids += 1
        changes = {"stamp_s": float(self._grids)}
        if self._profile == "paper":
            inside = distance_transform_edt(unsafe) if not unsafe.all() else np.full(unsafe.shape, 1e3)
            outside = distance_transform_edt(~unsafe) if unsafe.any() else np.full(unsafe.shape, 1e3)
            changes["h_m"] = CELL_M * (outside - inside)
        return SafetyField(make_grid(unsafe, resolution_m=CELL_M, **changes))


def _sort_into_parts(truth: np.ndarray) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Unsafe cells (iy, ix) sorted by patches of 8 x 8 cells, and where each patch that has any begins."""
    iy, ix = np.nonzero(truth)
    patch = (iy // 8) * CELLS + ix // 8
    order = np.argsort(patch, kind="stable")
    return iy[order], ix[order], np.unique(patch[order], return_index=True)[1]


def find_overlapped(unsafe: np.ndarray, lo_m: np.ndarray, poses: np.ndarray, half_m: np.ndarray) -> Set[int]:
    """Flat indices of the unsafe cells that a rectangle overlaps at any of the poses (n, 3); -1: it left the grid.

    Exact, by separating axes, less 1 nm: touching is not overlapping.
    """
    half_m = np.maximum(np.asarray(half_m) - 1e-9, 0.0)
    c, s = np.cos(poses[:, 2:]), np.sin(poses[:, 2:])
    extent_m = np.hstack([np.abs(c) * half_m[0] + np.abs(s) * half_m[1], np.abs(s) * half_m[0] + np.abs(c) * half_m[1]])
    size = np.array(unsafe.shape[::-1])
    low_m, high_m = (poses[:, :2] - extent_m).min(axis=0), (poses[:, :2] + extent_m).max(axis=0)
    found = {-1} if np.any(low_m < lo_m) or np.any(high_m > lo_m + CELL_M * size) else set()
    low = np.maximum(np.floor((low_m - lo_m) / CELL_M).astype(int) - 1, 0)
    high = np.minimum(np.floor((high_m - lo_m) / CELL_M).astype(int) + 2, size)
    iy, ix = np.nonzero(unsafe[low[1] : high[1], low[0] : high[0]])
    if not len(iy):
        return found
    iy, ix = iy + low[1], ix + low[0]
    # (poses, cells): the gap along the axes of the grid, then along those of the robot.
    x = lo_m[0] + CELL_M * (ix + 0.5) - poses[:, :1]
    y = lo_m[1] + CELL_M * (iy + 0.5) - poses[:, 1:2]
    apart = (np.abs(x) >= extent_m[:, :1] + CELL_M / 2.0) | (np.abs(y) >= extent_m[:, 1:] + CELL_M / 2.0)
    spread_m = CELL_M / 2.0 * (np.abs(c) + np.abs(s))
    apart |= np.abs(c * x + s * y) >= half_m[0] + spread_m
    apart |= np.abs(c * y - s * x) >= half_m[1] + spread_m
    found.update((iy * size[0] + ix)[~apart.all(axis=0)].tolist())
    return found


@dataclass
class Tally:
    """Sums over episodes.

    Attributes:
        steps: in all.
        violating_steps: in which the robot overlapped a cell that the filter knew to be unsafe.
        avoidable_violating_steps: of these, those that a stop at the first tick of knowledge would have spared.
        episodes, violating_episodes: of these.
        passed: steps whose command was sent unchanged.
        speed_sum_mps: sum of the speed sent.
        stopped: steps in which the filter gave a reason to stop.
        bad_seeds: of the episodes with a violating step, avoidable where the map is revealed.
    """

    steps: int = 0
    violating_steps: int = 0
    avoidable_violating_steps: int = 0
    episodes: int = 0
    violating_episodes: int = 0
    passed: int = 0
    speed_sum_mps: float = 0.0
    stopped: int = 0
    bad_seeds: List[int] = field(default_factory=list)

    def add(self, other: Tally) -> None:
        """Add another one."""
        for name, value in vars(other).items():
            setattr(self, name, getattr(self, name) + value)


class Excuses:
    """The cells that no stop could have kept the robot out of: known too late."""

    def __init__(self, half_m: Tuple[float, float]):
        self._half_m = half_m
        self._known = self._excused = np.zeros(CELLS * CELLS, dtype=bool)

    def learn(self, unsafe: np.ndarray, lo_m: np.ndarray, stop_poses: np.ndarray) -> None:
        """Take the cells known from now on, and the poses of a stop that begins now."""
        known, ahead = unsafe.ravel(), np.zeros(unsafe.size, dtype=bool)
        ahead[list(find_overlapped(unsafe, lo_m, stop_poses, self._half_m) - {-1})] = True
        self._excused = known & (self._excused | (ahead & ~self._known))
        self._known = known

    def judge(self, overlapped: Set[int]) -> Tuple[bool, bool]:
        """Whether a known cell is overlapped, and whether one of them was avoidable."""
        hit = [cell for cell in overlapped if cell == -1 or self._known[cell]]
        return bool(hit), any(cell == -1 or not self._excused[cell] for cell in hit)


def slew(u: np.ndarray, u_wanted: np.ndarray, params: FilterParams) -> np.ndarray:
    """The next nominal command: within the limits, and changed no faster than waypoint_controller's default allows."""
    most = params.control_period_s * np.array([1.0, 1.0, 2.0])
    return u + np.clip(scale_to_limits(u_wanted, params.limits) - u, -most, most)


@functools.lru_cache(maxsize=None)
def make_filter(case_name: str, profile: str, design: str):
    """The filter of a case; to build its program takes as long as half an episode."""
    return DESIGNS[design](make_case_params(CASES[case_name], profile))


def run_episode(case_name: str, profile: str, seed: int, steps: int = EPISODE_STEPS, design: str = "shipped") -> Tally:
    """One episode; the same seed gives the same world, start and driver to every design.

    Args:
        case_name: key of CASES.
        profile: key of PROFILES.
        seed: of everything that is drawn.
        steps: of the control period.
        design: key of DESIGNS.
    """
    case, params = CASES[case_name], make_case_params(CASES[case_name], profile)
    rng = np.random.default_rng([606, seed])
    truth = make_random_mask(rng, CELLS)
    world = SafetyField(make_grid(truth, resolution_m=CELL_M))
    barrier = HalfPlaneBarrier(params.disc_array, params.alpha_per_s, 0.0, params.limits, 8)
    pose = draw_safe_pose(rng, world, lambda p: barrier.compute_clearance(world, p).h_m - params.margin_m)
    if pose is None:
        return Tally()
    filter_ = make_filter(case_name, profile, design)
    start_anew(filter_)
    lag_s = case.lag_s + (case.lag_error_s if seed % 2 else -case.lag_error_s)
    plant = Plant(pose, lag_s, round(case.delay_s / params.control_period_s), params.control_period_s)
    known, driver = KnownMap(truth, case.revealed, profile, rng), Driver(rng, params.limits)
    excuses = Excuses(case.half_m)
    tally, nominal = Tally(episodes=1, steps=steps), np.zeros(3)
    for tick in range(steps):
        if known.look(tick, plant.pose) or tick == 0:
            excuses.learn(known.field.unsafe, world.lo_m, plant.predict_stop())
        nominal = slew(nominal, driver.step(plant.pose, known.field), params)
        result = filter_.step(make_inputs(nominal, known.field, plant.pose, plant.twist))
        u = result.u_safe
        hit, avoidable = excuses.judge(find_overlapped(known.field.unsafe, world.lo_m, plant.step(u), case.half_m))
        tally.violating_steps += hit
        tally.avoidable_violating_steps += avoidable
        tally.passed += bool(np.abs(u - nominal).max() <= UNCHANGED)
        tally.speed_sum_mps += math.hypot(u[0], u[1])
        tally.stopped += bool(result.reason)
    tally.violating_episodes = int(tally.violating_steps > 0)
    if tally.avoidable_violating_steps if case.revealed else tally.violating_steps:
        tally.bad_seeds.append(seed)
    return tally

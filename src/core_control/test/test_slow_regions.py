# SPDX-License-Identifier: BSD-3-Clause
"""Slow regions: the robot is slow before and while it is in one, free beside it, and the smallest cap holds."""

import os

import numpy as np
import pytest
from control_support import Driver, Plant, make_field, make_inputs, make_params, make_slow_field

from core_control.cbf_filter import CbfFilter
from core_control.dynamics import place_discs
from core_control.modes import Reason
from core_control.proposal import Proposal
from core_control.safety_field import Boxes
from core_control.slow_regions import SlowRegions
from core_control.speed_cap import CapReason
from core_control.types import Clearance, Mode

SEED = int(os.environ.get("CORE_SEED", "0"))
AT_ONCE = {"max_acceleration_mps2": 100.0, "max_yaw_acceleration_radps2": 100.0}
PAPER = {"profile": "paper", "alpha_per_s": 0.25, "output_rate_hz": 10.0}
AHEAD = np.array([0.5, 0.0, 0.0])
REGION_M = ((1.5, 3.0), (-1.0, 1.0))
FIELD = make_slow_field(REGION_M)
# Front of the discs that cover the robot, before base_link [m].
FRONT_M = 0.367 + 0.3100


def get_speed(u):
    return float(np.hypot(u[0], u[1]))


def drive(params, field, u_nominal, x_m=0.0, ticks=200, lag_s=0.08, delay_s=0.0):
    """Results of a drive along x with what the plant did in each tick: poses and largest speed."""
    filter_, plant = CbfFilter(params), Plant((x_m, 0.0, 0.0), lag_s, round(delay_s / params.control_period_s))
    for _ in range(ticks):
        result = filter_.step(make_inputs(u_nominal, field, plant.pose, plant.twist))
        start_mps, poses = get_speed(plant.twist), plant.step(result.u_safe)
        yield result, poses, max(start_mps, get_speed(plant.twist))


def is_in_region(poses, region_m, params):
    """Whether a disc of the robot overlaps the rectangle at any of the poses."""
    centres = place_discs(poses, params.disc_array)
    low, high = np.array(region_m).T
    gap = np.maximum(np.maximum(low - centres, centres - high), 0.0)
    return bool(np.any(np.hypot(gap[..., 0], gap[..., 1]) < params.disc_array[:, 2] - 1e-6))


@pytest.mark.parametrize(("lag_s", "delay_s"), [(0.0, 0.0), (0.08, 0.0), (0.3, 0.1)])
def test_the_robot_has_slowed_down_when_it_enters_and_is_free_when_it_has_left(lag_s, delay_s):
    params = make_params(lag_s=lag_s, delay_s=delay_s)
    inside, before, after = 0, [], []
    for result, poses, speed_mps in drive(params, FIELD, AHEAD, -1.5, 500, lag_s, delay_s):
        if is_in_region(poses, REGION_M, params):
            inside += 1
            assert result.speed_cap_mps == pytest.approx(0.2)
            assert result.speed_cap_reason == CapReason.SLOW_REGION
            assert result.detail == "slowed to 0.2 m/s by AROUND(person)"
            assert get_speed(result.u_safe) <= 0.2 * (1.0 + 1e-9)
            assert speed_mps <= 0.2 + 0.05 * 0.3 + 1e-6
        elif not inside:
            before.append(speed_mps)
        else:
            after.append(result)
    assert inside > 200
    assert max(before) > 0.49, "it was fast before"
    assert any((result.mode, result.speed_cap_reason) == (Mode.NOMINAL, "") for result in after), "and free after"


def test_it_does_not_slow_down_before_it_must():
    last_free_m = max(
        poses[0, 0] for result, poses, _ in drive(make_params(), FIELD, AHEAD, ticks=80) if result.mode == Mode.NOMINAL
    )
    # One period and three lags at 0.5 m/s, the stop, and the distance between two samples.
    assert 0.0 <= REGION_M[0][0] - FRONT_M - last_free_m <= 0.5 * (0.05 + 0.24 + 0.08) + 0.05


@pytest.mark.parametrize(
    ("pose", "u"),
    [
        ((2.2, -1.8, 0.0), (0.5, 0.0, 0.0)),  # past it
        ((0.5, 0.0, 0.0), (-0.5, 0.0, 0.0)),  # away from it
        ((0.0, 3.0, 0.0), (0.5, 0.25, 0.8)),
    ],
)
def test_beside_a_slow_region_a_command_passes_untouched(pose, u):
    result = CbfFilter(make_params(**AT_ONCE)).step(make_inputs(u, FIELD, pose))
    assert (result.mode, result.speed_cap_mps) == (Mode.NOMINAL, np.inf)
    np.testing.assert_array_equal(result.u_safe, u)


@pytest.mark.parametrize("u", [(0.4, 0.0, 0.4), (0.4, 0.2, -0.8), (-0.5, 0.0, 0.1), (0.0, 0.25, 0.0)])
def test_inside_the_command_is_made_smaller_as_a_whole(u):
    result = CbfFilter(make_params(**AT_ONCE)).step(make_inputs(u, FIELD, (2.2, 0.0, 0.3)))
    np.testing.assert_allclose(result.u_safe, np.array(u) * 0.2 / get_speed(u))
    assert (result.mode, result.reason) == (Mode.FILTERED, "")


@pytest.mark.parametrize("u", [(0.0, 0.0, 0.8), (0.15, 0.0, 0.3), (0.0, 0.0, 0.0)])
def test_inside_slow_commands_and_turning_on_the_spot_pass(u):
    result = CbfFilter(make_params(**AT_ONCE)).step(make_inputs(u, FIELD, (2.2, 0.0, 0.3)))
    assert (result.mode, result.detail) == (Mode.NOMINAL, "")
    np.testing.assert_array_equal(result.u_safe, u)
    assert result.speed_cap_mps == pytest.approx(0.2)


def test_the_smallest_cap_under_the_footprint_holds():
    wide, narrow = make_slow_field(((-5, 5), (-5, 5)), 0.3), make_slow_field(((0.4, 0.6), (-0.1, 0.1)), 0.1)
    caps_mps = np.fmin(wide.grid.speed_cap_mps, narrow.grid.speed_cap_mps)
    field = make_field(np.zeros_like(wide.unsafe), speed_cap_mps=caps_mps)
    result = CbfFilter(make_params(**AT_ONCE)).step(make_inputs(AHEAD, field))
    assert result.detail == "slowed to 0.1 m/s by a slow region"
    np.testing.assert_allclose(result.u_safe, [0.1, 0.0, 0.0])


@pytest.mark.parametrize(
    ("age_s", "cap_mps", "reason"),
    [
        (9.0, 0.2, CapReason.SLOW_REGION),
        (13.5, 0.2 * np.hypot(0.5, 0.25), CapReason.CONSTRAINTS_AGE),
    ],
)
def test_of_age_and_region_the_smaller_cap_wins_and_is_named(age_s, cap_mps, reason):
    result = CbfFilter(make_params(**AT_ONCE)).step(make_inputs(AHEAD, FIELD, (2.2, 0, 0), constraints_age_s=age_s))
    assert (result.speed_cap_mps, result.speed_cap_reason) == (pytest.approx(cap_mps), reason)
    np.testing.assert_allclose(result.u_safe, [cap_mps, 0.0, 0.0])
    assert ("constraints are" in result.detail) == (reason == CapReason.CONSTRAINTS_AGE)


def test_a_cap_below_the_dead_band_is_rest_and_ends_outside():
    field = make_slow_field(REGION_M, 0.01)
    filter_ = CbfFilter(make_params(**AT_ONCE))
    resting = [filter_.step(make_inputs(AHEAD, field, (2.2, 0, 0))) for _ in range(3)]
    for result in resting:
        np.testing.assert_array_equal(result.u_safe, np.zeros(3))
        assert result.detail == "slowed to rest by AROUND(person)"
    turning = filter_.step(make_inputs((0, 0, 0.5), field, (2.2, 0, 0)))
    np.testing.assert_array_equal(turning.u_safe, (0, 0, 0.5))
    assert get_speed(filter_.step(make_inputs(AHEAD, field, (0, 0, 0))).u_safe) == 0.5


def test_the_cap_holds_while_the_footprint_leaves():
    result = CbfFilter(make_params(**AT_ONCE)).step(
        make_inputs((-0.5, 0, 0), FIELD, (REGION_M[0][0] - FRONT_M + 0.001, 0, 0), (-1.0, 0, 0))
    )
    assert result.speed_cap_reason == CapReason.SLOW_REGION
    assert get_speed(result.u_safe) == pytest.approx(0.2)


def test_fuzz_the_cap_found_is_that_of_every_cell_looked_at_one_by_one():
    """Regions of several caps beside and within each other, some of one cell, poses inside, outside and at the edge."""
    rng, params, found_count = np.random.default_rng([SEED, 12]), make_params(), 0
    regions = SlowRegions(params)
    for _ in range(40):
        caps_mps = np.full((60, 60), np.nan)
        for _ in range(rng.integers(1, 8)):
            (iy, ix), (ny, nx) = rng.integers(0, 58, 2), rng.integers(1, 30, 2)
            caps_mps[iy : iy + ny, ix : ix + nx] = rng.choice([0.1, 0.2, 0.3, np.nan], p=[0.2, 0.2, 0.5, 0.1])
        field = make_field(np.zeros((60, 60), bool), speed_cap_mps=caps_mps)
        iy, ix = np.nonzero(~np.isnan(caps_mps))
        low = field.compute_centre(iy, ix) - 0.05
        cells = Boxes(low, low + 0.1, iy * 60 + ix)
        for _ in range(10):
            pose, twist = np.append(rng.uniform(-3.5, 3.5, 2), rng.uniform(-np.pi, np.pi)), rng.uniform(-0.3, 0.3, 3)
            u, pending = rng.uniform(-1.0, 1.0, 3) * params.limits, [(rng.choice([-0.5, 0.5], 3), 0.5)]
            points = place_discs(regions._predict((pose, twist, pending), u), params.disc_array).reshape(-1, 2)
            radii_m = np.tile(regions._grown_radii_m, len(points) // 3)
            hit = (cells.compute_distance(points) < radii_m[:, None]).any(axis=0)
            expected = caps_mps[iy[hit], ix[hit]].min(initial=np.inf)
            found = regions.find(field, (pose, twist, pending), u)
            assert (np.inf if found is None else found[0]) == expected
            found_count += found is not None
    assert 100 < found_count < 390


@pytest.mark.parametrize("changes", [PAPER, {"enforce": False}])
def test_the_papers_profile_and_a_filter_that_is_off_know_no_slow_regions(changes):
    grid = FIELD.grid
    field = make_slow_field(REGION_M)
    object.__setattr__(field.grid, "h_m", np.full_like(grid.h_m, 10.0))
    result = CbfFilter(make_params(**changes)).step(make_inputs(AHEAD, field, (2.2, 0, 0)))
    np.testing.assert_array_equal(result.u_safe, AHEAD)
    assert (result.speed_cap_mps, result.speed_cap_reason) == (np.inf, "")


def test_a_profile_that_answers_faster_than_the_region_allows_never_reaches_the_robot():
    filter_ = CbfFilter(make_params())
    filter_._profile.propose = lambda _: Proposal(AHEAD, Clearance(1.0, np.zeros(2)))
    free, slow = (filter_.step(make_inputs(AHEAD, FIELD, (x_m, 0, 0))) for x_m in (-1.0, 2.2))
    assert free.mode == Mode.NOMINAL
    assert (slow.mode, slow.reason) == (Mode.STOPPED, Reason.INTERNAL_ERROR)
    np.testing.assert_array_equal(slow.u_safe, np.zeros(3))


def test_fuzz_whatever_is_asked_for_no_command_inside_is_faster_than_the_cap():
    rng, inside = np.random.default_rng([SEED, 11]), 0
    params = make_params()
    for _ in range(6):
        corner = rng.uniform(-2.0, 0.5, 2)
        region_m = np.stack([corner, corner + rng.uniform(0.3, 2.0, 2)], axis=1)
        cap_mps = rng.uniform(0.05, 0.4)
        field = make_slow_field(region_m, cap_mps)
        low, high = (np.round(np.array(region_m).T / 0.1) * 0.1) + [[0.1], [-0.1]]  # cells that surely are slow
        plant = Plant(np.append(rng.uniform(-3, 3, 2), 0.0))
        filter_, driver = CbfFilter(params), Driver(rng, params.limits)
        for _ in range(200):
            u = driver.step(plant.pose, field)
            result = filter_.step(make_inputs(u, field, plant.pose, plant.twist))
            if is_in_region(plant.pose[None], np.stack([low, high], axis=1), params):
                inside += 1
                assert get_speed(result.u_safe) <= cap_mps * (1.0 + 1e-9)
                assert result.speed_cap_reason == CapReason.SLOW_REGION
            plant.step(result.u_safe)
    assert inside > 50

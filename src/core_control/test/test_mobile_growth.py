# SPDX-License-Identifier: BSD-3-Clause
"""What moves counts as nearer the older the grid is; what stands is measured as before, to the last bit."""

import os

import numpy as np
import pytest
from control_support import (
    AROUND_PERSON,
    CONE_LINE,
    Driver,
    Plant,
    make_field,
    make_inputs,
    make_params,
    make_random_mask,
    start_anew,
)

from core_control.barriers.half_planes import HalfPlaneBarrier, select_planes
from core_control.cbf_filter import CbfFilter
from core_control.mover_growth import MoverGrowth
from core_control.safety_field import Boxes
from core_control.types import Mode

SEED = int(os.environ.get("CORE_SEED", "0"))
PARAMS = make_params()
CAUSES = (CONE_LINE, AROUND_PERSON)
AHEAD = (0.4, 0.0, 0.0)


def make_mixed_field(rng, n=60, mobile_share=0.5):
    """Random unsafe cells in patches that stand or move."""
    unsafe = make_random_mask(rng, n)
    patch = rng.random((n // 6, n // 6)) < mobile_share
    moves = np.kron(patch, np.ones((6, 6), bool))
    cause = np.where(unsafe, moves.astype(np.uint16), 65535).astype(np.uint16)
    return make_field(unsafe, cause=cause, causes=CAUSES), unsafe & moves


def make_person(x_m, cause=AROUND_PERSON, **changes):
    """Something 0.4 m wide whose near side is x_m ahead."""
    unsafe = np.zeros((100, 100), bool)
    x = round((x_m + 5.0) / 0.1)
    unsafe[48:52, x : x + 4] = True
    return make_field(unsafe, causes=(cause,), **changes)


def compute_distance_to_cells(field, mask, points):
    """Distance to the squares of a mask, cell by cell."""
    centres = field.compute_centre(*np.nonzero(mask))
    gap = np.abs(points[:, None] - centres) - 0.5 * field.grid.resolution_m
    return np.linalg.norm(np.maximum(gap, 0.0), axis=2).min(axis=1, initial=np.inf)


@pytest.mark.parametrize("seed", range(8))
def test_fuzz_the_grown_distance_is_exact_outside_and_never_larger_inside(seed):
    rng = np.random.default_rng([SEED, seed])
    field, moves = make_mixed_field(rng)
    points, growth_m = rng.uniform(-3.2, 3.2, (300, 2)), rng.uniform(0.01, 0.6)
    before_m, after_m = field.compute_signed_distance(points), field.grow(growth_m).compute_signed_distance(points)
    expected_m = np.minimum(before_m, compute_distance_to_cells(field, moves, points) - growth_m)
    outside = before_m > 0.0
    np.testing.assert_allclose(after_m[outside], expected_m[outside], atol=1e-9)
    # Deep inside what moves the border cells decide; the depth in the union is a bound that holds.
    assert np.all(after_m <= before_m)
    assert np.all(after_m >= expected_m - 1e-9)
    assert np.any(after_m < before_m)


def test_fuzz_the_grown_distance_changes_no_faster_than_the_point_moves():
    rng = np.random.default_rng([SEED, 20])
    grown = make_mixed_field(rng)[0].grow(0.3)
    p = rng.uniform(-3.2, 3.2, (4000, 2))
    q = p + rng.normal(0.0, 0.05, p.shape)
    change = np.abs(grown.compute_signed_distance(p) - grown.compute_signed_distance(q))
    assert np.all(change <= np.linalg.norm(p - q, axis=1) + 1e-9)


def test_fuzz_planes_of_grown_cells_are_lower_bounds_and_leave_none_unguarded():
    rng = np.random.default_rng([SEED, 21])
    for _ in range(20):
        lo = rng.uniform(-2, 2, (60, 2))
        growth_m = np.where(rng.random(60) < 0.5, rng.uniform(0.0, 0.5), 0.0)
        boxes = Boxes(lo, lo + rng.uniform(0.05, 0.5, (60, 2)), np.arange(60), growth_m)
        centre = np.array([3.0, 3.0])
        planes = select_planes(centre, boxes, 60)
        points = rng.uniform(-4, 4, (1000, 2))
        distances_m = boxes.compute_distance(points)
        bounds_m = []
        for plane in planes:
            # The distance of the plane to the centre says where it lies.
            bounds_m.append((points - centre) @ plane.normal + plane.distance_m)
            assert np.all(bounds_m[-1] <= distances_m[:, plane.cell] + 1e-9)
        assert np.all(distances_m.min(axis=1) >= np.min(bounds_m, axis=0) - 1e-9)
        assert planes[0].distance_m == pytest.approx(boxes.compute_distance(centre[None]).min())


@pytest.mark.parametrize("growth_m", [0.0, -0.1])
def test_without_growth_or_without_movers_it_is_the_very_same_field(growth_m):
    field, _ = make_mixed_field(np.random.default_rng(1))
    assert field.grow(growth_m) is field
    still = make_field(make_random_mask(np.random.default_rng(1), 60))
    assert still.grow(0.5) is still


def test_rows_of_what_stands_are_untouched_to_the_last_bit():
    barrier = HalfPlaneBarrier(PARAMS.disc_array, 2.5, 0.15, PARAMS.limits, 8)
    compared = 0
    for seed in range(30):
        rng = np.random.default_rng([SEED, 30, seed])
        field, moves = make_mixed_field(rng, mobile_share=0.1)
        pose = np.append(rng.uniform(-2.5, 2.5, 2), rng.uniform(-np.pi, np.pi))
        points = pose[:2] + rng.uniform(-0.6, 0.6, (50, 2))
        if compute_distance_to_cells(field, moves, points).min() < 1.5:
            continue
        compared += 1
        grown = field.grow(0.1)
        assert grown is not field or not moves.any()
        np.testing.assert_array_equal(grown.compute_signed_distance(points), field.compute_signed_distance(points))
        before, after = barrier.compute_rows(field, pose), barrier.compute_rows(grown, pose)
        for name in ("a", "b", "cell", "point_m"):
            np.testing.assert_array_equal(getattr(after, name), getattr(before, name))
    assert compared >= 5


@pytest.mark.parametrize(("cause", "lost_m"), [(AROUND_PERSON, 0.12), (CONE_LINE, 0.0)])
def test_h_falls_with_the_age_of_the_grid_for_what_moves_alone(cause, lost_m):
    field = make_person(1.5, cause)
    new, old = (CbfFilter(PARAMS).step(make_inputs(AHEAD, field, grid_age_s=age_s)) for age_s in (0.0, 0.12))
    assert new.h_m - old.h_m == pytest.approx(lost_m, abs=1e-12)


@pytest.mark.parametrize("changes", [{"mobile_speed_mps": 0.0}, {"profile": "paper", "alpha_per_s": 0.25}])
def test_growth_can_be_switched_off_and_is_off_in_the_papers_profile(changes):
    field = make_person(1.5, h_m=np.ones((100, 100)))
    new, old = (
        CbfFilter(make_params(**changes)).step(make_inputs(AHEAD, field, grid_age_s=age_s)) for age_s in (0, 0.4)
    )
    assert new.h_m == old.h_m
    np.testing.assert_array_equal(new.u_safe, old.u_safe)


@pytest.mark.parametrize("age_s", [np.nan, -0.1, 1e9, np.inf])
def test_an_age_that_says_nothing_changes_h_by_no_more_than_the_timeout(age_s):
    field = make_person(1.5)
    now = CbfFilter(PARAMS).step(make_inputs(AHEAD, field))
    then = CbfFilter(PARAMS).step(make_inputs(AHEAD, field, grid_age_s=age_s))
    assert 0.0 <= now.h_m - then.h_m <= 0.5 + 1e-12


def test_an_old_grid_brings_the_robot_into_hold_without_moving_it():
    """The robot stands near a person and the map falls silent: h becomes negative by growth, and nothing moves."""
    field, filter_ = make_person(0.75), CbfFilter(PARAMS)
    for u_nominal in (np.zeros(3), np.array(AHEAD)):
        start_anew(filter_)
        results = [filter_.step(make_inputs(u_nominal, field, grid_age_s=age_s)) for age_s in np.arange(0.0, 0.5, 0.05)]
        assert results[0].h_m > 0.0 > results[-1].h_m
        assert results[-1].mode == Mode.HOLD
        for result in results:
            np.testing.assert_array_equal(result.u_safe, np.zeros(3))
    back = filter_.step(make_inputs((-0.1, 0, 0), field, grid_age_s=0.3))
    assert (back.mode, back.u_safe[0]) == (Mode.HOLD, -0.1)


def test_fuzz_the_verifier_lets_a_stop_pass_and_keeps_clear_of_what_has_grown():
    """Grids of 10 Hz with ages up to 0.15 s: the footprint's discs stay clear of what moves, grown by its age."""
    steps = 0
    for seed in range(6):
        rng = np.random.default_rng([SEED, 40, seed])
        field, _ = make_mixed_field(rng, 60)
        barrier = HalfPlaneBarrier(PARAMS.disc_array, 2.5, 0.15, PARAMS.limits, 8)
        grown = field.grow(0.15)
        poses = (np.append(rng.uniform(-2.7, 2.7, 2), rng.uniform(-np.pi, np.pi)) for _ in range(500))
        pose = next((p for p in poses if barrier.compute_clearance(grown, p).h_m > 0.06), None)
        if pose is None:
            continue
        filter_, plant, driver = CbfFilter(PARAMS), Plant(pose), Driver(rng, PARAMS.limits)
        filter_.step(make_inputs((0, 0, 0), field, pose, grid_age_s=0.15))
        for tick in range(120):
            age_s = 0.05 + 0.05 * (tick % 3)
            inputs = make_inputs(driver.step(plant.pose, field), field, plant.pose, plant.twist, grid_age_s=age_s)
            for pose in plant.step(filter_.step(inputs).u_safe):
                assert barrier.compute_clearance(field.grow(age_s), pose).h_m >= -1e-9
            steps += 1
    assert steps >= 240


@pytest.mark.parametrize("ages_s", [(0.1,), (0.0, 0.05), (0.05, 0.1, 0.15), (0.05, 0.1, 0.05, 0.1, 0.15)])
def test_the_robot_does_not_stutter_before_a_person_while_grids_come_and_age(ages_s):
    field, filter_, plant = make_person(2.5), CbfFilter(PARAMS), Plant((0.0, 0.0, 0.0))
    sent = []
    for tick in range(200):
        age_s = ages_s[tick % len(ages_s)]
        result = filter_.step(make_inputs((0.5, 0, 0), field, plant.pose, plant.twist, grid_age_s=age_s))
        plant.step(result.u_safe)
        sent.append(result.u_safe[0])
    rises = np.diff(sent[40:])
    assert sent[40] == 0.5
    assert rises.max() <= PARAMS.alpha_per_s * 0.1 * 0.05 * 3.0 + 1e-9
    assert sent[-1] == 0.0
    assert np.count_nonzero(np.diff(np.array(sent[40:]) > 0.0)) == 1, "it comes to rest once"


def test_the_growth_rises_at_once_and_falls_back_slowly():
    growth, field = MoverGrowth(PARAMS), make_person(1.5)
    point = np.array([[1.0, 0.0]])
    found_m = []
    for age_s in (0.0, 0.15, *[0.05] * 25, 0.3):
        growth.update(age_s)
        found_m.append(0.5 - growth.apply(field).compute_signed_distance(point)[0])
    np.testing.assert_allclose(found_m[:3], [0.0, 0.15, 0.145], atol=1e-9)
    np.testing.assert_allclose(found_m[-2:], [0.05, 0.3], atol=1e-9)


def test_a_person_inside_a_barrier_that_stands_grows_out_of_it():
    unsafe = np.zeros((60, 60), bool)
    unsafe[25:35, 25:35] = True
    cause = np.where(unsafe, 0, 65535).astype(np.uint16)
    cause[28:32, 28:32] = 1
    field = make_field(unsafe, cause=cause, causes=CAUSES)
    point = np.array([[1.0, 0.0]])
    np.testing.assert_allclose(field.compute_signed_distance(point), [0.5])
    np.testing.assert_allclose(field.grow(0.2).compute_signed_distance(point), [0.5])
    np.testing.assert_allclose(field.grow(0.45).compute_signed_distance(point), [0.35])


def test_the_result_says_who_it_is_kept_from():
    result = CbfFilter(PARAMS).step(make_inputs(AHEAD, make_person(0.8), grid_age_s=0.1))
    assert result.binding.cause == AROUND_PERSON

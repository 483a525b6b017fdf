# SPDX-License-Identifier: BSD-3-Clause
"""Half-plane rows: lower bounds of the true distance, right slopes, nothing lost by dropping cells."""

import numpy as np
import pytest
from control_support import integrate_arc, make_field, make_random_mask, make_wall

from core_control.barriers.half_planes import HalfPlaneBarrier, select_planes
from core_control.params import FilterParams
from core_control.safety_field import Boxes

PARAMS = FilterParams()


def make_barrier(margin_m=0.15, rows_per_disc=8, discs=PARAMS.disc_array):
    return HalfPlaneBarrier(discs, PARAMS.alpha_per_s, margin_m, PARAMS.limits, rows_per_disc)


def draw_boxes(rng, n):
    lo = rng.uniform(-2, 2, (n, 2))
    return Boxes(lo, lo + rng.uniform(0.05, 0.5, (n, 2)), np.arange(n))


def draw_poses(seed, count=40):
    """Fields with random poses in them."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        field = make_field(make_random_mask(rng, 60))
        yield rng, field, np.append(rng.uniform(-2.9, 2.9, 2), rng.uniform(-np.pi, np.pi))


@pytest.mark.parametrize("seed", range(5))
def test_half_plane_is_a_lower_bound_of_the_distance_to_its_cell(seed):
    rng = np.random.default_rng(seed)
    boxes = draw_boxes(rng, 40)
    centre = rng.uniform(-3, 3, 2)
    if boxes.compute_distance(centre[None]).min() == 0.0:
        centre = np.array([3.0, 3.0])
    points = rng.uniform(-4, 4, (2000, 2))
    true_m = boxes.compute_distance(points)
    for plane in select_planes(centre, boxes, 40):
        bound_m = (points - plane.point_m) @ plane.normal
        assert np.all(bound_m <= true_m[:, plane.cell] + 1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_dropped_cells_lie_behind_a_plane_that_was_kept(seed):
    rng = np.random.default_rng(seed)
    boxes, centre = draw_boxes(rng, 60), np.array([3.0, 3.0])
    planes = select_planes(centre, boxes, 60)
    points = rng.uniform(-4, 4, (3000, 2))
    bounds_m = np.array([(points - plane.point_m) @ plane.normal for plane in planes])
    free = np.all(bounds_m > 0.0, axis=0)
    assert free.any()
    distance_m = boxes.compute_distance(points[free]).min(axis=1)
    assert np.all(distance_m >= bounds_m[:, free].min(axis=0) - 1e-9)


def test_infinite_boxes_give_finite_planes():
    field = make_field(np.zeros((10, 10), bool))
    planes = select_planes(np.array([0.1, 0.2]), field.unsafe_boxes, 8)
    assert sorted(round(plane.distance_m, 6) for plane in planes) == [0.3, 0.4, 0.6, 0.7]
    assert all(np.isfinite(plane.point_m).all() and np.isfinite(plane.normal).all() for plane in planes)


@pytest.mark.parametrize("disc", [(0.4, 0.0, 0.1), (0.0, 0.3, 0.1), (-0.3, -0.2, 0.1)])
def test_row_is_the_slope_of_the_distance(disc):
    """Finite difference: a . u of the nearest cell's row is the rate at which the clearance grows."""
    barrier, step_s, checked = make_barrier(discs=np.array([disc])), 1e-6, 0
    for rng, field, pose in draw_poses(1, 80):
        rows, u = barrier.compute_rows(field, pose), rng.uniform(-1, 1, 3)
        here, ahead, behind = (
            barrier.compute_clearance(field, integrate_arc(pose, u, at_s)) for at_s in (0.0, step_s, -step_s)
        )
        smooth = ahead.cell == behind.cell and np.allclose(ahead.gradient, behind.gradient, atol=1e-4)
        if len(rows) and smooth and here.h_m > -disc[2]:
            assert rows.cell[0] == here.cell
            assert rows.a[0] @ u == pytest.approx((ahead.h_m - behind.h_m) / (2.0 * step_s), abs=1e-4)
            checked += 1
    assert checked > 15


def test_gradient_is_the_slope_of_h():
    checked = 0
    for rng, field, pose in draw_poses(2, 60):
        barrier, step_m = make_barrier(), 1e-6
        here = barrier.compute_clearance(field, pose)
        direction = rng.normal(size=2)
        direction /= np.linalg.norm(direction)
        shift = np.append(direction, 0.0) * step_m
        ahead, behind = (barrier.compute_clearance(field, pose + sign * shift) for sign in (1, -1))
        if ahead.cell != behind.cell or not np.allclose(ahead.gradient, behind.gradient, atol=1e-4):
            continue
        slope = (ahead.h_m - behind.h_m) / (2.0 * step_m)
        assert slope == pytest.approx(here.gradient @ direction, abs=1e-4)
        checked += 1
    assert checked > 30


def test_zero_is_always_allowed():
    for _, field, pose in draw_poses(3):
        rows = make_barrier().compute_rows(field, pose)
        assert np.all(rows.b <= 0.0)
        assert len(rows) <= 3 * make_barrier().rows_per_disc


def test_rows_bound_the_shrinking_of_every_distance():
    """Straight motion that obeys the rows keeps d - margin >= (1 - alpha dt)(d - margin), for every cell."""
    period_s, checked = PARAMS.control_period_s, 0
    for rng, field, pose in draw_poses(4):
        barrier = make_barrier(rows_per_disc=64)
        before_m = barrier.compute_clearance(field, pose).h_m - 0.15
        if before_m < 0.0:
            continue
        rows = barrier.compute_rows(field, pose)
        for u in rng.uniform(-1, 1, (50, 3)) * [0.5, 0.25, 0.0]:
            if np.all(rows.a @ u >= rows.b):
                after_m = barrier.compute_clearance(field, integrate_arc(pose, u, period_s)).h_m - 0.15
                assert after_m >= (1.0 - PARAMS.alpha_per_s * period_s) * before_m - 1e-9
                checked += 1
    assert checked > 300


def test_closer_than_the_margin_only_motion_away_is_allowed():
    field = make_wall(1.0)
    rows = make_barrier().compute_rows(field, np.array([1.0 - 0.677 - 0.05, 0.0, 0.0]))
    assert np.all(rows.b == 0.0)
    assert np.all(rows.a @ [-0.1, 0.0, 0.0] >= 0.0)
    assert np.any(rows.a @ [0.1, 0.0, 0.0] < 0.0)
    assert np.all(rows.a @ [0.0, 0.1, 0.0] >= -1e-12)


def test_a_disc_inside_the_unsafe_set_may_only_leave_by_the_nearest_way():
    rows = make_barrier().compute_rows(make_wall(1.0), np.array([1.05 - 0.367, 0.0, 0.0]))
    front = rows.a[-1]
    np.testing.assert_allclose(front[:2], [-1.0, 0.0], atol=1e-9)


def test_without_any_safe_cell_nothing_moves():
    rows = make_barrier().compute_rows(make_field(np.ones((5, 5), bool)), np.zeros(3))
    for u in np.vstack([np.eye(3), -np.eye(3)])[[0, 1, 3, 4]]:
        assert np.any(rows.a @ u < 0.0)


def test_far_from_everything_there_are_no_rows():
    assert len(make_barrier().compute_rows(make_wall(4.0), np.zeros(3))) == 0


def test_as_few_rows_as_asked_for_and_the_nearest_ones():
    rng = np.random.default_rng(0)
    field = make_field(rng.random((60, 60)) < 0.1)
    few = make_barrier(rows_per_disc=2).compute_rows(field, np.zeros(3))
    assert len(few) <= 6

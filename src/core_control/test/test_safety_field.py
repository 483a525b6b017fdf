# SPDX-License-Identifier: BSD-3-Clause
"""The signed distance against a brute-force one, its slope, the grid's edge, causes, and malformed grids."""

import numpy as np
import pytest
from control_support import CONE_LINE, make_field, make_grid, make_random_mask

from core_control.exceptions import GridError
from core_control.safety_field import UNKNOWN_CAUSE, SafetyField
from core_control.types import NO_CELL, CellState


def compute_brute_force(field, point):
    """Signed distance from every cell square and the outside of the grid."""
    half = field.grid.resolution_m / 2.0
    ny, nx = field.unsafe.shape
    iy, ix = np.mgrid[:ny, :nx]
    centres = field.compute_centre(iy.ravel(), ix.ravel())
    distance = np.linalg.norm(np.maximum(np.abs(centres - point) - half, 0.0), axis=1)
    unsafe = field.unsafe.ravel()
    if field.is_inside(point[None])[0]:
        return -distance[~unsafe].min() if (~unsafe).any() else -np.inf
    to_edge = min((point - field.lo_m).min(), (field.hi_m - point).min())
    return min(distance[unsafe].min() if unsafe.any() else np.inf, to_edge)


@pytest.mark.parametrize("seed", range(10))
def test_signed_distance_is_exact(seed):
    rng = np.random.default_rng(seed)
    field = make_field(make_random_mask(rng, 40))
    points = rng.uniform(field.lo_m - 0.5, field.hi_m + 0.5, (60, 2))
    expected = [compute_brute_force(field, point) for point in points]
    np.testing.assert_allclose(field.compute_signed_distance(points), expected, atol=1e-9)


def test_signed_distance_never_changes_faster_than_the_point_moves():
    rng = np.random.default_rng(3)
    field = make_field(make_random_mask(rng))
    p = rng.uniform(-5.5, 5.5, (4000, 2))
    q = p + rng.normal(0.0, 0.05, p.shape)
    change = np.abs(field.compute_signed_distance(p) - field.compute_signed_distance(q))
    assert np.all(change <= np.linalg.norm(p - q, axis=1) + 1e-9)


def test_smallest_distance_overlooks_no_box():
    rng = np.random.default_rng(6)
    field = make_field(make_random_mask(rng))
    for spread_m in (0.0, 0.01, 0.1, 1.0, 5.0):
        points = rng.uniform(-4, 4, 2) + rng.normal(0.0, spread_m, (50, 2))
        expected = field.unsafe_boxes.compute_distance(points).min(axis=1)
        np.testing.assert_array_equal(field.unsafe_boxes.compute_smallest_distance(points), expected)


def test_outside_the_grid_is_unsafe():
    field = make_field(np.zeros((20, 20), bool))
    np.testing.assert_allclose(field.compute_signed_distance(np.array([[0.0, 0.0], [1.5, 0.0]])), [1.0, -0.5])
    assert field.is_inside(np.array([[1.01, 0.0], [0.0, -1.01], [0.0, 0.0]])).tolist() == [True, True, False]


def test_a_grid_without_safe_cells_is_infinitely_deep():
    field = make_field(np.ones((5, 5), bool))
    assert field.compute_signed_distance(np.zeros((1, 2)))[0] == -np.inf
    assert field.find_exit(np.zeros(2)) is None


@pytest.mark.parametrize(("policy", "expected"), [(True, True), (False, False)])
def test_unknown_follows_the_policy_of_the_message(policy, expected):
    state = np.full((3, 3), CellState.SAFE, np.uint8)
    state[1, 1] = CellState.UNKNOWN
    field = make_field(np.zeros((3, 3), bool), state=state, unknown_is_unsafe=policy)
    assert field.unsafe[1, 1] == expected


def test_cause_of_a_cell():
    unsafe = np.zeros((3, 3), bool)
    unsafe[1, 2] = True
    state = np.where(unsafe, CellState.UNSAFE, CellState.SAFE).astype(np.uint8)
    state[0, 0] = CellState.UNKNOWN
    field = make_field(unsafe, state=state)
    assert field.get_cause(1 * 3 + 2) == CONE_LINE
    assert field.get_cause(0) == UNKNOWN_CAUSE
    assert field.get_cause(NO_CELL) == UNKNOWN_CAUSE
    assert field.get_cause(4).rule == ""


@pytest.mark.parametrize(
    "changes",
    [
        {"resolution_m": 0.0},
        {"resolution_m": np.nan},
        {"origin_m": (np.nan, 0.0)},
        {"h_m": np.zeros((3, 4))},
        {"cause": np.zeros((4, 3), np.uint16)},
        {"state": np.full((3, 3), 7, np.uint8)},
        {"state": np.zeros((0, 3), np.uint8)},
        {"speed_cap_mps": np.zeros((3, 4))},
        {"speed_cap_mps": np.full((3, 3), -0.1)},
        {"speed_cap_mps": np.full((3, 3), np.inf)},
    ],
)
def test_a_grid_that_contradicts_itself_is_refused(changes):
    with pytest.raises(GridError):
        SafetyField(make_grid(np.zeros((3, 3), bool), **changes))


@pytest.mark.parametrize(("value", "finite"), [(np.nan, False), (-np.inf, False), (np.inf, True)])
def test_h_that_is_no_number_is_noticed(value, finite):
    h_m = np.ones((3, 3))
    h_m[2, 0] = value
    assert make_field(np.zeros((3, 3), bool), h_m=h_m).is_finite == finite

# SPDX-License-Identifier: BSD-3-Clause
"""Profile paper: the printed formulas, the closed form of their program, and what goes wrong with them."""

import numpy as np
import pytest
from control_support import make_field, make_grid, make_inputs, make_params

from core_control.barriers.sdf_gradient import SdfGradientBarrier
from core_control.cbf_filter import CbfFilter
from core_control.dynamics import compute_rotation
from core_control.safety_field import SafetyField
from core_control.types import Mode

RES_M = 0.2


def make_paper_field(unsafe):
    """Centre-to-centre distance to the nearest cell of the other kind, as the paper's profile of the map sends it."""
    field = SafetyField(make_grid(unsafe, resolution_m=RES_M))
    iy, ix = np.mgrid[: unsafe.shape[0], : unsafe.shape[1]]
    cells = np.column_stack([iy.ravel(), ix.ravel()])
    distance = np.linalg.norm(cells[:, None] - cells[None], axis=2)
    other = unsafe.ravel()[:, None] != unsafe.ravel()[None]
    h_m = np.where(other, distance, np.inf).min(axis=1).reshape(unsafe.shape) * RES_M
    return make_field(unsafe, resolution_m=RES_M, h_m=np.where(unsafe, -h_m, h_m), origin_m=field.lo_m)


def make_wall_field():
    unsafe = np.zeros((20, 20), bool)
    unsafe[:, 15:] = True
    return make_paper_field(unsafe)


def make_filter(**changes):
    return CbfFilter(make_params(profile="paper", alpha_per_s=0.25, output_rate_hz=10.0, **changes))


def test_h_is_looked_up_at_the_nearest_cell():
    field, barrier = make_wall_field(), SdfGradientBarrier(0.25)
    assert barrier.compute_clearance(field, np.array([0.69, 0.0, 0.0])).h_m == pytest.approx(0.4)
    assert barrier.compute_clearance(field, np.array([0.79, 0.0, 0.0])).h_m == pytest.approx(0.4)
    assert barrier.compute_clearance(field, np.array([0.81, 0.0, 0.0])).h_m == pytest.approx(0.2)


def test_gradient_is_the_printed_one_inside_the_safe_set():
    field, position = make_wall_field(), np.array([0.33, 0.17])
    clearance = SdfGradientBarrier(0.25).compute_clearance(field, np.append(position, 0.4))
    gap = position - clearance.point_m
    np.testing.assert_allclose(clearance.gradient, gap / np.linalg.norm(gap))
    assert clearance.point_m[0] == pytest.approx(1.1)


@pytest.mark.parametrize(("convention", "sign"), [("flipped", -1.0), ("printed", 1.0)])
def test_outside_the_safe_set_the_sign_flips_unless_printed_is_asked_for(convention, sign):
    clearance = SdfGradientBarrier(0.25, convention).compute_clearance(make_wall_field(), np.array([1.5, 0.1, 0.0]))
    assert clearance.h_m < 0.0
    assert np.sign(clearance.gradient[0]) == sign


def test_outside_the_grid_h_grows_towards_it():
    clearance = SdfGradientBarrier(0.25).compute_clearance(make_wall_field(), np.array([-3.0, 0.1, 0.0]))
    assert clearance.h_m == pytest.approx(-1.1)
    np.testing.assert_allclose(clearance.gradient, [1.0, 0.0], atol=1e-9)


def test_without_unsafe_cells_there_is_no_row():
    field = make_field(np.zeros((10, 10), bool), h_m=np.full((10, 10), np.inf))
    result = make_filter().step(make_inputs([0.4, 0.0, 0.0], field))
    assert result.mode == Mode.NOMINAL
    assert result.rows == 0


@pytest.mark.parametrize("solver", ["compiled", "cvxpy"])
@pytest.mark.parametrize("h_m", [-28.3, -np.inf])
def test_without_safe_cells_it_stops(h_m, solver):
    field = make_field(np.ones((10, 10), bool), h_m=np.full((10, 10), h_m))
    result = make_filter(solver=solver).step(make_inputs([0.4, 0.0, 0.0], field))
    assert (result.mode, result.reason) == (Mode.STOPPED, "solver_failed")
    np.testing.assert_array_equal(result.u_safe, np.zeros(3))


@pytest.mark.parametrize("solver", ["compiled", "cvxpy"])
def test_answer_is_the_closed_form_projection(solver):
    """u = u_nominal + max(b - a . u_nominal, 0) a, for |a| = 1."""
    rng, field, filter_ = np.random.default_rng(5), make_wall_field(), make_filter(solver=solver)
    for _ in range(40):
        pose = np.append(rng.uniform([-1.8, -1.8], [0.9, 1.8]), rng.uniform(-np.pi, np.pi))
        u_nominal = rng.uniform(-1, 1, 3) * [0.4, 0.2, 0.6]
        result = filter_.step(make_inputs(u_nominal, field, pose))
        clearance = SdfGradientBarrier(0.25).compute_clearance(field, pose)
        a = np.append(compute_rotation(pose[2]).T @ clearance.gradient, 0.0)
        expected = u_nominal + max(-0.25 * clearance.h_m - a @ u_nominal, 0.0) * a
        if np.all(np.abs(expected) <= [0.5, 0.25, 0.8]):
            np.testing.assert_allclose(result.u_safe, expected, atol=1e-4)


def test_outside_the_safe_set_it_moves_without_being_asked():
    """The paper calls u = 0 always feasible; for h < 0 it is not."""
    result = make_filter().step(make_inputs([0.0, 0.0, 0.0], make_wall_field(), (1.5, 0.1, 0.0)))
    assert result.mode == Mode.FILTERED
    assert result.u_safe[0] < -0.05


def test_the_point_robot_walks_into_an_unsafe_cell():
    """Reported failure: h of the nearest cell is never below one cell in the safe set, so the border is crossed."""
    filter_, field, pose = make_filter(), make_wall_field(), np.zeros(3)
    for _ in range(300):
        pose = pose + np.append(filter_.step(make_inputs([0.5, 0.0, 0.0], field, pose)).u_safe[:2], 0.0) * 0.1
        if field.is_inside(pose[None, :2])[0]:
            return
    raise AssertionError("the paper's plain form kept out of the unsafe cell")

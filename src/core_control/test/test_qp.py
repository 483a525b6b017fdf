# SPDX-License-Identifier: BSD-3-Clause
"""Optimality by residuals, both solvers, and answers that must be refused."""

import numpy as np
import pytest

from core_control.exceptions import SolverError
from core_control.qp import TOLERANCE, VelocityQp, satisfies
from core_control.slide import compute_slide_rows

WEIGHTS = np.array([1.0, 1.0, 0.5])
SOLVERS = ["clarabel", "daqp"]


def make_qp(solver, rows=8, boxed=True):
    return VelocityQp(rows, WEIGHTS, boxed, solver)


def draw_problem(rng):
    n = rng.integers(0, 8)
    a = rng.normal(size=(n, 3))
    return rng.uniform(-1, 1, 3), a, -rng.uniform(0.0, 0.2, n), (-rng.uniform(0.1, 1, 3), rng.uniform(0.1, 1, 3))


@pytest.mark.parametrize("solver", SOLVERS)
def test_no_admissible_command_is_closer(solver):
    """For a convex program: u is optimal iff grad(u) . (v - u) >= 0 for every admissible v."""
    rng, qp = np.random.default_rng(0), make_qp(solver)
    for _ in range(60):
        u_nominal, a, b, (lower, upper) = draw_problem(rng)
        u = qp.solve(u_nominal, a, b, (lower, upper))
        assert np.all(u >= lower)
        assert np.all(u <= upper)
        assert satisfies(u, a, b, 10 * TOLERANCE)
        others = rng.uniform(lower, upper, (3000, 3))
        others = np.concatenate([others, u + 0.05 * (others - u), np.zeros((1, 3))])
        others = others[np.all(others @ a.T >= b, axis=1)]
        slope = 2.0 * WEIGHTS**2 * (u - u_nominal)
        assert np.all((others - u) @ slope >= -5e-4)


def test_solvers_agree():
    rng, first, second = np.random.default_rng(1), make_qp("clarabel"), make_qp("daqp")
    for _ in range(100):
        u_nominal, a, b, box = draw_problem(rng)
        gap = first.solve(u_nominal, a, b, box) - second.solve(u_nominal, a, b, box)
        assert np.abs(gap).max() < 1e-3


@pytest.mark.parametrize("solver", SOLVERS)
def test_the_same_problem_has_the_same_answer_to_the_last_bit(solver):
    problem = draw_problem(np.random.default_rng(2))
    qp = make_qp(solver)
    first = qp.solve(*problem)
    qp.solve(*draw_problem(np.random.default_rng(3)))
    np.testing.assert_array_equal(qp.solve(*problem), first)


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("place", range(3))
def test_a_number_that_is_none_is_refused(solver, value, place):
    data = [np.ones(3), np.ones((1, 3)), -np.ones(1)]
    data[place] = data[place] * value
    with pytest.raises(SolverError):
        make_qp(solver).solve(*data)


@pytest.mark.parametrize("solver", SOLVERS)
def test_rows_that_contradict_each_other_are_refused(solver):
    a = np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])
    with pytest.raises(SolverError):
        make_qp(solver).solve(np.zeros(3), a, np.array([0.1, 0.1]))


def test_a_wrong_answer_of_the_solver_is_refused(monkeypatch):
    qp = make_qp("clarabel")
    monkeypatch.setattr(qp._problem, "solve", lambda **_: qp._u.save_value(np.array([0.5, 0.0, 0.0])))
    a, b = np.array([[-1.0, 0.0, 0.0]]), np.zeros(1)
    with pytest.raises(SolverError, match="breaks a row"):
        qp.solve(np.array([0.5, 0.0, 0.0]), a, b)
    with pytest.raises(SolverError, match="breaks a limit"):
        qp.solve(np.array([0.5, 0.0, 0.0]), -a, b, (-np.ones(3), np.full(3, 0.1)))


def test_slide_rows_allow_zero_and_the_nominal_command():
    rng = np.random.default_rng(4)
    for u_nominal in rng.uniform(-1, 1, (100, 3)) * rng.integers(0, 2, (100, 3)):
        rows = compute_slide_rows(u_nominal, WEIGHTS, 0.5)
        assert satisfies(np.zeros(3), rows.a, rows.b, 0.0)
        assert satisfies(u_nominal, rows.a, rows.b, 1e-12)


def test_slide_rows_bound_added_motion_by_progress():
    rows = compute_slide_rows(np.array([0.5, 0.0, 0.0]), WEIGHTS, 0.5)
    assert satisfies(np.array([0.2, 0.1, 0.0]), rows.a, rows.b)
    assert not satisfies(np.array([0.2, 0.11, 0.0]), rows.a, rows.b)
    assert not satisfies(np.array([0.0, 0.05, 0.0]), rows.a, rows.b)
    assert not satisfies(np.array([-0.1, 0.0, 0.0]), rows.a, rows.b)

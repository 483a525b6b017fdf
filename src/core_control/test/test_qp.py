# SPDX-License-Identifier: BSD-3-Clause
"""Optimality by residuals, both solvers, and answers that must be refused."""

import cvxpy as cp
import numpy as np
import pytest

from core_control.compiled_program import CompiledProgram
from core_control.exceptions import SolverError
from core_control.qp import TOLERANCE, VelocityQp, satisfies
from core_control.slide import compute_slide_rows

WEIGHTS = np.array([1.0, 1.0, 0.5])
SOLVERS = ["compiled", "cvxpy"]


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
    rng, first, second = np.random.default_rng(1), make_qp("compiled"), make_qp("cvxpy")
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
    qp = make_qp("compiled")
    monkeypatch.setattr(qp, "_find", lambda values: np.array([0.5, 0.0, 0.0]))
    a, b = np.array([[-1.0, 0.0, 0.0]]), np.zeros(1)
    with pytest.raises(SolverError, match="breaks a row"):
        qp.solve(np.array([0.5, 0.0, 0.0]), a, b)
    with pytest.raises(SolverError, match="breaks a limit"):
        qp.solve(np.array([0.5, 0.0, 0.0]), -a, b, (-np.ones(3), np.full(3, 0.1)))


def test_the_compiled_answer_is_exact_where_a_closed_form_exists():
    """One row, no limits: u = u_nominal + max(0, b - a . u_nominal) W^-2 a / |W^-1 a|^2."""
    rng, qp = np.random.default_rng(5), make_qp("compiled", rows=1, boxed=False)
    for _ in range(500):
        u_nominal, a = rng.uniform(-1, 1, 3), rng.normal(size=3)
        # Half of the rows are broken by next to nothing.
        b = rng.choice([rng.uniform(-0.5, 0.5), a @ u_nominal + 10.0 ** rng.uniform(-12, -5)])
        step = a / WEIGHTS**2
        exact = u_nominal + max(0.0, b - a @ u_nominal) * step / (a @ step)
        np.testing.assert_allclose(qp.solve(u_nominal, a[None], np.array([b])), exact, atol=1e-9)


def test_a_compiled_program_that_disagrees_with_cvxpy_is_not_used(monkeypatch):
    exact = CompiledProgram.solve
    monkeypatch.setattr(CompiledProgram, "solve", lambda self, values: exact(self, values) + 1.1e-4)
    with pytest.raises(SolverError, match="differ"):
        make_qp("compiled")


def test_a_row_without_coefficients_that_is_broken_is_refused():
    with pytest.raises(SolverError):
        make_qp("compiled").solve(np.zeros(3), np.zeros((1, 3)), np.ones(1), (-np.ones(3), np.ones(3)))


def compile_program(cost, constraints, u, parameters):
    return CompiledProgram(cp.Problem(cp.Minimize(cost), constraints), u, parameters)


def test_a_program_that_is_not_affine_in_its_parameters_is_refused():
    u, p, q = cp.Variable(2), cp.Parameter(2), cp.Parameter()
    with pytest.raises(SolverError, match="DPP"):
        compile_program(cp.sum_squares(u - p), [q * (p @ u) >= 0.0], u, [p, q])


def test_a_program_with_a_free_auxiliary_variable_is_refused():
    u, slack, p = cp.Variable(2), cp.Variable(), cp.Parameter(2)
    with pytest.raises(SolverError, match="auxiliary"):
        compile_program(cp.sum_squares(u - p) + cp.square(slack), [u[0] + slack >= 0.0], u, [p])


def test_a_program_with_an_equality_of_its_own_is_refused():
    u, p = cp.Variable(2), cp.Parameter(2)
    with pytest.raises(SolverError):
        compile_program(cp.quad_form(u, np.eye(2)) + p @ u, [u[0] == 0.0], u, [p])


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

# SPDX-License-Identifier: BSD-3-Clause
"""The quadratic program of the filter, written once in cvxpy, and the check every answer must pass."""

from __future__ import annotations

import time
from typing import Optional, Tuple

import cvxpy as cp
import numpy as np

from core_control.exceptions import SolverError

# Largest violation of a row or a limit that counts as rounding [m/s, m/s, rad/s].
TOLERANCE = 1e-6
# OSQP is left out on purpose: the step size it adapts depends on wall time, so its answers do not repeat.
SOLVERS = {"clarabel": cp.CLARABEL, "daqp": cp.DAQP}

Box = Tuple[np.ndarray, np.ndarray]
UNUSED_BOX: Box = (-np.ones(3), np.ones(3))


def satisfies(u: np.ndarray, a: np.ndarray, b: np.ndarray, tolerance: float = TOLERANCE) -> bool:
    """Whether a u >= b - tolerance holds for every row; false when anything is NaN."""
    return bool(np.all(a @ u >= b - tolerance))


class VelocityQp:
    """Change a wanted velocity as little as the rows allow.

        minimise   |W (u - u_nominal)|^2
        subject to a_i . u >= b_i for every row,   lower <= u <= upper (where boxed)

    The problem is built once with a fixed number of rows (unused ones are 0 . u >= -1) and obeys cvxpy's rules for
    parametrised programs (DPP), so that a solve is a substitution of numbers.

    Args:
        row_count: largest number of rows.
        weights: (3,) diagonal of W, > 0.
        boxed: whether the limits are part of the problem; the paper's form has none.
        solver: key of SOLVERS.

    Source: [CORE] control synthesis QP. Differs: W weighs rad/s against m/s; limits added (core only).
    """

    def __init__(self, row_count: int, weights: np.ndarray, boxed: bool, solver: str):
        """Build and solve once, so that the first tick pays nothing for it."""
        self._row_count, self._boxed, self._solver = row_count, boxed, SOLVERS[solver]
        self._u = cp.Variable(3)
        self._u_nominal, self._a, self._b = cp.Parameter(3), cp.Parameter((row_count, 3)), cp.Parameter(row_count)
        self._lower, self._upper = cp.Parameter(3), cp.Parameter(3)
        constraints = [self._a @ self._u >= self._b]
        if boxed:
            constraints += [self._u >= self._lower, self._u <= self._upper]
        cost = cp.sum_squares(cp.multiply(weights, self._u - self._u_nominal))
        self._problem = cp.Problem(cp.Minimize(cost), constraints)
        assert self._problem.is_dcp(dpp=True), "the problem must be parametrised so that cvxpy compiles it once"
        self.solve_time_s = 0.0
        self.solve(np.ones(3), np.zeros((0, 3)), np.zeros(0), UNUSED_BOX)

    def solve(self, u_nominal: np.ndarray, a: np.ndarray, b: np.ndarray, box: Optional[Box] = None) -> np.ndarray:
        """The minimiser (3,), checked.

        Args:
            u_nominal: (3,) [m/s, m/s, rad/s].
            a: (n, 3) left sides of the rows, n <= row_count.
            b: (n,) right sides.
            box: lower and upper limits, (3,) each; needed when boxed.

        Raises:
            SolverError: non-finite data, a status other than optimal, or an answer that breaks a row or a limit.
        """
        start_s = time.thread_time()
        try:
            u = self._solve(u_nominal, a, b, box or UNUSED_BOX)
        finally:
            self.solve_time_s = time.thread_time() - start_s
        return u

    def _solve(self, u_nominal: np.ndarray, a: np.ndarray, b: np.ndarray, box: Box) -> np.ndarray:
        if not all(np.isfinite(part).all() for part in (u_nominal, a, b, *box)):
            raise SolverError("the problem holds a number that is not finite")
        padded_a, padded_b = np.zeros((self._row_count, 3)), np.full(self._row_count, -1.0)
        padded_a[: len(b)], padded_b[: len(b)] = a, b
        self._u_nominal.value, self._a.value, self._b.value = u_nominal, padded_a, padded_b
        self._lower.value, self._upper.value = box
        try:
            self._problem.solve(solver=self._solver, warm_start=False)
        except (cp.error.SolverError, ValueError, ArithmeticError) as error:
            raise SolverError(f"{self._solver}: {error}") from error
        u = self._check(self._u.value, a, b)
        return self._check_limits(u, a, b, box) if self._boxed else u

    def _check(self, u: Optional[np.ndarray], a: np.ndarray, b: np.ndarray) -> np.ndarray:
        if self._problem.status != cp.OPTIMAL:
            raise SolverError(f"{self._solver}: status {self._problem.status}")
        if u is None or u.shape != (3,) or not np.isfinite(u).all():
            raise SolverError(f"{self._solver}: answer {u} is not finite")
        if not satisfies(u, a, b):
            raise SolverError(f"{self._solver}: answer breaks a row by {float(np.max(b - a @ u)):.3g} m/s")
        return np.array(u)

    def _check_limits(self, u: np.ndarray, a: np.ndarray, b: np.ndarray, box: Box) -> np.ndarray:
        lower, upper = box
        beyond = float(np.max(np.maximum(lower - u, u - upper)))
        if beyond > TOLERANCE:
            raise SolverError(f"{self._solver}: answer breaks a limit by {beyond:.3g}")
        clipped = np.clip(u, lower, upper)
        if not satisfies(clipped, a, b, 10.0 * TOLERANCE):
            raise SolverError(f"{self._solver}: answer breaks a row at its limit")
        return clipped

# SPDX-License-Identifier: BSD-3-Clause
"""The quadratic program of the filter, written once in cvxpy, and the check every answer must pass."""

from __future__ import annotations

import time
from typing import List, Optional, Tuple

import cvxpy as cp
import numpy as np

from core_control.compiled_program import CompiledProgram
from core_control.exceptions import SolverError

# Largest violation of a row or a limit that counts as rounding [m/s, m/s, rad/s].
TOLERANCE = 1e-6
# OSQP is left out on purpose: the step size it adapts depends on wall time, so its answers do not repeat.
CVXPY_SOLVER = cp.CLARABEL
# Programs on which both must agree before a compiled one is used, and the largest difference [m/s, rad/s].
CHECKED_PROGRAMS, LARGEST_DIFFERENCE = 200, 1e-4

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
    parametrised programs (DPP), so that a solve is a substitution of numbers. Compiled, it is solved without cvxpy, 50
    times as fast; before that is relied on, both must agree on random programs.

    Args:
        row_count: largest number of rows.
        weights: (3,) diagonal of W, > 0.
        boxed: whether the limits are part of the problem; the paper's form has none.
        solver: "compiled" or "cvxpy".

    Raises:
        SolverError: compiled and plain answers differ by more than LARGEST_DIFFERENCE.

    Source: [CORE] control synthesis QP. Differs: W weighs rad/s against m/s; limits added (core only).
    """

    def __init__(self, row_count: int, weights: np.ndarray, boxed: bool, solver: str):
        """Build, compile and check; the first tick pays for none of it."""
        self._row_count, self._boxed = row_count, boxed
        self._u = cp.Variable(3)
        u_nominal, a, b = cp.Parameter(3), cp.Parameter((row_count, 3)), cp.Parameter(row_count)
        constraints = [a @ self._u >= b]
        self._parameters = [u_nominal, a, b]
        if boxed:
            lower, upper = cp.Parameter(3), cp.Parameter(3)
            constraints += [self._u >= lower, self._u <= upper]
            self._parameters += [lower, upper]
        cost = cp.sum_squares(cp.multiply(weights, self._u - u_nominal))
        self._problem = cp.Problem(cp.Minimize(cost), constraints)
        self._find = self._solve_plainly
        if solver == "compiled":
            self._find = CompiledProgram(self._problem, self._u, self._parameters).solve
            self._compare()
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
        u = self._check(self._find(self._pad(u_nominal, a, b, box)), a, b)
        return self._check_limits(u, a, b, box) if self._boxed else u

    def _pad(self, u_nominal: np.ndarray, a: np.ndarray, b: np.ndarray, box: Box) -> List[np.ndarray]:
        padded_a, padded_b = np.zeros((self._row_count, 3)), np.full(self._row_count, -1.0)
        padded_a[: len(b)], padded_b[: len(b)] = a, b
        return [u_nominal, padded_a, padded_b, *(box if self._boxed else ())]

    def _solve_plainly(self, values: List[np.ndarray]) -> np.ndarray:
        """By cvxpy's own way."""
        if not all(np.isfinite(value).all() for value in values):
            raise SolverError("the problem holds a number that is not finite")
        for parameter, value in zip(self._parameters, values):
            parameter.value = value
        try:
            self._problem.solve(solver=CVXPY_SOLVER, warm_start=False)
        except (cp.error.SolverError, ValueError, ArithmeticError) as error:
            raise SolverError(f"{CVXPY_SOLVER}: {error}") from error
        if self._problem.status != cp.OPTIMAL:
            raise SolverError(f"{CVXPY_SOLVER}: status {self._problem.status}")
        return self._u.value

    def _compare(self) -> None:
        rng = np.random.default_rng(0)
        for _ in range(CHECKED_PROGRAMS):
            n = int(rng.integers(0, self._row_count + 1))
            box = (-rng.uniform(0.1, 1.0, 3), rng.uniform(0.1, 1.0, 3))
            values = self._pad(rng.uniform(-1.0, 1.0, 3), rng.normal(size=(n, 3)), -rng.uniform(0.0, 0.3, n), box)
            difference = float(np.abs(self._find(values) - self._solve_plainly(values)).max())
            if not difference <= LARGEST_DIFFERENCE:
                raise SolverError(f"compiled and plain answer differ by {difference:.3g} > {LARGEST_DIFFERENCE:g}")

    @staticmethod
    def _check(u: Optional[np.ndarray], a: np.ndarray, b: np.ndarray) -> np.ndarray:
        if u is None or u.shape != (3,) or not np.isfinite(u).all():
            raise SolverError(f"answer {u} is not finite")
        if not satisfies(u, a, b):
            raise SolverError(f"answer breaks a row by {float(np.max(b - a @ u)):.3g} m/s")
        return np.array(u)

    @staticmethod
    def _check_limits(u: np.ndarray, a: np.ndarray, b: np.ndarray, box: Box) -> np.ndarray:
        lower, upper = box
        beyond = float(np.maximum(lower - u, u - upper).max())
        if beyond <= 0.0:
            return u
        if beyond > TOLERANCE:
            raise SolverError(f"answer breaks a limit by {beyond:.3g}")
        clipped = np.clip(u, lower, upper)
        # Below the lower limit after that: the limits exclude each other.
        if np.any(clipped < lower) or not satisfies(clipped, a, b, 10.0 * TOLERANCE):
            raise SolverError("answer breaks a row or a limit at its limit")
        return clipped

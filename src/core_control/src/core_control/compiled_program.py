# SPDX-License-Identifier: BSD-3-Clause
"""A parametrised quadratic program of cvxpy, read once into matrices and solved by DAQP."""

from __future__ import annotations

import itertools
from typing import Sequence, Tuple

import cvxpy as cp
import daqp
import numpy as np
from scipy import sparse

from core_control.exceptions import SolverError

# Status of an optimal solution. Read first: otherwise DAQP returns whatever it had.
OPTIMAL = 1
# By how much an answer may break a row [its unit]; the default of 1e-6 would show in the command.
PRIMAL_TOLERANCE = 1e-10
# Largest relative error of a map that is affine but for rounding.
ROUNDING = 1e-9
PROBES = 5
REFUSED = "the problem cannot be compiled"


class CompiledProgram:
    """Solves a program without cvxpy in the way: minimise over u, given numbers for the parameters theta.

    cvxpy's canonical form holds u and auxiliary variables y that an equality ties to it:

        minimise 1/2 x'P x + q'x   subject to   E x = e,  F x <= g,     x = (u, y)
        y = Ey^-1 (e - Eu u)   =>   x = N u + p,   N = (1, -Ey^-1 Eu),  p = (0, Ey^-1 e)
        minimise 1/2 u'(N'P N) u + (N'(q + P p))'u   subject to   (F N) u <= g - F p

    What is left are affine maps of theta. They are found at the unit vectors and checked elsewhere; p is zero in u,
    where the coefficients of F depend on theta, so that F p stays affine.

    Args:
        problem: follows cvxpy's rules for parametrised programs (DPP), quadratic cost, linear constraints.
        variable: u, a vector; all other variables must follow from it.
        parameters: of the problem, in the order in which solve() takes their values.

    Raises:
        SolverError: the problem is not of this kind.

    Source: [DAQP] for the solver; the form is that of Problem.get_problem_data for OSQP.
    """

    def __init__(self, problem: cp.Problem, variable: cp.Variable, parameters: Sequence[cp.Parameter]):
        """Find the maps; takes about a millisecond for each number in the parameters."""
        self._problem, self._variable, self._parameters = problem, variable, list(parameters)
        if not problem.is_dcp(dpp=True):
            raise SolverError(f"{REFUSED}: it does not follow cvxpy's rules for parameters (DPP)")
        size = sum(parameter.size for parameter in self._parameters)
        self._hessian, self._shapes, base = self._reduce(np.zeros(size))
        columns = [self._reduce(unit)[2] - base for unit in np.eye(size)]
        self._base, self._slopes = base, sparse.csr_matrix(np.array(columns).T)
        self._check_affine(size)

    def solve(self, values: Sequence[np.ndarray]) -> np.ndarray:
        """The minimiser (n,).

        Args:
            values: of the parameters.

        Raises:
            SolverError: a value is not finite, or DAQP did not find an optimum.
        """
        theta = np.concatenate([np.ravel(value) for value in values])
        # DAQP takes NaN in a row for a row that holds, and says it found an optimum.
        if not np.isfinite(theta).all():
            raise SolverError("the problem holds a number that is not finite")
        f, a, b = self._split(self._base + self._slopes @ theta)
        # A row without coefficients holds by itself, or never: then no answer may be given.
        used = a.any(axis=1)
        if np.any(b[~used] < 0.0):
            raise SolverError("daqp: a row that no command changes is broken")
        a, b = np.ascontiguousarray(a[used]), b[used]
        free, kinds = np.full(len(b), -1e30), np.zeros(len(b), dtype=np.intc)
        u, _, status, _ = daqp.solve(self._hessian, f, a, b, free, kinds, primal_tol=PRIMAL_TOLERANCE)
        if status != OPTIMAL:
            raise SolverError(f"daqp: status {status}")
        return np.array(u)

    def _split(self, flat: np.ndarray) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
        n, m = self._shapes
        return flat[:n], flat[n : n + n * m].reshape(m, n), flat[n + n * m :]

    def _reduce(self, theta: np.ndarray) -> Tuple[np.ndarray, Tuple[int, int], np.ndarray]:
        """Hessian, (n, m), and (f, A, b) in one row, of the program for these parameters."""
        self._assign(theta)
        data, _, _ = self._problem.get_problem_data(cp.OSQP)
        first = data[cp.settings.PARAM_PROB].var_id_to_col[self._variable.id]
        n = self._variable.size
        own = np.arange(first, first + n)
        others = np.setdiff1d(np.arange(len(data["q"])), own)
        P, q, E, F = data["P"].toarray(), data["q"], _dense(data["A"]), _dense(data["F"])
        P = P + np.triu(P, 1).T if not np.any(np.tril(P, -1)) else P
        N, p = np.zeros((len(q), n)), np.zeros(len(q))
        N[own] = np.eye(n)
        if len(others):
            if E.shape[0] != len(others) or np.linalg.matrix_rank(E[:, others]) < len(others):
                raise SolverError(f"{REFUSED}: its auxiliary variables do not follow from the others")
            N[others] = -np.linalg.solve(E[:, others], E[:, own])
            p[others] = np.linalg.solve(E[:, others], data["b"])
        elif len(E):
            raise SolverError(f"{REFUSED}: it has equalities of its own")
        a, b = F @ N, data["G"] - F @ p
        return N.T @ P @ N, (n, len(b)), np.concatenate([N.T @ (q + P @ p), a.ravel(), b])

    def _assign(self, theta: np.ndarray) -> None:
        ends = list(itertools.accumulate(parameter.size for parameter in self._parameters))
        for parameter, end in zip(self._parameters, ends):
            parameter.value = theta[end - parameter.size : end].reshape(parameter.shape)

    def _check_affine(self, size: int) -> None:
        rng = np.random.default_rng(0)
        for theta in rng.uniform(-2.0, 2.0, (PROBES, size)):
            hessian, _, flat = self._reduce(theta)
            gap = np.abs(flat - (self._base + self._slopes @ theta)).max() + np.abs(hessian - self._hessian).max()
            if not gap <= ROUNDING * (1.0 + np.abs(flat).max()):
                raise SolverError(f"{REFUSED}: it is not affine in its parameters (off by {gap:.2g})")


def _dense(matrix) -> np.ndarray:
    return matrix.toarray() if sparse.issparse(matrix) else np.asarray(matrix)

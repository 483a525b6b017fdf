# SPDX-License-Identifier: BSD-3-Clause
"""A short run of every case of bench filter_fuzz, and proof that it finds a filter that lets bad input through."""

import os
from dataclasses import replace

import numpy as np
import pytest
from control_support import make_inputs, make_params, make_wall
from fuzz_cases import CASES, run_case

from core_control import cbf_filter, modes
from core_control.cbf_filter import CbfFilter
from core_control.exceptions import SolverError
from core_control.modes import Reason
from core_control.qp import VelocityQp
from core_control.types import Mode

SEED = int(os.environ.get("CORE_SEED", "0"))
NEVER = ("non_finite", "out_of_limit", "crashes", "moved_on_failed_check", "broken_rows")


def fuzz(case, count):
    return run_case((case, (SEED, 0), count))


def found(tally):
    return {name for name in NEVER if getattr(tally, name)}


@pytest.mark.parametrize("case", list(CASES))
def test_bad_input_never_moves_the_robot_and_never_crashes(case):
    count = 60 if "cvxpy" in case else 600
    tally = fuzz(case, count)
    assert not found(tally), (SEED, tally.examples)
    assert tally.inputs >= count
    assert tally.reached_program > 0.03 * count
    if not case.startswith("qp"):
        assert tally.must_stop > 0.2 * count
        assert tally.moved > 0.05 * count
    if case in ("core", "core_laggy"):
        assert tally.reached_verifier > 0.4 * count
        assert tally.internal_errors == 0, tally.reasons


def test_the_same_seed_gives_the_same_counts():
    assert fuzz("core", 100) == fuzz("core", 100)


def test_a_filter_that_does_not_look_at_its_inputs_is_found_out(monkeypatch):
    monkeypatch.setattr(cbf_filter, "find_stop", lambda inputs, params: None)
    assert found(fuzz("core", 300)) >= {"moved_on_failed_check"}
    assert found(fuzz("paper", 300)) >= {"moved_on_failed_check"}


@pytest.mark.parametrize("name", ["find_nominal_stop", "find_odometry_stop", "find_grid_stop"])
def test_one_check_left_out_is_found_out(monkeypatch, name):
    monkeypatch.setattr(modes, name, lambda inputs, params: None)
    assert found(fuzz("paper", 600)) & {"moved_on_failed_check", "crashes"}


def test_a_command_passed_on_when_the_program_fails_is_found_out(monkeypatch):
    monkeypatch.setattr(cbf_filter, "_stopped", lambda inputs, stop: pass_on(inputs, stop))
    assert found(fuzz("core", 300)) >= {"moved_on_failed_check", "out_of_limit"}


def pass_on(inputs, stop):
    return cbf_filter.FilterResult(Mode.STOPPED, make_zero_unless_vector(inputs), np.zeros(3), stop.reason, stop.detail)


def make_zero_unless_vector(inputs):
    u = inputs.u_nominal
    return u if u is not None and u.shape == (3,) and np.isfinite(u).all() else np.zeros(3)


def test_an_unchecked_answer_of_the_solver_is_found_out(monkeypatch):
    monkeypatch.setattr(VelocityQp, "_solve", lambda self, u, a, b, box: self._find(self._pad(u, a, b, box)))
    assert found(fuzz("qp", 1000)) >= {"broken_rows"}
    monkeypatch.setattr(VelocityQp, "_solve", lambda self, u, a, b, box: u)
    assert found(fuzz("qp", 300)) >= {"broken_rows", "out_of_limit", "non_finite"}


def test_an_exception_that_gets_out_is_found_out(monkeypatch):
    monkeypatch.setattr(CbfFilter, "_decide_checked", lambda self, inputs: 1 / 0)
    monkeypatch.setattr(CbfFilter, "latch", lambda self, detail: 1 / 0)
    assert found(fuzz("core", 50)) == {"crashes"}


# What fuzzing found.


@pytest.mark.parametrize("profile", ["core", "paper"])
@pytest.mark.parametrize("shape", [(), (0,), (1,), (4,), (1, 3), (3, 3)])
@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("u_nominal", Reason.NOMINAL_NOT_FINITE),
        ("pose", Reason.ODOMETRY_NOT_FINITE),
        ("twist", Reason.ODOMETRY_NOT_FINITE),
    ],
)
def test_a_vector_of_another_size_stops_with_a_reason(profile, shape, name, reason):
    alpha_per_s = 0.25 if profile == "paper" else 2.5
    filter_ = CbfFilter(make_params(profile=profile, alpha_per_s=alpha_per_s))
    inputs = replace(make_inputs((0.1, 0.0, 0.0), make_wall(3.0)), **{name: np.full(shape, 0.01)})
    result = filter_.step(inputs)
    assert (result.mode, result.reason) == (Mode.STOPPED, reason)
    assert not np.any(result.u_safe)


@pytest.mark.parametrize("rows_per_disc", [1, 3, 8])
def test_a_disc_without_a_way_out_is_held_by_the_program_whatever_the_number_of_rows(rows_per_disc):
    filter_ = CbfFilter(make_params(discs=[[0.0, 0.0, 0.3]], rows_per_disc=rows_per_disc))
    result = filter_.step(make_inputs((0.1, 0.0, 0.0), make_wall(-5.0)))
    assert (result.mode, result.reason) == (Mode.HOLD, "")
    assert not np.any(result.u_safe)


@pytest.mark.parametrize("upper", [-1e-308, -1e-9, -0.1])
@pytest.mark.parametrize("solver", ["compiled", "cvxpy"])
def test_limits_that_exclude_each_other_by_next_to_nothing_are_refused(solver, upper):
    qp = VelocityQp(1, np.ones(3), True, solver)
    with pytest.raises(SolverError):
        qp.solve(np.full(3, 0.1), np.zeros((0, 3)), np.zeros(0), (np.zeros(3), np.full(3, upper)))

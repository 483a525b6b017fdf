# SPDX-License-Identifier: BSD-3-Clause
"""The filter as a whole: laws on random input, modes and reasons, bad numbers, limits, rest."""

from dataclasses import replace

import numpy as np
import pytest
from control_support import (
    CONE_LINE,
    Plant,
    make_field,
    make_inputs,
    make_params,
    make_random_mask,
    make_wall,
    start_anew,
)

from core_control.barriers.half_planes import HalfPlaneBarrier
from core_control.cbf_filter import CbfFilter
from core_control.dynamics import compute_rotation
from core_control.exceptions import SolverError
from core_control.modes import ALL_REASONS, Reason
from core_control.types import Mode

PARAMS = make_params()
BARRIER = HalfPlaneBarrier(PARAMS.disc_array, PARAMS.alpha_per_s, PARAMS.margin_m, PARAMS.limits, PARAMS.rows_per_disc)
AHEAD = (0.5, 0.0, 0.0)
FRONT_M = 0.677


def draw_inputs(seed, count):
    """Inputs at rest, with the robot's clearance."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        field = make_field(make_random_mask(rng, 60))
        pose = np.append(rng.uniform(-2.8, 2.8, 2), rng.uniform(-np.pi, np.pi))
        inputs = make_inputs(rng.uniform(-1.2, 1.2, 3) * PARAMS.limits, field, pose)
        yield inputs, BARRIER.compute_clearance(field, pose).h_m


def assert_stopped(result, reason):
    assert (result.mode, result.reason) == (Mode.STOPPED, reason)
    assert result.detail
    np.testing.assert_array_equal(result.u_safe, np.zeros(3))


# Laws on random input.


@pytest.mark.parametrize("solver", ["compiled", "cvxpy"])
def test_answer_satisfies_every_row_and_limit(solver):
    filter_, changed = CbfFilter(make_params(solver=solver)), 0
    for inputs, _ in draw_inputs(0, 120):
        start_anew(filter_)
        result = filter_.step(inputs)
        assert result.mode in (Mode.NOMINAL, Mode.FILTERED, Mode.HOLD)
        rows = BARRIER.compute_rows(inputs.field, inputs.pose)
        assert np.all(rows.a @ result.u_safe >= rows.b - 2e-5)
        assert np.all(np.abs(result.u_safe) <= np.minimum(PARAMS.limits, PARAMS.accelerations * 0.05) + 1e-9)
        changed += result.binding is not None
    assert changed > 20


def test_safe_nominal_command_is_untouched_to_the_last_bit():
    filter_, passed = CbfFilter(make_params(max_acceleration_mps2=100.0, max_yaw_acceleration_radps2=100.0)), 0
    for inputs, h_m in draw_inputs(1, 120):
        inputs = replace(inputs, u_nominal=np.clip(inputs.u_nominal, -PARAMS.limits, PARAMS.limits))
        rows = BARRIER.compute_rows(inputs.field, inputs.pose)
        if h_m > 0.2 and np.all(rows.a @ inputs.u_nominal >= rows.b):
            result = filter_.step(inputs)
            assert result.mode == Mode.NOMINAL
            np.testing.assert_array_equal(result.u_safe, inputs.u_nominal)
            assert (result.reason, result.detail, result.binding) == ("", "", None)
            passed += 1
    assert passed > 10


def test_zero_stays_zero_wherever_the_robot_stands():
    filter_ = CbfFilter(PARAMS)
    for inputs, _ in draw_inputs(2, 60):
        result = filter_.step(replace(inputs, u_nominal=np.zeros(3)))
        np.testing.assert_array_equal(result.u_safe, np.zeros(3))


def test_same_inputs_same_outputs_to_the_last_bit():
    first, second = CbfFilter(PARAMS), CbfFilter(PARAMS)
    for inputs, _ in draw_inputs(3, 40):
        np.testing.assert_array_equal(first.step(inputs).u_safe, second.step(inputs).u_safe)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e308, -1e308])
@pytest.mark.parametrize(("name", "size"), [("u_nominal", 3), ("pose", 3), ("twist", 3)])
def test_a_bad_number_anywhere_never_reaches_the_robot(value, name, size):
    for entry in range(size):
        vector = np.array([0.4, 0.1, 0.2])
        vector[entry] = value
        result = CbfFilter(PARAMS).step(replace(make_inputs(AHEAD, make_wall(2.0)), **{name: vector}))
        assert np.isfinite(result.u_safe).all()
        assert np.all(np.abs(result.u_safe) <= PARAMS.limits)
        if not np.isfinite(value):
            assert_stopped(result, Reason.NOMINAL_NOT_FINITE if name == "u_nominal" else Reason.ODOMETRY_NOT_FINITE)


def test_fuzz_of_conflicting_rows_and_wild_numbers():
    rng, filter_ = np.random.default_rng(4), CbfFilter(PARAMS)
    wild = np.array([0.0, 1.0, -1.0, 1e-300, 1e9, 1e308, -1e308, np.nan, np.inf])
    for _ in range(300):
        field = make_field(rng.random((12, 12)) < rng.random(), resolution_m=float(rng.choice([0.05, 0.2, 0.5])))
        inputs = make_inputs(rng.choice(wild, 3), field, rng.choice(wild[:7], 3), rng.choice(wild, 3))
        inputs = inputs if rng.random() < 0.5 else replace(inputs, pose=rng.normal(size=3), twist=rng.normal(size=3))
        result = filter_.step(inputs)
        start_anew(filter_)
        assert np.isfinite(result.u_safe).all()
        assert np.all(np.abs(result.u_safe) <= PARAMS.limits + 1e-12)


# Modes and reasons.

MISSING = [
    ({"u_nominal": None, "nominal_age_s": np.nan}, Reason.WAITING_FOR_NOMINAL),
    ({"nominal_age_s": 0.31}, Reason.NOMINAL_STALE),
    ({"nominal_age_s": np.nan}, Reason.NOMINAL_STALE),
    ({"nominal_planar": False}, Reason.NOMINAL_NOT_PLANAR),
    ({"field": None}, Reason.GRID_MISSING),
    ({"grid_age_s": 0.51}, Reason.GRID_STALE),
    ({"field": None, "grid_problem": (Reason.GRID_MALFORMED, "h_m has 3 entries")}, Reason.GRID_MALFORMED),
    ({"pose": None, "twist": None}, Reason.ODOMETRY_MISSING),
    ({"odometry_age_s": 0.31}, Reason.ODOMETRY_STALE),
    ({"odometry_frame_id": "map"}, Reason.FRAME_MISMATCH),
    ({"constraints_age_s": np.nan}, Reason.CONSTRAINTS_MISSING),
    ({"constraints_age_s": 15.1}, Reason.CONSTRAINTS_STALE),
    ({"nominal_age_s": -0.21}, Reason.NOMINAL_STALE),
    ({"odometry_age_s": -3.0}, Reason.ODOMETRY_STALE),
    ({"grid_age_s": -np.inf}, Reason.GRID_STALE),
    ({"constraints_age_s": -60.0}, Reason.CONSTRAINTS_STALE),
]


@pytest.mark.parametrize(("changes", "reason"), MISSING)
def test_missing_or_stale_input_stops_with_its_reason_and_the_filter_goes_on_by_itself(changes, reason):
    filter_, good = CbfFilter(PARAMS), make_inputs((0.05, 0.0, 0.0), make_wall(3.0))
    assert_stopped(filter_.step(replace(good, **changes)), reason)
    assert filter_.step(good).mode == Mode.NOMINAL


def test_grid_with_a_nan_stops():
    h_m = np.ones((20, 20))
    h_m[19, 19] = np.nan
    result = CbfFilter(PARAMS).step(make_inputs(AHEAD, make_field(np.zeros((20, 20), bool), h_m=h_m)))
    assert_stopped(result, Reason.GRID_NOT_FINITE)


def test_constraints_may_be_switched_off():
    filter_ = CbfFilter(make_params(require_constraints=False))
    assert filter_.step(make_inputs((0.05, 0, 0), make_wall(3.0), constraints_age_s=np.nan)).mode == Mode.NOMINAL


def test_a_failed_solve_stops_for_one_tick():
    filter_ = CbfFilter(PARAMS)

    def fail(*_):
        raise SolverError("no answer")

    filter_._profile._qp.solve = fail
    near = make_inputs((0.1, 0, 0), make_wall(2.0), (2.0 - FRONT_M - 0.16, 0, 0))
    assert_stopped(filter_.step(near), Reason.SOLVER_FAILED)
    assert filter_.step(replace(near, u_nominal=np.array([-0.05, 0, 0]))).mode == Mode.NOMINAL


def test_an_exception_stops_until_reset():
    filter_, good = CbfFilter(PARAMS), make_inputs((0.05, 0, 0), make_wall(3.0))
    broken = replace(good, field=object())
    assert_stopped(filter_.step(broken), Reason.INTERNAL_ERROR)
    assert_stopped(filter_.step(good), Reason.INTERNAL_ERROR)
    filter_.reset()
    assert filter_.step(good).mode == Mode.NOMINAL


def test_a_map_that_began_anew_stops_until_reset():
    empty = np.zeros((100, 100), dtype=bool)
    before, after = (make_inputs((0.05, 0, 0), make_field(empty, history_start_s=start_s)) for start_s in (0.1, 20.0))
    filter_ = CbfFilter(PARAMS)
    assert filter_.step(before).mode == Mode.NOMINAL
    for inputs in (after, before, after):
        assert_stopped(filter_.step(inputs), Reason.MAP_LOST)
    filter_.reset()
    assert filter_.step(after).mode == Mode.NOMINAL


def test_after_a_jump_of_time_a_new_map_is_no_loss():
    empty = np.zeros((100, 100), dtype=bool)
    filter_ = CbfFilter(PARAMS)
    filter_.step(make_inputs((0.05, 0, 0), make_field(empty, history_start_s=0.1)))
    filter_.forget()
    assert filter_.step(make_inputs((0.05, 0, 0), make_field(empty, history_start_s=0.2))).mode == Mode.NOMINAL


def test_switched_off_it_passes_the_command_into_the_wall_and_still_reports_h():
    filter_ = CbfFilter(make_params(enforce=False))
    inputs = make_inputs((0.7, 0, 0), make_wall(2.0), (2.0 - FRONT_M - 0.01, 0, 0))
    result = filter_.step(inputs)
    assert result.mode == Mode.DISABLED
    np.testing.assert_array_equal(result.u_safe, [0.7, 0, 0])
    assert result.h_m == pytest.approx(0.01, abs=1e-3)
    assert_stopped(filter_.step(replace(inputs, u_nominal=np.array([np.nan, 0, 0]))), Reason.NOMINAL_NOT_FINITE)
    assert_stopped(filter_.step(replace(inputs, nominal_age_s=1.0)), Reason.NOMINAL_STALE)
    assert filter_.step(replace(inputs, field=None, grid_age_s=np.nan)).mode == Mode.DISABLED


def test_every_reason_is_a_stable_code():
    """Renaming a code breaks whoever reads cbf_filter/state; a new one is added here by its name."""
    nominal = "waiting_for_nominal nominal_stale nominal_not_finite nominal_not_planar nominal_publishers"
    grid = "grid_missing grid_stale grid_not_finite grid_malformed map_lost constraints_missing constraints_stale"
    odometry = "odometry_missing odometry_stale odometry_not_finite frame_mismatch"
    others = "solver_failed internal_error e_stop loop_overrun foreign_publisher deep_inside escape_failed"
    assert set(ALL_REASONS) == set(" ".join([nominal, grid, odometry, others]).split())
    assert len(set(ALL_REASONS)) == len(ALL_REASONS)


def test_the_binding_place_and_its_cause_are_named():
    result = CbfFilter(PARAMS).step(make_inputs(AHEAD, make_wall(2.0), (2.0 - FRONT_M - 0.16, 0.03, 0)))
    assert result.mode == Mode.FILTERED
    assert result.binding.cause == CONE_LINE
    np.testing.assert_allclose(result.binding.point_m, [2.0, 0.03], atol=1e-9)
    np.testing.assert_allclose(result.gradient, [-1.0, 0.0], atol=1e-9)
    assert "BETWEEN(traffic_cone)" in result.detail


@pytest.mark.parametrize(("scale", "expected_mps"), [(0.5, 0.05), (0.0, 0.0)])
def test_the_verifier_has_the_last_word(scale, expected_mps):
    filter_ = CbfFilter(PARAMS)
    filter_._profile._roll_out.find_scale = lambda *_: scale
    result = filter_.step(make_inputs((0.1, 0, 0), make_wall(4.0)))
    assert (result.mode, result.scale) == (Mode.FILTERED, scale)
    np.testing.assert_allclose(result.u_safe, [expected_mps, 0, 0])
    assert "verifier" in result.detail or not expected_mps
    assert result.binding.cause == CONE_LINE


# HOLD.


def test_inside_only_motion_away_passes():
    field, pose = make_wall(2.0), (2.0 - FRONT_M + 0.1, 0, 0)
    for u_nominal, passes in [((0.1, 0, 0), False), ((-0.1, 0, 0), True), ((0, 0.1, 0), True)]:
        result = CbfFilter(PARAMS).step(make_inputs(u_nominal, field, pose))
        assert result.mode == Mode.HOLD
        assert result.h_m == pytest.approx(-0.1, abs=1e-3)
        np.testing.assert_allclose(result.u_safe, u_nominal if passes else np.zeros(3), atol=1e-6)


def draw_inputs_inside(seed, count):
    """Inputs at rest with the footprint on unsafe cells that were there before the robot."""
    found = 0
    for inputs, h_m in draw_inputs(seed, 40 * count):
        if -1.0 < h_m < -0.01 and found < count:
            found += 1
            yield inputs


def test_in_hold_the_robot_never_moves_by_itself():
    filter_ = CbfFilter(make_params(underfoot_grids=0))
    for inputs in draw_inputs_inside(5, 60):
        start_anew(filter_)
        result = filter_.step(replace(inputs, u_nominal=np.zeros(3)))
        assert (result.mode, result.reason) == (Mode.HOLD, "")
        np.testing.assert_array_equal(result.u_safe, np.zeros(3))


def test_in_hold_what_passes_does_not_come_closer_and_a_way_out_passes():
    """Small commands at rest, against the true clearance after them: the law, then both of its sides."""
    filter_, passed, refused = CbfFilter(make_params(underfoot_grids=0)), 0, 0
    for inputs in draw_inputs_inside(6, 60):
        before = BARRIER.compute_clearance(inputs.field, inputs.pose)
        outward = np.append(compute_rotation(inputs.pose[2]).T @ before.gradient, 0.0) * 0.05
        for u, is_inward in ((outward, False), (-outward, True)):
            start_anew(filter_)
            plant, result = Plant(inputs.pose), filter_.step(replace(inputs, u_nominal=u))
            plant.step(result.u_safe)
            h_m = BARRIER.compute_clearance(inputs.field, plant.pose).h_m
            if not is_exempt(filter_):
                assert h_m > before.h_m - 1e-6
                refused += is_inward and not np.any(result.u_safe)
            passed += not is_inward and bool(np.any(result.u_safe))
    assert passed > 20
    assert refused > 10


def is_exempt(filter_):
    return len(filter_._keeper._underfoot) > 0


def test_a_robot_inside_walks_out_and_never_deeper():
    filter_, field = CbfFilter(make_params(underfoot_grids=0)), make_wall(2.0)
    plant, depths_m = Plant((2.2, 0, 0.1)), []
    for _ in range(120):
        result = filter_.step(make_inputs((-0.3, 0.0, 0.0), field, plant.pose, plant.twist))
        plant.step(result.u_safe)
        depths_m.append(result.h_m)
    assert depths_m[0] < -0.8
    assert np.all(np.diff(depths_m) > 0.0)
    assert depths_m[-1] > 0.5


# Output.


def test_growth_is_slewed_and_a_stop_is_not():
    filter_, free = CbfFilter(PARAMS), make_inputs(AHEAD, make_wall(4.0))
    speeds = [filter_.step(free).u_safe[0] for _ in range(6)]
    np.testing.assert_allclose(speeds, [0.1, 0.2, 0.3, 0.4, 0.5, 0.5])
    np.testing.assert_array_equal(filter_.step(replace(free, u_nominal=np.zeros(3))).u_safe, np.zeros(3))


def test_reversal_passes_zero_at_once():
    filter_, free = CbfFilter(PARAMS), make_inputs(AHEAD, make_wall(4.0))
    for _ in range(6):
        filter_.step(free)
    assert filter_.step(replace(free, u_nominal=-np.array(AHEAD))).u_safe[0] == pytest.approx(-0.1)


def test_a_command_beyond_the_limits_keeps_its_curvature():
    filter_ = CbfFilter(make_params(max_acceleration_mps2=100.0, max_yaw_acceleration_radps2=100.0))
    result = filter_.step(make_inputs((2.0, 0.0, 0.8), make_wall(4.0)))
    np.testing.assert_allclose(result.u_safe, [0.5, 0.0, 0.2])


@pytest.mark.parametrize("angle_rad", [0.0, 0.2, 0.5])
@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_pushed_against_a_barrier_it_comes_to_rest_and_stays(angle_rad, noise):
    rng, filter_, field = np.random.default_rng(0), CbfFilter(PARAMS), make_wall(2.0)
    plant, poses, commands = Plant((0.5, 0, angle_rad)), [], []
    for _ in range(500):
        pose = plant.pose + noise * rng.normal(size=3) * 0.004
        twist = plant.twist + noise * rng.normal(size=3) * 0.05
        result = filter_.step(make_inputs(AHEAD, field, pose, twist))
        plant.step(result.u_safe)
        poses.append(plant.pose)
        commands.append(result.u_safe)
    assert np.mean(np.any(commands[-200:], axis=1)) <= 0.02 * noise
    assert np.ptp(np.array(poses)[-200:, :2], axis=0).max() < 0.01
    corner_x_m = np.max(np.abs([0.55 * np.cos(poses[-1][2]), 0.25 * np.sin(poses[-1][2])]).sum())
    assert 0.1 < 2.0 - poses[-1][0] - corner_x_m < 0.35


def test_dead_band_leaves_small_safe_commands_alone():
    result = CbfFilter(PARAMS).step(make_inputs((0.01, 0, 0.01), make_wall(4.0)))
    np.testing.assert_array_equal(result.u_safe, [0.01, 0, 0.01])


def test_slow_commands_along_the_barrier_are_not_swallowed_for_ever():
    """The dead-band looks at what the barrier left of a command, and a free command ends the rest."""
    filter_, field = CbfFilter(PARAMS), make_wall(2.0)
    pose = (2.0 - FRONT_M - 0.151, 0, 0)
    np.testing.assert_array_equal(filter_.step(make_inputs(AHEAD, field, pose)).u_safe, np.zeros(3))
    np.testing.assert_array_equal(filter_.step(make_inputs((-0.03, 0, 0), field, pose)).u_safe, [-0.03, 0, 0])

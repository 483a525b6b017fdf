# SPDX-License-Identifier: BSD-3-Clause
"""Bases that cannot go sideways: every command is one they can follow, they stay out, and they get along walls."""

from dataclasses import replace

import numpy as np
import pytest
from control_support import (
    Driver,
    Plant,
    draw_safe_pose,
    footprint_overlaps,
    make_field,
    make_inputs,
    make_params,
    make_random_mask,
    make_wall,
    start_anew,
)

from core_control.barriers.half_planes import HalfPlaneBarrier
from core_control.cbf_filter import CbfFilter
from core_control.core_profile import CoreProfile
from core_control.exceptions import ParameterError
from core_control.kinematics import Kinematics
from core_control.modes import Reason
from core_control.params import FilterParams, WaypointParams
from core_control.proposal import Situation
from core_control.types import Mode
from core_control.waypoint_controller import WaypointController

RADIUS_M = 1.0
WHEELED = {
    "differential": {"kinematics": "differential"},
    "ackermann": {"kinematics": "ackermann", "min_turning_radius_m": RADIUS_M},
}
# One disc on the axle: the base has no lever on its turning but the discs ahead.
SMALL = {"footprint": {"length_m": 0.3, "width_m": 0.3, "disc_count": 1}}
AHEAD = (0.5, 0.0, 0.0)


def assert_can_follow(u, params):
    assert u[1] == 0.0
    if params.kinematics == "ackermann":
        assert params.min_turning_radius_m * abs(u[2]) <= abs(u[0]) + 1e-9


# Laws.


def draw_commands(count=500):
    return np.random.default_rng(0).uniform(-1.0, 1.0, (count, 3)) * [1.0, 0.5, 2.0]


def test_a_holonomic_base_follows_everything():
    kinematics = Kinematics(make_params())
    for u in draw_commands(20):
        assert kinematics.adapt(u) is u
        assert kinematics.allows(u)
        assert kinematics.describe(u) == ""
        assert len(kinematics.compute_rows(u)) == 0


@pytest.mark.parametrize("kind", sorted(WHEELED))
def test_adapted_commands_can_be_followed_and_keep_their_speed(kind):
    params = make_params(**WHEELED[kind])
    kinematics = Kinematics(params)
    for u in draw_commands():
        adapted = kinematics.adapt(u)
        assert_can_follow(adapted, params)
        assert adapted[0] == u[0]
        assert 0.0 <= adapted[2] * np.sign(u[2]) <= abs(u[2])
        assert kinematics.adapt(adapted) is adapted
        assert kinematics.allows(adapted) and not kinematics.allows(u)
        assert "sideways" in kinematics.describe(u) and not kinematics.describe(adapted)


def test_differential_turns_on_the_spot_and_ackermann_does_not():
    turn = np.array([0.0, 0.0, 0.5])
    assert Kinematics(make_params(**WHEELED["differential"])).adapt(turn) is turn
    ackermann = Kinematics(make_params(**WHEELED["ackermann"]))
    np.testing.assert_array_equal(ackermann.adapt(turn), np.zeros(3))
    assert ackermann.describe(turn) == "turn limited to a radius of 1 m"


def test_rows_of_the_turning_radius_hold_exactly_for_what_can_be_followed():
    kinematics = Kinematics(make_params(**WHEELED["ackermann"]))
    for wanted, u in zip(draw_commands(), draw_commands()[::-1]):
        u = u * [1.0, 0.0, 1.0]
        rows = kinematics.compute_rows(kinematics.adapt(wanted))
        assert np.all(rows.b == 0.0)
        assert np.all(rows.a @ kinematics.adapt(wanted) >= 0.0)
        assert np.all(rows.a @ u >= 0.0) == (kinematics.allows(u) and u[0] * wanted[0] >= 0.0)


@pytest.mark.parametrize("kind", sorted(WHEELED))
@pytest.mark.parametrize("vx_mps", [-0.5, -0.1, 0.1, 0.5])
def test_discs_ahead_reach_the_look_ahead_distance_in_the_direction_of_travel(kind, vx_mps):
    params = make_params(**WHEELED[kind], **SMALL)
    discs, on_axle = Kinematics(params).place_discs(vx_mps)
    np.testing.assert_array_equal(discs[:1], params.disc_array)
    np.testing.assert_array_equal(discs[1:, 1:], np.repeat(params.disc_array[:, 1:], len(discs) - 1, axis=0))
    assert on_axle[0] and not on_axle[1:].any()
    reach_m = discs[1:, 0] * np.sign(vx_mps)
    assert reach_m.min() > 0.0
    assert reach_m.max() == pytest.approx(params.look_ahead_m * abs(vx_mps) / params.max_vx_mps)
    assert np.diff(np.concatenate([[0.0], reach_m])).max() <= 0.2 + 1e-9


def test_a_base_that_turns_on_the_spot_needs_its_own_discs_alone():
    params = make_params(**WHEELED["differential"])
    discs, on_axle = Kinematics(params).place_discs(0.0)
    np.testing.assert_array_equal(discs, params.disc_array)
    assert not on_axle.any()


def test_a_long_footprint_has_its_lever_itself():
    params = make_params(**WHEELED["differential"])
    kinematics = Kinematics(params)
    for vx_mps in (-0.5, 0.5):
        discs, _ = kinematics.place_discs(vx_mps)
        assert np.abs(discs[:, 0]).max() == np.abs(params.disc_array[:, 0]).max()
        assert len(np.unique(discs[:, 0])) == len(discs) == kinematics.disc_count


def test_limits_of_the_base_enter_those_of_the_command():
    np.testing.assert_array_equal(make_params().limits, [0.5, 0.25, 0.8])
    np.testing.assert_array_equal(make_params(kinematics="differential").limits, [0.5, 0.0, 0.8])
    np.testing.assert_array_equal(make_params(**WHEELED["ackermann"]).limits, [0.5, 0.0, 0.5])


def test_profile_paper_refuses_a_base_that_cannot_go_sideways():
    with pytest.raises(ParameterError, match="kinematics: got 'differential', allowed holonomic in profile paper"):
        FilterParams.from_dict({"profile": "paper", "alpha_per_s": 0.25, "kinematics": "differential"})


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"max_vy_mps": 0.0}, "max_vy_mps: got 0.0, allowed > 0 with kinematics holonomic"),
        ({"kinematics": "ackermann"}, "min_turning_radius_m: got 0.0, allowed > 0 with kinematics ackermann"),
    ],
)
def test_figures_that_the_kinematics_need_are_asked_for(values, message):
    with pytest.raises(ParameterError, match=message):
        FilterParams.from_dict(values)


# The filter as a whole.


def test_what_is_left_out_is_said():
    field = make_field(np.zeros((60, 60), dtype=bool))
    result = CbfFilter(make_params(kinematics="differential")).step(make_inputs((0.05, 0.1, 0.1), field))
    assert result.mode == Mode.FILTERED
    assert "sideways motion left out" in result.detail
    np.testing.assert_array_equal(result.u_safe, [0.05, 0.0, 0.1])


def test_a_sideways_command_does_not_slow_the_rest_of_it():
    field = make_field(np.zeros((60, 60), dtype=bool))
    result = CbfFilter(make_params(kinematics="differential")).step(make_inputs((0.05, 50.0, 0.1), field))
    np.testing.assert_array_equal(result.u_safe, [0.05, 0.0, 0.1])


@pytest.mark.parametrize("kind", sorted(WHEELED))
def test_a_command_it_can_follow_passes_to_the_last_bit(kind):
    field = make_field(np.zeros((60, 60), dtype=bool))
    result = CbfFilter(make_params(**WHEELED[kind])).step(make_inputs((0.09, 0.0, -0.07), field))
    assert result.mode == Mode.NOMINAL
    np.testing.assert_array_equal(result.u_safe, [0.09, 0.0, -0.07])


def test_a_start_at_full_lock_keeps_the_turning_radius():
    field = make_field(np.zeros((60, 60), dtype=bool))
    result = CbfFilter(make_params(**WHEELED["ackermann"])).step(make_inputs((0.5, 0.0, 0.5), field))
    np.testing.assert_allclose(result.u_safe, [0.1, 0.0, 0.1], atol=1e-12)


@pytest.mark.parametrize("kind", sorted(WHEELED))
def test_a_command_the_base_cannot_follow_is_never_sent(kind, monkeypatch):
    params = make_params(**WHEELED[kind])
    filter_ = CbfFilter(params)
    inputs = make_inputs((0.05, 0.0, 0.04), make_field(np.zeros((60, 60), dtype=bool)))
    propose = filter_._profile.propose
    wrong = {"differential": [0.05, 0.01, 0.0], "ackermann": [0.05, 0.0, 0.06]}[kind]
    monkeypatch.setattr(filter_._profile, "propose", lambda s: replace(propose(s), u=np.array(wrong)))
    result = filter_.step(inputs)
    assert (result.mode, result.reason, result.latched) == (Mode.STOPPED, Reason.INTERNAL_ERROR, True)
    np.testing.assert_array_equal(result.u_safe, np.zeros(3))


def draw_pushed(params, count):
    """Inputs of robots at rest before a wall of unsafe cells, pushed along it, into it or away from it."""
    kinematics, rng, field = Kinematics(params), np.random.default_rng(5), make_wall(3.0)
    reach_m = params.footprint.length_m / 2.0 + 0.5
    for _ in range(count):
        yaw_rad = rng.choice([-0.5, 0.5]) * np.pi + rng.uniform(-0.6, 0.6)
        pose = np.array([3.0 - rng.uniform(0.3, reach_m), rng.uniform(-2.0, 2.0), yaw_rad])
        wanted = np.array([rng.choice([-0.5, 0.5]), 0.0, rng.uniform(-0.5, 0.5)])
        yield make_inputs(kinematics.adapt(wanted), field, pose)


@pytest.mark.parametrize("kind", sorted(WHEELED))
@pytest.mark.parametrize("shape", [{}, SMALL], ids=["long", "small"])
def test_answer_satisfies_every_row_and_limit(kind, shape):
    fast = {"max_acceleration_mps2": 100.0, "max_yaw_acceleration_radps2": 100.0}
    params = make_params(**WHEELED[kind], **shape, **fast, lag_s=0.0)
    kinematics, bound = Kinematics(params), 0
    filter_ = CbfFilter(params)
    for inputs in draw_pushed(params, 300):
        field, pose, wanted = inputs.field, inputs.pose, inputs.u_nominal
        start_anew(filter_)
        result = filter_.step(inputs)
        discs, on_axle = kinematics.place_discs(wanted[0])
        margins_m = np.where(on_axle, params.verifier_margin_m, params.margin_m)
        rows = HalfPlaneBarrier(discs, params.alpha_per_s, margins_m, params.limits, 8).compute_rows(field, pose)
        assert np.all(rows.a @ result.u_safe >= rows.b - 2e-5)
        assert np.all(np.abs(result.u_safe) <= params.limits + 1e-9)
        assert_can_follow(result.u_safe, params)
        bound += bool(result.binding is not None and np.any(result.u_safe))
    assert bound > 10


# In closed loop.


def run_episode(seed, params, size_m, lag_s=0.08, delay_ticks=0, steps=200, follow=None):
    """(violating steps, moving steps, steps in which no barrier bound, reasons); every command is checked."""
    rng = np.random.default_rng([909, seed])
    field = make_field(make_random_mask(rng))
    barrier = HalfPlaneBarrier(params.disc_array, params.alpha_per_s, params.margin_m, params.limits, 8)
    pose = draw_safe_pose(rng, field, lambda p: barrier.compute_clearance(field, p).h_m)
    if pose is None:
        return np.zeros(3), set()
    filter_, driver = CbfFilter(params), Driver(rng, make_params().limits)
    plant = Plant(pose, lag_s, delay_ticks, params.control_period_s)
    counts, reasons = np.zeros(3), set()
    for _ in range(steps):
        result = filter_.step(make_inputs(driver.step(plant.pose, field), field, plant.pose, plant.twist))
        if params.kinematics != "holonomic":
            assert_can_follow(result.u_safe, params)
        if follow is not None:
            np.testing.assert_array_equal(result.u_safe, follow(result.u_safe))
        poses = plant.step(result.u_safe)[4::5]
        violated = any(footprint_overlaps(field, p, size_m=size_m) for p in poses)
        counts += [violated, np.any(result.u_safe), result.binding is None]
        reasons |= {result.reason} - {""}
    return counts, reasons


@pytest.mark.parametrize("kind", sorted(WHEELED))
@pytest.mark.parametrize(
    ("seeds", "shape", "size_m", "changes", "plant"),
    [
        (range(5), {}, (1.1, 0.5), {}, {}),
        (range(20, 25), SMALL, (0.3, 0.3), {}, {}),
        (range(40, 44), SMALL, (0.3, 0.3), {"lag_s": 0.3, "delay_s": 0.1}, {"lag_s": 0.3, "delay_ticks": 2}),
        (range(52, 55), SMALL, (0.3, 0.3), {"margin_m": 0.04, "alpha_per_s": 10.0}, {}),
    ],
    ids=["long", "small", "lag_and_delay", "small_margin"],
)
def test_it_never_enters_an_unsafe_cell(kind, seeds, shape, size_m, changes, plant):
    params = make_params(**WHEELED[kind], **shape, **changes)
    episodes = [run_episode(seed, params, size_m, **plant) for seed in seeds]
    violations, moved, passed = sum(counts for counts, _ in episodes)
    assert violations == 0
    assert moved > 0.5 * len(seeds) * 200
    assert passed > 0.4 * len(seeds) * 200
    assert set().union(*(reasons for _, reasons in episodes)) == set()


def drive_at_wall(params, angle_rad, u, ticks=200):
    """(final pose, speeds) of a robot pushed along u against the face x = 3 m, which it meets at an angle."""
    field, filter_ = make_wall(3.0, size_m=24.0), CbfFilter(params)
    yaw_rad = np.pi / 2.0 - angle_rad + (np.pi if u[0] < 0.0 else 0.0)
    plant, speeds = Plant((2.0, -6.0, yaw_rad), params.lag_s), []
    for _ in range(ticks):
        u_safe = filter_.step(make_inputs(u, field, plant.pose, plant.twist)).u_safe
        plant.step(u_safe)
        speeds.append(abs(u_safe[0]))
    return plant.pose, np.array(speeds)


@pytest.mark.parametrize("kind", sorted(WHEELED))
@pytest.mark.parametrize("shape", [{}, SMALL], ids=["long", "small"])
@pytest.mark.parametrize("u", [AHEAD, (-0.5, 0.0, 0.0)], ids=["forwards", "backwards"])
@pytest.mark.parametrize("angle_deg", [10.0, 20.0])
def test_follows_a_wall_it_meets_at_a_small_angle(kind, shape, u, angle_deg):
    params = make_params(**WHEELED[kind], **shape)
    pose, speeds = drive_at_wall(params, np.radians(angle_deg), u)
    assert np.degrees(np.arccos(abs(np.sin(pose[2])))) < 0.5
    assert pose[1] > -6.0 + 4.5
    assert speeds[-50:].min() > 0.49


@pytest.mark.parametrize("kind", sorted(WHEELED))
@pytest.mark.parametrize("shape", [{}, SMALL], ids=["long", "small"])
def test_rests_before_a_wall_it_meets_squarely(kind, shape):
    params = make_params(**WHEELED[kind], **shape)
    pose, speeds = drive_at_wall(params, np.radians(80.0), AHEAD)
    assert not speeds[-50:].any()
    assert 3.0 - pose[0] < 0.9


def drive_past_corner(params, radius_m, goal_y_m):
    """(reached, least clearance [m], seconds) on a way to (6, goal_y) that cuts a block in x -1..3, y -3..0."""
    unsafe = np.zeros((160, 160), dtype=bool)
    unsafe[50:80, 70:110] = True
    field, filter_ = make_field(unsafe), CbfFilter(params)
    waypoints = {"waypoints": [[6.0, goal_y_m]], "min_turning_radius_m": radius_m}
    controller = WaypointController(WaypointParams.from_dict(waypoints))
    plant, least_m = Plant((-2.0, 1.0, np.arctan2(goal_y_m - 1.0, 8.0)), params.lag_s), np.inf
    for tick in range(600):
        wanted = controller.step(plant.pose, tick * 0.05)
        if wanted.goal_reached:
            break
        result = filter_.step(make_inputs(wanted.u, field, plant.pose, plant.twist))
        plant.step(result.u_safe)
        least_m = min(least_m, result.h_m)
    return wanted.goal_reached, least_m, tick * 0.05


@pytest.mark.parametrize("kind", sorted(WHEELED))
@pytest.mark.parametrize("shape", [{}, SMALL], ids=["long", "small"])
@pytest.mark.parametrize("goal_y_m", [0.0, -0.4, -1.2])
def test_reaches_a_goal_past_a_corner_as_a_robot_does_that_walks_sideways(kind, shape, goal_y_m):
    reached, _, holonomic_s = drive_past_corner(make_params(**shape), 0.0, goal_y_m)
    assert reached
    radius_m = RADIUS_M if kind == "ackermann" else 0.0
    params = make_params(**WHEELED[kind], **shape)
    reached, least_m, wheeled_s = drive_past_corner(params, radius_m, goal_y_m)
    assert reached
    assert wheeled_s < holonomic_s + 1.0
    assert least_m > 0.1


# Bases that ignore small entries.

BANDS = {"dead_band_mps": 0.05, "dead_band_radps": 0.05}


def drop_small(u):
    """What a base with dead-bands of its own makes of a command."""
    return np.where(np.abs(u) < [0.05, 0.05, 0.05], 0.0, u)


def walk_along_wall(params, ticks=400):
    """Least clearance [m] of a robot that ignores small entries, pushed at 5 degrees against a face."""
    field, filter_, least_m = make_wall(3.0, size_m=40.0), CbfFilter(params), np.inf
    plant = Plant((2.0, -15.0, np.pi / 2.0 - np.radians(5.0)), params.lag_s)
    for _ in range(ticks):
        result = filter_.step(make_inputs(AHEAD, field, plant.pose, plant.twist))
        if params.dead_band_per_axis:
            np.testing.assert_array_equal(result.u_safe, drop_small(result.u_safe))
        plant.step(drop_small(result.u_safe))
        least_m = min(least_m, result.h_m)
    return least_m


def test_what_the_base_would_ignore_is_left_out_before_it_counts():
    assert walk_along_wall(make_params(**BANDS)) < 0.0
    assert walk_along_wall(make_params(**BANDS, dead_band_per_axis=True)) > 0.12


@pytest.mark.parametrize(("wall_m", "expected"), [(3.0, [0.25, 0.0, 0.0]), (0.6, [0.0, 0.0, 0.0])])
def test_what_is_left_after_scaling_is_verified_without_its_small_entries(monkeypatch, wall_m, expected):
    profile = CoreProfile(make_params(**BANDS, dead_band_per_axis=True))
    find_scale, scales = profile.roll_out.find_scale, [0.5]
    monkeypatch.setattr(profile.roll_out, "find_scale", lambda *args: scales.pop() if scales else find_scale(*args))
    situation = Situation(make_wall(wall_m), np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3), [])
    u, _ = profile.verify(situation, np.array([0.5, 0.06, 0.0]))
    np.testing.assert_array_equal(u, expected)


@pytest.mark.parametrize("kind", ["holonomic", *sorted(WHEELED)])
def test_a_base_that_ignores_small_entries_stays_out(kind):
    params = make_params(**WHEELED.get(kind, {}), **BANDS, dead_band_per_axis=True)
    for seed in range(4):
        counts, reasons = run_episode(seed, params, (1.1, 0.5), follow=drop_small)
        assert counts[0] == 0
        assert not reasons

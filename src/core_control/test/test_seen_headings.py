# SPDX-License-Identifier: BSD-3-Clause
"""Headings the camera has not looked along: slow there, free where it looks, forgotten with time and way."""

import os
from dataclasses import replace

import numpy as np
import pytest
from control_support import Plant, make_field, make_inputs, make_params, make_wall

from core_control.cbf_filter import CbfFilter
from core_control.params import WaypointParams
from core_control.seen_headings import SeenHeadings
from core_control.speed_cap import CapReason
from core_control.types import Mode
from core_control.waypoint_controller import WaypointController

SEED = int(os.environ.get("CORE_SEED", "0"))
FOV_RAD = 1.474
FORWARD = {"camera_fov_rad": FOV_RAD}
AT_ONCE = {"max_acceleration_mps2": 100.0, "max_yaw_acceleration_radps2": 100.0}
FREE = make_field(np.zeros((200, 200), bool))
DEG = np.pi / 180.0


def get_speed(u):
    return float(np.hypot(u[0], u[1]))


def renew(field, stamp_s):
    """The same field with a grid of another stamp."""
    return type(field)(replace(field.grid, stamp_s=stamp_s))


def see(headings, yaw_deg, stamp_s, place_m=(0.0, 0.0), yaw_rate_radps=0.0, **changes):
    pose = (*place_m, yaw_deg * DEG)
    field = renew(make_field(np.zeros((3, 3), bool)), stamp_s)
    headings.update(make_inputs((0, 0, 0), field, pose, (0, 0, yaw_rate_radps), **changes))


def seen_degrees(headings):
    return [degrees for degrees in range(-175, 185, 10) if headings.is_seen(degrees * DEG)]


# The memory by itself.


def test_at_first_nothing_is_seen_and_one_grid_shows_the_field_of_view():
    headings = SeenHeadings(make_params(**FORWARD))
    assert seen_degrees(headings) == []
    see(headings, 0, 1.0)
    assert seen_degrees(headings) == [-35, -25, -15, -5, 5, 15, 25, 35]


@pytest.mark.parametrize("yaw_deg", [-180, -95, 0, 170, 3600])
def test_the_view_turns_with_the_robot_and_lies_where_the_camera_points(yaw_deg):
    headings = SeenHeadings(make_params(**FORWARD, camera_yaw_rad=np.pi / 2))
    see(headings, yaw_deg, 1.0)
    assert headings.is_seen((yaw_deg + 90) * DEG)
    assert not headings.is_seen(yaw_deg * DEG)
    assert len(seen_degrees(headings)) in (8, 9)


def test_a_narrow_camera_sees_at_least_along_its_axis():
    rng = np.random.default_rng([SEED, 0])
    for yaw_deg in rng.uniform(-180, 180, 50):
        headings = SeenHeadings(make_params(camera_fov_rad=0.01))
        see(headings, yaw_deg, 1.0)
        assert headings.is_seen(yaw_deg * DEG)
        assert len(seen_degrees(headings)) <= 2


def test_an_all_round_camera_sees_every_heading_without_any_grid():
    assert len(seen_degrees(SeenHeadings(make_params()))) == 36


def test_the_heading_of_the_image_counts_not_that_of_the_tick():
    headings = SeenHeadings(make_params(**FORWARD))
    see(headings, 30, 1.0, yaw_rate_radps=0.5, grid_age_s=0.4)  # at 0.2 rad less when the image was taken
    assert (headings.is_seen(-20 * DEG), headings.is_seen(65 * DEG)) == (True, False)


def test_a_heading_is_forgotten_after_its_time():
    headings = SeenHeadings(make_params(**FORWARD, unseen_after_s=2.0))
    see(headings, 0, 1.0)
    for _ in range(40):
        see(headings, 180, 1.0)  # the same grid again: nothing new is seen
    assert headings.is_seen(0.0)
    see(headings, 180, 1.0)
    assert seen_degrees(headings) == []


def test_a_heading_is_forgotten_where_the_robot_is_far_from_the_place_it_looked_from():
    headings = SeenHeadings(make_params(**FORWARD))
    see(headings, 0, 1.0)
    see(headings, 90, 2.0, place_m=(0.0, 0.99))
    assert headings.is_seen(0.0)
    see(headings, 90, 3.0, place_m=(0.0, 1.01))
    assert (headings.is_seen(0.0), headings.is_seen(90 * DEG)) == (False, True)


@pytest.mark.parametrize(
    "changes",
    [{"grid_age_s": 0.6}, {"grid_age_s": np.nan}, {"field": None}, {"pose": None}, {"pose": np.full(3, np.nan)}],
)
def test_without_a_usable_grid_or_pose_nothing_is_seen(changes):
    headings = SeenHeadings(make_params(**FORWARD))
    headings.update(replace(make_inputs((0, 0, 0), FREE), **changes))
    assert seen_degrees(headings) == []


# The filter.


def step_all(filter_, commands, pose=(0.0, 0.0, 0.0), ticks_per_grid=2):
    field, results = FREE, []
    for tick, u in enumerate(commands):
        if tick % ticks_per_grid == 0:
            field = renew(FREE, 1.0 + tick)
        results.append(filter_.step(make_inputs(u, field, pose)))
    return results


@pytest.mark.parametrize("u", [(-0.5, 0, 0), (0, 0.25, 0), (0, -0.25, 0.5), (-0.3, 0.2, 0.1)])
def test_backwards_and_sideways_are_slow(u):
    for result in step_all(CbfFilter(make_params(**FORWARD, **AT_ONCE)), [u] * 5):
        np.testing.assert_allclose(result.u_safe, np.array(u) * 0.15 / get_speed(u))
        assert (result.speed_cap_mps, result.speed_cap_reason) == (0.15, CapReason.UNSEEN_HEADING)
        assert result.detail == "slowed to 0.15 m/s: the camera has not looked where it goes for 5 s"
        assert (result.mode, result.reason) == (Mode.FILTERED, "")


@pytest.mark.parametrize("u", [(0.5, 0, 0), (0.5, 0.2, 0.8), (0, 0, 0.8), (0, 0, -0.8), (-0.15, 0, 0.8), (0, 0, 0)])
def test_ahead_turning_on_the_spot_and_slow_commands_pass_untouched(u):
    for result in step_all(CbfFilter(make_params(**FORWARD, **AT_ONCE)), [u] * 5):
        assert result.mode == Mode.NOMINAL
        np.testing.assert_array_equal(result.u_safe, u)


def test_turning_on_the_spot_has_no_cap_even_where_nothing_ahead_was_seen():
    filter_ = CbfFilter(make_params(**FORWARD, **AT_ONCE, camera_yaw_rad=np.pi))
    turning, walking = step_all(filter_, [(0, 0, 0.8), (0.5, 0, 0)])
    assert (turning.mode, turning.speed_cap_reason) == (Mode.NOMINAL, "")
    assert walking.speed_cap_reason == CapReason.UNSEEN_HEADING


def test_backwards_is_free_where_the_robot_has_just_looked_and_slow_again_later():
    filter_ = CbfFilter(make_params(**FORWARD, **AT_ONCE))
    step_all(filter_, [(0, 0, 0)] * 2, (0, 0, np.pi))
    speeds = [get_speed(result.u_safe) for result in step_all(filter_, [(-0.5, 0, 0)] * 120, (0, 0, 0.0))]
    assert speeds[:98] == [0.5] * 98
    assert speeds[102:] == [pytest.approx(0.15)] * 18


@pytest.mark.parametrize("forget", ["forget", "reset"])
def test_a_jump_of_time_and_a_reset_forget_what_was_seen(forget):
    filter_ = CbfFilter(make_params(**FORWARD, **AT_ONCE))
    step_all(filter_, [(0, 0, 0)] * 2, (0, 0, np.pi))
    getattr(filter_, forget)()
    assert get_speed(step_all(filter_, [(-0.5, 0, 0)])[0].u_safe) == pytest.approx(0.15)


@pytest.mark.parametrize("u", [(-0.5, 0, 0), (-0.5, 0, 0.5)])
def test_a_cap_of_zero_lets_the_robot_stand_and_turn(u):
    filter_ = CbfFilter(make_params(**FORWARD, **AT_ONCE, unseen_speed_mps=0.0))
    result, turn = step_all(filter_, [u, (0, 0, 0.5)])
    np.testing.assert_array_equal(result.u_safe, np.zeros(3))
    assert result.detail.startswith("slowed to rest: the camera")
    np.testing.assert_array_equal(turn.u_safe, (0, 0, 0.5))


@pytest.mark.parametrize(
    "changes", [{"profile": "paper", "alpha_per_s": 0.25}, {"enforce": False}, {"camera_fov_rad": 6.2832}]
)
def test_it_is_off_in_the_papers_profile_without_enforcement_and_with_an_all_round_camera(changes):
    field = make_field(np.zeros((100, 100), bool), h_m=np.full((100, 100), 10.0))
    filter_ = CbfFilter(make_params(**{**FORWARD, **AT_ONCE, **changes}))
    result = filter_.step(make_inputs((-0.5, 0, 0), field))
    np.testing.assert_array_equal(result.u_safe, (-0.5, 0, 0))
    assert result.speed_cap_reason == ""


def test_sliding_out_of_view_is_slow():
    """Pushed along a wall with a heading that is in view; what the wall leaves of it is not."""
    field, params = make_wall(1.0), make_params(**{**FORWARD, **AT_ONCE, "camera_fov_rad": 0.9, "slide_ratio": 50.0})
    pose = (1.0 - 0.677 - 0.15, 0.0, 0.0)
    result = CbfFilter(params).step(make_inputs((0.5, 0.2, 0.0), field, pose))
    assert abs(np.arctan2(result.u_safe[1], result.u_safe[0])) > 0.6
    assert get_speed(result.u_safe) == pytest.approx(0.15)
    assert result.speed_cap_reason == CapReason.UNSEEN_HEADING


@pytest.mark.parametrize("goal", [(4.0, 0.0), (-4.0, 1.0), (0.0, -4.0), (-4.0, -0.1)])
def test_the_waypoint_controller_is_never_slowed(goal):
    """It turns on the spot and then walks ahead: the camera is there before the feet."""
    params = make_params(**FORWARD)
    filter_, plant = CbfFilter(params), Plant((0.0, 0.0, 0.0))
    controller, field, moved = WaypointController(WaypointParams.from_dict({"waypoints": [goal]})), FREE, 0
    for tick in range(300):
        if tick % 2 == 0:
            field = renew(FREE, 1.0 + tick)
        u = controller.step(plant.pose, 0.05 * tick).u
        result = filter_.step(make_inputs(u, field, plant.pose, plant.twist, grid_age_s=0.1 + 0.05 * (tick % 2)))
        assert result.speed_cap_reason == ""
        np.testing.assert_array_equal(result.u_safe, u)
        moved += get_speed(u) > 0.3
        plant.step(result.u_safe)
    assert moved > 50

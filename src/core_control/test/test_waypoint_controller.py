# SPDX-License-Identifier: BSD-3-Clause
"""The nominal controller in closed loop: reaches its waypoints in order, within its rates, and stops at the last."""

import math

import numpy as np
import pytest
from control_support import Plant

from core_control.params import WaypointParams
from core_control.waypoint_controller import Pid, WaypointController, is_inside_turn

PERIOD_S = 0.05


def run(waypoints, ticks=1500, start=(0.0, 0.0, 0.0), **changes):
    """(poses, commands) of a closed loop with lag."""
    controller = WaypointController(WaypointParams.from_dict({"waypoints": waypoints, **changes}))
    plant, poses, commands = Plant(start), [], []
    for k in range(ticks):
        command = controller.step(plant.pose, k * PERIOD_S)
        plant.step(command.u)
        poses.append(plant.pose)
        commands.append(command)
        if command.goal_reached:
            break
    return np.array(poses), commands


@pytest.mark.parametrize("goal", [[3.0, 0.0], [-2.0, 0.5], [0.0, -3.0], [1.0, 1.0]])
def test_reaches_the_goal_and_stops(goal):
    poses, commands = run([goal])
    assert commands[-1].goal_reached
    assert np.linalg.norm(poses[-1, :2] - goal) <= 0.2
    np.testing.assert_array_equal(commands[-1].u, np.zeros(3))


def test_passes_the_waypoints_in_order():
    waypoints = [[2.0, 0.0], [2.0, 2.0], [0.0, 2.0]]
    poses, commands = run(waypoints)
    assert commands[-1].goal_reached
    nearest = [np.linalg.norm(poses[:, :2] - waypoint, axis=1) for waypoint in waypoints]
    assert max(distance.min() for distance in nearest) <= 0.3
    first_visits = [int(np.argmax(distance <= 0.3)) for distance in nearest]
    assert first_visits == sorted(first_visits)


def test_speeds_and_their_growth_stay_within_the_limits():
    _, commands = run([[2.0, 0.0], [2.0, 2.0]], max_speed_mps=0.4, max_yaw_rate_radps=0.5)
    u = np.array([command.u for command in commands])
    assert u[:, 0].min() >= 0.0
    assert u[:, 0].max() <= 0.4 + 1e-12
    assert np.abs(u[:, 2]).max() <= 0.5 + 1e-12
    assert not u[:, 1].any()
    change = np.abs(np.diff(u[:-1], axis=0))
    assert change[:, 0].max() <= 1.0 * PERIOD_S + 1e-12
    assert change[:, 2].max() <= 2.0 * PERIOD_S + 1e-12


def test_turns_in_place_while_the_heading_error_is_large():
    controller = WaypointController(WaypointParams.from_dict({"waypoints": [[0.0, 3.0]]}))
    for k in range(20):
        u = controller.step(np.zeros(3), k * PERIOD_S).u
        assert u[0] == 0.0
    assert u[2] > 0.5


def test_distance_counts_the_waypoints_still_ahead():
    controller = WaypointController(WaypointParams.from_dict({"waypoints": [[1.0, 0.0], [1.0, 2.0]]}))
    assert controller.step(np.zeros(3), 0.0).distance_to_goal_m == pytest.approx(3.0)


def test_without_waypoints_it_stands_still():
    command = WaypointController(WaypointParams()).step(np.zeros(3), 0.0)
    np.testing.assert_array_equal(command.u, np.zeros(3))
    assert not command.goal_reached
    assert math.isnan(command.distance_to_goal_m)


def test_a_pose_that_is_no_number_gives_zero():
    controller = WaypointController(WaypointParams.from_dict({"waypoints": [[3.0, 0.0]]}))
    for k in range(10):
        controller.step(np.zeros(3), k * PERIOD_S)
    np.testing.assert_array_equal(controller.step(np.array([np.nan, 0, 0]), 1.0).u, np.zeros(3))


@pytest.mark.parametrize("stamp_s", [-5.0, 100.0])
def test_a_jump_of_time_starts_from_rest(stamp_s):
    controller = WaypointController(WaypointParams.from_dict({"waypoints": [[3.0, 0.0]]}))
    for k in range(20):
        controller.step(np.zeros(3), k * PERIOD_S)
    np.testing.assert_array_equal(controller.step(np.zeros(3), stamp_s).u, np.zeros(3))


def test_the_goal_stays_reached_until_new_waypoints_come():
    controller = WaypointController(WaypointParams.from_dict({"waypoints": [[0.1, 0.0]]}))
    assert controller.step(np.zeros(3), 0.0).goal_reached
    assert controller.step(np.array([2.0, 0.0, 0.0]), 0.05).goal_reached
    controller.set_waypoints([(3.0, 0.0)])
    assert not controller.step(np.zeros(3), 0.1).goal_reached


@pytest.mark.parametrize("waypoints", [[(np.nan, 0.0)], [(1.0, 2.0, 3.0)]])
def test_bad_waypoints_are_refused(waypoints):
    with pytest.raises(ValueError, match="finite pairs"):
        WaypointController(WaypointParams()).set_waypoints(waypoints)


def test_pid_keeps_its_integral_within_the_output():
    pid = Pid(1.0, 0.5, 0.1, 0.4)
    for _ in range(1000):
        assert pid.step(1.0, 0.05) == 0.4
    for _ in range(200):
        output = pid.step(-0.1, 0.05)
    assert output < 0.3


def test_pid_is_the_sum_of_its_three_parts():
    pid = Pid(2.0, 1.0, 0.5, 10.0)
    assert pid.step(0.1, 0.1) == pytest.approx(2.0 * 0.1 + 1.0 * 0.01)
    assert pid.step(0.2, 0.1) == pytest.approx(2.0 * 0.2 + 1.0 * 0.03 + 0.5 * 1.0)


@pytest.mark.parametrize("goal", [[3.0, 0.0], [-3.0, 0.5], [0.0, -3.0], [1.0, 1.0], [0.0, 0.8], [-0.5, 0.0]])
def test_with_a_turning_radius_it_reaches_the_goal_on_arcs(goal):
    poses, commands = run([goal], ticks=3000, min_turning_radius_m=1.0)
    assert commands[-1].goal_reached
    assert np.linalg.norm(poses[-1, :2] - goal) <= 0.2
    u = np.array([command.u for command in commands])
    assert u[:, 0].min() >= 0.0
    assert np.all(1.0 * np.abs(u[:, 2]) <= u[:, 0] + 1e-12)


def test_a_point_beside_the_robot_is_inside_the_turn_up_to_its_diameter():
    assert is_inside_turn(1.99, math.pi / 2.0, 1.0)
    assert not is_inside_turn(2.01, math.pi / 2.0, 1.0)
    assert not is_inside_turn(0.1, 0.0, 1.0)
    assert is_inside_turn(0.5, -math.pi / 6.0, 1.0)

# SPDX-License-Identifier: BSD-3-Clause
"""The kinematic world moves exactly as commanded, and the same commands give the same bits."""

import math

import numpy as np
import pytest

from core_bringup.kinematic_backend import KinematicBackend, integrate_twist
from core_bringup.params import find_robot_file
from core_bringup.robot import RobotConfig


@pytest.fixture
def backend():
    return KinematicBackend(RobotConfig.load(find_robot_file()))


def test_straight_line_and_quarter_circle_are_exact():
    np.testing.assert_allclose(integrate_twist([1, 2, math.pi / 2], [0.5, 0, 0], 2.0), [1, 3, math.pi / 2], atol=1e-15)
    radius = 0.4 / 0.8
    quarter = integrate_twist([0, 0, 0], [0.4, 0, 0.8], (math.pi / 2) / 0.8)
    np.testing.assert_allclose(quarter, [radius, radius, math.pi / 2], atol=1e-15)


def test_integral_agrees_with_small_euler_steps():
    rng = np.random.default_rng(4)
    for _ in range(20):
        pose, twist = rng.uniform(-2, 2, 3), rng.uniform(-1, 1, 3)
        steps, duration_s = 20000, 1.5
        theta = pose[2] + twist[2] * duration_s * (np.arange(steps) + 0.5) / steps
        dt = duration_s / steps
        x = pose[0] + dt * np.sum(np.cos(theta) * twist[0] - np.sin(theta) * twist[1])
        y = pose[1] + dt * np.sum(np.sin(theta) * twist[0] + np.cos(theta) * twist[1])
        np.testing.assert_allclose(
            integrate_twist(pose, twist, duration_s), [x, y, pose[2] + twist[2] * duration_s], atol=1e-8
        )


def test_one_step_equals_many_parts():
    pose = np.array([0.3, -0.2, 0.7])
    whole, parts = integrate_twist(pose, [0.3, 0.1, 0.5], 1.0), pose
    for _ in range(100):
        parts = integrate_twist(parts, [0.3, 0.1, 0.5], 0.01)
    np.testing.assert_allclose(parts, whole, atol=1e-13)


def test_tiny_yaw_rates_do_not_lose_the_line():
    for w in (0.0, 1e-300, 1e-18, 1e-9):
        np.testing.assert_allclose(integrate_twist([0, 0, 0], [0.5, 0.2, w], 1.0), [0.5, 0.2, w], atol=1e-9)


def test_state_is_that_of_a_level_robot(backend):
    backend.reset(np.array([1.0, 2.0, 0.5]))
    state = backend.step(np.array([0.3, -0.1, 0.2]), 0.05)
    assert state.time_s == pytest.approx(0.05, abs=1e-15)
    assert state.p_world_base[2] == 0.52
    np.testing.assert_array_equal(state.v_base, [0.3, -0.1, 0.0])
    np.testing.assert_array_equal(state.w_base, [0.0, 0.0, 0.2])
    assert np.linalg.norm(state.q_world_base) == pytest.approx(1.0)
    assert 2 * math.atan2(state.q_world_base[2], state.q_world_base[3]) == pytest.approx(0.51)
    assert len(state.joint_names) == len(state.joint_positions_rad) == len(state.joint_velocities_radps) == 12
    assert state.foot_contacts == (True,) * 4
    assert not state.fallen


def test_commands_are_clipped_to_the_limits_of_the_robot(backend):
    state = backend.step(np.array([9.0, -9.0, 9.0]), 0.1)
    np.testing.assert_array_equal([state.v_base[0], state.v_base[1], state.w_base[2]], [0.5, -0.25, 0.8])


def test_same_commands_give_the_same_bits_and_time_does_not_drift(backend):
    rng = np.random.default_rng(0)
    commands = rng.uniform(-1, 1, (2000, 3))

    def run():
        backend.reset(np.array([0.1, 0.2, 0.3]))
        return b"".join(
            backend.step(c, 0.05).p_world_base.tobytes() + backend.state.q_world_base.tobytes() for c in commands
        )

    assert run() == run()
    assert backend.state.time_s == 100.0


@pytest.mark.parametrize(
    ("command", "duration_s"),
    [
        ([0, 0], 0.05), ([0, 0, math.nan], 0.05), ([math.inf, 0, 0], 0.05), ([0, 0, 0], 0.0), ([0, 0, 0], -0.05),
        ([0, 0, 0], 1.23456789e-4), ([[0, 0, 0]], 0.05),
    ],
)  # fmt: skip
def test_bad_command_or_duration_is_refused_and_changes_nothing(backend, command, duration_s):
    before = backend.state
    with pytest.raises(ValueError, match=r"must be"):
        backend.step(np.array(command, dtype=float), duration_s)
    assert backend.state.time_s == before.time_s


@pytest.mark.parametrize("pose", [[0, 0], [0, 0, math.nan]])
def test_bad_start_is_refused(backend, pose):
    with pytest.raises(ValueError, match="start_pose"):
        backend.reset(np.array(pose, dtype=float))


def test_closing_twice_is_allowed(backend):
    backend.close()
    backend.close()

# SPDX-License-Identifier: BSD-3-Clause
"""Kinematics against finite differences and against a much finer integration."""

import numpy as np
import pytest
from control_support import integrate_arc, integrate_lag

from core_control.dynamics import compute_g, compute_rotation, place_discs, wrap_angle

RNG = np.random.default_rng(1)
CASES = [(RNG.uniform(-3, 3, 3), RNG.uniform(-1, 1, 3)) for _ in range(20)]


def integrate_euler(pose, u, duration_s, n=20000):
    pose = np.array(pose)
    for _ in range(n):
        pose = pose + compute_g(pose[2]) @ u * duration_s / n
    return pose


@pytest.mark.parametrize(("pose", "u"), CASES)
def test_g_is_the_derivative_of_the_exact_motion(pose, u):
    step_s = 1e-6
    slope = (integrate_arc(pose, u, step_s) - integrate_arc(pose, u, 0.0)) / step_s
    np.testing.assert_allclose(slope, compute_g(pose[2]) @ u, atol=1e-5)


@pytest.mark.parametrize(("pose", "u"), CASES[:3])
def test_arc_agrees_with_small_euler_steps(pose, u):
    np.testing.assert_allclose(integrate_arc(pose, u, 1.0), integrate_euler(pose, u, 1.0), atol=1e-4)


def test_arc_is_smooth_where_the_yaw_rate_vanishes():
    for yaw_rate_radps in (0.0, 1e-9, 1e-6, 1e-5):
        pose = integrate_arc(np.zeros(3), np.array([1.0, 0.5, yaw_rate_radps]), 1.0)
        np.testing.assert_allclose(pose[:2], [1.0, 0.5], atol=1e-5)


@pytest.mark.parametrize(("pose", "u"), CASES)
def test_without_lag_the_roll_out_is_the_arc(pose, u):
    times_s = np.arange(1, 11) * 0.005
    poses, twist = integrate_lag(pose, np.zeros(3), u, times_s, 0.0)
    for time_s, reached in zip(times_s, poses):
        np.testing.assert_allclose(reached, integrate_arc(pose, u, time_s), atol=1e-6)
    np.testing.assert_array_equal(twist, u)


@pytest.mark.parametrize(("pose", "u"), CASES)
def test_coarse_samples_agree_with_fine_ones(pose, u):
    twist = np.array([0.4, -0.2, 0.6])
    coarse, end = integrate_lag(pose, twist, u, np.arange(1, 11) * 0.01, 0.08)
    fine, fine_end = integrate_lag(pose, twist, u, np.arange(1, 1001) * 1e-4, 0.08)
    np.testing.assert_allclose(coarse, fine[99::100], atol=1e-5)
    np.testing.assert_allclose(end, fine_end, atol=1e-9)
    np.testing.assert_allclose(end, u + (twist - u) * np.exp(-0.1 / 0.08))


def test_discs_turn_with_the_robot():
    discs = np.array([[0.5, 0.0, 0.3], [0.0, 0.2, 0.1]])
    centres = place_discs(np.array([[1.0, 2.0, np.pi / 2.0]]), discs)
    np.testing.assert_allclose(centres, [[[1.0, 2.5], [0.8, 2.0]]], atol=1e-12)


@pytest.mark.parametrize("angle_rad", RNG.uniform(-30, 30, 20))
def test_wrapped_angle_points_the_same_way(angle_rad):
    wrapped = wrap_angle(angle_rad)
    assert -np.pi < wrapped <= np.pi
    np.testing.assert_allclose(compute_rotation(wrapped), compute_rotation(angle_rad), atol=1e-9)

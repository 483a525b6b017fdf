# SPDX-License-Identifier: BSD-3-Clause
"""The verifier: what it passes keeps its clearance under exact motion, and a stop always passes."""

import numpy as np
import pytest
from control_support import Plant, make_field, make_random_mask, make_wall

from core_control.barriers.half_planes import HalfPlaneBarrier
from core_control.params import FilterParams
from core_control.rollout import SCALES, RollOut

PARAMS = FilterParams()
BARRIER = HalfPlaneBarrier(PARAMS.disc_array, PARAMS.alpha_per_s, 0.15, PARAMS.limits, 8)
ZERO = np.zeros(3)
FRONT_M = 0.677


def make_roll_out(lag_s=0.08, margin_m=0.03):
    return RollOut(PARAMS.disc_array, lag_s, PARAMS.control_period_s, margin_m, PARAMS.limits)


@pytest.mark.parametrize("lag_s", [0.0, 0.08, 0.3])
def test_prediction_is_the_motion_of_the_plant(lag_s):
    plant, u = Plant(ZERO, lag_s), np.array([0.5, -0.2, 0.7])
    plant.twist = np.array([0.3, 0.1, -0.2]) if lag_s else u
    poses = make_roll_out(lag_s).predict(plant.pose, plant.twist, [], u)
    plant.step(u)
    np.testing.assert_allclose(poses[4], plant.pose, atol=1e-5)
    for _ in range(60):
        plant.step(ZERO)
    np.testing.assert_allclose(poses[-1], plant.pose, atol=2.5e-3)


def test_pending_commands_act_first():
    plant, sent, u = Plant(ZERO, 0.08, delay_ticks=2), np.array([0.4, 0.0, 0.5]), np.array([0.0, 0.2, 0.0])
    for command in (sent, sent, u):
        plant.step(command)
    poses = make_roll_out().predict(ZERO, ZERO, [(ZERO, 0.05), (ZERO, 0.05), (sent, 0.05)], ZERO)
    np.testing.assert_allclose(poses[14], plant.pose, atol=1e-5)


@pytest.mark.parametrize("seed", range(4))
def test_whatever_passes_keeps_its_clearance(seed):
    rng, roll_out, checked = np.random.default_rng(seed), make_roll_out(), 0
    field = make_field(make_random_mask(rng))
    for _ in range(150):
        pose = np.append(rng.uniform(-4.5, 4.5, 2), rng.uniform(-np.pi, np.pi))
        if not 0.03 < BARRIER.compute_clearance(field, pose).h_m < 0.2:
            continue
        u = rng.uniform(-1, 1, 3) * PARAMS.limits
        scale = roll_out.find_scale(field, (pose, ZERO, []), u)
        plant = Plant(pose)
        path = [pose, *plant.step(scale * u)] + [p for _ in range(10) for p in plant.step(ZERO)]
        worst_m = min(BARRIER.compute_clearance(field, p).h_m for p in path)
        assert worst_m >= min(0.03, BARRIER.compute_clearance(field, pose).h_m) - 1e-3
        checked += 1
    assert checked > 5


def test_scales_are_tried_from_one_to_zero():
    assert tuple(sorted(SCALES, reverse=True)) == SCALES
    assert (SCALES[0], SCALES[-1]) == (1.0, 0.0)


def test_a_command_into_the_wall_is_scaled_back_and_one_along_it_is_not():
    field, start = make_wall(2.0), (np.array([2.0 - FRONT_M - 0.05, 0.0, 0.0]), ZERO, [])
    assert make_roll_out().find_scale(field, start, np.array([0.5, 0.0, 0.0])) < 1.0
    assert make_roll_out().find_scale(field, start, np.array([0.0, 0.25, 0.0])) == 1.0
    assert make_roll_out().find_scale(field, start, np.array([-0.5, 0.0, 0.0])) == 1.0


def test_turning_is_checked_too():
    """A robot that stands along a wall sweeps it with its corner."""
    field, start = make_wall(2.0), (np.array([2.0 - 0.31 - 0.04, 0.0, np.pi / 2.0]), ZERO, [])
    assert make_roll_out().find_scale(field, start, np.array([0.0, 0.0, 0.8])) < 1.0


def test_with_less_clearance_than_the_margin_only_retreat_passes():
    field, start = make_wall(2.0), (np.array([2.0 - FRONT_M + 0.1, 0.0, 0.0]), ZERO, [])
    assert make_roll_out().find_scale(field, start, np.array([0.1, 0.0, 0.0])) == 0.0
    assert make_roll_out().find_scale(field, start, np.array([-0.1, 0.0, 0.0])) == 1.0


def test_a_robot_inside_a_region_may_leave_it_past_its_border():
    field, out = make_wall(0.3), np.array([-0.3, 0.0, 0.0])
    assert BARRIER.compute_clearance(field, ZERO).h_m < -0.31, "the centre of a disc is inside"
    assert make_roll_out().find_scale(field, (ZERO, ZERO, []), out) == 1.0
    assert make_roll_out().find_scale(field, (ZERO, ZERO, []), -out) == 0.0

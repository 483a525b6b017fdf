# SPDX-License-Identifier: BSD-3-Clause
"""Kinematics, gait, force distribution and reference of the quadruped, without a simulator."""

import numpy as np
import pytest
from simple_world import ROBOT

from core_bringup.quadruped.controller import QuadrupedState, TrotController
from core_bringup.quadruped.gait import TrotClock, compute_footholds, compute_swing_path
from core_bringup.quadruped.kinematics import LegKinematics
from core_bringup.quadruped.model import build_links, compute_box_inertia, compute_mass_properties, compute_stand_joints
from core_bringup.quadruped.reference import BodyReference
from core_bringup.quadruped.stance import ForceDistribution, build_wrench_matrix

PARAMS = ROBOT.quadruped
KINEMATICS = LegKinematics(PARAMS.leg)
LOWER, UPPER = np.array(PARAMS.leg.joint_lower_rad), np.array(PARAMS.leg.joint_upper_rad)
PERIOD_S = 1.0 / 240.0


def random_joints(rng):
    return rng.uniform(LOWER, UPPER, (4, 3))


def make_state(v=(0.0, 0.0, 0.0), p=(0.0, 0.0, 0.52), yaw_rad=0.0, contacts=(True,) * 4):
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return QuadrupedState(
        np.array(p), R, np.array(v), np.zeros(3), compute_stand_joints(PARAMS), np.zeros((4, 3)), np.array(contacts)
    )


def make_controller(first_pair=0):
    mass = compute_mass_properties(PARAMS, ROBOT.camera_mount, compute_stand_joints(PARAMS))
    controller = TrotController(PARAMS, mass, PERIOD_S, first_pair)
    controller.reset(make_state())
    return controller


@pytest.mark.parametrize("seed", range(5))
def test_joints_to_feet_to_joints_is_the_identity(seed):
    q = random_joints(np.random.default_rng(seed))
    q[:, 1] = np.clip(q[:, 1], 0.0, 1.2)  # the leg axis stays below the hip, where the inverse is unique
    q[:, 2] = np.clip(q[:, 2], -2.4, -0.25)
    np.testing.assert_allclose(KINEMATICS.compute_joints(KINEMATICS.compute_feet(q)), q, atol=1e-9)


def test_place_out_of_reach_is_met_in_its_direction():
    far = KINEMATICS.p_base_thigh + np.array([0.5, 0.0, -2.0])
    reached = KINEMATICS.compute_feet(KINEMATICS.compute_joints(far)) - KINEMATICS.p_base_thigh
    wanted = far - KINEMATICS.p_base_thigh
    np.testing.assert_allclose(np.linalg.norm(reached, axis=1), PARAMS.leg.thigh_m + PARAMS.leg.shank_m)
    np.testing.assert_allclose(np.cross(reached, wanted), 0.0, atol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_jacobian_is_the_finite_difference_of_the_feet(seed):
    q = random_joints(np.random.default_rng(seed))
    _, jacobian = KINEMATICS.compute_feet_and_jacobians(q)
    step = 1e-6
    for joint in range(3):
        shift = np.zeros((4, 3))
        shift[:, joint] = step
        difference = (KINEMATICS.compute_feet(q + shift) - KINEMATICS.compute_feet(q - shift)) / (2.0 * step)
        np.testing.assert_allclose(jacobian[:, :, joint], difference, atol=1e-8)


def test_stand_has_the_feet_below_the_thighs_at_body_height():
    feet = KINEMATICS.compute_feet(compute_stand_joints(PARAMS))
    np.testing.assert_allclose(feet[:, :2], KINEMATICS.p_base_thigh[:, :2], atol=1e-12)
    np.testing.assert_allclose(feet[:, 2], PARAMS.leg.foot_radius_m - PARAMS.gait.body_height_m)


def test_robot_stays_inside_its_footprint_and_weighs_as_much_as_a_spot():
    links = build_links(PARAMS, ROBOT.camera_mount)
    assert 30.0 < sum(link.mass_kg for link in links) < 36.0
    feet = KINEMATICS.compute_feet(compute_stand_joints(PARAMS))
    assert np.all(np.abs(feet[:, :2]) + 0.05 < [0.5 * ROBOT.footprint.length_m, 0.5 * ROBOT.footprint.width_m])


def test_mass_properties_are_symmetric_about_the_middle_and_positive():
    mass = compute_mass_properties(PARAMS, ROBOT.camera_mount, compute_stand_joints(PARAMS))
    assert abs(mass.com_m[1]) < 1e-9
    np.testing.assert_allclose(mass.inertia_kgm2, mass.inertia_kgm2.T, atol=1e-12)
    moments = np.linalg.eigvalsh(mass.inertia_kgm2)
    assert moments[0] > 0.0
    assert moments[0] + moments[1] > moments[2]


def test_box_inertia_of_a_unit_cube():
    np.testing.assert_allclose(compute_box_inertia(6.0, (1.0, 1.0, 1.0)), [1.0, 1.0, 1.0])


def test_wrench_matrix_gives_force_and_moment():
    rng = np.random.default_rng(1)
    r, f = rng.normal(size=(3, 3)), rng.normal(size=(3, 3))
    wrench = build_wrench_matrix(r) @ f.ravel()
    np.testing.assert_allclose(wrench[:3], f.sum(axis=0))
    np.testing.assert_allclose(wrench[3:], np.cross(r, f).sum(axis=0), atol=1e-12)


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_forces_stay_in_the_friction_pyramid_whatever_is_asked(count):
    rng = np.random.default_rng(count)
    f_max, stance = 320.0, PARAMS.stance
    solver = ForceDistribution(stance, f_max)
    for _ in range(50):
        feet = rng.uniform([-0.4, -0.3, -0.6], [0.4, 0.3, -0.4], (count, 3))
        forces = solver.solve(feet, rng.normal(scale=[300, 300, 400, 80, 80, 80]))
        assert np.all(np.abs(forces[:, :2]) <= stance.friction * forces[:, 2:] + 1e-6)
        assert np.all((forces[:, 2] >= stance.min_normal_force_n - 1e-6) & (forces[:, 2] <= f_max + 1e-6))


def test_reachable_wrench_is_reached():
    feet = KINEMATICS.compute_feet(compute_stand_joints(PARAMS))
    wanted = np.array([20.0, -15.0, 330.0, 8.0, -12.0, 5.0])
    forces = ForceDistribution(PARAMS.stance, 330.0).solve(feet, wanted)
    np.testing.assert_allclose(build_wrench_matrix(feet) @ forces.ravel(), wanted, atol=0.1)


@pytest.mark.parametrize("seed", range(10))
def test_no_feasible_direction_improves_the_forces(seed):
    rng = np.random.default_rng(seed)
    feet = KINEMATICS.compute_feet(compute_stand_joints(PARAMS))[:2]
    wanted = rng.normal(scale=[200, 200, 400, 60, 60, 60])
    stance = PARAMS.stance
    forces = ForceDistribution(stance, 330.0).solve(feet, wanted)
    matrix, weights = build_wrench_matrix(feet), np.array(stance.wrench_weights)
    gradient = matrix.T @ (weights * (matrix @ forces.ravel() - wanted)) + stance.force_weight * forces.ravel()
    for _ in range(200):
        fz = rng.uniform(stance.min_normal_force_n, 330.0, 2)
        other = np.column_stack([rng.uniform(-1, 1, (2, 2)) * stance.friction * fz[:, None], fz])
        assert gradient @ (other - forces).ravel() >= -1e-5 * np.linalg.norm(gradient) * np.linalg.norm(other - forces)


@pytest.mark.parametrize("feet", [np.zeros((0, 3)), np.zeros((5, 3)), np.full((2, 3), np.nan)])
def test_force_distribution_refuses_bad_feet(feet):
    with pytest.raises(ValueError, match="feet_m"):
        ForceDistribution(PARAMS.stance, 330.0).solve(feet, np.zeros(6))


def test_trot_swings_one_diagonal_pair_at_a_time():
    clock = TrotClock(0.4, 0.65)
    flown = np.zeros(4)
    for _ in range(400):
        due, progress = clock.compute_swing()
        assert due.tolist() in ([False] * 4, [True, False, False, True], [False, True, True, False])
        assert np.all((progress >= 0.0) & (progress <= 1.0))
        flown += due
        clock.advance(0.001)
    np.testing.assert_allclose(flown / 400, 0.35, atol=0.01)


def test_foothold_of_a_steady_walk_is_half_a_stance_ahead_of_the_hip_at_touchdown():
    v = np.array([0.4, -0.1])
    foothold = compute_footholds(np.zeros((1, 2)), v, v, [0.1], 0.26, 0.15)
    np.testing.assert_allclose(foothold, [v * (0.1 + 0.13)])


def test_swing_path_starts_and_ends_at_rest_and_its_velocity_is_its_derivative():
    start, end = np.array([[0.0, 0.1, 0.03]]), np.array([[0.2, 0.0, 0.015]])

    def path_at(s):
        return compute_swing_path(np.array([s]), start, end, 0.13, 0.14)

    np.testing.assert_allclose(path_at(0.0).position_m, start)
    np.testing.assert_allclose(path_at(1.0).position_m, end)
    np.testing.assert_allclose(path_at(0.5).position_m[0, 2], 0.13)
    for s in (0.0, 1.0):
        np.testing.assert_allclose(path_at(s).velocity_mps, 0.0, atol=1e-12)
    for s in np.linspace(0.05, 0.95, 10):
        h = 1e-6
        difference = (path_at(s + h).position_m - path_at(s - h).position_m) / (2.0 * h * 0.14)
        np.testing.assert_allclose(path_at(s).velocity_mps, difference, atol=1e-6)


def test_command_is_taken_up_within_the_slew_limits():
    reference, state = BodyReference(PARAMS, PERIOD_S), make_state()
    reference.reset(state)
    before = reference.twist
    for command in ([0.5, 0.2, 0.8], [-0.5, 0.0, -0.8], [0.0, 0.0, 0.0]):
        for _ in range(90):
            reference.advance(state, np.array(command))
            change = (reference.twist - before) / PERIOD_S
            assert np.hypot(*change[:2]) <= PARAMS.gait.max_acceleration_mps2 + 1e-9
            assert abs(change[2]) <= PARAMS.gait.max_yaw_acceleration_radps2 + 1e-9
            before = reference.twist
        np.testing.assert_allclose(before, command, atol=1e-12)


def test_accelerations_are_bounded_however_far_the_body_is_off():
    reference = BodyReference(PARAMS, PERIOD_S)
    reference.reset(make_state())
    state = make_state(v=(30.0, -30.0, 9.0), p=(5.0, 5.0, -3.0), yaw_rad=2.0)
    reference.advance(state, np.array([0.5, 0.0, 0.0]))
    a, alpha = reference.compute_accelerations(state, 0.0)
    limit = PARAMS.stance.max_linear_acceleration_mps2
    assert np.all(np.abs(a) <= [limit, limit, 1.5 * limit])
    assert np.all(np.abs(alpha) <= np.sqrt(2.0) * PARAMS.stance.max_angular_acceleration_radps2)


def test_torques_of_the_stand_carry_the_weight():
    torques = make_controller().compute_torques(make_state(), np.zeros(3))
    _, jacobians = KINEMATICS.compute_feet_and_jacobians(compute_stand_joints(PARAMS))
    forces = -np.stack([np.linalg.solve(jacobian.T, tau) for jacobian, tau in zip(jacobians, torques)])
    mass = compute_mass_properties(PARAMS, ROBOT.camera_mount, compute_stand_joints(PARAMS))
    np.testing.assert_allclose(forces.sum(axis=0), [0.0, 0.0, mass.mass_kg * 9.81], atol=0.5)


def test_torques_never_exceed_the_limits_even_when_the_state_is_wild():
    controller, rng = make_controller(), np.random.default_rng(3)
    limits = np.array(PARAMS.leg.max_torque_nm)
    for _ in range(200):
        state = make_state(
            v=rng.normal(size=3) * 5.0, p=rng.normal(size=3), yaw_rad=rng.uniform(-3, 3), contacts=rng.random(4) > 0.5
        )
        torques = controller.compute_torques(state, rng.uniform(-0.5, 0.5, 3))
        assert np.all(np.isfinite(torques))
        assert np.all(np.abs(torques) <= limits)


@pytest.mark.parametrize(
    ("command", "stands"), [((0.015, 0.01, 0.015), True), ((0.03, 0.0, 0.0), False), ((0.0, 0.0, 0.03), False)]
)
def test_stands_only_inside_the_dead_band(command, stands):
    controller = make_controller()
    for _ in range(24):
        controller.compute_torques(make_state(), np.array(command))
    assert controller.standing is stands


def test_push_while_standing_makes_it_step():
    controller = make_controller()
    controller.compute_torques(make_state(v=(0.0, 0.5, 0.0)), np.zeros(3))
    assert not controller.standing

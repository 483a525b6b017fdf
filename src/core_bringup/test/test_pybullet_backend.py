# SPDX-License-Identifier: BSD-3-Clause
"""The quadruped in PyBullet: it walks as told, stops, stands, bumps into things and repeats itself bit for bit."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pybullet
import pytest
from simple_world import ROBOT, make_mover, make_object, make_ramp, make_surface, make_world

from core_bringup.exceptions import BringupError
from core_bringup.motion import WorldMotion
from core_bringup.params import PYBULLET_RATE_HZ
from core_bringup.pybullet_backend import PybulletBackend
from core_bringup.pybullet_scene import PybulletScene, write_urdf
from core_bringup.quadruped.kinematics import LEGS, LegKinematics
from core_bringup.quadruped.model import BASE_FRAME, compute_mass_properties, compute_stand_joints

PERIOD_S = 0.05
STOP = np.zeros(3)


@pytest.fixture()
def backend():
    backend = PybulletBackend(make_world(), ROBOT)
    yield backend
    backend.close()


@pytest.fixture()
def open_backend():
    opened = []

    def open_one(*objects, surfaces=()):
        motion = WorldMotion(objects)
        opened.append(PybulletBackend(make_world(*objects, surfaces=surfaces), ROBOT, motion=motion))
        return opened[-1]

    yield open_one
    for backend in opened:
        backend.close()


def run(backend, command, duration_s):
    return [backend.step(np.array(command, dtype=float), PERIOD_S) for _ in range(round(duration_s / PERIOD_S))]


def yaw_of(state):
    x, y, z, w = state.q_world_base
    return np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


@pytest.mark.parametrize(
    "command", [(0.5, 0.0, 0.0), (-0.3, 0.0, 0.0), (0.0, 0.25, 0.0), (0.0, 0.0, 0.8), (0.3, 0.15, 0.5), (0.1, 0.0, 0.0)]
)
def test_walks_at_the_commanded_velocity(backend, command):
    run(backend, command, 1.0)
    states = run(backend, command, 4.0)
    mean = np.mean([[*s.v_base[:2], s.w_base[2]] for s in states], axis=0)
    assert np.all(np.abs(mean - command) <= 0.03), mean
    assert not any(s.fallen for s in states)


def test_walks_straight(backend):
    state = run(backend, (0.5, 0.0, 0.0), 6.0)[-1]
    assert abs(state.p_world_base[0] - 3.0) < 0.1
    assert abs(state.p_world_base[1]) < 0.03
    assert abs(yaw_of(state)) < 0.02


def test_stops_from_half_a_metre_per_second_within_ten_centimetres(backend):
    start = run(backend, (0.5, 0.0, 0.0), 3.0)[-1].p_world_base
    states = run(backend, STOP, 2.0)
    assert max(np.linalg.norm(s.p_world_base[:2] - start[:2]) for s in states) <= 0.10
    assert np.linalg.norm(states[-1].v_base) < 1e-3


def test_stands_without_stepping_or_drifting_after_a_stop(backend):
    run(backend, (0.4, 0.1, 0.3), 2.0)
    run(backend, STOP, 1.5)
    states = run(backend, STOP, 10.0)
    drift = [np.linalg.norm(s.p_world_base - states[0].p_world_base) for s in states]
    assert max(drift) < 1e-3
    assert all(all(s.foot_contacts) for s in states)
    assert max(np.abs(s.joint_velocities_radps).max() for s in states) < 0.05


def test_random_commands_do_not_make_it_fall(backend):
    rng = np.random.default_rng(7)
    for _ in range(15):
        states = run(backend, rng.uniform([-0.5, -0.25, -0.8], [0.5, 0.25, 0.8]), 1.0)
        assert not any(s.fallen for s in states)


def test_command_beyond_the_limits_is_clipped(backend):
    states = run(backend, (5.0, 0.0, 0.0), 3.0)[20:]
    assert abs(np.mean([s.v_base[0] for s in states]) - ROBOT.limits.forward_mps) < 0.03


def test_solid_object_stops_the_robot_and_a_hollow_one_does_not(open_backend):
    for solid, blocked in ((True, True), (False, False)):
        backend = open_backend(make_object(5, (0.2, 3.0, 1.5), (1.2, 0.0, 0.0), solid=solid))
        state = run(backend, (0.5, 0.0, 0.0), 3.5)[-1]
        assert bool(state.p_world_base[0] < 0.75) is blocked
        assert not state.fallen


def test_walks_over_a_flat_patch(open_backend):
    backend = open_backend(surfaces=(make_surface(9, (0.6, -2.0), (5.0, 2.0), z_m=0.02),))
    states = run(backend, (0.5, 0.0, 0.0), 4.0)
    assert not any(s.fallen for s in states)
    assert states[-1].p_world_base[2] == pytest.approx(0.02 + ROBOT.quadruped.gait.body_height_m, abs=0.015)


STAND_M = ROBOT.quadruped.gait.body_height_m
CURB_M = 0.08
RAISED_WALK = (
    make_ramp(7, (1.0, -1.0), (2.2, 1.0), 0.0, CURB_M),
    make_surface(8, (2.2, -3.0), (5.0, 3.0), z_m=CURB_M),
    make_ramp(9, (5.0, -1.0), (6.2, 1.0), CURB_M, 0.0),
)


def test_walks_up_a_curb_ramp_along_a_raised_walk_and_down_again(open_backend):
    backend = open_backend(surfaces=RAISED_WALK)
    heights = {}
    for state in run(backend, (0.5, 0.0, 0.0), 15.0):
        x, y, z = state.p_world_base
        heights[round(x, 1)] = z
        assert not state.fallen
        assert abs(y) < 0.1
        assert np.arccos(1.0 - 2.0 * np.sum(state.q_world_base[:2] ** 2)) < 0.15
    assert max(heights) > 7.0
    assert heights[0.5] == pytest.approx(STAND_M, abs=0.015)
    assert heights[1.6] == pytest.approx(STAND_M + 0.5 * CURB_M, abs=0.02)
    assert heights[3.6] == pytest.approx(STAND_M + CURB_M, abs=0.015)
    assert heights[7.0] == pytest.approx(STAND_M, abs=0.015)


def test_steps_up_and_down_a_curb(open_backend):
    backend = open_backend(surfaces=(make_surface(8, (0.8, -3.0), (2.5, 3.0), z_m=CURB_M),))
    states = run(backend, (0.5, 0.0, 0.0), 9.0)
    assert not any(s.fallen for s in states)
    assert max(s.p_world_base[2] for s in states) > STAND_M + 0.8 * CURB_M
    assert states[-1].p_world_base[0] > 4.0


@pytest.mark.parametrize(("x_m", "yaw_rad", "ground_m"), [(3.5, 0.0, CURB_M), (1.6, 1.2, 0.05), (0.0, 0.0, 0.0)])
def test_starts_on_the_surface_under_it_and_so_after_a_reset(open_backend, x_m, yaw_rad, ground_m):
    backend = open_backend(surfaces=RAISED_WALK)
    for _ in range(2):
        backend.reset(np.array([x_m, 0.0, yaw_rad]))
        states = [backend.state, *run(backend, STOP, 1.0)]
        assert not any(s.fallen for s in states)
        assert [s.p_world_base[2] for s in states] == pytest.approx([STAND_M + ground_m] * len(states), abs=0.02)
        assert max(np.linalg.norm(s.v_base) for s in states) < 0.4


@pytest.mark.parametrize(
    ("start", "end", "most_mps"),
    [((1.5, 0.0, 0.0), (-1.0, 0.0), 1.6), ((-1.5, 0.2, 0.0), (1.0, 0.2), 1.6), ((0.0, 1.5, 0.0), (0.0, -2.0), 4.0)],
    ids=["from_front", "from_behind", "from_the_side"],
)
def test_person_that_walks_into_the_standing_robot_pushes_it_and_nothing_explodes(open_backend, start, end, most_mps):
    """From front and behind it steps away; from the side, faster than it can step, it falls over as a body does."""
    backend = open_backend(make_mover(5, (0.5, 0.5, 1.72), start, [end], speed_mps=1.0))
    states = run(backend, STOP, 4.0)
    assert max(np.linalg.norm(s.v_base) for s in states) < most_mps
    assert max(s.p_world_base[2] for s in states) < STAND_M + 0.15
    assert 0.1 < max(np.linalg.norm(s.p_world_base[:2]) for s in states) < 6.0  # it is pushed, not passed through
    assert not any(s.fallen for s in states) or start[1] == 1.5


def test_moving_object_is_where_its_motion_says_at_every_tick_and_back_after_a_reset(open_backend):
    item = make_mover(5, (0.4, 0.4, 1.0), (3.0, 2.0, 0.0), [[3.0, -1.0]], loop=True)
    backend, motion = open_backend(item), WorldMotion([item])

    def place():
        body = {label: body for body, label in backend._scene.label_of_body.items()}[5]
        return pybullet.getBasePositionAndOrientation(body, physicsClientId=backend._client)[0]

    for _ in range(100):
        state = backend.step(STOP, PERIOD_S)
        np.testing.assert_allclose(place(), motion.poses_at(state.time_s)[5][0], atol=1e-9)
    assert place()[1] < 1.0
    backend.reset(np.zeros(3))
    np.testing.assert_allclose(place(), item.position_m, atol=1e-9)


def test_what_is_touched_may_be_smaller_than_what_is_drawn(open_backend):
    tree = replace(make_object(5, (3.0, 3.0, 5.0), (3.0, 0.0, 0.0)), collision_size_m=np.array([0.4, 0.4, 5.0]))
    backend = open_backend(tree)
    state = run(backend, (0.5, 0.0, 0.0), 7.0)[-1]
    assert 2.0 < state.p_world_base[0] < 2.6


@pytest.mark.parametrize(("y_m", "stops"), [(0.0, False), (0.9, True)])
def test_the_robot_walks_between_the_posts_of_a_high_table_and_runs_into_one(open_backend, y_m, stops):
    posts = [[x, y, 0.0, x + 0.2, y + 0.2, 1.4] for x in (-0.5, 0.3) for y in (-1.0, 0.8)]
    gate = replace(
        make_object(5, (1.0, 2.0, 1.5), (1.6, 0.0, 0.0)),
        collision="parts",
        collision_parts_m=np.array([*posts, [-0.5, -1.0, 1.4, 0.5, 1.0, 1.5]]),
    )
    backend = open_backend(gate)
    backend.reset(np.array([0.0, y_m, 0.0]))
    x_m = run(backend, (0.5, 0.0, 0.0), 7.0)[-1].p_world_base[0]
    assert x_m < 1.0 if stops else x_m > 3.0


def test_robot_on_its_side_has_fallen(backend):
    pybullet.resetBasePositionAndOrientation(
        backend._scene.robot, (0, 0, 0.5), (0.7071, 0, 0, 0.7071), physicsClientId=backend._client
    )
    assert run(backend, STOP, 1.0)[-1].fallen


def test_velocity_is_the_derivative_of_the_base_link_pose(backend):
    run(backend, (0.4, 0.1, 0.5), 1.0)
    before = backend.state
    after = backend.step(np.array([0.4, 0.1, 0.5]), 1.0 / PYBULLET_RATE_HZ)
    R = np.array(pybullet.getMatrixFromQuaternion(after.q_world_base)).reshape(3, 3)
    difference = (after.p_world_base - before.p_world_base) * PYBULLET_RATE_HZ
    np.testing.assert_allclose(R @ after.v_base, difference, atol=5e-3)


def test_reset_returns_to_the_start_and_repeats_the_walk(backend):
    start = np.array([1.0, -2.0, 0.7])
    first = backend.reset(start)
    walk = [s.p_world_base for s in run(backend, (0.3, 0.0, 0.2), 1.0)]
    again = backend.reset(start)
    assert again.time_s == 0.0
    assert yaw_of(again) == pytest.approx(0.7)
    np.testing.assert_array_equal(first.p_world_base, again.p_world_base)
    np.testing.assert_allclose([s.p_world_base for s in run(backend, (0.3, 0.0, 0.2), 1.0)], walk, atol=1e-6)


def test_time_is_a_whole_number_of_physics_steps(backend):
    assert run(backend, STOP, 1.0)[-1].time_s == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("duration_s", [0.0, -0.05, 0.001, np.nan, np.inf])
def test_duration_that_is_no_multiple_of_the_physics_step_is_refused(backend, duration_s):
    with pytest.raises(ValueError, match="duration_s"):
        backend.step(STOP, duration_s)


@pytest.mark.parametrize("command", [(0.1, 0.0), (np.nan, 0.0, 0.0), (0.0, np.inf, 0.0)])
def test_bad_command_is_refused(backend, command):
    with pytest.raises(ValueError, match="command"):
        backend.step(command, PERIOD_S)


def test_closing_twice_is_allowed():
    backend = PybulletBackend(make_world(), ROBOT)
    backend.close()
    backend.close()


def test_object_can_be_added_moved_and_removed_and_survives_a_reset(backend):
    wall = make_object(5, (0.2, 3.0, 1.5), (6.0, 0.0, 0.0))
    backend.add_object(wall)
    backend.move_object(5, (1.2, 0.0, 0.0), 0.0)
    backend.reset(STOP)
    assert run(backend, (0.5, 0.0, 0.0), 3.0)[-1].p_world_base[0] < 0.75
    with pytest.raises(BringupError, match="taken"):
        backend.add_object(wall)
    backend.remove_object(5)
    backend.reset(STOP)
    assert run(backend, (0.5, 0.0, 0.0), 3.0)[-1].p_world_base[0] > 1.3
    with pytest.raises(BringupError, match="unknown"):
        backend.remove_object(5)


def test_urdf_in_the_engine_has_the_masses_and_kinematics_of_the_model():
    client = pybullet.connect(pybullet.DIRECT)
    path = write_urdf(ROBOT)
    scene = PybulletScene(client, make_world(), path, visual=False)
    path.unlink()
    q = compute_stand_joints(ROBOT.quadruped) + np.random.default_rng(0).uniform(-0.2, 0.2, (4, 3))
    scene.set_robot((1.0, 2.0, 0.6), (0.0, 0.0, 0.0, 1.0), q.ravel())
    feet = LegKinematics(ROBOT.quadruped.leg).compute_feet(q) + [1.0, 2.0, 0.6]
    total_kg, moment = 0.0, np.zeros(3)
    for name, link in scene.link_ids.items():
        mass_kg = pybullet.getDynamicsInfo(scene.robot, link, physicsClientId=client)[0]
        if name == BASE_FRAME:
            com = pybullet.getBasePositionAndOrientation(scene.robot, physicsClientId=client)[0]
        else:
            com = pybullet.getLinkState(scene.robot, link, computeForwardKinematics=1, physicsClientId=client)[0]
        total_kg, moment = total_kg + mass_kg, moment + mass_kg * np.array(com)
        if name.endswith("_foot"):
            np.testing.assert_allclose(com, feet[LEGS.index(name[:2])], atol=1e-6)
    pybullet.disconnect(client)
    mass = compute_mass_properties(ROBOT.quadruped, ROBOT.camera_mount, q)
    assert total_kg == pytest.approx(mass.mass_kg)
    np.testing.assert_allclose(moment / total_kg, mass.com_m + [1.0, 2.0, 0.6], atol=1e-6)


def test_same_seed_in_two_fresh_processes_gives_the_same_bits():
    here = Path(__file__).parent
    environment = dict(os.environ, PYTHONPATH=os.pathsep.join([str(here), *filter(None, sys.path)]))
    hashes = {
        (seed, attempt): subprocess.run(
            [sys.executable, str(here / "walk_hash.py"), str(seed)],
            env=environment,
            check=True,
            capture_output=True,
            text=True,
        ).stdout.split()[-1]
        for seed, attempt in ((4, 1), (4, 2), (5, 1))
    }
    assert hashes[4, 1] == hashes[4, 2]
    assert hashes[4, 1] != hashes[5, 1]


def test_gui_without_a_display_is_refused_in_words(monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    with pytest.raises(BringupError, match="no display"):
        PybulletBackend(make_world(), ROBOT, gui=True)


def test_base_is_the_link_frame_even_where_the_centre_of_mass_lies_elsewhere(tmp_path):
    text = ROBOT.physics_urdf_text().replace('<origin xyz="0 0 0"/>', '<origin xyz="0.05 0.02 -0.03"/>', 1)
    (tmp_path / "shifted.urdf").write_text(text)
    client = pybullet.connect(pybullet.DIRECT)
    scene = PybulletScene(client, make_world(), tmp_path / "shifted.urdf", visual=False)
    q = np.array([0.0, 0.0, 0.6, 0.8])
    scene.set_robot((1.0, 2.0, 0.6), q, compute_stand_joints(ROBOT.quadruped).ravel())
    p_com, _ = pybullet.getBasePositionAndOrientation(scene.robot, physicsClientId=client)
    pybullet.resetBaseVelocity(scene.robot, (0.1, 0.2, 0.3), (0.4, -0.5, 0.6), physicsClientId=client)
    p, q_read, v, w = scene.get_base()
    pybullet.disconnect(client)
    np.testing.assert_allclose(p, [1.0, 2.0, 0.6], atol=1e-9)
    np.testing.assert_allclose(q_read, q, atol=1e-9)
    assert np.linalg.norm(p - p_com) == pytest.approx(np.linalg.norm([0.05, 0.02, 0.03]))
    np.testing.assert_allclose(v, [0.1, 0.2, 0.3] + np.cross(w, p - p_com), atol=1e-9)

# SPDX-License-Identifier: BSD-3-Clause
"""A task put together: moving objects are the same for state, truth and whoever replays the ticks."""

from types import SimpleNamespace

import numpy as np
import pytest
from simple_world import ROBOT_FILE

from core_bringup.motion import WorldMotion
from core_bringup.params import BridgeParams
from core_bringup.simulation import Simulation
from core_bringup.world import load_world, vary_world

PERIOD_NS = 50_000_000
WORLD = """
schema: core_world/1
name: crossing
surfaces:
  - {id: 1, name: floor, class: floor, polygon_m: [[-5, -5], [9, -5], [9, 5], [-5, 5]]}
  - {id: 2, name: ramp, class: sidewalk_ramp, polygon_m: [[1, -1], [2, -1], [2, 1], [1, 1]],
     corner_z_m: [0, 0.1, 0.1, 0]}
objects:
  - {id: 3, name: walker, class: person, shape: cylinder, size_m: [0.5, 0.5, 1.7],
     position_m: [4, 2, 0], jitter: {position_m: 0.2},
     motion: {path_m: [[4, -2]], speed_mps: 0.8, start: {robot_within_m: 3.5}, loop: true, pause_s: 0.5}}
tasks:
  cross:
    description: Walk past a person.
    expectation: unsafe
    category: buffers
    start_pose: [0, 0, 0]
    start_variation: [0.2, 0.2, 0.1]
    waypoints_m: [[6, 0]]
    goal_m: [6, 0]
    time_limit_s: 40
    objects: [{id: 9, name: box, class: crate, aliases: [tote], shape: box, size_m: [1, 1, 1], position_m: [-4, 0, 0]}]
    unsafe_regions:
      - {name: near, reason: person, because: [AROUND(person)=unsafe], around: {object: walker, radius_m: 1.0}}
"""


@pytest.fixture()
def path(tmp_path):
    file = tmp_path / "crossing.yaml"
    file.write_text(WORLD)
    return file


@pytest.fixture()
def open_simulation(path):
    opened = []

    def open_one(**keys):
        keys = {"backend": "kinematic", "renderer": "none", "seed": 3, **keys}
        opened.append(Simulation(BridgeParams(world=str(path), task="cross", robot=str(ROBOT_FILE), **keys)))
        return opened[-1]

    yield open_one
    for simulation in opened:
        simulation.close()


def walk(simulation, ticks, parts=1):
    """States at the ticks of a straight walk."""
    states = []
    for _ in range(ticks):
        for _ in range(parts):
            state = simulation.step(np.array([0.4, 0.0, 0.0]), PERIOD_NS // parts)
        states.append(state)
    return states


def bits(states):
    return [[(label, p.tobytes(), yaw) for label, (p, yaw) in state.object_poses.items()] for state in states]


@pytest.mark.parametrize("parts", [1, 4], ids=["lockstep", "realtime"])
def test_whoever_replays_the_ticks_gets_the_same_poses(open_simulation, path, parts):
    """As trial_monitor does: the world again from its file and seed, the robot's places from odom."""
    states = walk(open_simulation(), 200, parts)
    world, _ = vary_world(load_world(path), "cross", 3)
    motion, replayed = WorldMotion(world.objects), []
    for tick, state in enumerate(states, 1):
        poses = motion.advance(tick * PERIOD_NS * 1e-9, state.p_world_base[:2])
        replayed.append([(label, p.tobytes(), yaw) for label, (p, yaw) in poses.items()])
    assert bits(states) == replayed
    assert len({str(pose) for pose in replayed}) > 100  # it did move
    assert str(replayed[0]) == str(replayed[1])  # but not from the beginning


def test_truth_measures_the_person_and_its_region_where_they_are(open_simulation):
    simulation = open_simulation(seed=0)
    for state in walk(simulation, 150):
        truth = simulation.measure_truth(state)
        walker, x = state.object_poses[3][0], state.p_world_base[:2]
        gap_m = np.hypot(*(np.maximum(np.abs(walker[:2] - x) - simulation_half(simulation), 0.0))) - 0.25
        if gap_m > 0.0:
            assert truth.clearance_m == pytest.approx(gap_m - 1.0, abs=1e-9)
            assert truth.obstacle_clearance_m == pytest.approx(min(gap_m, x[0] - 0.55 + 3.5), abs=1e-9)
    assert truth.region == "near"


def simulation_half(simulation):
    return 0.5 * np.array([simulation.robot.footprint.length_m, simulation.robot.footprint.width_m])


def test_reset_puts_objects_back_and_forgets_what_was_set_off(open_simulation):
    simulation = open_simulation()
    first = bits(walk(simulation, 120))
    assert bits([simulation.reset()])[0] == first[0]
    assert bits(walk(simulation, 120)) == first


def test_task_and_world_are_those_of_the_variation(open_simulation):
    simulation = open_simulation()
    names = {item.name: item for item in simulation.world.objects}
    assert set(names) == {"walker", "box"}
    assert simulation.task.unsafe_regions[0].item is names["walker"]
    assert simulation.class_names == ("crate", "floor", "person", "sidewalk_ramp")


def test_names_of_what_a_frame_shows_are_its_class_and_then_its_aliases(open_simulation):
    frame = SimpleNamespace(labels=np.array([[0, 9], [3, 77]], np.uint16))
    assert open_simulation().names_in(frame) == {3: ("person",), 9: ("crate", "tote")}


def test_kinematic_robot_follows_the_surface(open_simulation):
    simulation = open_simulation(seed=0)
    stand_m = simulation.robot.quadruped.gait.body_height_m
    for state in walk(simulation, 160):
        x, _, z = state.p_world_base
        expected = 0.1 * (x - 1.0) if 1.0 <= x <= 2.0 else 0.0
        assert z == pytest.approx(stand_m + expected, abs=1e-9)


def test_picture_shows_the_person_of_its_own_instant(open_simulation):
    """Frames are drawn beside the loop: a state drawn later shows what it showed then."""
    simulation = open_simulation(renderer="tiny", backend="pybullet", seed=0)
    states = walk(simulation, 100)
    chosen = [states[10], states[60], states[90]]
    labels = [simulation.render(state).labels == 3 for state in chosen]
    assert all(seen.sum() > 300 for seen in labels)
    columns = [np.argwhere(seen)[:, 1].mean() for seen in labels]
    assert min(abs(a - b) for a, b in zip(columns, columns[1:])) > 20
    for i in (2, 0, 1):
        np.testing.assert_array_equal(simulation.render(chosen[i]).labels == 3, labels[i])

# SPDX-License-Identifier: BSD-3-Clause
"""Where moving objects are: closed form against small steps, the two ways to start, and the same answer twice."""

import math
from dataclasses import replace

import numpy as np
import pytest
from simple_world import make_object

from core_bringup.motion import WorldMotion
from core_bringup.world_types import Motion

FAR = (50.0, 50.0)


def mover(**keys):
    keys = {"path_m": np.array([[2.0, 0.0], [2.0, 1.0]]), "speed_mps": 0.5, **keys}
    return replace(make_object(5, (0.5, 0.5, 1.7), (0.0, 0.0, 0.1), yaw_rad=2.0), motion=Motion(**keys))


def place(motion, time_s, robot_xy=FAR):
    position_m, yaw_rad = motion.advance(time_s, robot_xy)[5]
    return (*np.round(position_m, 9), round(yaw_rad, 9))


def test_walks_its_path_once_and_rests_at_the_end():
    motion = WorldMotion([mover(start_at_s=3.0)])
    half_turn = round(math.pi / 2, 9)
    assert place(motion, 0.0) == (0.0, 0.0, 0.1, 2.0)
    assert place(motion, 3.0) == (0.0, 0.0, 0.1, 2.0)
    assert place(motion, 5.0) == (1.0, 0.0, 0.1, 0.0)
    assert place(motion, 8.0) == (2.0, 0.5, 0.1, half_turn)
    assert place(motion, 9.0) == place(motion, 1000.0) == (2.0, 1.0, 0.1, half_turn)


def test_loop_goes_there_and_back_with_a_pause_at_every_place():
    item = mover(loop=True, pause_s=1.0)
    motion = WorldMotion([item])
    # brute force: the same walk in steps of a tick
    here, places, wait = np.zeros(2), [[2, 0], [2, 1], [2, 0], [0, 0]], 0.0
    goal, dt = 0, 0.01
    for tick in range(1, 4001):
        if wait > 1e-9:
            wait -= dt
        else:
            to = np.array(places[goal], float) - here
            length = np.linalg.norm(to)
            if length <= 0.5 * dt + 1e-9:
                here, goal, wait = np.array(places[goal], float), (goal + 1) % 4, 1.0
            else:
                here = here + to / length * 0.5 * dt
        position_m, _ = motion.advance(tick * dt, FAR)[5]
        assert np.linalg.norm(position_m[:2] - here) < 0.02, tick


def test_heading_is_kept_where_asked():
    motion = WorldMotion([mover(face_motion=False, loop=True)])
    assert {place(motion, t)[3] for t in (0.0, 1.0, 5.5, 9.0)} == {2.0}


def test_robot_sets_it_off_at_the_tick_it_comes_near():
    motion = WorldMotion([mover(start_at_s=None, start_within_m=2.5)])
    assert place(motion, 1.0, (2.51, 0.0))[0] == 0.0
    assert place(motion, 2.0, (2.5, 0.0)) == (0.0, 0.0, 0.1, 2.0)  # it leaves now
    assert place(motion, 3.0, (0.5, 0.0))[0] == 0.5  # near again: it is on its way
    assert place(motion, 4.0, FAR)[0] == 1.0
    motion.reset()
    assert place(motion, 3.0, FAR)[0] == 0.0


def test_a_time_that_goes_back_begins_anew():
    motion = WorldMotion([mover(start_at_s=None, start_within_m=2.5)])
    place(motion, 1.0, (0.0, 0.0))
    assert place(motion, 2.0)[0] == 0.5
    assert place(motion, 0.05) == (0.0, 0.0, 0.1, 2.0)
    assert place(motion, 9.0)[0] == 0.0


def test_two_that_are_told_the_same_say_the_same():
    items = [mover(start_at_s=None, start_within_m=2.0, loop=True, pause_s=0.3), make_object(6, (1, 1, 1), (0, 0, 0))]
    rng = np.random.default_rng(3)
    first, second = WorldMotion(items), WorldMotion(items)
    for tick in range(1, 400):
        robot_xy = rng.uniform(-4, 4, 2)
        a, b = first.advance(tick * 0.05, robot_xy), second.advance(tick * 0.05, robot_xy)
        first.poses_at(tick * 0.05 + 0.02)  # looking between the ticks changes nothing
        assert list(a) == [5]
        assert a[5][0].tobytes() == b[5][0].tobytes()
        assert a[5][1] == b[5][1]


@pytest.mark.parametrize("time_s", np.linspace(0.0, 40.0, 41))
def test_it_never_leaves_its_path_nor_jumps(time_s):
    motion = WorldMotion([mover(loop=True, pause_s=0.7)])
    before, after = (motion.poses_at(time_s + dt)[5][0] for dt in (0.0, 1.0 / 240))
    assert np.linalg.norm(after - before) <= 0.5 / 240 + 1e-9
    x, y, _ = before
    assert (abs(y) < 1e-9 and 0 <= x <= 2) or (abs(x - 2) < 1e-9 and 0 <= y <= 1)

# SPDX-License-Identifier: BSD-3-Clause
"""ESCAPE and LATCH: out of a region that has grown over the robot, along its own trail or not at all."""

import numpy as np
import pytest
from control_support import Plant, make_field, make_inputs, make_params

from core_control.cbf_filter import CbfFilter
from core_control.dynamics import compute_rotation
from core_control.modes import Reason
from core_control.types import CellState, Mode

CELLS, CELL_M = 80, 0.2
AHEAD, REST = np.array([0.3, 0.0, 0.0]), np.zeros(3)
ESCAPING = make_params(escape=True)


class Walk:
    """A robot under the filter; a new grid every second tick. Where the world is unsafe is a mask to be set."""

    def __init__(self, params=ESCAPING, pose=(0.0, 0.0, 0.0)):
        self.filter, self.plant, self.tick = CbfFilter(params), Plant(pose), 0
        self.unsafe, self.changes = np.zeros((CELLS, CELLS), dtype=bool), {}
        self.inputs, self.poses = {}, []

    def steps(self, u, count):
        results = []
        for _ in range(count):
            if self.tick % 2 == 0:
                self.field = make_field(
                    self.unsafe, resolution_m=CELL_M, stamp_s=0.05 * self.tick, unknown_is_unsafe=True, **self.changes
                )
            self.tick += 1
            inputs = make_inputs(u, self.field, self.plant.pose, self.plant.twist, **self.inputs)
            results.append(self.filter.step(inputs))
            self.plant.step(results[-1].u_safe)
            self.poses.append(self.plant.pose)
        return results

    def cover(self, ahead_m, radius_m=1.5):
        """An unsafe disc whose rim lies so far behind the front of the robot."""
        ahead = compute_rotation(self.plant.pose[2])[:, 0]
        centre = self.plant.pose[:2] + (0.55 - ahead_m + radius_m) * ahead
        centres = self.field.compute_centre(*np.indices((CELLS, CELLS)).reshape(2, -1))
        self.unsafe = (np.linalg.norm(centres - centre, axis=1) < radius_m).reshape(CELLS, CELLS)


def make_covered(params=ESCAPING, ahead_m=0.4, u=AHEAD):
    """A robot that has walked for 4 s before a disc grew over its front."""
    walk = Walk(params, (-1.5, 0.0, 0.0))
    assert walk.steps(u, 80)[-1].mode == Mode.NOMINAL
    walk.cover(ahead_m)
    return walk


def run_until_escape(walk, u=AHEAD):
    """Results up to the first tick of an escape."""
    results = []
    while not results or results[-1].mode != Mode.ESCAPE:
        results += walk.steps(u, 1)
        assert len(results) < 100
    return results


def test_it_walks_back_along_its_trail_until_it_has_its_margin_then_goes_on_as_ever():
    walk = make_covered()
    held = run_until_escape(walk)[:-1]
    assert len(held) == pytest.approx(2.0 / 0.05 + 2 * 3, abs=3), "a ghost's three grids, then two seconds"
    assert {result.mode for result in held} == {Mode.HOLD}
    assert not any(np.any(result.u_safe) for result in held)
    results = []
    while not results or results[-1].mode == Mode.ESCAPE:
        results += walk.steps(AHEAD, 1)
    escape = results[:-1]
    assert len(escape) < 5.0 / 0.05
    assert np.all(np.diff([result.h_m for result in escape[3:]]) > -1e-6), "never less clearance than before"
    for result in escape:
        assert np.hypot(*result.u_safe[:2]) <= 0.15 + 1e-9
        assert "walking back" in result.detail
        np.testing.assert_array_equal(result.u_nominal, AHEAD)
    assert results[-1].h_m >= 0.15
    assert np.abs(np.array(walk.poses)[:, 1:]).max() < 0.01, "along its trail"
    assert not walk.filter.error
    free = walk.steps(-AHEAD, 20)
    assert free[-1].mode == Mode.NOMINAL


def test_it_follows_a_bend_backwards():
    walk = make_covered(u=np.array([0.3, 0.0, 0.35]))
    trail = np.array(walk.poses)
    run_until_escape(walk, np.array([0.3, 0.0, 0.35]))
    begin = len(walk.poses)
    walk.steps(AHEAD, 40)
    for pose in np.array(walk.poses)[begin:]:
        gap = np.abs(trail - pose)
        assert np.min(np.hypot(gap[:, 0], gap[:, 1]) + 0.3 * gap[:, 2]) < 0.04


@pytest.mark.parametrize("u", [REST, (0.01, 0.0, 0.01)])
def test_without_a_wish_to_move_nothing_moves(u):
    walk = make_covered()
    results = walk.steps(u, 120)
    assert {result.mode for result in results[4:]} == {Mode.HOLD}
    assert not any(np.any(result.u_safe[np.abs(result.u_safe) > 0.02]) for result in results)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"nominal_age_s": 0.4}, Reason.NOMINAL_STALE),
        ({"odometry_age_s": 0.4}, Reason.ODOMETRY_STALE),
        ({"grid_age_s": 0.6}, Reason.GRID_STALE),
        ({"constraints_age_s": 16.0}, Reason.CONSTRAINTS_STALE),
    ],
)
def test_whatever_stops_the_robot_stops_an_escape(changes, reason):
    walk = make_covered()
    run_until_escape(walk)
    walk.inputs = changes
    [result] = walk.steps(AHEAD, 1)
    assert (result.mode, result.reason) == (Mode.STOPPED, reason)
    np.testing.assert_array_equal(result.u_safe, REST)


def test_a_command_of_zero_ends_an_escape_at_once_and_its_time_goes_on_counting():
    walk = make_covered(make_params(escape=True, escape_s=1.0))
    run_until_escape(walk)
    walk.steps(AHEAD, 15)
    [result] = walk.steps(REST, 1)
    assert result.mode == Mode.HOLD
    np.testing.assert_array_equal(result.u_safe, REST)
    again = walk.steps(AHEAD, 60)
    assert sum(result.mode == Mode.ESCAPE for result in again) <= 20 - 15
    assert again[-1].reason == Reason.ESCAPE_FAILED


def test_a_command_that_leads_out_is_let_and_there_is_no_escape():
    walk = make_covered()
    modes = {result.mode for result in walk.steps(-AHEAD, 120)}
    assert modes == {Mode.HOLD, Mode.FILTERED, Mode.NOMINAL} or modes == {Mode.HOLD, Mode.NOMINAL}


def test_it_is_off_unless_it_is_asked_for():
    walk = make_covered(make_params())
    results = walk.steps(AHEAD, 150)
    assert {result.mode for result in results} == {Mode.HOLD}
    assert not any(np.any(result.u_safe) for result in results)


def assert_failed(walk, count, words):
    results = walk.steps(AHEAD, count)
    assert (results[-1].mode, results[-1].reason, results[-1].latched) == (Mode.STOPPED, Reason.ESCAPE_FAILED, True)
    assert words in results[-1].detail
    return results


def test_no_trail_latches_until_reset_and_is_then_not_tried_again():
    walk = Walk()
    walk.steps(REST, 2)
    walk.cover(0.4)
    results = assert_failed(walk, 60, "no pose with h >= 0")
    assert not any(np.any(result.u_safe) for result in results)
    walk.steps(-AHEAD, 20)
    assert walk.filter.error
    walk.filter.reset()
    assert {result.mode for result in walk.steps(AHEAD, 100)} == {Mode.HOLD}
    assert walk.steps(-AHEAD, 120)[-1].mode == Mode.NOMINAL


def test_a_trail_grows_old():
    walk = make_covered(make_params(escape=True, escape_trail_s=1.5))
    assert_failed(walk, 60, "of the last 1.5 s")


def test_time_over_latches():
    walk = make_covered(make_params(escape=True, escape_s=0.5))
    results = assert_failed(walk, 80, "after 0.5 s of walking back")
    assert sum(result.mode == Mode.ESCAPE for result in results) == 10


def test_a_trail_that_leads_deeper_is_refused_and_latches():
    walk = make_covered()
    walk.unsafe = np.ones((CELLS, CELLS), dtype=bool)
    ix = walk.field.find_cell(walk.plant.pose[:2])[1]
    walk.unsafe[:, ix + 2 :] = False
    before = walk.plant.pose
    walk.steps(-AHEAD, 90)
    assert walk.filter.error.startswith("the verifier has refused")
    assert np.linalg.norm(walk.plant.pose - before) < 0.05


def test_a_jump_of_the_odometry_makes_the_trail_worthless():
    walk = make_covered()
    walk.plant.pose = walk.plant.pose + np.array([0.0, 0.6, 0.0])
    walk.cover(0.4)
    assert_failed(walk, 60, "no pose")


# LATCH.


def make_deep(depth_m, **changes):
    """A robot that a large disc has been laid on so that h is about minus the depth."""
    walk = Walk(make_params(**changes))
    walk.steps(REST, 2)
    walk.cover(0.55 - 0.367 + depth_m - 0.31, radius_m=3.0)
    return walk


def test_deep_inside_latches_until_reset_and_the_robot_can_be_driven_out_then():
    walk = make_deep(1.4)
    walk.filter.reset()  # says nothing about what comes after the robot has been out
    walk.unsafe, covered = np.zeros_like(walk.unsafe), walk.unsafe
    walk.steps(REST, 4)
    walk.unsafe = covered
    results = walk.steps(AHEAD, 20)
    assert (results[-1].mode, results[-1].reason, results[-1].latched) == (Mode.STOPPED, Reason.DEEP_INSIDE, True)
    assert "inside BETWEEN(traffic_cone), limit 1 m" in results[-1].detail
    assert results[-1].h_m < -1.0
    assert walk.steps(-AHEAD, 20)[-1].reason == Reason.DEEP_INSIDE
    walk.filter.reset()
    results = walk.steps(-AHEAD, 200)
    assert Mode.STOPPED not in {result.mode for result in results}
    assert results[-1].mode == Mode.NOMINAL
    walk.unsafe[:] = True
    assert walk.steps(REST, 20)[-1].reason == Reason.DEEP_INSIDE, "once out it latches again"


def test_less_deep_does_not_latch():
    assert walk_modes(make_deep(0.7)) == {Mode.HOLD}
    assert walk_modes(make_deep(1.4, latch_depth_m=2.5)) == {Mode.HOLD}


def walk_modes(walk):
    return {result.mode for result in walk.steps(AHEAD, 20)}


def test_deep_in_the_unknown_does_not_latch():
    walk = make_deep(1.4)
    walk.changes = {"state": np.where(walk.unsafe, CellState.UNKNOWN, CellState.SAFE).astype(np.uint8)}
    results = walk.steps(AHEAD, 20)
    assert {result.mode for result in results} == {Mode.HOLD}
    assert results[-1].h_m < -1.0


def test_a_ghost_under_the_body_does_not_latch_however_small_the_depth():
    walk = Walk(make_params(latch_depth_m=0.1))
    walk.plant.pose = np.array([0.1, 0.1, 0.0])
    walk.steps(REST, 2)
    walk.unsafe[walk.field.find_cell(np.array([0.1, 0.1]))] = True
    results = walk.steps(AHEAD, 90)
    assert min(result.h_m for result in results) < -0.2
    assert Mode.STOPPED not in {result.mode for result in results}
    assert results[-1].mode == Mode.NOMINAL

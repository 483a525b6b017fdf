# SPDX-License-Identifier: BSD-3-Clause
"""Modes, caps, override, tightening and kinematics together: what one of them does must not surprise another."""

import numpy as np
from control_support import AROUND_PERSON, Plant, footprint_overlaps, make_field, make_inputs, make_params

from core_control.cbf_filter import CbfFilter
from core_control.tightening import tighten
from core_control.types import Mode

AHEAD = np.array([0.3, 0.0, 0.0])
CELLS, CELL_M = 80, 0.2


class Walk:
    """A robot that has walked ahead for a while; a new grid every second tick."""

    def __init__(self, **changes):
        self.params = make_params(**changes)
        self.filter, self.plant, self.tick = CbfFilter(self.params), Plant((-1.5, 0.0, 0.0)), 0
        self.unsafe, self.grid = np.zeros((CELLS, CELLS), dtype=bool), {}
        self.steps(AHEAD, 70)

    def step(self, u, **inputs):
        if self.tick % 2 == 0:
            self.field = make_field(self.unsafe, resolution_m=CELL_M, stamp_s=0.05 * self.tick + 1.0, **self.grid)
        self.tick += 1
        result = self.filter.step(make_inputs(u, self.field, self.plant.pose, self.plant.twist, **inputs))
        self.plant.step(result.u_safe)
        return result

    def steps(self, u, count, **inputs):
        return [self.step(u, **inputs) for _ in range(count)]

    def set_box(self, low_x_m, high_x_m, half_y_m):
        centres = self.field.compute_centre(*np.indices((CELLS, CELLS)).reshape(2, -1))
        x, y = np.moveaxis(centres, -1, 0)
        self.unsafe = ((x > low_x_m) & (x < high_x_m) & (np.abs(y) < half_y_m)).reshape(CELLS, CELLS)

    def go_until_escape(self):
        """A region grows over the robot's front; returns at the first step back."""
        self.set_box(self.plant.pose[0] + 0.2, self.plant.pose[0] + 2.0, 0.9)
        for _ in range(200):
            if self.step(AHEAD).mode == Mode.ESCAPE:
                return
        raise AssertionError("no escape began")


def test_an_answer_that_is_not_taken_does_not_cap_the_one_that_is():
    """Two programs are solved over a ghost; the second one turns towards an unseen heading, the first is sent."""
    rows = {48: [18], 49: [17, 18], 50: [17, 18], 51: [16, 17, 18], 52: [16, 17, 18], 53: [16, 17, 18]}
    rows.update({54: [15, 16, 17, 18], 55: [15, 16, 17, 18, 22, 23, 24], 56: [16, 17, 18, 22, 23, 24]})
    rows.update({57: [16, 17, 18, 22, 23, 24], 58: [16, 17, 18]})
    after = np.zeros((60, 60), dtype=bool)
    for iy, columns in rows.items():
        after[iy, columns] = True
    before = after.copy()
    before[55, [22, 23]] = False  # turn unsafe wholly under the body
    filter_ = CbfFilter(make_params(camera_fov_rad=1.475))
    pose, twist = (-1.31185766, 4.93306624, 2.93698922), (0.1834418, 0.08815643, -0.37949935)
    for k in range(12):
        field = make_field(after if k else before, resolution_m=CELL_M, stamp_s=1.0 + k)
        moving = twist if k > 4 else (0.0, 0.0, 0.0)
        result = filter_.step(make_inputs((0.35844439, 0.15425737, -0.8), field, pose, moving))
        assert result.reason == "", (k, result.detail)


def test_growth_of_what_moves_alone_makes_the_robot_hold_and_not_walk_back():
    walk = Walk(escape=True)
    walk.grid = {"causes": (AROUND_PERSON,)}
    nose_m = walk.plant.pose[0] + 0.55
    walk.set_box(nose_m + 0.35, nose_m + 0.95, 0.4)
    modes = set()
    for _ in range(120):
        modes.add(walk.step(AHEAD, grid_age_s=0.4).mode)
        assert not footprint_overlaps(walk.field, walk.plant.pose)
    assert Mode.HOLD in modes and Mode.ESCAPE not in modes


def test_after_an_override_the_robot_rests_before_it_escapes_and_not_along_a_trail_it_was_driven_off():
    walk = Walk(escape=True)
    walk.go_until_escape()
    walk.steps((0.0, 0.2, 0.0), 100, override_mps=0.2)
    later = walk.steps(AHEAD, 39)
    assert Mode.ESCAPE not in {result.mode for result in later}


def test_after_a_silent_controller_the_robot_rests_before_it_escapes():
    walk = Walk(escape=True)
    walk.go_until_escape()
    assert {result.reason for result in walk.steps(AHEAD, 100, nominal_age_s=1.0)} == {"nominal_stale"}
    later = [result.mode for result in walk.steps(AHEAD, 60)]
    assert Mode.ESCAPE not in later[:39] and Mode.ESCAPE in later


def test_an_escape_sends_no_entry_that_the_base_ignores():
    walk = Walk(escape=True, dead_band_per_axis=True, dead_band_mps=0.04)
    walk.steps((0.3, 0.06, 0.0), 60)
    walk.go_until_escape()
    bands = np.array([0.04, 0.04, 0.02])
    for result in walk.steps(AHEAD, 10):
        assert result.mode == Mode.ESCAPE
        assert not np.any((result.u_safe != 0.0) & (np.abs(result.u_safe) < bands))


def test_a_tightened_margin_holds_for_an_escape_too():
    walk = Walk(escape=True)
    walk.go_until_escape()
    walk.filter.tighten(tighten(walk.params, walk.params, {"margin_m": 0.25}))
    results = walk.steps(AHEAD, 150)
    ended = next(i for i, result in enumerate(results) if result.mode != Mode.ESCAPE)
    assert results[ended].h_m >= 0.25


def test_a_jump_of_the_clock_does_not_take_the_operators_word_back():
    walk = Walk(latch_depth_m=0.5)
    walk.set_box(-6.0, 6.0, 6.0)
    assert walk.steps(AHEAD, 14)[-1].reason == "deep_inside"
    walk.filter.reset()
    assert {result.reason for result in walk.steps(AHEAD, 14)} == {""}
    walk.filter.forget()
    assert "deep_inside" not in {result.reason for result in walk.steps(AHEAD, 14)}


def test_a_ghost_does_not_lock_where_the_cells_of_every_grid_lie_elsewhere():
    walk = Walk()
    x_m, moved = walk.plant.pose[0], 0
    for _ in range(100):
        walk.grid = {"origin_m": (-8.0 - 0.013 * (walk.tick // 2), -8.0)}
        walk.field = make_field(walk.unsafe, resolution_m=CELL_M, **walk.grid)
        walk.set_box(x_m - 0.11, x_m + 0.11, 0.11)
        moved += bool(np.any(walk.step(AHEAD).u_safe))
    assert moved > 50


def test_a_reset_does_not_forget_the_commands_that_are_on_their_way():
    params = make_params(delay_s=1.0)
    walls = np.zeros((CELLS, CELLS), dtype=bool)
    walls[:, 50:] = True  # from x = 2 m on
    field = make_field(walls, resolution_m=CELL_M)

    def find_rest_m(reset_at):
        filter_, plant = CbfFilter(params), Plant((-1.5, 0.1, 0.0), 0.08, 20)
        for tick in range(260):
            if tick == reset_at:
                filter_.reset()
            plant.step(filter_.step(make_inputs((0.5, 0.0, 0.0), field, plant.pose, plant.twist)).u_safe)
        return plant.pose[0]

    without_m = find_rest_m(None)
    for reset_at in range(70, 130, 5):
        assert find_rest_m(reset_at) <= without_m + 0.02, reset_at

# SPDX-License-Identifier: BSD-3-Clause
"""Cells that turn unsafe under the robot: it stands for a moment, walks off them, and enters no other unsafe cell."""

import os

import numpy as np
import pytest
from control_support import (
    LENGTH_M,
    WIDTH_M,
    Driver,
    Plant,
    footprint_overlaps,
    make_field,
    make_inputs,
    make_params,
    make_random_mask,
)
from scipy.ndimage import label

from core_control.body import Body, find_unsafe_near
from core_control.cbf_filter import CbfFilter
from core_control.dynamics import compute_rotation, place_discs
from core_control.types import Mode
from core_control.underfoot import Underfoot

SEED = int(os.environ.get("CORE_SEED", "0"))
PARAMS = make_params()
CELLS, CELL_M = 60, 0.2
AHEAD = np.array([0.4, 0.0, 0.0])
OFF_CENTRE = make_params(footprint={"length_m": LENGTH_M, "width_m": WIDTH_M, "center_x_m": 0.3})
DISCS = make_params(discs=[[0.3, 0.0, 0.4], [-0.3, 0.0, 0.4]])


class Walk:
    """A robot under the filter; a new grid every second tick, each with a stamp of its own."""

    def __init__(self, pose=(0.0, 0.0, 0.0), params=PARAMS, cells=CELLS):
        self.filter, self.plant, self.tick = CbfFilter(params), Plant(pose), 0
        self.unsafe = np.zeros((cells, cells), dtype=bool)
        self.field = None

    def step(self, u):
        """One tick; the result of the filter, and the poses the robot went through."""
        if self.tick % 2 == 0:
            self.field = make_field(self.unsafe, resolution_m=CELL_M, stamp_s=0.05 * self.tick)
        self.tick += 1
        result = self.filter.step(make_inputs(u, self.field, self.plant.pose, self.plant.twist))
        return result, self.plant.step(result.u_safe)

    def steps(self, u, count):
        return [self.step(u)[0] for _ in range(count)]

    def set_under(self, value=True, offset_m=(0.0, 0.0)):
        """Change the cell under a point of the body."""
        cell = self.field.find_cell(self.plant.pose[:2] + np.array(offset_m))
        self.unsafe[cell] = value
        return cell


def is_moving(result):
    return bool(np.any(result.u_safe))


# The outline.


@pytest.mark.parametrize("params", [PARAMS, OFF_CENTRE, DISCS], ids=["rectangle", "off_centre", "discs"])
def test_squares_under_the_body_are_those_whose_points_all_lie_in_it(params):
    rng, body = np.random.default_rng(0), Body(params)
    grid = np.stack(np.meshgrid(*[np.linspace(-0.5, 0.5, 21)] * 2), axis=-1).reshape(-1, 2)
    seen = np.zeros(3, dtype=int)
    for _ in range(300):
        pose, cell_m = rng.uniform(-1, 1, 3) * [0.3, 0.3, 3.0], rng.uniform(0.05, 0.3)
        centre = rng.uniform(-0.8, 0.8, 2)
        points = centre + cell_m * grid - pose[:2]
        c, s = np.cos(pose[2]), np.sin(pose[2])
        local = points @ np.array([[c, -s], [s, c]])
        if params is DISCS:
            gaps = np.linalg.norm(local[:, None] - params.disc_array[:, :2], axis=2)
            within, inside = (gaps <= 0.2).all(axis=0).any(), (gaps < 0.4).any()
        else:
            local = local - [params.footprint.center_x_m, 0.0]
            inside_each = (np.abs(local) < [LENGTH_M / 2, WIDTH_M / 2]).all(axis=1)
            within, inside = inside_each.all(), inside_each.any()
        covered = body.covers(pose, centre[None], cell_m)[0]
        touched = body.overlaps(pose[None], centre[None], cell_m)[0]
        assert covered == within
        assert touched or not inside
        assert inside or not touched or body.overlaps(pose[None], centre[None], cell_m, -0.05 * cell_m)[0] <= touched
        seen += [covered, touched and not covered, not touched]
    assert seen.min() > 10


def test_overlaps_agree_with_those_of_the_soundness_tests():
    rng, body = np.random.default_rng(1), Body(PARAMS)
    field = make_field(make_random_mask(rng, CELLS), resolution_m=CELL_M)
    for _ in range(300):
        pose = np.append(rng.uniform(-4.5, 4.5, 2), rng.uniform(-np.pi, np.pi))
        iy, ix = find_unsafe_near(field, pose[None], body.reach_m)
        assert body.overlaps(pose[None], field.compute_centre(iy, ix), CELL_M).any() == footprint_overlaps(field, pose)


# One ghost.


@pytest.mark.parametrize("u", [AHEAD, -AHEAD, [0.0, 0.2, 0.0], [0.3, 0.0, 0.4]], ids=["ahead", "back", "left", "turn"])
def test_one_ghost_cell_stops_the_robot_for_three_grids_and_does_not_lock_it(u):
    walk = Walk((0.1, 0.1, 0.0))
    assert all(is_moving(result) for result in walk.steps(u, 10))
    cell = walk.set_under()
    walk.tick += walk.tick % 2
    stood = walk.steps(u, 6)
    for result in stood:
        assert (result.mode, result.reason) == (Mode.HOLD, "")
        np.testing.assert_array_equal(result.u_safe, np.zeros(3))
        assert "a cell under the robot became unsafe: BETWEEN(traffic_cone)" in result.detail
        assert result.binding.cell == cell[0] * CELLS + cell[1]
        assert result.h_m < 0.0
    after = walk.steps(u, 80)
    assert all(is_moving(result) for result in after), "it is not stopped half-way off the cell"
    assert {result.mode for result in after} >= {Mode.HOLD, Mode.NOMINAL}
    assert after[-1].mode == Mode.NOMINAL
    assert not footprint_overlaps(walk.field, walk.plant.pose)


def test_a_ghost_that_goes_away_costs_no_more_than_its_time():
    walk = Walk((0.1, 0.1, 0.0))
    walk.steps(AHEAD, 10)
    cell = walk.set_under()
    assert not any(is_moving(result) for result in walk.steps(AHEAD, 2))
    walk.unsafe[cell] = False
    assert all(is_moving(result) for result in walk.steps(AHEAD, 10))


def test_a_place_that_flickers_is_stood_out_once():
    walk, standing = Walk((0.1, 0.1, 0.0)), 0
    walk.steps(np.zeros(3), 2)
    cell = walk.set_under()
    for grid in range(40):
        walk.unsafe[cell] = grid % 2 == 0
        standing += sum(not is_moving(result) for result in walk.steps((0.02, 0.0, 0.0), 2))
    assert standing == 2 * PARAMS.underfoot_grids


def test_a_cell_partly_under_the_body_is_no_ghost():
    walk = Walk((0.1, 0.1, 0.0))
    walk.steps(np.zeros(3), 2)
    walk.set_under(offset_m=(LENGTH_M / 2.0, 0.0))
    assert not any(is_moving(result) for result in walk.steps(AHEAD, 20))
    assert all(is_moving(result) for result in walk.steps(-AHEAD, 10))


def test_a_cell_the_robot_has_walked_off_is_not_walked_on_again():
    walk = Walk((0.1, 0.1, 0.0))
    walk.steps(np.zeros(3), 2)
    walk.set_under()
    left = False
    for _ in range(200):
        result, poses = walk.step(-AHEAD if left else AHEAD)
        overlapping = any(footprint_overlaps(walk.field, pose) for pose in poses)
        assert not (left and overlapping)
        left = left or not overlapping
    assert left
    assert not is_moving(result)


def test_deep_in_one_cell_the_robot_still_keeps_out_of_the_others():
    """A disc whose centre lies in an unsafe cell has one row, out of it; here a wall stands in that way."""
    walk = Walk((0.12, 0.1, 0.0), make_params(discs=[[0.0, 0.0, 0.45]]))
    walk.steps(np.zeros(3), 2)
    walk.set_under()
    walk.unsafe[:, walk.field.find_cell(np.array([0.7, 0.0]))[1]] = True
    results = walk.steps(AHEAD, 60)
    assert {result.mode for result in results} == {Mode.HOLD}
    assert walk.plant.pose[0] + 0.45 < 0.6
    assert any(is_moving(result) for result in walk.steps(-AHEAD, 40))


def test_nobody_moves_by_himself_off_a_ghost():
    walk = Walk((0.1, 0.1, 0.0))
    walk.steps(np.zeros(3), 2)
    walk.set_under()
    assert not any(is_moving(result) for result in walk.steps(np.zeros(3), 20))


@pytest.mark.parametrize("yaw_rad", [0.0, 0.7, 2.5])
def test_in_a_region_larger_than_the_body_its_neighbours_hold_the_robot(yaw_rad):
    """A disc that has grown over the robot: it can be driven out, and no other way."""
    walk = Walk((0.1, 0.1, yaw_rad), make_params(latch_depth_m=3.0))
    walk.steps(np.zeros(3), 2)
    centres = walk.field.compute_centre(*np.indices((CELLS, CELLS)).reshape(2, -1))
    walk.unsafe = (np.linalg.norm(centres + [1.0, 0.0], axis=1) < 2.0).reshape(CELLS, CELLS)
    inward, outward = (np.append(compute_rotation(yaw_rad).T @ [sign, 0.0], 0.0) * 0.3 for sign in (-1.0, 1.0))
    walk.steps(inward, 8)
    for u in (inward, inward + [0.0, 0.0, 0.4], inward - [0.0, 0.0, 0.4]):
        depths_m = [result.h_m for result in walk.steps(u, 40)]
        assert min(depths_m) > depths_m[0] - 1e-6
        assert walk.plant.pose[0] > 0.0
    results = walk.steps(outward, 150)
    assert {result.mode for result in results} >= {Mode.HOLD, Mode.NOMINAL}
    assert walk.plant.pose[0] > 1.5


def test_places_keep_their_meaning_when_the_corner_of_the_grid_moves():
    underfoot, pose = Underfoot(PARAMS, Body(PARAMS)), np.array([0.05, 0.1, 0.0])
    safe, unsafe = np.zeros((21, 21), bool), np.zeros((21, 21), bool)
    corner = np.array([-2.0, -2.1])
    underfoot.update(make_field(safe, resolution_m=CELL_M, origin_m=corner), pose)
    unsafe[10, 10] = True
    underfoot.update(make_field(unsafe, resolution_m=CELL_M, origin_m=corner, stamp_s=0.1), pose)
    assert (len(underfoot), underfoot.find_new()) == (1, 10 * 21 + 10)
    moved = np.roll(unsafe, (-3, 2), axis=(0, 1))
    for i in range(2, 5):
        field = make_field(moved, resolution_m=CELL_M, origin_m=corner + [-0.4, 0.6], stamp_s=0.1 * i)
        assert underfoot.find_new() is not None
        underfoot.update(field, pose)
    assert (len(underfoot), underfoot.find_new()) == (1, None)
    assert field.unsafe.sum() == 1
    assert not underfoot.clear_field().unsafe.any()
    out_of_step = make_field(unsafe, resolution_m=CELL_M, origin_m=corner + 0.07, stamp_s=0.5)
    underfoot.update(out_of_step, pose)
    assert len(underfoot) == 1
    assert underfoot.find_new() is None, "the cell of another lattice that it lies in takes its count"


# The law.


class FlickeringWorld:
    """Blocks of cells turn unsafe under the robot and around it, some for good; ghosts and real things alike."""

    def __init__(self, rng):
        self._rng, self.base = rng, rng.random((CELLS, CELLS)) < 0.02
        self.base[27:33, 27:33] = False

    def look(self, walk):
        row, column = walk.field.find_cell(walk.plant.pose[:2])
        shown = self.base.copy()
        for _ in range(self._rng.choice([0, 0, 0, 1, 2])):
            iy, ix = np.array([row, column]) + self._rng.integers(-5, 5, 2)
            ly, lx = self._rng.integers(1, 4, 2)
            shown[max(0, iy) : iy + ly, max(0, ix) : ix + lx] = True
        shown &= self._rng.random(shown.shape) > 0.02
        self.base = shown if self._rng.random() < 0.1 else self.base
        if self._rng.random() < 0.05:  # so that it is not walled in for ever
            self.base = self.base & (self._rng.random(shown.shape) < 0.5)
        walk.unsafe = shown


def find_overlapped(field, poses, grow_m=0.0):
    """Mask of the unsafe cells that the rectangle overlaps at any of the poses."""
    body, on = Body(PARAMS), np.zeros_like(field.unsafe)
    iy, ix = find_unsafe_near(field, poses, body.reach_m + grow_m)
    on[iy, ix] = body.overlaps(poses, field.compute_centre(iy, ix), CELL_M, grow_m)
    return on


def run_random_walk(seed, steps=120):
    """(ticks that led into another region, into more of the same one, moves on unsafe cells, smallest rise of h)."""
    rng = np.random.default_rng([SEED, 6, seed])
    walk, world = Walk((0.0, 0.0, rng.uniform(-3, 3))), FlickeringWorld(rng)
    walk.unsafe = world.base
    driver, roll_out = Driver(rng, PARAMS.limits), walk.filter._profile.roll_out
    walk.step(np.zeros(3))
    others, deeper, on_cells, rise_m = 0, 0, 0, np.inf
    for _ in range(steps):
        if walk.tick % 2 == 0:
            world.look(walk)
        pose, twist = walk.plant.pose, walk.plant.twist
        result, poses = walk.step(driver.step(pose, walk.field))
        stop = np.concatenate([pose[None], roll_out.predict(pose, twist, [], np.zeros(3))])
        on = find_overlapped(walk.field, stop)
        after = roll_out.predict(walk.plant.pose, walk.plant.twist, [], np.zeros(3))
        entered = find_overlapped(walk.field, np.concatenate([poses, after]), -0.003) & ~on
        joined, count = label(walk.field.unsafe, np.ones((3, 3)))
        same = np.isin(joined, np.unique(joined[on & walk.field.unsafe]))
        others += bool((entered & ~same).any())
        on_cells += bool(on.any()) and is_moving(result)
        if (entered & same).any():
            deeper += 1
            h_m = compute_h(walk.field, np.concatenate([poses, pose[None]]))
            rise_m = min(rise_m, h_m - compute_h(walk.field, stop))
    return np.array([others, deeper, on_cells, rise_m])


def compute_h(field, poses):
    centres = place_discs(poses, PARAMS.disc_array)
    return min(field.compute_signed_distance(centres[:, i]).min() - disc[2] for i, disc in enumerate(PARAMS.disc_array))


def test_the_body_enters_no_unsafe_cell_that_it_was_not_on_when_it_turned_unsafe():
    """Each tick: what it overlaps it overlapped before, or by stopping. Then the same holds for every walk.

    The one exception: out of a region larger than the body the way leads through it, with h that does not fall.
    """
    results = np.array([run_random_walk(seed) for seed in range(12)])
    others, deeper, on_cells = results[:, :3].sum(axis=0)
    assert others == 0
    assert on_cells > 50
    assert results[:, 3].min() > -2e-3

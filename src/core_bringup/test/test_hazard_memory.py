# SPDX-License-Identifier: BSD-3-Clause
"""Grids made by hand that hold a barrier, lose a cell of it, or never had it; and the walk that asks for them."""

import math
import stat

import numpy as np
import pytest
from simple_world import ROBOT

from core_bringup.camera import CameraModel
from core_bringup.evaluation import hazard_walk
from core_bringup.evaluation.frame_recording import FrameRecording, RecordingHeader, RecordingWriter
from core_bringup.evaluation.grid_file import NO_CAUSE, SAFE, UNKNOWN, UNSAFE, DecidedGrid
from core_bringup.evaluation.ground_program import GroundStream, add_noise
from core_bringup.evaluation.hazard_memory import (
    Drift,
    GridCheck,
    HazardWatch,
    Passage,
    core_cells,
    count_openings,
    summarise_round,
)
from core_bringup.evaluation.true_regions import TrueRegion, TruthParams
from core_bringup.exceptions import BringupError
from core_bringup.world import load_world
from core_bringup.world_types import CameraNoise
from core_perception.predicates import parse_predicate

RES_M = 0.2
# A line across a passage of 3 m x 2 m, two columns of cells thick: x 1.4 ... 1.8, y 0 ... 2.
LINE = TrueRegion("BETWEEN(cone)", np.array([[1.41, 0.0], [1.79, 0.0], [1.79, 2.0], [1.41, 2.0]]))
PASSAGE = Passage((0.0, 0.0), (3.0, 2.0), 0.5)
CLOSED = [(x, y) for x in (7, 8) for y in range(10)]


def grid(closed=CLOSED, unknown=(), frame=0, origin=(-5, -5), size=30, h_m=None, unknown_is_unsafe=True):
    state = np.full((size, size), SAFE, np.uint8)
    for cells, value in ((unknown, UNKNOWN), (closed, UNSAFE)):
        for x, y in cells:
            if 0 <= x - origin[0] < size and 0 <= y - origin[1] < size:
                state[y - origin[1], x - origin[0]] = value
    unsafe = (state == UNSAFE) | ((state == UNKNOWN) & unknown_is_unsafe)
    barrier = np.where(unsafe, -0.1, 0.1) if h_m is None else np.full(state.shape, h_m)
    cause = np.full(state.shape, NO_CAUSE, np.uint16)
    return DecidedGrid(frame, 0.1 * frame, origin, unsafe, state, barrier, cause, ())


def watch():
    return HazardWatch({"line": LINE}, PASSAGE, RES_M)


def without(*cells):
    return [cell for cell in CLOSED if cell not in cells]


def test_a_barrier_that_stays_has_no_opening():
    watched = watch()
    checks = [watched.check(grid(frame=k)) for k in range(3)]
    assert watched.confirmed == {"line": 0}
    assert not any(check.is_open for check in checks)
    assert [(check.passable, check.threaded) for check in checks] == [(False, False)] * 3


def test_one_lost_cell_is_an_opening_though_nobody_fits_through():
    watched = watch()
    watched.check(grid())
    check = watched.check(grid(without((7, 4)), frame=1))
    assert (check.is_open, check.open_cells, check.gap_m) == (True, 1, pytest.approx(0.2))
    assert check.first_open_m.tolist() == pytest.approx([1.5, 0.9])
    assert (check.passable, check.threaded) == (False, False)


@pytest.mark.parametrize(("rows", "passable", "gap_m"), [(1, False, 0.4), (2, False, 0.4), (3, True, 0.6)])
def test_the_robot_passes_a_gap_as_wide_as_itself(rows, passable, gap_m):
    watched = watch()
    watched.check(grid())
    check = watched.check(grid(without(*[(x, 4 + k) for x in (7, 8) for k in range(rows)])))
    assert (check.passable, check.threaded) == (passable, True)
    assert check.gap_m == pytest.approx(gap_m)


def test_a_point_slips_through_over_a_corner():
    watched = watch()
    watched.check(grid())
    check = watched.check(grid(without((7, 4), (8, 5))))
    assert (check.passable, check.threaded, check.open_cells) == (False, True, 2)
    assert check.gap_m == pytest.approx(0.4)


def test_a_barrier_value_above_zero_opens_a_cell_that_is_called_unsafe():
    watched = watch()
    watched.check(grid())
    assert watched.check(grid(h_m=0.01)).open_cells == len(CLOSED)
    assert watched.check(grid(h_m=0.0)).open_cells == 0
    assert watched.check(grid((), h_m=-0.1)).open_cells == len(CLOSED)  # nor does h alone close one that is called safe


def test_nothing_is_asked_before_the_hazard_was_closed_once():
    watched = watch()
    for cells in ((), without((7, 4))):
        check = watched.check(grid(cells))
        assert (check.open_cells, check.passable, check.is_open) == (0, None, False)
    assert not watched.confirmed
    watched.check(grid(frame=5))
    assert watched.confirmed == {"line": 5}
    assert watched.check(grid(without((7, 4)))).is_open


def test_unknown_neither_confirms_nor_opens_and_does_not_close_the_passage():
    watched = watch()
    watched.check(grid((), unknown=CLOSED))
    assert not watched.confirmed
    watched.check(grid())
    check = watched.check(grid((), unknown=CLOSED))
    assert (check.open_cells, check.passable) == (0, True)
    assert watched.check(grid((), unknown=CLOSED, unknown_is_unsafe=False)).open_cells == len(CLOSED)


def test_what_the_window_does_not_hold_is_not_looked_at():
    watched = watch()
    # Half the line is outside: no confirmation.
    watched.check(grid(origin=(-5, 5)))
    assert not watched.confirmed
    watched.check(grid())
    gone = watched.check(grid((), origin=(40, 40)))
    assert (gone.open_cells, gone.passable, gone.is_open) == (0, None, False)
    half = watched.check(grid(without((7, 8), (7, 2)), origin=(-5, 5)))
    assert half.open_cells == 1


def test_every_hazard_is_confirmed_on_its_own():
    other = TrueRegion("AROUND(person)", np.array([[-0.6, 0.0], [-0.4, 0.0], [-0.4, 0.2], [-0.6, 0.2]]), 0.1)
    watched = HazardWatch({"line": LINE, "person": other}, PASSAGE, RES_M)
    check = watched.check(grid())
    assert watched.confirmed == {"line": 0}
    assert not check.is_open
    cells, _ = core_cells(other, grid(), RES_M)
    around = [(int(x) - 5, int(y) - 5) for y, x in np.argwhere(cells)]
    watched.check(grid(CLOSED + around, frame=1))
    assert watched.confirmed == {"line": 0, "person": 1}
    assert watched.check(grid(frame=2)).open_cells == len(around)


def test_core_cells_are_those_whose_centre_is_inside():
    mask, whole = core_cells(LINE, grid(), RES_M)
    assert sorted((int(x) - 5, int(y) - 5) for y, x in np.argwhere(mask)) == CLOSED
    assert whole
    disc = TrueRegion("", np.array([[0.0, 0.0], [0.2, 0.0], [0.2, 0.2], [0.0, 0.2]]), 0.15)
    mask, _ = core_cells(disc, grid(), RES_M)
    # The own cell and, 0.1 m from its sides, the four beside it; corners are 0.14 m off.
    assert int(mask.sum()) == 9
    mask, _ = core_cells(TrueRegion("", disc.polygon_m, 0.12), grid(), RES_M)
    assert int(mask.sum()) == 5


def test_with_drift_the_hazard_is_looked_for_where_odometry_has_it():
    drift = Drift((0.0, 1.0), math.pi / 2)  # (x, y) -> (-y, x + 1)
    turned = [(-1 - y, x + 5) for x, y in CLOSED]
    watched = watch()
    watched.check(grid(turned, origin=(-15, -5)), drift)
    assert watched.confirmed == {"line": 0}
    check = watched.check(grid(turned[1:], origin=(-15, -5)), drift)
    assert (check.open_cells, check.passable) == (1, False)
    assert watched.check(grid(CLOSED, origin=(-15, -5)), drift).passable


def test_openings_and_rounds_are_counted():
    def check(n, open_cells, gap_m=0.0, passable=False, threaded=False):
        return GridCheck(n, open_cells, gap_m, None, passable, threaded)

    checks = [check(0, 0), check(1, 2, 0.4), check(2, 1, 0.2), check(3, 0), check(4, 0, passable=True, threaded=True)]
    assert count_openings(checks) == 2
    assert count_openings([check(0, 1)]) == 1
    assert summarise_round(3, checks) == {
        "round": 3, "frames": 5, "open_frames": 3, "open_cells": 2, "longest_gap_m": 0.4, "passable_frames": 1,
        "threaded_frames": 1,
    }  # fmt: skip


# ---- the walk --------------------------------------------------------------------------------------------------------

WORLD = load_world(hazard_walk.WORLD).for_task(hazard_walk.TASK)


def test_every_round_goes_ten_metres_away_and_comes_back():
    lap = hazard_walk.plan(WORLD, 3, ROBOT)
    x_m, rounds = np.array([pose.x_m for pose in lap.poses]), np.array(lap.round_of)
    assert sorted(set(lap.round_of)) == [1, 2, 3]
    for n in (1, 2, 3):
        part = x_m[rounds == n]
        assert part.max() - part.min() > 9.6
        assert part[-1] > hazard_walk.NEAR_X_M - 0.3
    # The lanes differ, and all keep clear of the person by more than his radius and half the robot's width.
    lanes = [np.mean([p.y_m for p, r in zip(lap.poses, lap.round_of) if r == n]) for n in (1, 2, 3)]
    assert len({round(lane, 2) for lane in lanes}) == 3
    (person,) = [o for o in WORLD.objects if o.name == "aisle_worker"]
    away_m = min(math.hypot(p.x_m - person.position_m[0], p.y_m - person.position_m[1]) for p in lap.poses)
    assert away_m > 0.25 + 1.0 + 0.25


def test_the_line_is_out_of_view_on_the_way_back():
    lap = hazard_walk.plan(WORLD, 1, ROBOT)
    assert sum(math.cos(pose.yaw_rad) < 0.0 for pose in lap.poses) > 200


def test_the_cores_are_the_line_and_the_person_in_the_aisle():
    predicates = [parse_predicate(text) for text in WORLD.task(hazard_walk.TASK).oracle_predicates]
    cores = hazard_walk.make_cores(WORLD, predicates, TruthParams(), RES_M)
    assert list(cores) == ["BETWEEN(traffic_cone)", "AROUND(person)"]
    line, person = cores.values()
    assert line.bounds_m()[0] == pytest.approx([5.82, -3.02])
    assert person.radius_m == pytest.approx(0.8)
    assert person.polygon_m.mean(axis=0) == pytest.approx([4.4, 1.75])


def test_drift_grows_with_the_way_and_the_same_seed_drifts_the_same():
    lap = hazard_walk.plan(WORLD, 1, ROBOT)
    assert all(drift == Drift() for drift in hazard_walk.drift_along(lap.poses, 0))
    drifts = hazard_walk.drift_along(lap.poses, 3)
    assert drifts == hazard_walk.drift_along(lap.poses, 3)
    offsets_m = [d.offset_m((p.x_m, p.y_m)) for d, p in zip(drifts, lap.poses)]
    assert offsets_m[0] == 0.0
    assert 0.001 < max(offsets_m) < 0.05 * 25.0
    assert max(abs(d.yaw_rad) for d in drifts) == pytest.approx(abs(drifts[-1].yaw_rad))
    # Where the odometry believes to be is how it counted its own steps.
    p_odom = np.array([d.apply(np.array([[p.x_m, p.y_m]]))[0] for d, p in zip(drifts, lap.poses)])
    p_world = np.array([[p.x_m, p.y_m] for p in lap.poses])
    ratio = (
        np.linalg.norm(np.diff(p_odom, axis=0), axis=1).sum() / np.linalg.norm(np.diff(p_world, axis=0), axis=1).sum()
    )
    assert abs(ratio - 1.0) <= hazard_walk.STRAIGHT_PER_M
    T = drifts[-1].matrix()
    place = np.array([1.0, 2.0])
    assert (T @ [*place, 0.5, 1.0])[:2] == pytest.approx(drifts[-1].apply(place[None])[0])


# ---- the program -----------------------------------------------------------------------------------------------------

HEADER = RecordingHeader(CameraModel(5, 3, 274.9, 0.3, 2.0, 1.0), {1: "floor"}, ())
IMAGES = (np.full((3, 5), 2000, np.uint16), np.ones((3, 5), np.uint16))
HEAD = "core_grids 1\\nresolution_m 0.2\\nunknown_is_unsafe 1\\nend\\n"


def program(path, text):
    path.write_text(f"#!/usr/bin/env python3\nimport sys, struct\n{text}\n", encoding="utf-8")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return path


def frame(k):
    return 1.0 + k, np.eye(4), np.zeros(2), *IMAGES


def test_a_stream_hands_on_a_grid_for_every_frame(tmp_path):
    size = 8 * 19 + 2 * 2 * 15
    one = program(
        tmp_path / "ground",
        f"""
read, write = open(sys.argv[2], "rb"), open(sys.argv[4], "wb")
while read.readline() != b"end\\n": pass
write.write(b"{HEAD}")
for k in range(3):
    stamp_s, = struct.unpack("<d", read.read({size})[:8])
    write.write(struct.pack("<idiiii", k, stamp_s, 0, 0, 1, 1) + b"\\1" + struct.pack("<fHi", -0.1, 65535, 0))
    write.flush()
""",
    )
    grids = []
    with GroundStream(one, {"resolution_m": 0.2}, HEADER, 3, grids.append) as stream:
        for k in range(3):
            stream.add(*frame(k))
    assert [(g.frame, g.stamp_s, bool(g.unsafe[0, 0])) for g in grids] == [
        (0, 1.0, True),
        (1, 2.0, True),
        (2, 3.0, True),
    ]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("sys.exit('no such parameter')", "exit status 1: no such parameter"),
        (f"open(sys.argv[2], 'rb').read()\nsys.stdout.write('{HEAD}')\nsys.exit(3)", "exit status 3"),
        ("open(sys.argv[2], 'rb').read()\nprint('nonsense')", "ConfigError"),
    ],
)
def test_a_program_that_fails_is_named_with_what_it_said(tmp_path, text, words):
    failing = program(tmp_path / "ground", text)
    with pytest.raises(BringupError, match=words), GroundStream(failing, {}, HEADER, 500, lambda grid: None) as stream:
        for k in range(500):
            stream.add(*frame(k))


def test_a_check_that_raises_ends_the_run(tmp_path):
    grid_text = 'struct.pack("<idiiii", 0, 1.0, 0, 0, 1, 1) + b"\\1" + struct.pack("<fHi", -0.1, 65535, 0)'
    one = program(tmp_path / "ground", f'open(sys.argv[4], "wb").write(b"{HEAD}" + {grid_text})\nsys.stdin.read()')

    def fail(_grid):
        raise ValueError("cannot be checked")

    with pytest.raises(BringupError, match="cannot be checked"), GroundStream(one, {}, HEADER, 1, fail) as stream:
        stream.add(*frame(0))


def test_noise_changes_depth_and_nothing_else(tmp_path):
    path = tmp_path / "exact.frames"
    depth_mm = np.full((3, 5), 5000, np.uint16)
    depth_mm[0, 0] = 0
    with RecordingWriter(path, HEADER, 2) as writer:
        for k in range(2):
            writer.add(1.0 + k, np.eye(4), np.zeros(2), depth_mm, IMAGES[1])
    noise = CameraNoise(depth_sigma_per_m2=0.0015, seed=1)
    for name in ("a", "b"):
        add_noise(path, noise, tmp_path / name)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
    noisy = FrameRecording.open(tmp_path / "a").frames
    for k in range(2):
        assert noisy[k]["depth_mm"][0, 0] == 0
        off_mm = np.abs(noisy[k]["depth_mm"].astype(int) - 5000)[depth_mm > 0]
        assert 0 < off_mm.max() < 4 * 37.5
        assert (noisy[k]["labels"] == IMAGES[1]).all()
    assert (noisy[0]["depth_mm"] != noisy[1]["depth_mm"]).any()

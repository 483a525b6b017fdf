# SPDX-License-Identifier: BSD-3-Clause
"""Maps made by hand against truths made by hand: overlap, depth of the border, what counts as observed."""

import io
import struct

import numpy as np
import pytest
from simple_world import make_mover, make_object

from core_bringup.camera import CameraModel
from core_bringup.evaluation.grid_file import NO_CAUSE, SAFE, UNKNOWN, UNSAFE, DecidedGrid, GridReader
from core_bringup.evaluation.map_truth import GridCollage, add_counts, compare, figures
from core_bringup.evaluation.map_truth_picture import OPTIMISTIC, PESSIMISTIC, UNDECIDED, classify, draw_comparison
from core_bringup.evaluation.map_truth_run import SCENES, judge, summarise
from core_bringup.evaluation.sight import SightParams, behind_edge, look
from core_bringup.evaluation.true_regions import SAMPLES, Raster, TrueRegion
from core_bringup.exceptions import ConfigError
from core_bringup.world import load_world
from core_perception.predicates import parse_predicate

RES_M = 0.2
RASTER = Raster((0, 0), (10, 10), RES_M)  # 0 ... 2 m


def truth_of(*rectangles):
    """Samples of rectangles (x0, y0, x1, y1) in cells."""
    mask = np.zeros((100, 100), dtype=bool)
    for x0, y0, x1, y1 in RES_M * np.array(rectangles, dtype=float).reshape(-1, 4):
        RASTER.paint(TrueRegion("", np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])), mask)
    return mask


def cells(*rectangles):
    """Mask of cells [x0, x1) x [y0, y1)."""
    mask = np.zeros((10, 10), dtype=bool)
    for x0, y0, x1, y1 in rectangles:
        mask[y0:y1, x0:x1] = True
    return mask


ALL = cells((0, 0, 10, 10))


def test_a_map_that_is_right_is_right():
    comparison = compare(RASTER, truth_of((2, 2, 6, 5.5)), cells((2, 2, 6, 6)), ALL)
    result = figures(comparison.counts())
    assert (result["iou"], result["optimistic_share"], result["pessimistic_share"]) == (1.0, 0.0, 0.0)
    assert result["border_within_1_cell"] == 1.0
    assert comparison.worst()[0] == 0.0


@pytest.mark.parametrize("rows", [1, 2, 3])
def test_a_border_some_rows_too_far_in_has_that_depth(rows):
    comparison = compare(RASTER, truth_of((0, 2, 10, 8)), cells((0, 2 + rows, 10, 8)), ALL)
    depth, place_m, _ = comparison.worst()
    assert depth == pytest.approx(rows - 0.5 / SAMPLES, abs=1e-3)  # measured at the outermost sample
    assert place_m[1] == pytest.approx(0.4, abs=0.02)
    counts = comparison.counts()
    assert (counts["both"], counts["optimistic"]) == (10 * (6 - rows), 10 * rows)
    # The upper border, all of it right, is as long as the lower one.
    assert counts["border_within_1"] == counts["border"] * (1.0 if rows == 1 else 0.5)


def test_a_missed_object_is_as_deep_as_the_next_closed_thing_is_far():
    truth = truth_of((1, 1, 2, 2), (8, 1, 9, 2))
    comparison = compare(RASTER, truth, cells((8, 1, 9, 2)), ALL)
    assert comparison.worst()[0] == pytest.approx(7.0, abs=0.06)
    nothing = compare(RASTER, truth, cells(), ALL)
    assert nothing.worst()[0] == pytest.approx(10.0 * np.sqrt(2.0))
    assert figures(nothing.counts())["border_within_1_cell"] == 0.0


def test_a_hole_inside_is_no_fault_of_the_border():
    unsafe = cells((1, 1, 9, 9)) & ~cells((4, 4, 6, 6))
    comparison = compare(RASTER, truth_of((1, 1, 9, 9)), unsafe, ALL)
    assert comparison.worst()[0] == 0.0
    assert comparison.worst(everywhere=True)[0] == pytest.approx(1.0, abs=0.1)
    assert comparison.counts()["optimistic"] == 4


def test_cells_never_observed_count_nowhere():
    comparison = compare(RASTER, truth_of((0, 2, 10, 8)), cells(), cells((0, 0, 10, 2)))
    assert comparison.counts()["border"] == 0
    assert comparison.worst() is None
    assert figures(comparison.counts())["iou"] is None


def test_a_cell_that_a_border_only_touches_has_no_true_side():
    # The face lies on the edge of row 4; the row before it may be called either way.
    truth, observed = truth_of((0, 4, 10, 6)), cells((0, 0, 10, 6))
    for unsafe, strict in ((cells((0, 4, 10, 6)), 1.0), (cells((0, 3, 10, 6)), 20 / 30)):
        comparison = compare(RASTER, truth, unsafe, observed)
        result = figures(comparison.counts())
        assert (result["iou"], result["iou_strict"]) == (1.0, pytest.approx(strict, abs=1e-4))
        assert comparison.counts()["undecided"] == 10
    two = compare(RASTER, truth, cells((0, 2, 10, 6)), observed).counts()
    assert (two["pessimistic"], two["pessimistic_beside"]) == (10, 0)
    # A border two samples off is decided.
    assert compare(RASTER, truth_of((0, 4.2, 10, 6)), cells(), observed).counts()["undecided"] == 0


def test_any_part_of_a_cell_makes_it_unsafe():
    comparison = compare(RASTER, truth_of((2.3, 2.3, 2.5, 2.5)), cells((2, 2, 3, 3)), ALL)
    assert comparison.counts()["both"] == 1
    assert figures(comparison.counts())["iou"] == 1.0


def test_figures_add_up_over_maps():
    counts = [
        compare(RASTER, truth_of((0, 0, 10, n + 0.5)), cells((0, 0, 10, 2)), ALL).counts() for n in (1, 2)
    ]  # fmt: skip
    assert figures(add_counts(counts))["iou"] == pytest.approx(40 / 50)


def decided(origin, state, frame=0, unknown_is_unsafe=True, causes=(("NEAR(box)", "box", 1),)):
    state = np.array(state, np.uint8)
    unsafe = (state == UNSAFE) | ((state == UNKNOWN) & unknown_is_unsafe)
    cause = np.where(state == UNSAFE, 0, NO_CAUSE).astype(np.uint16)
    return DecidedGrid(frame, 0.0, origin, unsafe, state, np.where(unsafe, -0.1, 0.1), cause, causes)


def test_a_collage_keeps_the_newest_decision_about_every_cell():
    first = decided((0, 0), [[SAFE, UNSAFE], [UNSAFE, UNSAFE]])
    second = decided((1, 0), [[SAFE, UNSAFE], [SAFE, SAFE]])
    collage = GridCollage([first, second])
    assert collage.rectangle == ((0, 0), (3, 2))
    unsafe, number = collage.join()
    assert unsafe.tolist() == [[False, False, True], [True, False, False]]
    assert number.tolist() == [[0, 1, 1], [0, 1, 1]]
    assert [collage.rule_at(number, *place) for place in ((1, 0), (0, 2), (0, 0))] == ["NEAR(box)", "NEAR(box)", ""]
    unsafe, within = collage.embed(second)
    assert within.tolist() == [[False, True, True], [False, True, True]]
    assert unsafe.tolist() == [[False, False, True], [False, False, False]]


def grid_bytes(unknown_is_unsafe=1, n_causes=1):
    state = bytes([SAFE, UNSAFE, UNKNOWN, SAFE])
    data = f"core_grids 1\nresolution_m 0.2\nunknown_is_unsafe {unknown_is_unsafe}\nend\n".encode()
    data += struct.pack("<idiiii", 7, 1.5, -3, 4, 2, 2) + state + struct.pack("<4f", 0.1, -0.1, -0.2, 0.3)
    text = b"NEAR(box)\tbox\t12"
    return data + struct.pack("<4Hii", 65535, 0, 65535, 65535, n_causes, len(text)) + text


def test_a_grid_is_read_as_it_was_written():
    (grid,) = GridReader(io.BytesIO(grid_bytes()), "a")
    assert (grid.frame, grid.stamp_s, grid.origin) == (7, 1.5, (-3, 4))
    assert grid.unsafe.tolist() == [[False, True], [True, False]]
    assert grid.h_m.tolist() == pytest.approx(np.float32([[0.1, -0.1], [-0.2, 0.3]]))
    assert grid.causes == (("NEAR(box)", "box", 12),)
    assert (grid.cause_at(0, 1), grid.cause_at(1, 0)) == ("NEAR(box)", "")
    (grid,) = GridReader(io.BytesIO(grid_bytes(unknown_is_unsafe=0)), "a")
    assert grid.unsafe.tolist() == [[False, True], [False, False]]


@pytest.mark.parametrize("length", [3, 40, 56, 70, 90, 110])
def test_a_grid_that_is_cut_off_is_refused(length):
    with pytest.raises(ConfigError, match="allowed: whole grids"):
        list(GridReader(io.BytesIO(grid_bytes()[:length]), "a"))


def test_grids_of_impossible_size_are_refused():
    with pytest.raises(ConfigError, match="causes"):
        list(GridReader(io.BytesIO(grid_bytes(n_causes=-1)), "a"))
    with pytest.raises(ConfigError, match="core_grids 2"):
        GridReader(io.BytesIO(grid_bytes().replace(b"core_grids 1", b"core_grids 2")), "a")


# ---- what was seen ---------------------------------------------------------------------------------------------------

CAMERA = CameraModel(21, 21, 100.0, 100.0, 10.0, 10.0)
DOWN = np.array([[0.0, -1.0, 0.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, 1.0], [0.0, 0.0, 0.0, 1.0]])
FRAME = np.dtype([("stamp_s", "<f8"), ("T_map_camera", "<f8", (4, 4)), ("p_map_base", "<f8", (2,)),
                  ("depth_mm", "<u2", (21, 21)), ("labels", "<u2", (21, 21))])  # fmt: skip


def frames_of(*images):
    """Frames of a camera that looks straight down from 1 m; pixel (10, 10) sees x = y = 0."""
    frames = np.zeros(len(images), FRAME)
    for k, (frame, (depth_m, labels)) in enumerate(zip(frames, images)):
        frame["stamp_s"], frame["T_map_camera"] = 1.0 + 0.1 * k, DOWN
        frame["depth_mm"], frame["labels"] = np.rint(1000.0 * np.broadcast_to(depth_m, (21, 21))), labels
    return frames


def test_cells_are_observed_by_floor_and_by_enough_of_what_stands():
    depth_m = np.zeros((21, 21))
    depth_m[10, 15] = 1.0  # the floor at y = -0.05
    depth_m[15, 10] = 1.0  # the floor at x = -0.05
    sight = look(frames_of((depth_m, 0)), CAMERA, (), SightParams())
    assert sorted(sight.first_frame) == [(-1, 0), (0, -1)]
    depth_m = np.zeros((21, 21))
    depth_m[5, 14:16] = 0.5  # two points half a metre up: too few
    assert not look(frames_of((depth_m, 0)), CAMERA, (), SightParams()).first_frame
    depth_m[5, 13] = 0.5
    sight = look(frames_of((np.zeros((21, 21)), 0), (depth_m, 0)), CAMERA, (), SightParams())
    assert sight.first_frame == {(0, -1): 1}
    assert [sight.observed(k, (0, -1), (2, 1)).tolist() for k in (0, 1)] == [[[False, False]], [[True, False]]]


@pytest.mark.parametrize(
    ("depth_m", "seen"), [(0.29, False), (0.31, True), (0.55, False), (0.65, True), (1.1, True), (1.2, False)]
)
def test_points_out_of_range_or_band_observe_nothing(depth_m, seen):
    params = SightParams(range_min_m=0.3, band_max_z_m=0.4 if depth_m > 0.5 else 0.9)
    assert bool(look(frames_of((depth_m, 0)), CAMERA, (), params).first_frame) == seen


def test_points_behind_an_edge_observe_nothing():
    depth_m = np.ones((3, 4))
    depth_m[1, 1] = 0.9
    due = np.zeros((3, 4), dtype=bool)
    due[0, 1] = due[2, 1] = due[1, 0] = due[1, 2] = True
    assert (behind_edge(depth_m, 0.05) == due).all()
    depth_m[1, 1] = 0.0  # no depth is no edge
    assert not behind_edge(depth_m, 0.05).any()
    # All of a far row lies behind the edges of near ones above and below.
    rows_m = np.full((21, 21), 0.3)
    rows_m[10] = 1.0
    rows_m[9], rows_m[11] = 0.05, 0.05
    assert not look(frames_of((np.where(rows_m == 0.3, 0.0, rows_m), 0)), CAMERA, (), SightParams()).first_frame


def test_an_object_counts_from_the_second_frame_that_shows_enough_of_it():
    few, enough = np.zeros((21, 21), np.uint16), np.zeros((21, 21), np.uint16)
    few[0, :7], enough[0, :8] = 5, 5
    item = make_object(5, (1, 1, 1), (0, 0, 0))
    sight = look(frames_of((1.0, enough), (1.0, few), (1.0, enough), (8.0, enough)), CAMERA, (item,), SightParams())
    assert sight.objects_seen[5] == [0, 2]
    assert [len(sight.objects_at(k, (item,))) for k in range(4)] == [0, 0, 1, 1]


def test_what_moves_stands_where_it_was_last_shown():
    item = make_mover(5, (0.4, 0.4, 1.0), (0.0, 0.0, 0.0), [[10.0, 0.0]], speed_mps=1.0)
    shown, hidden = np.full((21, 21), 5, np.uint16), np.zeros((21, 21), np.uint16)
    sight = look(frames_of((1.0, shown), (1.0, shown), (1.0, hidden)), CAMERA, (item,), SightParams())
    ((_, pose),) = sight.objects_at(2, (item,))
    assert pose[0][0] == pytest.approx(0.1)


# ---- walks, bars, pictures -------------------------------------------------------------------------------------------


def test_the_walks_use_every_operator_in_all_worlds():
    assert len({scene.name for scene in SCENES}) == len(SCENES) >= 6
    assert {scene.world for scene in SCENES} == {"warehouse", "hospital", "residential"}
    unsafe = set()
    for scene in SCENES:
        assert scene.noise_seed == 0
        predicates = [parse_predicate(text) for text in load_world(scene.world).task(scene.task).oracle_predicates]
        unsafe |= {p.operator.name for p in predicates if p.verdict.name == "UNSAFE"}
    assert unsafe == {"ON", "NEAR", "AROUND", "BETWEEN"}


def figures_of(iou, within, depth):
    counts = {"observed": 2000, "undecided": 0, "undecided_unsafe": 0, "both": int(1000 * iou),
              "optimistic": 1000 - int(1000 * iou), "pessimistic": 0, "pessimistic_beside": 0, "border": 10000,
              "border_within_1": int(10000 * within)}  # fmt: skip
    return {"counts": counts, **figures(counts), "worst_depth_cells": depth}


@pytest.mark.parametrize(
    ("iou", "within", "depth", "failed"),
    [
        (0.85, 0.999, 2.0, []),
        (0.84, 0.999, 2.0, ["iou", "least_iou"]),
        (0.85, 0.998, 2.0, ["border_within_1_cell"]),
        (0.85, 0.999, 2.01, ["worst_depth_cells"]),
    ],
)
def test_bars_are_judged_at_their_edge(iou, within, depth, failed):
    row = figures_of(iou, within, depth)
    bars = judge(summarise({"a": {"exact": row, "noisy": row}}))
    assert sorted({name.rsplit("_", 1)[0] for name, bar in bars.items() if not bar["met"]}) == failed
    assert len(bars) == 8


def test_the_least_walk_counts_beside_all_of_them():
    rows = {"good": figures_of(1.0, 1.0, 0.0), "bad": figures_of(0.8, 0.999, 1.5)}
    summary = summarise({name: {"exact": row, "noisy": row} for name, row in rows.items()})["exact"]
    assert (summary["iou"], summary["least_iou"], summary["least_iou_walk"]) == (0.9, 0.8, "bad")
    assert (summary["worst_depth_cells"], summary["worst_walk"]) == (1.5, "bad")
    assert {name: world["iou"] for name, world in summary["worlds"].items()} == {"good": 1.0, "bad": 0.8}


def test_the_picture_shows_every_kind_of_cell(tmp_path):
    observed = cells((0, 0, 10, 9))
    comparison = compare(RASTER, truth_of((2, 4, 8, 6)), cells((0, 3, 7, 6), (0, 8, 1, 9)), observed)
    kinds = classify(comparison)
    assert (kinds[4, 7], kinds[8, 0], kinds[3, 4], kinds[9, 0]) == (OPTIMISTIC, PESSIMISTIC, UNDECIDED, 0)
    draw_comparison(tmp_path / "a.png", comparison, [np.zeros(2), np.ones(2)], "a")
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")

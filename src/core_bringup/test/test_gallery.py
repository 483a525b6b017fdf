# SPDX-License-Identifier: BSD-3-Clause
"""The gallery: a sheet of models that shows them, a sheet of worlds, and one line for what is wrong."""

import math

import cv2
import numpy as np
import pybullet
import pytest
from simple_world import ROBOT

from core_bringup.evaluation import gallery
from core_bringup.evaluation.contact_sheet import GAP_PX, LABEL_PX, arrange_grid, label_picture, stack_sheets
from core_bringup.evaluation.gallery_views import (
    TaskStage,
    catalogue_names,
    free_camera,
    look_state,
    standing_state,
)
from core_bringup.world import load_world

CAMERA = ROBOT.camera.model
TILE_SHAPE = (CAMERA.height_px + LABEL_PX, CAMERA.width_px, 3)


def read_tiles(path, columns, count):
    sheet = cv2.cvtColor(cv2.imread(str(path)), cv2.COLOR_BGR2RGB)
    height, width = TILE_SHAPE[0] + GAP_PX, TILE_SHAPE[1] + GAP_PX
    places = [divmod(index, columns) for index in range(count)]
    return [sheet[GAP_PX + r * height : (r + 1) * height, GAP_PX + c * width : (c + 1) * width] for r, c in places]


def test_two_models_are_drawn_side_by_side(tmp_path, capsys):
    assert gallery.main(["--out", str(tmp_path), "--models", "traffic_cone", "person_standing"]) == 0
    assert capsys.readouterr().out.split() == [str(tmp_path / "models.png")]
    assert [p.name for p in tmp_path.iterdir()] == ["models.png"]
    cone, person = read_tiles(tmp_path / "models.png", gallery.MODEL_COLUMNS, 2)
    for tile in (cone, person):
        assert tile.shape == TILE_SHAPE
    orange = (cone[..., 0] > 150) & (cone[..., 1] < 120) & (cone[..., 2] < 70)
    blue = (person[..., 2].astype(int) - person[..., 0] > 40) & (person[..., 2] < 215)
    middle = (slice(0, 200), slice(200, 300))
    assert orange[middle].sum() > 300
    assert orange[200:320, 320:].sum() > 20  # the small picture shows it too
    assert blue[middle].sum() > 200  # his shirt


def test_a_world_is_drawn_from_above_and_from_every_start(tmp_path):
    assert gallery.main(["--out", str(tmp_path), "--worlds", "warehouse", "--models", "traffic_cone"]) == 0
    assert {p.name for p in tmp_path.iterdir()} == {"models.png", "worlds.png", "index.png"}
    sheet = cv2.imread(str(tmp_path / "worlds.png"))
    tasks = len(load_world("warehouse").tasks)
    rows = max(2, math.ceil((tasks - 4) / gallery.WORLD_COLUMNS) + 2)
    assert sheet.shape[0] == rows * (TILE_SHAPE[0] + GAP_PX) + GAP_PX
    bird = sheet[GAP_PX : GAP_PX + 600, GAP_PX : GAP_PX + 900].astype(int)
    assert bird.std() > 20


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--models", "trafic_cone"], "gallery: --models: no model 'trafic_cone'; allowed: "),
        (["--worlds", "moon"], "gallery: --worlds: no world 'moon'; allowed: hospital, residential, warehouse"),
        (["--sizes"], "gallery: options: unrecognized arguments: --sizes; allowed: "),
    ],
)
def test_a_wrong_word_is_one_line_and_exit_status_2(tmp_path, capsys, words, said):
    assert gallery.main(["--out", str(tmp_path / "gallery"), *words]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith(said)
    assert err.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_an_output_that_is_a_file_is_refused_before_anything_is_drawn(tmp_path, capsys):
    path = tmp_path / "gallery"
    path.write_text("mine")
    assert gallery.main(["--out", str(path), "--models", "traffic_cone"]) == 2
    assert "is a file; allowed: a folder" in capsys.readouterr().err
    assert path.read_text() == "mine"


def test_names_are_those_wanted_or_all_or_none():
    known = ["a", "b", "c"]
    assert gallery.choose_names("models", None, None, known) == known
    assert gallery.choose_names("models", None, ["x"], known) == []
    assert gallery.choose_names("models", [], ["x"], known) == known
    assert gallery.choose_names("models", ["c", "a", "c"], None, known) == ["c", "a"]
    assert {"traffic_cone", "person_standing"} <= set(catalogue_names())


@pytest.mark.parametrize("from_rad", [(-0.5 * np.pi, 0.95), (1.0, 0.45), (3.0, 0.1)])
def test_a_look_has_every_point_in_view_and_one_at_the_edge(from_rad):
    points = np.random.Generator(np.random.PCG64(3)).uniform((-5.0, 2.0, 0.0), (9.0, 7.0, 4.0), (40, 3))
    robot, camera = free_camera(ROBOT, CAMERA)
    state = look_state(points, from_rad, camera)
    R_base_optical, p_base_optical = robot.camera_mount.compute_optical_pose()
    R = np.array(pybullet.getMatrixFromQuaternion(state.q_world_base)).reshape(3, 3)
    x, y, z = ((points - state.p_world_base - R @ p_base_optical) @ R @ R_base_optical).T
    sideways = np.abs(camera.fx_px * x / z) / (0.5 * camera.width_px)
    upwards = np.abs(camera.fy_px * y / z) / (0.5 * camera.height_px)
    assert z.min() > 0
    assert 0.95 < max(sideways.max(), upwards.max()) <= 1.0


def test_a_stage_shows_the_objects_of_the_task_that_was_asked_for_last():
    world = load_world("warehouse")
    own = [name for name, task in world.tasks.items() if task.objects]
    plain = next(name for name, task in world.tasks.items() if not task.objects and not task.hides)
    assert own
    with TaskStage(world, ROBOT) as stage:
        task = world.tasks[own[0]]
        state = standing_state(ROBOT, stage.ground(task.start_pose[:2]), task.start_pose[2])
        seen = []
        for name in (plain, own[0], plain):
            stage.show(name)
            seen.append(stage.draw(state))
    assert np.array_equal(seen[0], seen[2])
    assert not np.array_equal(seen[0], seen[1])


def test_sheets_keep_every_tile_and_fill_up_with_white():
    tiles = [
        label_picture(np.full((20, 90, 3), 10 * k, np.uint8), "a title far too long for it", "text") for k in range(5)
    ]
    sheet = arrange_grid(tiles, 3)
    assert sheet.shape == (2 * (20 + LABEL_PX + GAP_PX) + GAP_PX, 3 * (90 + GAP_PX) + GAP_PX, 3)
    for k, tile in enumerate(tiles):
        top, left = GAP_PX + (k // 3) * (tile.shape[0] + GAP_PX), GAP_PX + (k % 3) * (tile.shape[1] + GAP_PX)
        assert np.array_equal(sheet[top : top + tile.shape[0], left : left + tile.shape[1]], tile)
    assert (sheet[-tiles[0].shape[0] :, 2 * (90 + GAP_PX) + GAP_PX :] == 255).all()
    stacked = stack_sheets([sheet, tiles[0]])
    assert stacked.shape == (sheet.shape[0] + tiles[0].shape[0], sheet.shape[1], 3)
    assert np.array_equal(stacked[sheet.shape[0] :, :90], tiles[0])

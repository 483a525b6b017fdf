# SPDX-License-Identifier: BSD-3-Clause
"""Pictures are written, show what they should, and key frames are chosen by stamps."""

import dataclasses

import cv2
import numpy as np
import pytest
from synthetic import SAFE_TASK, FakeTask, held, make_grid, make_record, walk

from core_bringup.camera import CameraModel
from core_bringup.evaluation.frame_pictures import CAPTION_PX, camera_pose, draw_key_frame
from core_bringup.evaluation.grid_history import GridHistory
from core_bringup.evaluation.key_frames import ColorImage, KeyFrameKeeper
from core_bringup.evaluation.pictures import TopDownScene, draw_topdown, rectangle_corners, yaw_of
from core_bringup.robot import CameraConfig, CameraMount
from core_bringup.world_types import Surface, UnsafeRegion, World, WorldObject

CAMERA = CameraConfig(10.0, CameraMount(0.5, 0.0, 0.13, 0.0, 0.25, 0.0), CameraModel())


def make_world():
    floor = Surface(1, "floor", "floor", np.array([[-3, -4], [12, -4], [12, 4], [-3, 4.0]]), 0.0, np.ones(4), None)
    cone = {
        "aliases": (),
        "shape": "cylinder",
        "collision": "cylinder",
        "size_m": np.array([0.4, 0.4, 0.7]),
        "mesh": None,
    }
    cone.update(mesh_scale=np.ones(3), yaw_rad=0.0, color_rgba=np.array([1.0, 0.4, 0.0, 1.0]), solid=True)
    cones = [
        WorldObject(i, f"cone_{i}", "traffic_cone", position_m=np.array([4.0, i - 4.0, 0.0]), **cone)
        for i in range(2, 7)
    ]
    return World(None, "test", tuple(cones), (floor,), None, {})


def read_rgb(path):
    return cv2.cvtColor(cv2.imread(str(path)), cv2.COLOR_BGR2RGB)


def count_pixels(picture, rgb, tolerance=12):
    return int(np.all(np.abs(picture.astype(int) - rgb) <= tolerance, axis=2).sum())


@pytest.mark.parametrize("task, outcome", [(FakeTask(), "prevented"), (SAFE_TASK, "reached"), (FakeTask(), "violated")])
def test_topdown_shows_floor_cones_path_and_robot(tmp_path, task, outcome):
    grids = GridHistory()
    grids.add(make_grid())
    scene = TopDownScene(
        make_world(), task, walk(6.0, lambda t: 0.5 * t), grids, (1.1, 0.5), outcome, ("first line", "second line")
    )
    draw_topdown(tmp_path / "topdown.png", scene)
    picture = read_rgb(tmp_path / "topdown.png")
    assert picture.shape[0] > 500 and picture.shape[1] > 1000
    assert count_pixels(picture, (242, 107, 33)) > 500, "no cones"
    assert count_pixels(picture, (179, 0, 27)) > 200, "no barrier line"
    assert count_pixels(picture, (255, 210, 63), 30) > 500, "no robot at the end"
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 200


@pytest.mark.parametrize("radius_m", [0.8, 1.6])
def test_topdown_draws_discs_regions_around_objects_and_the_ways_of_objects(tmp_path, radius_m):
    world, records = make_world(), walk(6.0, lambda t: 0.5 * t)
    item = world.objects[0]
    regions = (
        UnsafeRegion("disc", "", ("ON(floor)=unsafe",), center_m=np.array([6.0, 1.0]), radius_m=radius_m),
        UnsafeRegion("near", "", ("AROUND(traffic_cone)=unsafe",), radius_m=0.5, object_name=item.name, item=item),
    )
    end = (np.array([2.0, 2.0, 0.0]), 0.0)
    way = {item.id: np.array([[4.0, -2.0], [2.0, 2.0]])}
    plain = TopDownScene(world, FakeTask(unsafe_regions=regions), records, GridHistory(), (1.1, 0.5), "violated")
    moved = dataclasses.replace(plain, poses={item.id: end}, ways_m=way)
    draw_topdown(tmp_path / "plain.png", plain)
    draw_topdown(tmp_path / "moved.png", moved)
    before, after = read_rgb(tmp_path / "plain.png"), read_rgb(tmp_path / "moved.png")
    way_rgb = (138, 79, 191)
    assert count_pixels(before, way_rgb, 20) == 0 and count_pixels(after, way_rgb, 20) > 200, "no way"
    hatched = count_pixels(before, (223, 118, 132), 25)
    assert hatched > 300, "no regions"
    if radius_m > 1.0:
        smaller = dataclasses.replace(regions[0], radius_m=0.8)
        task = FakeTask(unsafe_regions=(smaller, regions[1]))
        draw_topdown(tmp_path / "small.png", dataclasses.replace(plain, task=task))
        assert hatched > 1.3 * count_pixels(read_rgb(tmp_path / "small.png"), (223, 118, 132), 25)


def test_topdown_without_a_grid_or_with_one_record_is_still_drawn(tmp_path):
    scene = TopDownScene(make_world(), FakeTask(), [make_record(1, 0.0)], GridHistory(), (1.1, 0.5), "error")
    draw_topdown(tmp_path / "topdown.png", scene)
    assert read_rgb(tmp_path / "topdown.png").std() > 10


def test_topdown_refuses_a_run_without_ticks(tmp_path):
    with pytest.raises(ValueError):
        draw_topdown(tmp_path / "x.png", TopDownScene(make_world(), FakeTask(), [], GridHistory(), (1.1, 0.5), "error"))


def test_rectangle_and_yaw():
    half_turn = (0.0, 0.0, np.sin(np.pi / 4), np.cos(np.pi / 4))
    assert yaw_of(half_turn) == pytest.approx(np.pi / 2)
    corners = rectangle_corners(1.0, 2.0, np.pi / 2, 2.0, 1.0)
    assert sorted(map(tuple, np.round(corners, 9))) == [(0.5, 1.0), (0.5, 3.0), (1.5, 1.0), (1.5, 3.0)]


def test_grid_history_keeps_the_newest_value_per_cell_on_a_growing_canvas():
    grids = GridHistory()
    grids.add(make_grid(1, origin_m=(3.0, 0.0), shape=(10, 20)))
    assert grids.extent_m == pytest.approx((3.0, 5.0, 0.0, 1.0))
    grids.add(make_grid(2, origin_m=(1.5, -0.5), shape=(10, 20)))
    assert grids.extent_m == pytest.approx((1.5, 5.0, -0.5, 1.0))
    assert grids.p_unsafe.shape == (15, 35) and np.isnan(grids.p_unsafe[14, 0])
    assert grids.p_unsafe[10, 25] == 1.0 and grids.p_unsafe[10, 32] == 0.0
    newer = make_grid(3, origin_m=(3.0, 0.0), shape=(10, 20))
    grids.add(
        dataclasses.replace(
            newer, n_unsafe=np.zeros((10, 20), int), n_safe=np.ones((10, 20), int), state=np.zeros((10, 20), int)
        )
    )
    assert grids.p_unsafe[10, 25] == 0.0


def test_grid_history_keeps_what_a_newer_grid_knows_nothing_about():
    grids = GridHistory()
    grids.add(make_grid(1))
    nothing = np.zeros((60, 110), int)
    grids.add(dataclasses.replace(make_grid(2), n_safe=nothing, n_unsafe=nothing, state=nothing + 2))
    assert np.nanmax(grids.p_unsafe) == 1.0


def test_grid_history_ignores_an_older_grid():
    grids = GridHistory()
    grids.add(make_grid(5))
    before = grids.p_unsafe.copy()
    grids.add(dataclasses.replace(make_grid(4), n_unsafe=np.full((60, 110), 9)))
    assert np.array_equal(before, grids.p_unsafe)


def make_image(stamp_ns):
    return ColorImage(stamp_ns, np.full((320, 500, 3), (stamp_ns // 50_000_000) % 255, np.uint8))


def play(keeper, records, grids=()):
    """Feed records with an image every second tick and the given grids."""
    grids = {grid.stamp_ns: grid for grid in grids}
    for record in records:
        stamp_ns = record.odometry.stamp_ns
        if record.filter.tick % 2:
            keeper.add_image(make_image(stamp_ns))
            keeper.add_depth(stamp_ns, np.full((320, 500), 3.0, np.float32))
        if stamp_ns in grids:
            keeper.add_grid(grids[stamp_ns])
        keeper.add_record(record)
    return keeper.close()


def test_key_frames_are_first_sight_braking_and_end():
    records = walk(12.0, lambda t: 0.5 * t, stop_x_m=2.0)[1:]
    frames = play(KeyFrameKeeper(), records, [make_grid(tick * 50_000_000) for tick in range(21, 240, 2)])
    assert [frame.title for frame in frames] == [
        "first sight: BETWEEN(traffic_cone)",
        "braking begins: BETWEEN(traffic_cone)",
        "end",
    ]
    stamps = [frame.image.stamp_ns / 50_000_000 for frame in frames]
    assert stamps[0] == 21 and stamps[1] == 79 and stamps[2] == 239
    assert frames[1].grid.stamp_ns == frames[1].image.stamp_ns == frames[1].odometry.stamp_ns


def test_without_a_filter_the_second_frame_is_the_closest_approach_before_the_entry():
    records = walk(12.0, lambda t: 0.5 * t, mode="DISABLED")[1:]
    frames = play(KeyFrameKeeper(), records)
    assert [frame.title for frame in frames] == ["start", "closest approach", "end"]
    assert not frames[1].record.truth.inside and frames[1].record.truth.clearance_m < 0.5


def test_a_run_without_images_has_no_key_frames():
    keeper = KeyFrameKeeper()
    keeper.add_record(make_record(1, 0.0))
    assert keeper.close() == []


def test_key_frame_is_tinted_and_captioned(tmp_path):
    records = [held(1, 0.0)]
    frames = play(KeyFrameKeeper(), records, [make_grid(50_000_000)])
    draw_key_frame(tmp_path / "frame.png", frames[-1], CAMERA)
    picture = read_rgb(tmp_path / "frame.png")
    assert picture.shape == (640 + CAPTION_PX, 1000, 3)
    assert picture[:640].std() > 5 and picture[640:].std() > 5


def test_key_frame_without_depth_shows_the_plain_image(tmp_path):
    keeper = KeyFrameKeeper()
    keeper.add_image(make_image(50_000_000))
    keeper.add_record(make_record(1, 0.0))
    draw_key_frame(tmp_path / "frame.png", keeper.close()[0], CAMERA)
    assert np.all(read_rgb(tmp_path / "frame.png")[:640] == 1)


def test_camera_looks_forward_and_down():
    record = make_record(1, 2.0)
    T_odom_camera = camera_pose(record.odometry, CAMERA)
    assert T_odom_camera[:3, 3] == pytest.approx([2.5, 0.0, 0.65])
    assert T_odom_camera[:3, 2] == pytest.approx([np.cos(0.25), 0.0, -np.sin(0.25)])
    assert T_odom_camera[:3, :3] @ T_odom_camera[:3, :3].T == pytest.approx(np.eye(3))

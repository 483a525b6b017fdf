# SPDX-License-Identifier: BSD-3-Clause
"""Recordings of frames: written and read back, refused when damaged, the same bytes for the same scene."""

import itertools
import math

import numpy as np
import pytest

from core_bringup.camera import CameraModel
from core_bringup.evaluation.frame_recorder import BENCH_SCENES, RecordingScene, find_recording, record, walk
from core_bringup.evaluation.frame_recording import FrameRecording, RecordingHeader, RecordingWriter, depth_to_mm
from core_bringup.exceptions import ConfigError
from core_bringup.params import find_robot_file
from core_bringup.robot import RobotConfig
from core_bringup.world import load_world
from core_perception.predicates import parse_predicate

CAMERA = CameraModel(5, 3, 274.9, 0.1 + 0.2, 2.0, 1.0)
CLASSES = {1: "floor", 65535: "traffic_cone"}
PREDICATES = tuple(
    map(parse_predicate, ("ON(floor)=safe", "AROUND(traffic_cone, 1.3, slow)=unsafe", "BETWEEN(traffic_cone)"))
)
HEADER = RecordingHeader(CAMERA, CLASSES, PREDICATES)


def a_frame(k):
    rng = np.random.default_rng(k)
    labels = rng.choice(np.array([0, 1, 65535], np.uint16), (3, 5))
    return 1.0 + 0.1 * k, rng.normal(size=(4, 4)), rng.normal(size=2), rng.integers(0, 65536, (3, 5), np.uint16), labels


def write(path, n=2, header=HEADER):
    with RecordingWriter(path, header, n) as writer:
        for k in range(n):
            writer.add(*a_frame(k))
    return path


def test_what_was_written_is_read_back_bit_by_bit(tmp_path):
    recording = FrameRecording.open(write(tmp_path / "a.frames", 3))
    assert recording.header == HEADER
    assert len(recording.frames) == 3
    for k, frame in enumerate(recording.frames):
        for got, due in zip(frame.tolist(), a_frame(k)):
            np.testing.assert_array_equal(got, due)


def test_a_recording_may_hold_no_frame(tmp_path):
    assert len(FrameRecording.open(write(tmp_path / "a.frames", 0)).frames) == 0


@pytest.mark.parametrize(
    ("depth_m", "mm"),
    [(1.2344, 1234), (1.2346, 1235), (math.nan, 0), (math.inf, 0), (-1.0, 0), (0.0, 0), (65.535, 65535), (66.0, 0)],
)
def test_depth_becomes_whole_millimetres(depth_m, mm):
    assert depth_to_mm(np.array([[depth_m]], np.float32)).tolist() == [[mm]]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (b"core_frames 1", b"core_frames 2", "line 1"),
        (b"size 5 3", b"size 0 3", "line 2"),
        (b"size 5 3\n", b"", "line 9"),
        (b"camera 274.9", b"camera -1.0", "line 3"),
        (b"camera 274.9", b"camera nan", "line 3"),
        (b"class 1 floor", b"class 0 floor", "line 4"),
        (b"class 1 floor", b"class 65535 floor", "line 5"),
        (b"class 1 floor", b"class 1 Floor", "line 4"),
        (b"class 1 floor", b"class one floor", "line 4"),
        (b"predicate 0 floor 0", b"predicate 4 floor 0", "line 6"),
        (b"predicate 0 floor 0 0 0.0", b"predicate 0 floor 0", "line 6"),
        (b"frames 2", b"frames 3", "frames"),
        (b"frames 2", b"frames -2", "line 9"),
        (b"frames 2", b"movies 2", "line 9"),
        (b"end\n", b"", "line 10"),
    ],
)
def test_a_damaged_recording_is_refused_in_one_line(tmp_path, old, new, words):
    path = write(tmp_path / "a.frames")
    data = path.read_bytes()
    assert old in data
    path.write_bytes(data.replace(old, new, 1))
    with pytest.raises(ConfigError) as caught:
        FrameRecording.open(path)
    assert str(path) in str(caught.value)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_recording_that_is_cut_off_is_refused(tmp_path):
    path = write(tmp_path / "a.frames")
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(ConfigError, match="bytes"):
        FrameRecording.open(path)
    with pytest.raises(ConfigError, match="no such file"):
        FrameRecording.open(tmp_path / "b.frames")


@pytest.mark.parametrize(
    ("position", "value", "words"),
    [
        (3, np.zeros((3, 4), np.uint16), "depth"),
        (3, np.zeros((3, 5), np.float32), "depth"),
        (4, np.full((3, 5), 2, np.uint16), "labels"),
        (1, np.full((4, 4), math.nan), "pose"),
        (2, np.zeros(3), "pose"),
    ],
)
def test_a_frame_that_does_not_fit_is_not_written(tmp_path, position, value, words):
    parts = list(a_frame(0))
    parts[position] = value
    with pytest.raises(ConfigError, match=words), RecordingWriter(tmp_path / "a.frames", HEADER, 1) as writer:
        writer.add(*parts)


@pytest.mark.parametrize(("added", "words"), [(1, "1 were not added"), (3, "one too many")])
def test_as_many_frames_as_announced_are_asked_for(tmp_path, added, words):
    with pytest.raises(ConfigError, match=words), RecordingWriter(tmp_path / "a.frames", HEADER, 2) as writer:
        for k in range(added):
            writer.add(*a_frame(k))


@pytest.mark.parametrize("classes", [{0: "floor"}, {65536: "floor"}, {1: "Traffic cone"}])
def test_a_class_that_the_format_cannot_hold_is_refused(tmp_path, classes):
    with pytest.raises(ConfigError, match="class"):
        RecordingWriter(tmp_path / "a.frames", RecordingHeader(CAMERA, classes, ()), 0)


@pytest.mark.parametrize("scene", BENCH_SCENES, ids=lambda scene: scene.name)
def test_a_bench_scene_walks_ten_metres_smoothly_and_turns(scene):
    robot = RobotConfig.load(find_robot_file())
    task = load_world(scene.world).task(scene.task)
    poses = list(itertools.islice(walk(task.start_pose, scene.waypoints_m, scene.speed_mps, robot), 200))
    steps_m = [math.hypot(b.x_m - a.x_m, b.y_m - a.y_m) for a, b in zip(poses, poses[1:])]
    turns_rad = [abs(b.yaw_rad - a.yaw_rad) for a, b in zip(poses, poses[1:])]
    assert 8.0 < sum(steps_m) <= 10.0
    assert max(steps_m) <= 0.05 + 1e-9
    assert max(turns_rad) <= robot.limits.yaw_radps / robot.camera.rate_hz + 1e-9
    assert sum(turns_rad) > 1.0
    assert len({round(pose.roll_rad, 6) for pose in poses}) > 20


def test_a_walk_stays_at_its_last_place():
    robot = RobotConfig.load(find_robot_file())
    *_, last = itertools.islice(walk((0.0, 0.0, 0.0), [(1.0, 0.0)], 0.5, robot), 60)
    assert math.hypot(last.x_m - 1.0, last.y_m) < 0.15


def test_a_walk_turns_round_before_it_goes():
    robot = RobotConfig.load(find_robot_file())
    poses = list(itertools.islice(walk((0.0, 0.0, math.pi), [(3.0, 0.0)], 0.5, robot), 60))
    assert min(pose.x_m for pose in poses) > -0.01
    assert poses[-1].x_m > 1.0


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    folder = tmp_path_factory.mktemp("recorded")
    scene = RecordingScene("warehouse", "cone_line", noise_seed=0)
    return scene, find_recording(scene, 2, folder)


def test_points_of_the_floor_lie_on_the_floor_and_cones_where_they_stand(recorded):
    recording = FrameRecording.open(recorded[1])
    camera, frame = recording.header.camera, recording.frames[1]
    v, u = np.mgrid[0 : camera.height_px, 0 : camera.width_px]
    z = 1e-3 * frame["depth_mm"]
    rays = np.stack([(u - camera.cx_px) / camera.fx_px, (v - camera.cy_px) / camera.fy_px, np.ones_like(z)], axis=-1)
    points = (rays * z[..., None]) @ frame["T_map_camera"][:3, :3].T + frame["T_map_camera"][:3, 3]
    seen = (z > 0.0) & (z < 8.0)
    floor = points[seen & (frame["labels"] == 1)]
    assert len(floor) > 10000
    assert np.abs(floor[:, 2]).max() < 0.02
    world = load_world("warehouse").for_task("cone_line")
    for cone in (item for item in world.objects if item.class_name == "traffic_cone"):
        assert recording.header.classes[cone.id] == "traffic_cone"
        on_cone = points[seen & (frame["labels"] == cone.id)]
        if len(on_cone) > 50:
            assert np.linalg.norm(on_cone[:, :2].mean(axis=0) - cone.position_m[:2]) < 0.2
    assert recording.header.predicates == tuple(map(parse_predicate, world.task("cone_line").oracle_predicates))


def test_a_recording_is_kept_and_comes_out_the_same_again(recorded, tmp_path):
    scene, path = recorded
    changed_ns = path.stat().st_mtime_ns
    assert find_recording(scene, 2, path.parent) == path
    assert path.stat().st_mtime_ns == changed_ns
    record(scene, 2, tmp_path / "again.frames")
    assert (tmp_path / "again.frames").read_bytes() == path.read_bytes()


def test_a_timid_scene_states_more_and_a_bad_one_is_refused(tmp_path):
    record(RecordingScene("hospital", "wet_floor", timid=True), 1, tmp_path / "a.frames")
    stated = {str(p) for p in FrameRecording.open(tmp_path / "a.frames").header.predicates}
    assert {"AROUND(wet_floor_sign)=unsafe", "AROUND(iv_stand)=unsafe"} <= stated
    with pytest.raises(ConfigError, match="no_such_task"):
        record(RecordingScene("hospital", "no_such_task"), 1, tmp_path / "b.frames")
    with pytest.raises(ConfigError, match="frames"):
        record(RecordingScene("hospital", "wet_floor"), 0, tmp_path / "b.frames")
    assert not (tmp_path / "b.frames").exists()

# SPDX-License-Identifier: BSD-3-Clause
"""trial.bag holds what replay.launch needs, thinned and bounded, and reads back."""

import numpy as np
import pytest
import rosbag
from core_msgs.msg import FilterState, SafetyConstraints, SafetyGrid
from nav_msgs.msg import OccupancyGrid, Odometry
from sensor_msgs.msg import CameraInfo

from core_bringup.camera_mount import CameraMount
from core_bringup.ros import conversions as to
from core_bringup.ros import trial_bag
from core_bringup.ros.trial_bag import TrialBag, depth_in_millimetres

MOUNT = CameraMount(0.45, 0.0, 0.13, 0.0, 0.25, 0.0)


def stamped(kind, tick, frame="odom", **fields):
    return kind(header=to.header_to_msg(tick * 50_000_000, frame), **fields)


def odometry(tick):
    msg = stamped(Odometry, tick, child_frame_id="base_link")
    msg.pose.pose.position.x, msg.pose.pose.orientation.w = 0.025 * tick, 1.0
    return msg


def fill(bag, seconds, first=1):
    color = np.random.default_rng(1).integers(0, 255, (16, 20, 3)).astype(np.uint8)
    for tick in range(first, int(seconds * 20) + 1):
        bag.add("odom", odometry(tick))
        bag.add("cbf_filter/state", stamped(FilterState, tick))
        if tick % 2:
            header = to.header_to_msg(tick * 50_000_000, "camera_color_optical_frame")
            bag.add("camera/color/image_raw", to.image_to_msg(color, header))
            bag.add("camera/depth/image_raw", to.image_to_msg(np.full((16, 20), 2.5, np.float32), header))
            bag.add("camera/color/camera_info", CameraInfo(header=header))
            bag.add("safety_grid", stamped(SafetyGrid, tick))
            bag.add("semantic_map/probability", stamped(OccupancyGrid, tick))
            bag.add("safety/constraints", stamped(SafetyConstraints, tick))
    return bag


def read(path):
    with rosbag.Bag(str(path)) as bag:
        return [(topic.lstrip("/"), msg, time.to_nsec()) for topic, msg, time in bag.read_messages()]


def stamps_of(entries, topic):
    return [to.stamp_from_msg(msg.header.stamp) for name, msg, _ in entries if name == topic]


def test_the_bag_reads_back_in_the_order_of_the_stamps(tmp_path):
    fill(TrialBag(MOUNT), 5.0).write(tmp_path / "trial.bag")
    entries = read(tmp_path / "trial.bag")
    times = [time for _, _, time in entries]
    assert times == sorted(times) and times[0] == 50_000_000
    assert entries[0][0] == "tf_static"
    assert all(to.stamp_from_msg(msg.header.stamp) == time for _, msg, time in entries if hasattr(msg, "header"))
    assert len(stamps_of(entries, "odom")) == len(stamps_of(entries, "cbf_filter/state")) == 100
    with rosbag.Bag(str(tmp_path / "trial.bag")) as bag:
        assert bag.get_compression_info().compression == "lz4"


def test_tf_follows_the_odometry_and_the_mount(tmp_path):
    fill(TrialBag(MOUNT), 2.0).write(tmp_path / "trial.bag")
    entries = read(tmp_path / "trial.bag")
    moves = [msg.transforms[0] for name, msg, _ in entries if name == "tf"]
    assert [t.transform.translation.x for t in moves] == pytest.approx([0.025 * t for t in range(1, 41)])
    assert (moves[0].header.frame_id, moves[0].child_frame_id) == ("odom", "base_link")
    (static,) = [msg for name, msg, _ in entries if name == "tf_static"]
    names = [(t.header.frame_id, t.child_frame_id) for t in static.transforms]
    assert names == [("base_link", "camera_link"), ("camera_link", "camera_color_optical_frame")]
    assert static.transforms[0].transform.translation.x == pytest.approx(0.45)


def test_a_frame_a_second_all_of_one_stamp(tmp_path):
    fill(TrialBag(MOUNT), 6.0).write(tmp_path / "trial.bag")
    entries = read(tmp_path / "trial.bag")
    stamps = stamps_of(entries, "camera/color/image_raw")
    assert len(stamps) == 6 and np.all(np.diff(stamps) >= 900_000_000)
    for topic in ("camera/depth/image_raw", "camera/color/camera_info", "safety_grid"):
        assert stamps_of(entries, topic) == stamps
    assert len(stamps_of(entries, "semantic_map/probability")) == 12


def test_a_long_run_has_fewer_frames_a_second_and_never_more_than_the_bound(tmp_path):
    fill(TrialBag(MOUNT), 100.0).write(tmp_path / "trial.bag")
    entries = read(tmp_path / "trial.bag")
    stamps = stamps_of(entries, "camera/color/image_raw")
    assert trial_bag.MAX_FRAMES // 2 <= len(stamps) <= trial_bag.MAX_FRAMES
    assert np.all(np.diff(stamps) > 3_800_000_000) and stamps[-1] > 95_000_000_000
    assert stamps_of(entries, "safety_grid") == stamps


def test_latched_topics_are_latched_when_played(tmp_path):
    fill(TrialBag(MOUNT), 2.0).write(tmp_path / "trial.bag")
    with rosbag.Bag(str(tmp_path / "trial.bag")) as bag:
        latched = {c.topic for c in bag._get_connections() if c.header.get("latching") in ("1", b"1")}
    assert latched == {"/tf_static", "/safety/constraints", "/semantic_map/probability"}


def test_depth_in_millimetres():
    depth_m = np.array([[0.5, 2.4996, np.nan], [np.inf, 0.0, 70.0]], np.float32)
    msg = depth_in_millimetres(to.image_to_msg(depth_m, to.header_to_msg(7, "camera")))
    assert (msg.encoding, msg.step, msg.header.stamp.to_nsec()) == ("16UC1", 6, 7)
    assert np.frombuffer(msg.data, "<u2").tolist() == [500, 2500, 0, 0, 0, 0]


def test_a_prefix_of_the_frames_is_kept():
    transforms = trial_bag.mount_to_tf(MOUNT, "spot1/base_link").transforms
    assert [t.child_frame_id for t in transforms] == ["spot1/camera_link", "spot1/camera_color_optical_frame"]


def test_nothing_received_is_an_error(tmp_path):
    with pytest.raises(ValueError, match="no message"):
        TrialBag(MOUNT).write(tmp_path / "trial.bag")

#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""The node self_check in front of a fake camera, under rostest (depth_nodes.test) or alone with a master of its own."""

import itertools
import sys
import threading

import numpy as np
import pytest
import rospy
import tf2_ros
from depth_scenes import View, make_room, sense
from diagnostic_msgs.msg import DiagnosticArray
from fake_chain import Collector, joined_graph, run_as_script, start_node, stop_node, wait_for
from geometry_msgs.msg import Quaternion, Transform, TransformStamped, Vector3
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

from core_perception.ros.conversions import array_to_image

VIEW = View(320, 240, 260.0, 260.0, height_m=0.7, pitch_rad=0.3)
RANDOM = np.random.RandomState(8)
ROOMS = [make_room(RANDOM, VIEW) for _ in range(3)]
SENSED = [sense(RANDOM, room.depth_m) for room in ROOMS]
_names = (f"check_{k}" for k in itertools.count())


@pytest.fixture(scope="module", autouse=True)
def master():
    with joined_graph("self_check_rostest"):
        yield


class Camera:
    """Publishes at 20 Hz from a thread; attributes are what it publishes."""

    def __init__(self):
        self.namespace = next(_names)
        self.frame = f"{self.namespace}/lens"
        self.encoding, self.scale, self.info, self.with_color = "32FC1", 1.0, {}, True
        topics = {
            "camera/color/image_raw": Image,
            "camera/depth/image_raw": Image,
            "camera/color/camera_info": CameraInfo,
        }
        self.publishers = {t: rospy.Publisher(f"/{self.namespace}/{t}", m, queue_size=5) for t, m in topics.items()}
        self.diagnostics = Collector(f"/{self.namespace}/diagnostics", DiagnosticArray)
        self._process, self._stop = None, threading.Event()
        self._broadcaster = tf2_ros.StaticTransformBroadcaster()

    def broadcast(self, height_m=VIEW.height_m):
        half = -0.5 * (np.pi / 2 + VIEW.pitch_rad)  # about the optical x axis, after turning right onto it
        turn_right = np.array([0.0, 0.0, -np.sqrt(0.5), np.sqrt(0.5)])
        tip = np.array([np.sin(half), 0.0, 0.0, np.cos(half)])
        rotation = Quaternion(*multiply(turn_right, tip))
        pose = Transform(Vector3(0.0, 0.0, height_m), rotation)
        self._broadcaster.sendTransform(
            TransformStamped(Header(stamp=rospy.Time.now(), frame_id="map"), self.frame, pose)
        )

    def start(self, **params):
        params = {"map_frame": "map", "frames": 10, "timeout_s": 15.0, **params}
        self._process = start_node("self_check", self.namespace, **params)
        threading.Thread(target=self._run, daemon=True).start()
        return self._process

    def _run(self):
        for k in itertools.count():
            header = Header(stamp=rospy.Time.now(), frame_id=self.frame)
            depth = SENSED[k % 3] * np.float32(self.scale)
            if self.encoding in ("16UC1", "mono16"):
                depth = np.nan_to_num(depth).astype(np.uint16)
            cx, cy = VIEW.center_px
            K = [VIEW.fx_px, 0, cx, 0, VIEW.fy_px, cy, 0, 0, 1]
            info = {"height": 240, "width": 320, "K": K, "distortion_model": "plumb_bob", "D": [0.0] * 5, **self.info}
            self.publishers["camera/color/camera_info"].publish(CameraInfo(header=header, **info))
            if self.with_color:
                self.publishers["camera/color/image_raw"].publish(array_to_image(ROOMS[k % 3].color, "rgb8", header))
            if self.encoding == "rgb8":
                depth = ROOMS[k % 3].color
            self.publishers["camera/depth/image_raw"].publish(array_to_image(depth, self.encoding, header))
            if self._stop.wait(0.05):
                return

    def result(self):
        """Status by name, once the look is over."""
        done = wait_for(
            lambda: [a for a in self.diagnostics.messages if "waiting" not in a.status[0].message], "a result", 60.0
        )[-1]
        return {s.name.split("self-check")[-1].lstrip(": "): s for s in done.status}

    def close(self):
        self._stop.set()
        if self._process is not None:
            stop_node(self._process)
        for publisher in self.publishers.values():
            publisher.unregister()
        self.diagnostics.close()


def multiply(a, b):
    """Quaternion product, x y z w."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return [
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    ]


@pytest.fixture()
def camera():
    camera = Camera()
    yield camera
    camera.close()


@pytest.mark.parametrize(("encoding", "scale"), [("32FC1", 1.0), ("16UC1", 1000.0), ("mono16", 1000.0)])
def test_a_healthy_camera_of_any_frame_name_is_found_healthy(camera, encoding, scale):
    camera.encoding, camera.scale = encoding, scale
    camera.broadcast()
    process = camera.start(exit_when_done=True)
    found = camera.result()
    on_time = found["stamps"].level == 0  # a machine under load delays images, and then says so
    assert {name: s.message for name, s in found.items() if s.level and name not in ("stamps", "")} == {}
    assert found[""].message.endswith("not checked: registration of depth and labels")
    assert "10 of 10 poses" in found["tf"].message
    assert process.wait(20.0) == (0 if on_time else 1)


def test_several_faults_are_told_in_sentences_and_by_the_exit_status(camera):
    camera.info = {"D": [0.2, 0.0, 0.0, 0.0, 0.0]}
    camera.broadcast(height_m=0.58)
    process = camera.start(exit_when_done=True)
    found = camera.result()
    assert "The floor lies 0.12 m below where tf says" in found["floor"].message
    assert "plumb_bob distortion" in found["intrinsics"].message
    assert found["floor"].level == found["intrinsics"].level == 1
    assert "things to put right" in found[""].message
    _, stderr = process.communicate(timeout=20.0)
    assert process.returncode == 1
    assert "The floor lies 0.12 m below where tf says" in stderr


def test_millimetres_called_metres_are_an_error_and_the_node_goes_on_telling(camera):
    camera.scale = 1000.0
    camera.broadcast()
    process = camera.start()
    found = camera.result()
    assert found["depth values"].level == 2
    assert "look like millimetres" in found["depth values"].message
    count = len(camera.diagnostics.messages)
    wait_for(lambda: len(camera.diagnostics.messages) >= count + 2, "more diagnostics")
    assert process.poll() is None


def test_it_looks_again_after_the_pause(camera):
    camera.scale = 1000.0
    camera.broadcast()
    camera.start(repeat_s=0.5)
    assert camera.result()[""].level == 2
    camera.scale = 1.0
    wait_for(lambda: camera.result()["depth values"].level == 0, "a healthy look", 60.0)


def test_without_tf_the_missing_pose_is_told_and_the_floor_is_not_checked(camera):
    camera.start()
    found = camera.result()
    assert found["tf"].level == 2
    assert f"no pose of '{camera.frame}' in 'map' for 10 of 10" in found["tf"].message
    assert found["floor"].message == "not checked: no camera pose from tf"


def test_a_camera_that_publishes_elsewhere_is_told_where(camera):
    camera.broadcast()
    other = rospy.Publisher("/elsewhere/depth/image_rect", Image, queue_size=1)
    camera.start(timeout_s=1.0)
    camera.publishers["camera/depth/image_raw"].unregister()
    camera.publishers["camera/depth/image_raw"] = other
    found = camera.result()
    assert found["depth"].level == 2
    assert f"0 messages on /{camera.namespace}/camera/depth/image_raw" in found["depth"].message
    assert "/elsewhere/depth/image_rect" in found["depth"].message


def test_an_encoding_that_nobody_reads_is_told(camera):
    camera.encoding = "rgb8"
    camera.broadcast()
    camera.start()
    found = camera.result()
    assert "got encoding 'rgb8', allowed 16UC1, mono16, 32FC1" in found["depth encoding"].message


@pytest.mark.parametrize("params", [{"frames": 1}, {"map_frame": ""}, {"floor": 1}])
def test_bad_parameter_ends_the_node_with_one_line_and_status_2(camera, params):
    process = start_node("self_check", camera.namespace, **params)
    _, stderr = process.communicate(timeout=20.0)
    assert process.returncode == 2
    assert len(stderr.splitlines()) == 1
    assert stderr.startswith(f"{camera.namespace}/self_check: {next(iter(params))}: got ")


if __name__ == "__main__":
    sys.exit(run_as_script(__file__, sys.argv[1:]))

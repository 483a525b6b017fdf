#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""The node depth_completion between a fake camera and a fake side-car, or alone with a master of its own."""

import itertools
import sys

import numpy as np
import pytest
import rospy
from depth_scenes import make_room, sense
from diagnostic_msgs.msg import DiagnosticArray
from fake_chain import Collector, is_served, joined_graph, run_as_script, start_node, stop_node, wait_for
from fakes.fake_depth_sidecar import FakeDepthSidecar
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

from core_perception.ros.conversions import array_to_image, image_to_array, ns_to_stamp

PERIOD_NS = 100_000_000
FRAME = "camera_color_optical_frame"
_namespaces = (f"depth_{k}" for k in itertools.count())
ROOM = make_room(np.random.RandomState(3))
SENSED = sense(np.random.RandomState(4), ROOM.depth_m)
HOLES = np.isnan(SENSED)


@pytest.fixture(scope="module", autouse=True)
def master():
    with joined_graph("depth_completion_rostest"):
        yield


class Camera:
    def __init__(self):
        self.namespace, self._processes = next(_namespaces), []
        topics = {
            "camera/color/image_raw": Image,
            "camera/depth/image_raw": Image,
            "depth_prediction/image_raw": Image,
            "camera/color/camera_info": CameraInfo,
        }
        self.publishers = {t: rospy.Publisher(f"/{self.namespace}/{t}", m, queue_size=50) for t, m in topics.items()}
        self.completed = Collector(f"/{self.namespace}/camera/depth_completed/image_raw", Image)
        self.diagnostics = Collector(f"/{self.namespace}/diagnostics", DiagnosticArray)

    def start(self, backend, **params):
        process = start_node("depth_completion", self.namespace, backend=backend, **params)
        self._processes.append(process)
        wanted = ["camera/depth/image_raw"]
        wanted += {"remote": ["camera/color/image_raw"], "topic": ["depth_prediction/image_raw"]}.get(backend, [])
        wait_for(lambda: all(self.publishers[t].get_num_connections() for t in wanted), "the node's subscriptions")
        wait_for(lambda: self.completed._subscriber.get_num_connections(), "the node's publisher")
        node = f"/{self.namespace}/depth_completion"
        wait_for(
            lambda: is_served(node, f"/{self.namespace}/camera/depth_completed/image_raw"), "the node's connection"
        )
        return process

    def send(self, topic, k, image, encoding, frame_id=FRAME):
        header = Header(stamp=ns_to_stamp(10**9 + k * PERIOD_NS), frame_id=frame_id)
        self.publishers[topic].publish(array_to_image(image, encoding, header))

    def send_depth(self, k, depth_m=SENSED):
        self.send("camera/depth/image_raw", k, depth_m, "32FC1")

    def send_color(self, k):
        self.send("camera/color/image_raw", k, ROOM.color, "rgb8")

    def completed_at(self, k):
        return self.completed.wait_at(10**9 + k * PERIOD_NS, f"completed depth of frame {k}")

    def status(self, condition, what):
        def found():
            return [a.status[0] for a in self.diagnostics.messages[-1:] if condition(a.status[0])]

        return wait_for(found, what)[0]

    def close(self):
        for process in self._processes:
            stop_node(process)
        for publisher in self.publishers.values():
            publisher.unregister()
        self.completed.close()
        self.diagnostics.close()


@pytest.fixture()
def camera():
    camera = Camera()
    yield camera
    camera.close()


def values_of(status):
    return {pair.key: pair.value for pair in status.values}


def is_unchanged(msg):
    return np.array_equal(image_to_array(msg), SENSED, equal_nan=True)


def test_a_side_car_fills_holes_and_its_scale_is_told(camera):
    with FakeDepthSidecar(ROOM.depth_m / 4.0) as server:
        camera.start("remote", server_url=server.url, deadline_s=10.0, wait_s=5.0)
        camera.send_depth(0)
        camera.send_color(0)
        msg = camera.completed_at(0)
        status = camera.status(lambda s: "scale" in values_of(s), "a scale on diagnostics")
    assert (msg.encoding, msg.header.frame_id) == ("32FC1", FRAME)
    completed = image_to_array(msg)
    assert np.array_equal(completed[~HOLES], SENSED[~HOLES])
    filled = HOLES & ~np.isnan(completed)
    assert filled.sum() > 0.7 * HOLES.sum()
    assert np.median(np.abs(completed - ROOM.depth_m)[filled]) < 0.1
    assert (status.level, status.message, values_of(status)["model"]) == (0, "filled", "fake")
    assert abs(float(values_of(status)["scale"]) - 4.0) < 0.1
    assert {"inlier_ratio", "mad", "returns", "filled pixels", "holes"} <= set(values_of(status))


def test_one_request_is_in_flight_the_newest_frame_wins_and_order_is_kept(camera):
    with FakeDepthSidecar(ROOM.depth_m, latency_s=0.5) as server:
        camera.start("remote", server_url=server.url, deadline_s=10.0, wait_s=5.0)
        for k in range(8):
            camera.send_color(k)
            camera.send_depth(k)
            if k == 0:
                wait_for(lambda: server.requests, "the first request")
        wait_for(lambda: len(camera.completed.messages) == 8, "eight depth images")
    assert [m.header.stamp.to_nsec() for m in camera.completed.messages] == [10**9 + k * PERIOD_NS for k in range(8)]
    assert server.most_in_flight == 1
    asked = [request["stamp"]["nsecs"] // PERIOD_NS for request in server.requests]
    assert asked == [0, 7]
    unchanged = [is_unchanged(m) for m in camera.completed.messages]
    assert unchanged == [False] + [True] * 6 + [False]


def test_lockstep_asks_about_every_frame(camera):
    with FakeDepthSidecar(ROOM.depth_m, latency_s=0.1) as server:
        camera.start("remote", server_url=server.url, deadline_s=10.0, lockstep=True)
        for k in range(4):
            camera.send_color(k)
            camera.send_depth(k)
        wait_for(lambda: len(camera.completed.messages) == 4, "four depth images")
    assert [is_unchanged(m) for m in camera.completed.messages] == [False] * 4
    assert server.most_in_flight == 1


@pytest.mark.parametrize("fault", ["hang", "500", "garbage", "old_stamp", "nan", "close"])
def test_what_a_side_car_does_wrong_passes_the_sensor_in_time_and_is_told(camera, fault):
    with FakeDepthSidecar(ROOM.depth_m) as server:
        server.fault = fault
        camera.start("remote", server_url=server.url, deadline_s=0.4, wait_s=5.0)
        camera.send_color(0)
        camera.send_depth(0)
        assert is_unchanged(camera.completed_at(0))
        status = camera.status(lambda s: "passed unchanged" in s.message, "a status that says so")
        assert status.level == 1
        server.fault = ""

        def recovered():
            recovered.k += 1
            camera.send_color(recovered.k)
            camera.send_depth(recovered.k)
            return not is_unchanged(camera.completed_at(recovered.k))

        recovered.k = 0
        wait_for(recovered, "a frame that is filled again")


def test_without_a_colour_image_the_depth_goes_on_unchanged(camera):
    with FakeDepthSidecar(ROOM.depth_m) as server:
        camera.start("remote", server_url=server.url, wait_s=0.2)
        camera.send_depth(0)
        assert is_unchanged(camera.completed_at(0))
        assert server.requests == []


def test_depth_that_is_not_registered_is_passed_and_told(camera):
    with FakeDepthSidecar(ROOM.depth_m) as server:
        camera.start("remote", server_url=server.url, wait_s=5.0)
        camera.send("camera/depth/image_raw", 0, SENSED, "32FC1", "camera_depth_optical_frame")
        camera.send_color(0)
        assert is_unchanged(camera.completed_at(0))
        camera.status(lambda s: "not registered" in s.message, "a status that says so")
        assert server.requests == []


def test_predicted_depth_of_another_node_is_used(camera):
    camera.start("topic", kind="disparity", wait_s=5.0)
    camera.send_depth(0)
    camera.send("depth_prediction/image_raw", 0, (3.0 / ROOM.depth_m).astype(np.float32), "32FC1")
    completed = image_to_array(camera.completed_at(0))
    assert np.array_equal(completed[~HOLES], SENSED[~HOLES])
    assert (HOLES & ~np.isnan(completed)).sum() > 0.7 * HOLES.sum()
    camera.send_depth(1)
    camera.send("depth_prediction/image_raw", 1, ROOM.color, "rgb8")
    assert is_unchanged(camera.completed_at(1))


@pytest.mark.parametrize("encoding", ["16UC1", "mono16"])
def test_without_a_back_end_millimetres_become_metres_and_nothing_else(camera, encoding):
    camera.start("none")
    camera.send("camera/depth/image_raw", 0, np.nan_to_num(SENSED * 1000.0).astype(np.uint16), encoding)
    completed = image_to_array(camera.completed_at(0))
    assert np.array_equal(np.isnan(completed), HOLES)
    assert np.nanmax(np.abs(completed - SENSED)) < 1.1e-3
    status = camera.status(lambda s: "nobody predicts" in s.message, "a status that says so")
    assert status.level == 0


def test_a_stamp_that_goes_back_is_followed(camera):
    with FakeDepthSidecar(ROOM.depth_m) as server:
        camera.start("remote", server_url=server.url, deadline_s=10.0, wait_s=5.0)
        for k in (50, 3, 4):
            camera.send_color(k)
            camera.send_depth(k)
            assert not is_unchanged(camera.completed_at(k))


BAD_PARAMETERS = [
    ({"backend": "magic"}, "backend: got 'magic', allowed one of none, remote, topic"),
    ({"backend": "remote", "server_url": "http://gpu.example.org:80"}, "http://gpu.example.org:80 is not on this"),
    ({"fit_max_m": 0.1}, "fit_max_m: got 0.1, allowed more than fit_min_m, which is 0.3"),
]


@pytest.mark.parametrize(("params", "message"), BAD_PARAMETERS)
def test_bad_parameter_ends_the_node_with_one_line_and_status_2(camera, params, message):
    process = start_node("depth_completion", camera.namespace, **params)
    _, stderr = process.communicate(timeout=20.0)
    assert process.returncode == 2
    assert len(stderr.splitlines()) == 1
    assert stderr.startswith(f"{camera.namespace}/depth_completion: {message}")


if __name__ == "__main__":
    sys.exit(run_as_script(__file__, sys.argv[1:]))

#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""perception.launch beside robots that are not ours: other frames, sizes, rates, clocks and faults.

Runs under rostest (foreign_robot.test), or alone with a master of its own.
"""

import contextlib
import itertools
import math
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
import rospkg
import rospy
from core_msgs.msg import InstanceArray, SafetyGrid
from diagnostic_msgs.msg import DiagnosticArray
from foreign_robot import (
    BOXES,
    COLORS,
    CONE_ID,
    FLOOR_ID,
    FLOOR_Z_M,
    PERSON_ID,
    SWING_S,
    WALL_ID,
    Lens,
    Robot,
    T_world_base,
    in_world,
    write_bag,
)
from sensor_msgs.msg import CameraInfo, Image
from tf2_msgs.msg import TFMessage

sys.path.insert(0, str(Path(rospkg.RosPack().get_path("core_perception")) / "test"))

from fake_chain import Collector, joined_graph, run_as_script, wait_for  # noqa: E402
from fakes.fake_sidecar import FakeSidecar  # noqa: E402

CLASS_MAP = "['1=floor', '11=person', '24=traffic_cone', '40=wall', '0=none']"
DEADLINE_S = 40.0
# Farthest reach of a rule around a thing, and a cell and a half.
REACH_M = 1.0 + 0.3
# Cells that are seen only along the edge of a thing may get its label: stamps differ by 15 ms.
STRAY_CELLS = 3
MIN_FRAMES = 2  # as semantic_map has it: what fewer saw makes no region
SAFE_M = ((1.6, 0.1), (4.5, -0.4), (1.3, -0.1))  # ahead, left
_names = (f"robot_{k}" for k in itertools.count())


@pytest.fixture(scope="module", autouse=True)
def master():
    with joined_graph("foreign_robot_rostest"):
        yield


class Session:
    """A robot on topics of its own names, and perception.launch with arguments for them."""

    KINDS = {"depth": Image, "camera_info": CameraInfo, "color": Image, "labels": Image}

    def __init__(self, robot):
        self.robot = robot
        self.topics = {
            "depth": f"/{robot.name}/kinect/depth_registered/image",
            "camera_info": f"/{robot.name}/kinect/rgb/info",
            "color": f"/{robot.name}/kinect/rgb/image",
            "labels": f"/{robot.name}/yolo/classes",
        }
        self.grids = Collector(f"/{robot.name}/safety_grid", SafetyGrid)
        self.instances = Collector(f"/{robot.name}/semantic_map/instances", InstanceArray)
        self.diagnostics = Collector(f"/{robot.name}/diagnostics", DiagnosticArray)
        self._publishers = {"/tf": rospy.Publisher("/tf", TFMessage, queue_size=50)}
        for name, kind in self.KINDS.items():
            if name != "color" or robot.with_color:
                self._publishers[name] = rospy.Publisher(self.topics[name], kind, queue_size=50)
        self._static = rospy.Publisher("/tf_static", TFMessage, queue_size=1, latch=True)
        self._static.publish(robot.static_tf(rospy.Time.now()))
        self._stop, self._thread, self._launch = threading.Event(), None, None
        self.sent_labels = []

    def launch(self, *extra):
        """Start perception as a user would, with names alone."""
        arguments = {
            **self.topics,
            "required": "true",
            "segmenter": "topic",
            "class_map": CLASS_MAP,
            "map_frame": self.robot.frames[0],
            "base_frame": self.robot.frames[2],
            "floor_z_m": str(FLOOR_Z_M),
        }
        arguments.update(word.split(":=", 1) for word in extra)
        words = [f"{name}:={value}" for name, value in arguments.items()]
        self._launch = subprocess.Popen(
            ["roslaunch", "core_bringup", "perception.launch", *words],
            env={**os.environ, "ROS_NAMESPACE": self.robot.name},
            start_new_session=True,
        )

    def play(self):
        """Send what the robot sends, again and again."""
        events = self.robot.events(SWING_S)
        self._thread = threading.Thread(target=self._play, args=(events,), daemon=True)
        self._thread.start()

    def _play(self, events):
        own_ns = [[h.stamp.to_nsec() for h in headers(message)] for _, _, message in events]
        start_s = time.time()
        for turn in itertools.count():
            for (at_s, topic, message), stamps_ns in zip(events, own_ns):
                offset_s = start_s + turn * SWING_S
                if self._stop.wait(max(0.0, offset_s + at_s - time.time())):
                    return
                for header, stamp_ns in zip(headers(message), stamps_ns):
                    ns = stamp_ns + round(offset_s * 1e9) - 10**9
                    header.stamp = rospy.Time(ns // 10**9, ns % 10**9)
                if topic == "labels":
                    self.sent_labels.append(message.header.stamp.to_sec())
                self._publishers[topic].publish(message)

    def status(self, node):
        """Newest (level, message) of a node's diagnostics, None while there is none."""
        for array in reversed(list(self.diagnostics.messages)):
            for status in array.status:
                if status.name.split("/")[-1].startswith(node):
                    return status.level, status.message
        return None

    def wait_for_words(self, node, *words):
        """Wait until a node's diagnostics say all these words; return the status."""

        def said():
            status = self.status(node)
            return status is not None and all(word in status[1] for word in words) and status

        try:
            return wait_for(said, f"{words} of {node}", DEADLINE_S)
        except AssertionError as error:
            raise AssertionError(f"{error}; it says {self.status(node)}") from None

    def settled(self, count=15, grids=None):
        """Wait for some grids, the last of which come after things were seen often enough."""
        grids = grids or (lambda: self.grids.messages)
        try:
            wait_for(lambda: len(grids()) >= count, f"{count} grids", DEADLINE_S)
        except AssertionError as error:
            nodes = ("semantic_map", "segmenter", "decompress_color", "decompress_depth")
            raise AssertionError(f"{error}: {[self.status(node) for node in nodes]}") from None
        return grids()[-1]

    def jumps(self):
        """How often the stamps of the grid went back."""
        return int((np.diff([m.header.stamp.to_sec() for m in self.grids.messages]) < 0.0).sum())

    def since_jump(self):
        """Grids since their stamps went back."""
        grids = list(self.grids.messages)
        back = np.flatnonzero(np.diff([m.header.stamp.to_sec() for m in grids]) < 0.0)
        return grids[back[-1] + 1 :] if back.size else grids

    @property
    def is_up(self):
        """All nodes run: the launch ends with the first that ends."""
        return self._launch.poll() is None

    def close(self):
        self._stop.set()
        if self._thread is not None:
            self._thread.join()
        if self._launch is not None:
            self._launch.send_signal(signal.SIGINT)
            try:
                self._launch.wait(30.0)
            finally:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(self._launch.pid, signal.SIGKILL)
        for publisher in [*self._publishers.values(), self._static]:
            publisher.unregister()
        for collector in (self.grids, self.instances, self.diagnostics):
            collector.close()


def headers(message):
    return [t.header for t in message.transforms] if isinstance(message, TFMessage) else [message.header]


@pytest.fixture()
def session(request):
    options = getattr(request, "param", {})
    session = Session(Robot(next(_names), **options))
    yield session
    session.close()


def state_at(grid, ahead_m, left_m):
    x_m, y_m = in_world(ahead_m, left_m)
    ix = math.floor((x_m - grid.origin_x_m) / grid.resolution_m)
    iy = math.floor((y_m - grid.origin_y_m) / grid.resolution_m)
    return grid.state[iy * grid.width + ix]


def distances_to_boxes(ahead_m, left_m):
    """(n, boxes) from points to the footprints of the boxes [m]."""
    apart = []
    for box_ahead_m, box_left_m, edge_m, _, _ in BOXES:
        beyond = [np.maximum(np.abs(d) - edge_m / 2, 0.0) for d in (ahead_m - box_ahead_m, left_m - box_left_m)]
        apart.append(np.hypot(*beyond))
    return np.stack(apart, axis=1)


def place_of(instance):
    """Ahead and to the left of the robot [m]."""
    corners = np.array([[p.x, p.y, 0.0, 1.0] for p in instance.footprint])
    return tuple((np.linalg.inv(T_world_base(0.0)) @ corners.mean(axis=0))[:2])


def describe(grid, cause):
    return str(grid.causes[cause]) if cause < len(grid.causes) else "no cause"


def assert_map_is_right(session):
    """Things stand in the cells where they are, floor is safe, and nothing unsafe lies anywhere else."""
    grid, instances = session.settled(), session.instances.messages[-1]
    assert grid.header.frame_id == session.robot.frames[0]
    assert [state_at(grid, *place) for place in SAFE_M] == [SafetyGrid.SAFE] * len(SAFE_M)
    for ahead_m, left_m, edge_m, _, _ in BOXES[:2]:
        assert state_at(grid, ahead_m - edge_m / 2 + 0.03, left_m) == SafetyGrid.UNSAFE
    iy, ix = np.nonzero(np.array(list(grid.state)).reshape(grid.height, grid.width) == SafetyGrid.UNSAFE)
    x_m = grid.origin_x_m + (ix + 0.5) * grid.resolution_m
    y_m = grid.origin_y_m + (iy + 0.5) * grid.resolution_m
    ahead_m, left_m, _, _ = np.linalg.inv(T_world_base(0.0)) @ [x_m, y_m, 0 * x_m, 0 * x_m + 1]
    apart_m = distances_to_boxes(ahead_m, left_m).min(axis=1)
    causes = [grid.cause[k] for k in iy * grid.width + ix]
    stray = [
        (round(float(a), 2), round(float(b), 2), describe(grid, cause))
        for a, b, far_m, cause in zip(ahead_m, left_m, apart_m, causes)
        if far_m >= REACH_M
    ]
    assert len(stray) <= STRAY_CELLS, stray
    held = [(i.class_name, *place_of(i), i) for i in instances.instances if i.frames_seen >= MIN_FRAMES]
    for number, name in ((PERSON_ID, "person"), (CONE_ID, "traffic_cone")):
        assert [one[0] for one in held].count(name) == 1, [one[:3] for one in held]
        ahead_m, left_m, instance = next(one[1:] for one in held if one[0] == name)
        index = [box[4] for box in BOXES].index(number)
        assert distances_to_boxes(np.array([ahead_m]), np.array([left_m]))[0, index] < 0.08, (name, ahead_m, left_m)
        assert abs(instance.z_min_m - FLOOR_Z_M) < 0.1


BENT = Lens(D=(0.12, -0.2, 0.001, -0.002, 0.05))
HALF_INFO = {"width": 320, "height": 240, "K": [262.5, 0, 159.25, 0, 262.5, 119.25, 0, 0, 1]}
HEALTHY = {
    "equal_stamps": ({"jitter_s": 0.0}, ()),
    "kinect": ({}, ()),
    "metres_with_holes": ({"encoding": "32FC1", "optical": "kinect2_link", "labels_encoding": "mono16"}, ()),
    "camera_info_of_half_the_size": ({"info": HALF_INFO}, ()),
    "bent_lens": ({"lens": BENT}, ("rectify:=true",)),
    "tf_late": ({"tf_late_s": 0.2, "labels_late_s": 0.1}, ()),
    "tf_with_gaps": ({"tf_gap_s": (1.0, 1.5)}, ()),
}


@pytest.mark.parametrize(("session", "extra"), HEALTHY.values(), ids=HEALTHY, indirect=["session"])
def test_things_land_where_they_are_at_the_rate_of_the_labels(session, extra):
    session.launch(*extra)
    session.play()
    assert_map_is_right(session)
    stamps_s = [m.header.stamp.to_sec() for m in session.grids.messages]
    labels_s = [s for s in session.sent_labels if stamps_s[0] <= s <= stamps_s[-1]]
    missed = [s for s in labels_s if min(abs(s - stamp_s) for stamp_s in stamps_s) > 0.02]
    assert len(missed) <= 0.2 * len(labels_s)
    assert session.status("semantic_map")[0] == 0, session.status("semantic_map")
    assert session.is_up


SMALL = Lens(320, 240, 262.5, 262.5, 159.5, 119.5)
FAULTS = {
    "bent_lens": (
        {"lens": Lens(320, 240, 262.5, 262.5, 159.5, 119.5, BENT.D)},
        (),
        "semantic_map",
        ("camera_info has distortion", "rectify"),
    ),
    "camera_info_of_another_shape": (
        {"lens": SMALL, "info": {"width": 1280, "height": 720}},
        (),
        "semantic_map",
        ("camera_info is for 1280x720, the images are 320x240",),
    ),
    "labels_of_another_size": (
        {"lens": SMALL, "labels_step_px": 2},
        (),
        "semantic_map",
        ("depth is 320x240, labels are 160x120",),
    ),
    "labels_of_another_frame": (
        {"lens": SMALL, "labels_frame": "kinect_link"},
        (),
        "semantic_map",
        ("labels in 'kinect_link'", "the same optical frame"),
    ),
    "stamps_apart": ({"lens": SMALL}, ("slop_s:=0.0001",), "semantic_map", ("no depth image within slop_s",)),
    "labels_seconds_late": ({"lens": SMALL, "labels_late_s": 6.0}, (), "semantic_map", ("raise queue_size",)),
    "no_such_base": ({"lens": SMALL}, ("base_frame:=base_link",), "semantic_map", ("waiting for tf", '"base_link"')),
    "no_depth": ({"lens": SMALL}, ("depth:=/nowhere/depth",), "semantic_map", ("no depth image on /nowhere/depth",)),
    "no_labels": ({"lens": SMALL}, ("labels:=/nowhere/ids",), "segmenter", ("no labels came (of /nowhere/ids)",)),
    "a_class_id_without_meaning": (
        {"lens": SMALL},
        ("class_map:=['1=floor', '0=none']",),
        "segmenter",
        ("allowed those of class_map",),
    ),
}


@pytest.mark.parametrize(("session", "extra", "node", "words"), FAULTS.values(), ids=FAULTS, indirect=["session"])
def test_what_is_dropped_is_told_with_the_reason_and_nothing_is_mapped(session, extra, node, words):
    session.launch(*extra)
    session.play()
    level, _ = session.wait_for_words(node, *words)
    assert level > 0
    assert session.grids.messages == []
    assert session.is_up


@pytest.fixture()
def sim_time():
    rospy.set_param("/use_sim_time", True)
    yield
    rospy.delete_param("/use_sim_time")


@pytest.mark.parametrize("session", [{"with_color": True, "jitter_s": 0.0}], indirect=True)
def test_a_looped_bag_of_compressed_images_is_mapped_anew_each_time(session, sim_time, tmp_path):
    bag, settings = tmp_path / "robot.bag", tmp_path / "segmenter.yaml"
    write_bag(bag, session.robot, session.topics, 2 * SWING_S)
    names = {FLOOR_ID: "floor", PERSON_ID: "person", CONE_ID: "traffic_cone", WALL_ID: "wall"}
    with FakeSidecar({name: COLORS[number] for number, name in names.items()}) as sidecar:
        sidecar.capabilities["classes"] = list(names.values())
        settings.write_text(f"server_url: {sidecar.url}\nimage_format: png\n")
        transports = ("color_transport:=compressed", "depth_transport:=compressedDepth")
        session.launch("segmenter:=remote", f"segmenter_params:={settings}", "class_map:=[]", *transports)
        player = subprocess.Popen(["rosbag", "play", "--quiet", "--clock", "--loop", str(bag)])
        try:
            for _ in range(3):
                session.settled(12, session.since_jump)
                assert_map_is_right(session)
                before = session.jumps()
                wait_for(lambda: session.jumps() > before, "the next round", DEADLINE_S)  # noqa: B023
        finally:
            player.terminate()
            player.wait()
    assert session.is_up


if __name__ == "__main__":
    sys.exit(run_as_script(__file__, sys.argv[1:]))

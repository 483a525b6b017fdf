# SPDX-License-Identifier: BSD-3-Clause
"""Fakes around the Python nodes: a lock-step world in front, an instance memory behind, and waiting by condition."""

import contextlib
import os
import socket
import subprocess
import sys
import threading
import time
import xmlrpc.client
from pathlib import Path

import numpy as np
import pytest
import rosgraph
import rospy
import tf2_ros
from core_msgs.msg import Instance, InstanceArray, LabelClass, LabelInfo, SafetyConstraints, SafetyGrid, Tick
from geometry_msgs.msg import Point32, Quaternion, Transform, TransformStamped, Vector3
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

from core_perception.ros.conversions import array_to_image, ns_to_stamp

PACKAGE_DIR = Path(__file__).resolve().parents[1]
DEADLINE_S = 20.0
QUEUE_SIZE = 50
HISTORY_START = rospy.Time(1)


def free_port():
    with socket.socket() as probe:
        probe.bind(("localhost", 0))
        return probe.getsockname()[1]


def start_master():
    """Set ROS_MASTER_URI to a master of our own and return its process."""
    port = int(os.environ.get("CORE_TEST_PORT", 0)) or free_port()
    os.environ["ROS_MASTER_URI"] = f"http://localhost:{port}"
    master = subprocess.Popen(
        ["rosmaster", "--core", "-p", str(port)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    wait_for(lambda: _accepts(port), "the ROS master")
    return master


@contextlib.contextmanager
def joined_graph(name):
    """Be a node of rostest's graph, or of one with a master of its own."""
    process = None if os.environ.get("CORE_UNDER_ROSTEST") else start_master()
    rospy.init_node(name, disable_signals=True)
    yield
    rospy.signal_shutdown("tests are over")
    if process is not None:
        process.terminate()
        process.wait(10.0)


def run_as_script(file, arguments):
    """Run the tests of a file; under rostest the last arguments name the result file, alone there are none."""
    results = [a.split("xml:", 1)[1] for a in arguments if a.startswith("--gtest_output=xml:")]
    if results:
        os.environ["CORE_UNDER_ROSTEST"] = "1"
    return pytest.main([file, "-p", "no:cacheprovider", *[f"--junitxml={path}" for path in results]])


def _accepts(port):
    with socket.socket() as probe:
        return probe.connect_ex(("localhost", port)) == 0


def wait_for(condition, what, deadline_s=DEADLINE_S):
    """Wait until condition() is true and return its value; fail with the name of what was awaited."""
    end = time.monotonic() + deadline_s
    while time.monotonic() < end:
        value = condition()
        if value:
            return value
        time.sleep(0.005)
    raise AssertionError(f"waited {deadline_s} s for {what}")


def start_node(name, namespace, **params):
    """Set private parameters and start one node of the package in a namespace."""
    for key, value in params.items():
        rospy.set_param(f"/{namespace}/{name}/{key}", value)
    command = [sys.executable, str(PACKAGE_DIR / "scripts" / name), f"__ns:={namespace}"]
    return subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True)


def is_served(node, topic):
    """Whether a node knows that this one reads its topic: a subscriber counts a connection before that."""
    own = rospy.get_name()
    uri = rosgraph.Master(own).lookupNode(node)
    connections = xmlrpc.client.ServerProxy(uri).getBusInfo(own)[2]
    return any(c[1] == own and c[2] == "o" and c[4] == topic and c[5] for c in connections)


def stop_node(process):
    process.terminate()
    try:
        process.communicate(timeout=5.0)
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()


class Collector:
    """Every message of one topic, in order."""

    def __init__(self, topic, message_type):
        self.messages, self._lock = [], threading.Lock()
        self._subscriber = rospy.Subscriber(topic, message_type, self._keep, queue_size=QUEUE_SIZE, tcp_nodelay=True)

    def _keep(self, msg):
        with self._lock:
            self.messages.append(msg)

    def at(self, stamp_ns):
        with self._lock:
            return next((m for m in reversed(self.messages) if m.header.stamp.to_nsec() == stamp_ns), None)

    def wait_at(self, stamp_ns, what):
        return wait_for(lambda: self.at(stamp_ns), what)

    def close(self):
        self._subscriber.unregister()


class FakeChain:
    """World and instance memory of one namespace."""

    def __init__(self, namespace, truth_classes, labels):
        self._truth_classes, self._labels = truth_classes, labels
        topics = {
            "lockstep/tick": Tick,
            "ground_truth/labels": Image,
            "ground_truth/label_info": LabelInfo,
            "semantic_map/instances": InstanceArray,
            "segmentation/label_info": LabelInfo,
        }
        self.publishers = {}
        for topic, kind in topics.items():
            if topic != "segmentation/label_info":
                self.publishers[topic] = rospy.Publisher(
                    f"/{namespace}/{topic}", kind, queue_size=QUEUE_SIZE, latch=True
                )
        self.constraints = Collector(f"/{namespace}/safety/constraints", SafetyConstraints)
        self.label_info = Collector(f"/{namespace}/segmentation/label_info", LabelInfo)
        self.labels = Collector(f"/{namespace}/segmentation/labels", Image)

    def publish_frame(self, stamp_ns):
        header = Header(stamp=ns_to_stamp(stamp_ns), frame_id="camera_color_optical_frame")
        self.publishers["ground_truth/labels"].publish(array_to_image(self._labels, "mono16", header))
        info = [LabelClass(label, name, 1.0) for label, name in self._truth_classes.items()]
        self.publishers["ground_truth/label_info"].publish(LabelInfo(header, info, []))

    def publish_tick(self, tick, stamp_ns):
        header = Header(stamp=ns_to_stamp(stamp_ns))
        self.publishers["lockstep/tick"].publish(Tick(header, tick, 0.1, ns_to_stamp(stamp_ns)))

    def publish_instances(self, stamp_ns, class_name, positions_m):
        header = Header(stamp=ns_to_stamp(stamp_ns), frame_id="odom")
        instances = [cone_instance(k + 1, class_name, x, y) for k, (x, y) in enumerate(positions_m)]
        self.publishers["semantic_map/instances"].publish(InstanceArray(header, HISTORY_START, instances))

    def close(self):
        for publisher in self.publishers.values():
            publisher.unregister()
        for collector in (self.constraints, self.label_info, self.labels):
            collector.close()


class FakeCamera:
    """A level camera 0.6 m above the floor, looking along x of odom at a box, over a grid that is all safe.

    As many real ones: colour is stamped after depth, camera_info is for larger images, the floor is not at z = 0.
    """

    width_px, height_px, focal_px, height_m, floor_z_m, box_m = 240, 180, 180.0, 0.6, 0.8, 3.0
    color_late = rospy.Duration(0, 9_000_000)
    box_rows, box_columns = slice(70, 115), slice(90, 150)

    def __init__(self, namespace):
        topics = {
            "camera/color/image_raw": Image,
            "camera/depth/image_raw": Image,
            "camera/color/camera_info": CameraInfo,
        }
        topics["safety_grid"] = SafetyGrid
        self._publishers = {t: rospy.Publisher(f"/{namespace}/{t}", kind, queue_size=5) for t, kind in topics.items()}
        self._drawn = Collector(f"/{namespace}/safety/overlay", Image)
        self._broadcaster = tf2_ros.StaticTransformBroadcaster()

    def publish_until_drawn(self, stamp):
        """Publish one frame after another, as a camera does, until an overlay comes."""
        rotation = Quaternion(-0.5, 0.5, -0.5, 0.5)  # optical z, x, y = odom x, -y, -z
        pose = Transform(Vector3(0.0, 0.0, self.floor_z_m + self.height_m), rotation)
        header = Header(stamp=stamp, frame_id="camera_color_optical_frame")
        self._broadcaster.sendTransform(TransformStamped(Header(stamp=stamp, frame_id="odom"), header.frame_id, pose))
        wait_for(lambda: all(p.get_num_connections() for p in self._publishers.values()), "the overlay's subscriptions")

        def drawn():
            header.stamp += rospy.Duration(0, 50_000_000)
            self._publish(header)
            return self._drawn.messages

        return wait_for(drawn, "an overlay")[-1]

    def _publish(self, header):
        v = np.arange(self.height_px)[:, None] + np.zeros((1, self.width_px))
        with np.errstate(divide="ignore"):
            depth = np.where(v > 90, self.height_m * self.focal_px / np.maximum(v - 90, 1e-9), np.nan)
        depth[self.box_rows, self.box_columns] = self.box_m
        color = np.full((self.height_px, self.width_px, 3), 128, np.uint8)
        focal_px = 2 * self.focal_px
        info = CameraInfo(header=header, K=[focal_px, 0, 240.5, 0, focal_px, 180.5, 0, 0, 1])
        info.width, info.height = 2 * self.width_px, 2 * self.height_px
        grid = SafetyGrid(header=Header(stamp=header.stamp, frame_id="odom"), resolution_m=0.1, width=200, height=200)
        grid.origin_x_m, grid.origin_y_m, grid.state = -10.0, -10.0, bytes(200 * 200)
        messages = [
            array_to_image(color, "rgb8", Header(stamp=header.stamp + self.color_late, frame_id=header.frame_id)),
            array_to_image(depth.astype(np.float32), "32FC1", header),
            info,
            grid,
        ]
        for publisher, message in zip(self._publishers.values(), messages):
            publisher.publish(message)

    def close(self):
        for publisher in self._publishers.values():
            publisher.unregister()
        self._drawn.close()


def cone_instance(number, class_name, x_m, y_m):
    corners = [(-0.18, -0.18), (0.18, -0.18), (0.18, 0.18), (-0.18, 0.18)]
    return Instance(
        id=number,
        class_name=class_name,
        footprint=[Point32(x_m + dx, y_m + dy, 0.0) for dx, dy in corners],
        in_view=True,
        frames_seen=1,
    )


def cone_labels():
    """(40, 60) label image: floor 1 with five cones 30..34 on it, a wall 2 above."""
    labels = np.full((40, 60), 1, np.uint16)
    labels[:10] = 2
    for k in range(5):
        labels[20:26, 5 + 11 * k : 9 + 11 * k] = 30 + k
    return labels


CONE_CLASSES = {
    1: "floor",
    2: "wall",
    30: "traffic_cone",
    31: "traffic_cone",
    32: "traffic_cone",
    33: "traffic_cone",
    34: "traffic_cone",
}
CONE_LINE_M = [(6.0, -2.72), (6.0, -1.36), (6.0, 0.0), (6.0, 1.36), (6.0, 2.72)]

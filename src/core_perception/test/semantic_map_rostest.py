#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""The semantic_map node between fake images of a floor with five cones and a reader of all its outputs."""

from __future__ import annotations

import subprocess
import threading
import unittest

import numpy as np
import rospy
import rostest
from core_msgs.msg import Instance, InstanceArray, LabelClass, LabelInfo, Predicate, SafetyConstraints, SafetyGrid
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import OccupancyGrid
from octomap_msgs.msg import Octomap
from octomap_msgs.srv import GetOctomap
from sensor_msgs.msg import CameraInfo, Image
from std_srvs.srv import Empty
from tf2_msgs.msg import TFMessage

WIDTH_PX, HEIGHT_PX = 250, 160
FX_PX, FY_PX, CX_PX, CY_PX = 137.45, 188.35, 124.75, 79.75
FRAME = "camera_color_optical_frame"
CAMERA_HEIGHT_M = 0.65
DEADLINE_S = 15.0
CONES_M = [(5.0, float(y)) for y in (-2, -1, 0, 1, 2)]


def render():
    """Images of a level camera at the origin, 0.65 m up, looking along x.

    Returns:
        depth (h, w) float32 [m], labels (h, w) uint16 with 1 the floor and 2.. the cones.
    """
    u, v = np.meshgrid(np.arange(WIDTH_PX), np.arange(HEIGHT_PX))
    right, down = (u - CX_PX) / FX_PX, (v - CY_PX) / FY_PX
    with np.errstate(divide="ignore"):
        depth = np.where(down > 0, CAMERA_HEIGHT_M / down, np.inf)
    labels = np.where(np.isfinite(depth), 1, 0)
    for i, (x_m, y_m) in enumerate(CONES_M):
        height_m = CAMERA_HEIGHT_M - x_m * down
        hit = (np.abs(-right * x_m - y_m) < 0.15) & (height_m >= 0.0) & (height_m < 0.7)
        depth, labels = np.where(hit, x_m, depth), np.where(hit, i + 2, labels)
    depth[depth > 30.0] = np.nan
    return depth.astype(np.float32), labels.astype(np.uint16)


def to_image(array, encoding, stamp):
    """(h, w) array as sensor_msgs/Image."""
    image = Image(height=array.shape[0], width=array.shape[1], encoding=encoding, step=array.strides[0])
    image.header.stamp, image.header.frame_id = stamp, FRAME
    image.data = array.tobytes()
    return image


def cone_rules(stamp, image_stamp):
    """ON(floor) safe, BETWEEN(traffic_cone) unsafe; in force from stamp, none while image_stamp is zero."""
    message = SafetyConstraints(image_stamp=image_stamp)
    message.header.stamp = stamp
    if not image_stamp.is_zero():
        message.predicates = [
            Predicate(spatial_operator=Predicate.ON, class_name="floor", verdict=Predicate.SAFE),
            Predicate(spatial_operator=Predicate.BETWEEN, class_name="traffic_cone", verdict=Predicate.UNSAFE),
        ]
    return message


def exempting(constraints, numbers, history_start):
    """The same constraints, BETWEEN sparing the instances of these numbers, counted by this history."""
    constraints.instances_history_start = history_start
    constraints.predicates[1].exempt_instances = numbers
    return constraints


class FakeChain:
    """Publishes what the rest of the chain would, below a namespace, and keeps what the node answers."""

    TOPICS = {
        "camera/depth/image_raw": Image,
        "camera/color/camera_info": CameraInfo,
        "segmentation/labels": Image,
        "segmentation/label_info": LabelInfo,
        "safety/constraints": SafetyConstraints,
    }
    ANSWERS = {
        "safety_grid": SafetyGrid,
        "semantic_map/instances": InstanceArray,
        "semantic_map/probability": OccupancyGrid,
        "semantic_map/unsafe": OccupancyGrid,
        "octomap_full": Octomap,
        "octomap_binary": Octomap,
        "octomap_color": Octomap,
        "semantic_octomap": Octomap,
        "diagnostics": DiagnosticArray,
    }

    def __init__(self, namespace):
        self.namespace = namespace
        self.answers = {name: [] for name in self.ANSWERS}
        self.changed = threading.Condition()
        self.tf = rospy.Publisher("/tf", TFMessage, queue_size=10, latch=True)
        self.pubs = {
            name: rospy.Publisher(namespace + name, kind, queue_size=10, latch=True)
            for name, kind in self.TOPICS.items()
        }
        self.subs = [
            rospy.Subscriber(namespace + name, kind, self._keep, callback_args=name)
            for name, kind in self.ANSWERS.items()
        ]
        self.depth, self.labels = render()

    def _keep(self, message, name):
        with self.changed:
            self.answers[name].append(message)
            self.changed.notify_all()

    def wait(self, name, accept):
        """Newest answer of a topic that satisfies accept; fails after the deadline."""
        with self.changed:
            found = self.changed.wait_for(lambda: any(map(accept, self.answers[name])), timeout=DEADLINE_S)
            if not found:
                raise AssertionError("no fitting message on %s%s within %s s" % (self.namespace, name, DEADLINE_S))
            return [message for message in self.answers[name] if accept(message)][-1]

    def send_pose(self, stamp):
        """Send both transforms at a stamp; the camera looks along x."""
        base, camera = TransformStamped(), TransformStamped()
        base.header.stamp = camera.header.stamp = stamp
        base.header.frame_id, base.child_frame_id = "odom", "base_link"
        base.transform.rotation.w = 1.0
        camera.header.frame_id, camera.child_frame_id = "odom", FRAME
        camera.transform.translation.z = CAMERA_HEIGHT_M
        q = camera.transform.rotation
        q.x, q.y, q.z, q.w = -0.5, 0.5, -0.5, 0.5
        self.tf.publish(TFMessage([base, camera]))

    def send_frame(self, stamp, constraints, label_stamp=None, depth=None):
        """Send all messages of a frame, the constraints first and the labels last."""
        label_stamp = label_stamp or stamp
        self.pubs["safety/constraints"].publish(constraints)
        info = CameraInfo(width=WIDTH_PX, height=HEIGHT_PX)
        info.header.stamp, info.header.frame_id = stamp, FRAME
        info.K = [FX_PX, 0.0, CX_PX, 0.0, FY_PX, CY_PX, 0.0, 0.0, 1.0]
        self.pubs["camera/color/camera_info"].publish(info)
        self.pubs["camera/depth/image_raw"].publish(depth or to_image(self.depth, "32FC1", stamp))
        label_info = LabelInfo(classes_evaluated=["floor", "traffic_cone"])
        label_info.header.stamp = label_stamp
        label_info.labels = [LabelClass(id=1, class_name="floor", score=1.0)]
        label_info.labels += [LabelClass(id=i + 2, class_name="traffic_cone", score=1.0) for i in range(len(CONES_M))]
        self.pubs["segmentation/label_info"].publish(label_info)
        self.pubs["segmentation/labels"].publish(to_image(self.labels, "mono16", label_stamp))

    def send(self, stamp, constraints, **options):
        """Send pose and frame."""
        self.send_pose(stamp)
        self.send_frame(stamp, constraints, **options)


def cell(grid, x_m, y_m):
    """Index of the cell that holds a point."""
    ix = int(np.floor((x_m - grid.origin_x_m) / grid.resolution_m))
    iy = int(np.floor((y_m - grid.origin_y_m) / grid.resolution_m))
    return iy * grid.width + ix


def numbers_of(instances):
    """Numbers of the instances of a message."""
    return [instance.id for instance in instances.instances]


def at(stamp):
    """Accepts messages of this stamp."""
    return lambda message: message.header.stamp == stamp


class SemanticMapTest(unittest.TestCase):
    """Lock-step node in the root namespace (core), free node in /free (paper)."""

    @classmethod
    def setUpClass(cls):
        cls.chain, cls.free = FakeChain("/"), FakeChain("/free/")

    def test_01_nothing_is_voted_before_the_first_answer(self):
        stamp = rospy.Time(1)
        self.chain.send(stamp, cone_rules(stamp, rospy.Time()))
        grid = self.chain.wait("safety_grid", at(stamp))
        self.assertTrue(grid.constraints_stamp.is_zero())
        self.assertEqual(sum(grid.n_unsafe), 0)
        self.assertEqual(grid.state[cell(grid, 3.0, 0.0)], SafetyGrid.UNKNOWN)
        self.assertEqual(grid.header.frame_id, "odom")
        instances = self.chain.wait("semantic_map/instances", at(stamp)).instances
        self.assertEqual([i.class_name for i in instances], ["traffic_cone"] * 5)

    def test_02_line_between_cones_is_unsafe_and_says_why(self):
        for k in (2, 3):
            stamp = rospy.Time(k)
            self.chain.send(stamp, cone_rules(stamp, rospy.Time(1)))
            grid = self.chain.wait("safety_grid", at(stamp))
        self.assertEqual(grid.constraints_stamp, rospy.Time(1))
        self.assertEqual(grid.state[cell(grid, 3.0, 0.1)], SafetyGrid.SAFE)
        self.assertGreater(grid.h_m[cell(grid, 3.0, 0.1)], 0.0)
        index = cell(grid, 4.99, 0.5)
        self.assertEqual(grid.state[index], SafetyGrid.UNSAFE)
        self.assertLess(grid.h_m[index], 0.0)
        self.assertEqual(grid.causes[grid.cause[index]].rule, "BETWEEN(traffic_cone)")
        unsafe = self.chain.wait("semantic_map/unsafe", at(stamp))
        self.assertEqual(unsafe.data[index], 100)
        self.assertEqual(unsafe.data[cell(grid, -5.0, 0.0)], -1)
        self.assertEqual(self.chain.wait("semantic_map/probability", at(stamp)).data[cell(grid, 3.0, 0.1)], 0)

    def test_03_exempt_cones_open_the_line_only_in_the_history_they_count_by(self):
        instances = self.chain.wait("semantic_map/instances", at(rospy.Time(3)))
        self.assertEqual(instances.history_start, rospy.Time(1))
        self.assertEqual(self.chain.wait("safety_grid", at(rospy.Time(3))).history_start, rospy.Time(1))
        numbers = numbers_of(instances)
        self.assertEqual({i.verdict for i in instances.instances}, {Instance.UNSAFE})
        cases = [  # exempt, history, is open
            (numbers, rospy.Time(1, 1), False),
            (numbers[1:], rospy.Time(1), False),
            (numbers, rospy.Time(1), True),
            ([], rospy.Time(), False),
        ]
        for k, (exempt, history_start, is_open) in enumerate(cases):
            stamp = rospy.Time(3, 1000 * (k + 1))
            self.chain.send(stamp, exempting(cone_rules(stamp, rospy.Time(1)), exempt, history_start))
            grid = self.chain.wait("safety_grid", at(stamp))
            index = cell(grid, 4.99, 0.5)
            self.assertEqual(grid.state[index], SafetyGrid.SAFE if is_open else SafetyGrid.UNSAFE, k)
            self.assertEqual(grid.h_m[index] > 0.0, is_open, k)
            held = self.chain.wait("semantic_map/instances", at(stamp))
            self.assertEqual(numbers_of(held), numbers)
            self.assertEqual({i.verdict for i in held.instances}, {Instance.SAFE if is_open else Instance.UNSAFE}, k)

    def test_04_exemption_without_history_or_number_is_refused_with_a_diagnostic(self):
        cases = [([1], rospy.Time(), "instances_history_start is 0"), ([0], rospy.Time(1), "instance 0")]
        for k, (exempt, history_start, complaint) in enumerate(cases):
            stamp, following = rospy.Time(3, 10000 * (2 * k + 1)), rospy.Time(3, 10000 * (2 * k + 2))
            self.chain.send(stamp, exempting(cone_rules(stamp, rospy.Time(1)), exempt, history_start))
            self.chain.wait("diagnostics", lambda m, part=complaint: part in m.status[0].message)
            self.chain.send(following, cone_rules(following, rospy.Time(1)))
            self.chain.wait("safety_grid", at(following))
            self.assertFalse(any(map(at(stamp), self.chain.answers["safety_grid"])))

    def test_05_cones_that_only_on_speaks_of_are_hidden_while_it_does(self):
        numbers = numbers_of(self.chain.answers["semantic_map/instances"][-1])
        self.assertEqual(len(numbers), len(CONES_M))
        for k in range(6):
            stamp, is_surface = rospy.Time(3, 100000 * (k + 1)), k < 5
            constraints = cone_rules(stamp, rospy.Time(1))
            if is_surface:
                constraints.predicates[1].spatial_operator = Predicate.ON
            self.chain.send(stamp, constraints)
            held = self.chain.wait("semantic_map/instances", at(stamp))
            grid = self.chain.wait("safety_grid", at(stamp))
            self.assertEqual(numbers_of(held), [] if is_surface else numbers)
            state = grid.state[cell(grid, 4.99, 0.5)]
            self.assertEqual(state, SafetyGrid.SAFE if is_surface else SafetyGrid.UNSAFE)

    def test_06_octomaps_carry_the_id_of_their_payload(self):
        ids = {"octomap_full": "OcTree", "octomap_binary": "OcTree", "octomap_color": "ColorOcTree"}
        ids["semantic_octomap"] = "SemanticOcTree"
        for topic, expected in ids.items():
            message = self.chain.wait(topic, lambda m: len(m.data) > 0)
            self.assertEqual((message.id, message.binary), (expected, topic == "octomap_binary"))
        answer = rospy.ServiceProxy("/octomap_binary", GetOctomap)()
        self.assertEqual((answer.map.id, answer.map.binary), ("OcTree", True))

    def test_07_frame_waits_for_its_pose_and_its_constraints(self):
        stamp = rospy.Time(4)
        self.chain.send_frame(stamp, cone_rules(stamp, rospy.Time(1)))
        self.chain.send_pose(stamp)
        self.chain.wait("safety_grid", at(stamp))
        early = rospy.Time(5)
        self.chain.send(early, cone_rules(rospy.Time(99), rospy.Time(1)))
        marker = rospy.ServiceProxy("/octomap_full", GetOctomap)()  # answered after what was sent before
        self.assertEqual(marker.map.header.stamp, stamp)
        self.assertFalse(any(map(at(early), self.chain.answers["safety_grid"])))
        self.chain.pubs["safety/constraints"].publish(cone_rules(early, rospy.Time(1)))
        self.chain.wait("safety_grid", at(early))

    def test_08_frame_of_wrong_size_is_refused_with_a_diagnostic(self):
        before = self.chain.answers["safety_grid"][-1]
        stamp = rospy.Time(6)
        self.chain.send(stamp, cone_rules(stamp, rospy.Time(1)), depth=to_image(self.chain.depth[:80], "32FC1", stamp))
        self.chain.wait("diagnostics", lambda m: "image_size" in m.status[0].message)
        following = rospy.Time(7)
        self.chain.send(following, cone_rules(following, rospy.Time(1)))
        after = self.chain.wait("safety_grid", at(following))
        self.assertFalse(any(map(at(stamp), self.chain.answers["safety_grid"])))
        self.assertEqual(before.state, after.state)

    def test_09_stamp_that_goes_back_flushes_the_map(self):
        stamp = rospy.Time(0.5)
        self.chain.send(stamp, cone_rules(stamp, rospy.Time()))
        grid = self.chain.wait("safety_grid", at(stamp))
        self.assertEqual(sum(grid.n_unsafe), 0)
        self.assertEqual(grid.state[cell(grid, 3.0, 0.1)], SafetyGrid.UNKNOWN)
        self.assertEqual(grid.history_start, stamp)
        # Nothing said of the numbers from before reaches what is held now, whatever history it claims.
        old = numbers_of(self.chain.wait("semantic_map/instances", at(rospy.Time(7))))
        for k, history_start in enumerate((rospy.Time(1), stamp)):
            later = rospy.Time(0.6 + 0.1 * k)
            self.chain.send(later, exempting(cone_rules(later, rospy.Time(0.5)), old, history_start))
            held = self.chain.wait("semantic_map/instances", at(later))
            self.assertEqual(held.history_start, stamp)
            self.assertEqual((len(held.instances), set(old) & set(numbers_of(held))), (len(CONES_M), set()))
            grid = self.chain.wait("safety_grid", at(later))
            self.assertEqual(grid.state[cell(grid, 4.99, 0.5)], SafetyGrid.UNSAFE)

    def test_10_free_node_matches_by_slop_and_uses_the_newest_constraints(self):
        now = rospy.Time.now()
        self.free.send_pose(now)
        label_stamp = now + rospy.Duration(0.03)
        self.free.send_frame(now, cone_rules(now - rospy.Duration(1), now), label_stamp=label_stamp)
        grid = self.free.wait("safety_grid", at(now))
        self.assertEqual(grid.constraints_stamp, now)
        self.assertFalse(grid.unknown_is_unsafe)
        self.assertGreater(grid.n_safe[cell(grid, 4.1, 0.1)], 1)
        # The pixels between the cones show the floor behind them.
        self.assertEqual(grid.state[cell(grid, 5.5, 0.5)], SafetyGrid.UNSAFE)

    def test_11_reset_forgets(self):
        rospy.ServiceProxy("/free/semantic_map/reset", Empty)()
        now = rospy.Time.now()
        self.free.send(now, cone_rules(now, rospy.Time()))
        grid = self.free.wait("safety_grid", at(now))
        self.assertEqual(sum(grid.n_unsafe), 0)

    def test_12_bad_parameter_ends_the_node_with_one_line(self):
        for argument, key in (("_tau:=1.5", "tau"), ("_no_such_key:=1", "no_such_key")):
            command = ["rosrun", "core_perception", "semantic_map", "__name:=bad", argument]
            done = subprocess.run(command, stderr=subprocess.PIPE, timeout=DEADLINE_S, check=False)
            lines = done.stderr.decode().strip().splitlines()
            self.assertEqual((done.returncode, len(lines)), (2, 1), lines)
            self.assertIn(key, lines[0])
            self.assertIn("allowed", lines[0])
            subprocess.run(["rosparam", "delete", "/bad"], check=False)


if __name__ == "__main__":
    rospy.init_node("semantic_map_test")
    rostest.rosrun("core_perception", "semantic_map", SemanticMapTest)

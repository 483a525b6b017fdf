#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""The semantic_map node between fake images of a floor with five cones and a reader of all its outputs."""

from __future__ import annotations

import shutil
import struct
import subprocess
import threading
import unittest
from pathlib import Path

import numpy as np
import rospy
import rostest
from core_msgs.msg import Instance, InstanceArray, LabelClass, LabelInfo, Predicate, SafetyConstraints, SafetyGrid
from core_msgs.srv import SaveMap
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Point, TransformStamped
from map_msgs.msg import OccupancyGridUpdate
from nav_msgs.msg import OccupancyGrid
from octomap_msgs.msg import Octomap
from octomap_msgs.srv import BoundingBoxQuery, GetOctomap
from sensor_msgs.msg import CameraInfo, Image, PointCloud2
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
        "semantic_map/unsafe_updates": OccupancyGridUpdate,
        "projected_map": OccupancyGrid,
        "octomap_point_cloud_centers": PointCloud2,
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
        self.x_m = 0.0  # of robot and camera

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
        """Send both transforms at a stamp; the camera looks along x, from x_m on it."""
        base, camera = TransformStamped(), TransformStamped()
        base.header.stamp = camera.header.stamp = stamp
        base.header.frame_id, base.child_frame_id = "odom", "base_link"
        base.transform.rotation.w = 1.0
        base.transform.translation.x = camera.transform.translation.x = self.x_m
        camera.header.frame_id, camera.child_frame_id = "odom", FRAME
        camera.transform.translation.z = CAMERA_HEIGHT_M
        q = camera.transform.rotation
        q.x, q.y, q.z, q.w = -0.5, 0.5, -0.5, 0.5
        self.tf.publish(TFMessage([base, camera]))

    def send_frame(self, stamp, constraints, label_stamp=None, depth=None, spoil=None):
        """Send all messages of a frame, the constraints first and the labels last.

        Args:
            stamp: of the depth and the camera [ros.Time].
            constraints: SafetyConstraints.
            label_stamp: of the labels, that of the depth by default.
            depth: another depth image.
            spoil: called with (depth, labels, camera_info, label_info, constraints) before they are sent.
        """
        label_stamp = label_stamp or stamp
        info = CameraInfo(width=WIDTH_PX, height=HEIGHT_PX)
        info.header.stamp, info.header.frame_id = stamp, FRAME
        info.K = [FX_PX, 0.0, CX_PX, 0.0, FY_PX, CY_PX, 0.0, 0.0, 1.0]
        depth = depth or to_image(self.depth, "32FC1", stamp)
        labels = to_image(self.labels, "mono16", label_stamp)
        label_info = LabelInfo(classes_evaluated=["floor", "traffic_cone"])
        label_info.header.stamp = label_stamp
        label_info.labels = [LabelClass(id=1, class_name="floor", score=1.0)]
        label_info.labels += [LabelClass(id=i + 2, class_name="traffic_cone", score=1.0) for i in range(len(CONES_M))]
        if spoil is not None:
            spoil(depth, labels, info, label_info, constraints)
        self.pubs["safety/constraints"].publish(constraints)
        self.pubs["camera/color/camera_info"].publish(info)
        self.pubs["camera/depth/image_raw"].publish(depth)
        self.pubs["segmentation/label_info"].publish(label_info)
        self.pubs["segmentation/labels"].publish(labels)

    def send(self, stamp, constraints, **options):
        """Send pose and frame."""
        self.send_pose(stamp)
        self.send_frame(stamp, constraints, **options)


def spoilt(part, **values):
    """A spoiler for FakeChain.send_frame that sets fields of one of its messages; a dotted name reaches inside."""
    index = ("depth", "labels", "info", "label_info", "constraints").index(part)

    def spoil(*messages):
        for path, value in values.items():
            target = messages[index]
            *parents, name = path.split("__")
            for parent in parents:
                target = target[int(parent)] if parent.isdigit() else getattr(target, parent)
            setattr(target, name, value)

    return spoil


# Every way in which a frame can be unusable: reason of the diagnostic, and what makes it so.
UNUSABLE = [
    ("image_size", spoilt("depth", data=b"123")),
    ("image_size", spoilt("depth", step=17)),
    ("image_size", spoilt("labels", width=0)),
    ("image_encoding", spoilt("depth", encoding="rgb8")),
    ("image_encoding", spoilt("depth", is_bigendian=1)),
    ("image_encoding", spoilt("labels", encoding="mono8")),
    ("frame_id", spoilt("depth", header__frame_id="")),
    ("frame_id", spoilt("labels", header__frame_id="camera_depth_optical_frame")),
    ("camera_invalid", spoilt("info", width=0)),
    ("camera_invalid", spoilt("info", width=2 * WIDTH_PX)),
    ("camera_invalid", spoilt("info", roi__x_offset=10)),
    ("camera_invalid", spoilt("info", binning_x=2)),
    ("camera_invalid", spoilt("info", K=[float("nan")] * 9)),
    ("distorted", spoilt("info", D=[0.1, 0.0, 0.0, 0.0, 0.0], distortion_model="plumb_bob")),
    ("labels_invalid", spoilt("label_info", labels__1__id=1)),
    ("constraints_invalid", spoilt("constraints", predicates__0__spatial_operator=9)),
    ("constraints_invalid", spoilt("constraints", predicates__0__radius_m=float("nan"))),
]


def cell(grid, x_m, y_m):
    """Index of the cell that holds a point."""
    ix = int(np.floor((x_m - grid.origin_x_m) / grid.resolution_m))
    iy = int(np.floor((y_m - grid.origin_y_m) / grid.resolution_m))
    return iy * grid.width + ix


def counted(diagnostics, key):
    """A counter of the node's diagnostics."""
    return int({v.key: v.value for v in diagnostics.status[0].values}[key])


def octomap_of(service):
    """The map as a GetOctomap service gives it."""
    return rospy.ServiceProxy(service, GetOctomap)().map


def read_full(message):
    """Leaves of a full message of one float a node: {(x, y, z) index of the lowest corner: (value, depth)}.

    Written from the format alone: pre-order, payload, one byte with a bit for each child that follows.
    """
    data, leaves, at = bytes(np.array(message.data, np.int8).tobytes()), {}, [0]

    def read(corner, depth):
        value, children = struct.unpack_from("<fB", data, at[0])
        at[0] += 5
        if children == 0:
            leaves[corner] = (value, depth)
        for i in range(8):
            if children >> i & 1:
                step = 1 << (15 - depth)
                read(tuple(c + (i >> axis & 1) * step for axis, c in enumerate(corner)), depth + 1)

    read((-32768, -32768, -32768), 0)
    assert at[0] == len(data), "bytes left over"
    return leaves


def clear(chain, lowest, highest):
    """Call clear_bbx; of a box without voxels it changes nothing."""
    rospy.ServiceProxy(chain.namespace + "semantic_map/clear_bbx", BoundingBoxQuery)(Point(*lowest), Point(*highest))


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
        cls.map_dir = Path(rospy.get_param("/semantic_map/map_dir"))
        cls.map_dir.mkdir(parents=True)
        cls.chain, cls.free = FakeChain("/"), FakeChain("/free/")

    @classmethod
    def tearDownClass(cls):
        shutil.rmtree(cls.map_dir)

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
        answer = octomap_of("/octomap_binary")
        self.assertEqual((answer.id, answer.binary, answer.header.frame_id), ("OcTree", True, "odom"))
        self.assertEqual((octomap_of("/octomap_full").id, octomap_of("/octomap_full").binary), ("OcTree", False))

    def test_06_names_of_octomap_server_show_the_same_voxels(self):
        full = octomap_of("/octomap_full")
        at_stamp = at(full.header.stamp)
        centers = self.chain.wait("octomap_point_cloud_centers", at_stamp)
        self.assertEqual([f.name for f in centers.fields], ["x", "y", "z"])
        points = np.frombuffer(centers.data, np.float32).reshape(-1, 3)
        leaves = read_full(full)
        unsafe = {corner for corner, (value, _) in leaves.items() if value >= 0.0}
        self.assertGreater(len(unsafe), 20)
        self.assertEqual({tuple(np.floor(p / full.resolution).astype(int)) for p in points}, unsafe)
        plan = self.chain.wait("projected_map", at_stamp)
        grid = self.chain.wait("safety_grid", at_stamp)
        decision = self.chain.wait("semantic_map/unsafe", at_stamp)
        self.assertEqual((plan.header.frame_id, len(plan.data)), ("odom", plan.info.width * plan.info.height))
        n_compared = 0
        for i, value in enumerate(plan.data):
            x_m = plan.info.origin.position.x + (i % plan.info.width + 0.5) * plan.info.resolution
            y_m = plan.info.origin.position.y + (i // plan.info.width + 0.5) * plan.info.resolution
            if np.hypot(x_m, y_m) > 1.6 and max(abs(x_m), abs(y_m)) < 9.5:  # of the window, not of the initial disc
                self.assertEqual(value, decision.data[cell(grid, x_m, y_m)], (x_m, y_m))
                n_compared += 1
        self.assertGreater(n_compared, 300)
        self.assertIn(100, plan.data)
        self.assertIn(0, plan.data)

    def test_06_saved_map_holds_every_voxel_and_no_path_is_taken(self):
        save = rospy.ServiceProxy("/semantic_map/save", SaveMap)
        done = save("cones.ot")
        self.assertTrue(done.success, done.message)
        self.assertEqual(done.message.split(": ")[0], str(self.map_dir / "cones.ot"))
        header, nodes = (self.map_dir / "cones.ot").read_bytes().split(b"\ndata\n", 1)
        self.assertEqual(header.splitlines()[1], b"id SemanticOcTree")
        semantic = self.chain.wait("semantic_octomap", at(octomap_of("/octomap_full").header.stamp))
        self.assertEqual(nodes, np.array(semantic.data, np.int8).tobytes())
        done = save("cones.bt")
        self.assertTrue(done.success, done.message)
        header, nodes = (self.map_dir / "cones.bt").read_bytes().split(b"\ndata\n", 1)
        self.assertEqual(header.splitlines()[0], b"# Octomap OcTree binary file")
        self.assertEqual(nodes, np.array(octomap_of("/octomap_binary").data, np.int8).tobytes())
        before = sorted(self.map_dir.iterdir())
        for file in ("", "../x.ot", "/tmp/x.ot", "x", ".ot", "x.pcd", "a b.ot", "x\n.ot", "-x.ot", "n" * 99 + ".ot"):
            done = save(file)
            self.assertFalse(done.success, file)
            self.assertIn("allowed", done.message)
            self.assertEqual(len(done.message.splitlines()), 1)
        self.assertEqual(sorted(self.map_dir.iterdir()), before)
        done = rospy.ServiceProxy("/free/semantic_map/save", SaveMap)("cones.ot")
        self.assertEqual((done.success, done.message), (False, "the map is empty"))

    def test_07_frame_waits_for_its_pose_and_its_constraints(self):
        stamp = rospy.Time(4)
        self.chain.send_frame(stamp, cone_rules(stamp, rospy.Time(1)))
        self.chain.send_pose(stamp)
        self.chain.wait("safety_grid", at(stamp))
        early = rospy.Time(5)
        self.chain.send(early, cone_rules(rospy.Time(99), rospy.Time(1)))
        clear(self.chain, (500.0, 500.0, 500.0), (501.0, 501.0, 501.0))  # answered after what was sent before
        self.assertFalse(any(map(at(early), self.chain.answers["safety_grid"])))
        self.chain.pubs["safety/constraints"].publish(cone_rules(early, rospy.Time(1)))
        self.chain.wait("safety_grid", at(early))

    def rejected(self, reason, at_least):
        """Frames rejected so far, once at least so many are, the newest for this reason."""
        accept = lambda m: reason in m.status[0].message and counted(m, "rejected") >= at_least  # noqa: E731
        return counted(self.chain.wait("diagnostics", accept), "rejected")

    def test_08_unusable_frame_gives_one_diagnostic_and_changes_no_cell(self):
        before = self.chain.answers["safety_grid"][-1]
        tree = octomap_of("/octomap_full").data
        now = rospy.Time.now()
        n = counted(self.chain.wait("diagnostics", lambda m: m.header.stamp > now), "rejected")
        for k, (reason, spoil) in enumerate(UNUSABLE):
            stamp = rospy.Time(6, 1000 * (k + 1))
            self.chain.send(stamp, cone_rules(stamp, rospy.Time(1)), spoil=spoil)
            self.assertEqual(self.rejected(reason, n + 1), n + 1, (k, reason))
            n += 1
        self.assertEqual(octomap_of("/octomap_full").data, tree)
        # Without stamps nothing belongs to a frame: each message is refused by itself.
        for part in ("depth", "labels", "info", "label_info", "constraints"):
            stamp = rospy.Time(6, 100000 + n)
            self.chain.send(stamp, cone_rules(stamp, rospy.Time(1)), spoil=spoilt(part, header__stamp=rospy.Time()))
            self.assertEqual(self.rejected("stamp that is 0", n + 1), n + 1, part)
            n += 1
        self.assertEqual(octomap_of("/octomap_full").data, tree)
        following = rospy.Time(7)
        self.chain.send(following, cone_rules(following, rospy.Time(1)))
        after = self.chain.wait("safety_grid", at(following))
        self.assertFalse([m for m in self.chain.answers["safety_grid"] if m.header.stamp.secs == 6])
        self.assertEqual(before.state, after.state)

    def test_08b_cleared_box_is_unknown_and_begins_a_new_history(self):
        stamp = rospy.Time(8)
        self.chain.send(stamp, cone_rules(stamp, rospy.Time(1)))
        before = self.chain.wait("safety_grid", at(stamp))
        self.assertEqual(before.state[cell(before, 3.3, 0.1)], SafetyGrid.SAFE)
        clear(self.chain, (500.0, 500.0, 500.0), (float("inf"), 501.0, 501.0))
        stamp = rospy.Time(8.1)
        self.chain.send(stamp, cone_rules(stamp, rospy.Time(1)))
        self.assertEqual(self.chain.wait("safety_grid", at(stamp)).history_start, before.history_start)
        for lowest, highest in (((1, 0, 0), (0, 1, 1)), ((float("nan"), 0, 0), (1, 1, 1))):
            self.assertRaises(rospy.ServiceException, clear, self.chain, lowest, highest)
        numbers = numbers_of(self.chain.wait("semantic_map/instances", at(stamp)))
        clear(self.chain, (3.0, -3.0, -1.0), (5.6, 3.0, 2.0))  # the cones are in it
        full = octomap_of("/octomap_full")
        inside = [c for c in read_full(full) if 15 <= c[0] < 28 and -15 <= c[1] < 15]
        self.assertEqual(inside, [])
        # What comes next sees nothing: what was cleared shows.
        stamp, blind = rospy.Time(8.2), to_image(np.zeros_like(self.chain.depth), "32FC1", rospy.Time(8.2))
        self.chain.send(stamp, cone_rules(stamp, rospy.Time(1)), depth=blind)
        grid = self.chain.wait("safety_grid", at(stamp))
        self.assertEqual(grid.history_start, stamp)
        for x_m in (3.3, 4.99):
            self.assertEqual(grid.state[cell(grid, x_m, 0.1)], SafetyGrid.UNKNOWN)
            self.assertLess(grid.h_m[cell(grid, x_m, 0.1)], 0.0)
        self.assertEqual(grid.state[cell(grid, 2.5, 0.1)], SafetyGrid.SAFE)
        held = self.chain.wait("semantic_map/instances", at(stamp))
        self.assertEqual((numbers_of(held), len(numbers)), ([], len(CONES_M)))

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
        saved = str(self.map_dir / "cones.ot")
        cases = [
            (["_tau:=1.5"], "tau"),
            (["_no_such_key:=1"], "no_such_key"),
            (["_map_file:=" + saved], "map_file"),  # in odom
            (["_map_file:=/no/such/file.ot", "_map_frame:=map"], "map_file"),
            (["_map_file:=" + __file__, "_map_frame:=map"], "map_file"),
            (["_map_file:=" + saved, "_map_frame:=map", "_resolution_m:=0.1"], "map_file"),
            (["_rectify:=true", "_ignore_distortion:=true"], "rectify"),
        ]
        for arguments, key in cases:
            command = ["rosrun", "core_perception", "semantic_map", "__name:=bad", *arguments]
            done = subprocess.run(command, stderr=subprocess.PIPE, timeout=DEADLINE_S, check=False)
            lines = done.stderr.decode().strip().splitlines()
            self.assertEqual((done.returncode, len(lines)), (2, 1), lines)
            self.assertIn(key, lines[0])
            self.assertIn("allowed", lines[0])
            subprocess.run(["rosparam", "delete", "/bad"], check=False)

    def test_13_saved_map_is_the_beginning_of_another_but_only_its_barriers(self):
        """Node /again starts late with the map that test_06 saved: cones of then are unsafe, floor of then unknown."""
        saved = str(self.map_dir / "cones.ot")
        rospy.set_param("/again/semantic_map", {"map_file": saved, "map_frame": "map", "window_m": 20.0})
        chain = FakeChain("/again/")
        command = ["rosrun", "core_perception", "semantic_map", "__ns:=/again"]
        node = subprocess.Popen(command)
        try:
            plan = chain.wait("projected_map", lambda m: len(m.data) > 0)
            full = read_full(chain.wait("octomap_full", lambda m: len(m.data) > 0))
        finally:
            node.terminate()
            node.wait()
        self.assertEqual(plan.header.frame_id, "map")
        self.assertIn(100, plan.data)
        self.assertNotIn(0, plan.data)
        self.assertTrue(all(value > 0.0 for value, _ in full.values()))
        self.assertTrue([c for c in full if c[0] in (24, 25) and -11 <= c[1] <= 10])

    def test_14_updates_make_the_grid_that_whole_ones_would(self):
        """The free node sends whole grids every 1000 s: between them, updates; the window must not move."""
        now = rospy.Time.now()
        for k in range(6):
            stamp = now + rospy.Duration(0.2 * k)
            depth = self.free.depth.copy()
            depth[:, : 40 * k] = np.nan  # each shows another part, so that each changes something
            self.free.send(stamp, cone_rules(now, now), depth=to_image(depth, "32FC1", stamp))
            grid = self.free.wait("safety_grid", at(stamp))
        state = np.array(list(grid.state), np.int8)
        expected = np.select([state == SafetyGrid.SAFE, state == SafetyGrid.UNSAFE], [0, 100], -1)
        self.free.wait("semantic_map/unsafe_updates", lambda m: m.header.stamp >= now)
        with self.free.changed:
            follows = self.free.changed.wait_for(lambda: np.array_equal(self.followed(), expected), DEADLINE_S)
        self.assertTrue(follows)
        self.assertLess(len([m for m in self.free.answers["semantic_map/unsafe"] if m.header.stamp >= now]), 3)

    def followed(self):
        """Cells of the newest whole grid of the free node with the updates that came after it."""
        whole = self.free.answers["semantic_map/unsafe"][-1]
        shown = np.array(whole.data, np.int8).reshape(whole.info.height, whole.info.width)
        for update in self.free.answers["semantic_map/unsafe_updates"]:
            if update.header.stamp > whole.header.stamp:
                patch = np.array(update.data, np.int8).reshape(update.height, update.width)
                shown[update.y : update.y + update.height, update.x : update.x + update.width] = patch
        return shown.ravel()


if __name__ == "__main__":
    rospy.init_node("semantic_map_test")
    rostest.rosrun("core_perception", "semantic_map", SemanticMapTest)

# SPDX-License-Identifier: BSD-3-Clause
"""A robot that shares nothing with the simulator: what its camera sees, its tf chain, and both on topics or in a bag.

It turns left and right on the spot, on a floor that is not at the height of the fixed frame's origin.
"""

from dataclasses import dataclass, field
from typing import Optional, Tuple

import cv2
import numpy as np
import rosbag
import rospy
from geometry_msgs.msg import Quaternion, Transform, TransformStamped, Vector3
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

FLOOR_Z_M = 1.37
ROBOT_M, ROBOT_YAW_RAD = (12.4, -7.8), 0.9  # in the fixed frame
ODOM_M, ODOM_YAW_RAD = (10.0, -9.0), -0.4  # the origin of odom, on the floor
CAMERA_M, PITCH_RAD = (0.1, 0.6), np.radians(25.0)  # ahead of the base and above the floor
SWING_RAD, SWING_S = 0.25, 3.0
DEPTH_HZ, LABELS_HZ, TF_HZ = 30, 5, 50
# Ahead and to the left of the robot [m], edge and height [m], class id: a person, a cone, a wall.
FLOOR_ID, PERSON_ID, CONE_ID, WALL_ID = 1, 11, 24, 40
BOXES = ((3.0, 0.8, 0.4, 1.7, PERSON_ID), (2.4, -0.9, 0.3, 0.6, CONE_ID), (7.0, 0.0, 1.2, 2.0, WALL_ID))
COLORS = {0: (200, 220, 255), FLOOR_ID: (90, 90, 90), PERSON_ID: (30, 60, 160), CONE_ID: (230, 110, 20)}
COLORS[WALL_ID] = (150, 140, 120)


def turn(axis, angle_rad):
    """(4, 4) rotation about axis 0, 1 or 2."""
    pose, (i, j) = np.eye(4), ((1, 2), (2, 0), (0, 1))[axis]
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    pose[i, i] = pose[j, j] = c
    pose[i, j], pose[j, i] = -s, s
    return pose


def shift(x_m, y_m, z_m):
    """(4, 4) translation."""
    pose = np.eye(4)
    pose[:3, 3] = x_m, y_m, z_m
    return pose


T_base_link = shift(CAMERA_M[0], 0.0, CAMERA_M[1]) @ turn(1, PITCH_RAD)
T_link_optical = np.array([[0.0, 0, 1, 0.02], [-1, 0, 0, -0.01], [0, -1, 0, 0], [0, 0, 0, 1]])
T_world_odom = shift(*ODOM_M, FLOOR_Z_M) @ turn(2, ODOM_YAW_RAD)


def T_world_base(time_s):
    """Pose of the base; it stands on the floor."""
    yaw_rad = ROBOT_YAW_RAD + SWING_RAD * np.sin(2.0 * np.pi * time_s / SWING_S)
    return shift(*ROBOT_M, FLOOR_Z_M) @ turn(2, yaw_rad)


def in_world(ahead_m, left_m):
    """(2,) of a place ahead and to the left of the robot as it stands in the middle of its swing [m]."""
    return (T_world_base(0.0) @ [ahead_m, left_m, 0.0, 1.0])[:2]


@dataclass(frozen=True)
class Lens:
    """A camera of any size; D is plumb_bob."""

    width_px: int = 640
    height_px: int = 480
    fx_px: float = 525.0
    fy_px: float = 525.0
    cx_px: float = 319.5
    cy_px: float = 239.5
    D: Tuple[float, ...] = (0.0,) * 5

    @property
    def K(self):
        return np.array([[self.fx_px, 0.0, self.cx_px], [0.0, self.fy_px, self.cy_px], [0.0, 0.0, 1.0]])

    def rays(self):
        """(h, w, 3) directions of all pixels in the optical frame, z = 1."""
        u, v = np.meshgrid(np.arange(self.width_px, dtype=float), np.arange(self.height_px, dtype=float))
        pixels = np.stack([u.ravel(), v.ravel()], axis=1)[:, None]
        xy = cv2.undistortPoints(pixels, self.K, np.array(self.D)).reshape(self.height_px, self.width_px, 2)
        return np.concatenate([xy, np.ones((self.height_px, self.width_px, 1))], axis=2)


def see(lens_rays, time_s):
    """Depth (h, w) [m], inf where nothing is, and class ids (h, w) uint8 of the camera at a time."""
    T_world_camera = T_world_base(time_s) @ T_base_link @ T_link_optical
    T_robot_camera = np.linalg.inv(T_world_base(0.0)) @ T_world_camera
    rays, eye = lens_rays @ T_robot_camera[:3, :3].T, T_robot_camera[:3, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = np.where(rays[..., 2] < 0.0, -eye[2] / rays[..., 2], np.inf)
        ids = np.where(np.isfinite(depth), FLOOR_ID, 0)
        for ahead_m, left_m, edge_m, height_m, number in BOXES:
            low = np.array([ahead_m - edge_m / 2, left_m - edge_m / 2, 0.0])
            high = low + (edge_m, edge_m, height_m)
            near, far = np.full(depth.shape, -np.inf), np.full(depth.shape, np.inf)
            for axis in range(3):
                t = (np.stack([low[axis], high[axis]])[:, None, None] - eye[axis]) / rays[..., axis]
                near, far = np.maximum(near, t.min(axis=0)), np.minimum(far, t.max(axis=0))
            hit = (near < far) & (near > 0.0) & (near < depth)
            depth, ids = np.where(hit, near, depth), np.where(hit, number, ids)
    return depth.astype(np.float32), ids.astype(np.uint8)


def to_mm(depth_m):
    """16UC1: 0 where there is none, as a Kinect has it beyond 8 m and below 0.5 m."""
    known = (depth_m > 0.5) & (depth_m < 8.0)
    return np.where(known, np.round(depth_m * 1000.0), 0).astype(np.uint16)


def with_holes(depth_m):
    """32FC1 with NaN and inf for what was not measured."""
    depth_m = depth_m.copy()
    depth_m[::7, ::5] = np.nan
    depth_m[3::11, 2::9] = np.inf
    depth_m[1::13, 1::8] = -1.0
    return depth_m


def image_message(pixels, encoding, header):
    rows = np.ascontiguousarray(pixels)
    return Image(header, rows.shape[0], rows.shape[1], encoding, 0, rows.strides[0], rows.tobytes())


def transform_message(stamp, parent, child, pose):
    w = 0.5 * np.sqrt(max(0.0, 1.0 + pose[0, 0] + pose[1, 1] + pose[2, 2]))
    vector, _ = cv2.Rodrigues(pose[:3, :3])
    angle = float(np.linalg.norm(vector))
    x, y, z = (vector.ravel() / angle * np.sin(angle / 2.0)) if angle > 0.0 else (0.0, 0.0, 0.0)
    rotation = Quaternion(x, y, z, w if angle == 0.0 else np.cos(angle / 2.0))
    return TransformStamped(Header(stamp=stamp, frame_id=parent), child, Transform(Vector3(*pose[:3, 3]), rotation))


@dataclass
class Robot:
    """Names and habits of one robot; every field can be another one's.

    Attributes:
        name: namespace of its topics and prefix of its frames.
        optical: frame id of its images.
        lens: of its camera.
        info: fields of camera_info that differ from the lens.
        encoding: of its depth, 16UC1 or 32FC1.
        jitter_s: largest difference between the stamps of depth and colour.
        labels_late_s: how long its segmentation takes.
        tf_late_s: how long its tf takes.
        tf_gap_s: first and last second of every 3 s without tf.
        labels_encoding: mono8 or mono16.
        labels_step_px: only every so many pixels of an image are labelled.
        labels_frame: another frame id of its label images.
        with_color: it publishes colour images.
    """

    name: str
    optical: str = "openni_rgb_optical_frame"
    lens: Lens = field(default_factory=Lens)
    info: dict = field(default_factory=dict)
    encoding: str = "16UC1"
    jitter_s: float = 0.015
    labels_late_s: float = 0.3
    tf_late_s: float = 0.0
    tf_gap_s: Optional[Tuple[float, float]] = None
    labels_encoding: str = "mono8"
    labels_step_px: int = 1
    labels_frame: str = ""
    with_color: bool = False

    @property
    def frames(self):
        """Fixed frame, odometry, base, camera and its optical frame."""
        return tuple(f"{self.name}/{n}" for n in ("world", "odom", "base_footprint", "camera_link", self.optical))

    def events(self, seconds):
        """What it sends: (time of sending [s], topic, message of stamps from 0 s), in order.

        Everything repeats after SWING_S.
        """
        rng = np.random.default_rng(5)
        rays, sent = self.lens.rays(), []
        for k in range(int(seconds * DEPTH_HZ)):
            time_s = k / DEPTH_HZ
            depth_s = time_s + rng.uniform(-self.jitter_s, self.jitter_s)
            depth_m, _ = see(rays, depth_s)
            pixels = to_mm(depth_m) if self.encoding == "16UC1" else with_holes(depth_m)
            sent.append((time_s + 0.03, "depth", image_message(pixels, self.encoding, self._header(depth_s))))
            sent.append((time_s + 0.02, "camera_info", self._camera_info(time_s)))
            is_labelled = k % (DEPTH_HZ // LABELS_HZ) == 0
            if not is_labelled and not self.with_color:
                continue
            _, ids = see(rays, time_s)
            if self.with_color:
                table = np.zeros((256, 3), np.uint8)
                table[list(COLORS)] = list(COLORS.values())
                sent.append((time_s + 0.02, "color", image_message(table[ids], "rgb8", self._header(time_s))))
            if is_labelled:
                pixels = ids[:: self.labels_step_px, :: self.labels_step_px]
                pixels = pixels.astype(np.uint16) if self.labels_encoding == "mono16" else pixels
                message = image_message(pixels, self.labels_encoding, self._header(time_s))
                message.header.frame_id = self.labels_frame or message.header.frame_id
                sent.append((time_s + self.labels_late_s, "labels", message))
        for k in range(int(seconds * TF_HZ)):
            time_s = k / TF_HZ
            if self.tf_gap_s and self.tf_gap_s[0] <= time_s % SWING_S < self.tf_gap_s[1]:
                continue
            world, odom, base, _, _ = self.frames
            T_odom_base = np.linalg.inv(T_world_odom) @ T_world_base(time_s)
            stamp = rospy.Time.from_sec(time_s + 1.0)
            chain = (world, odom, T_world_odom), (odom, base, T_odom_base)
            message = TFMessage([transform_message(stamp, *link) for link in chain])
            sent.append((time_s + self.tf_late_s, "/tf", message))
        return sorted(sent, key=lambda one: one[0])

    def static_tf(self, stamp):
        _, _, base, link, optical = self.frames
        chain = (base, link, T_base_link), (link, optical, T_link_optical)
        return TFMessage([transform_message(stamp, *mounted) for mounted in chain])

    def _header(self, time_s):
        return Header(stamp=rospy.Time.from_sec(time_s + 1.0), frame_id=self.frames[-1])

    def _camera_info(self, time_s):
        lens = self.lens
        info = CameraInfo(header=self._header(time_s), height=lens.height_px, width=lens.width_px)
        info.distortion_model, info.D = "plumb_bob", list(lens.D)
        info.K = list(lens.K.ravel())
        info.P = [*info.K[:3], 0.0, *info.K[3:6], 0.0, *info.K[6:], 0.0]
        for key, value in self.info.items():
            setattr(info, key, value)
        return info


def compress_color(message):
    """As image_transport's compressed topic has it; PNG, for the side-car of the test goes by exact colours."""
    rgb = np.frombuffer(message.data, np.uint8).reshape(message.height, message.width, 3)
    data = cv2.imencode(".png", rgb[:, :, ::-1])[1].tobytes()
    return CompressedImage(message.header, "rgb8; png compressed bgr8", data)


def compress_depth(message):
    """As image_transport's compressedDepth topic has it: a header of 12 bytes and a PNG."""
    pixels = np.frombuffer(message.data, np.uint16).reshape(message.height, message.width)
    data = bytes(12) + cv2.imencode(".png", pixels)[1].tobytes()
    return CompressedImage(message.header, "16UC1; compressedDepth", data)


def write_bag(path, robot, topics, seconds):
    """Record what a robot sends, its images compressed.

    Args:
        path: of the bag.
        robot: with colour.
        topics: by name, see Robot.events.
        seconds: a multiple of SWING_S.
    """
    with rosbag.Bag(str(path), "w") as bag:
        first = rospy.Time(1)
        bag.write("/tf_static", robot.static_tf(first), first)
        for at_s, name, message in robot.events(seconds):
            topic, stamp = topics.get(name, name), rospy.Time.from_sec(at_s + 1.0)
            if name == "color":
                bag.write(topic + "/compressed", compress_color(message), stamp)
            elif name == "depth":
                bag.write(topic + "/compressedDepth", compress_depth(message), stamp)
            elif name != "labels":
                bag.write(topic, message, stamp)

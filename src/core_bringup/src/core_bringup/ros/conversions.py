# SPDX-License-Identifier: BSD-3-Clause
"""Library values to and from ROS messages; x_to_msg and x_from_msg, nothing else."""

from __future__ import annotations

from typing import Dict, Sequence, Tuple

import numpy as np
import rospy
from core_msgs.msg import LabelClass, LabelInfo, Tick, Violation
from geometry_msgs.msg import Quaternion, TransformStamped, Twist, Vector3
from nav_msgs.msg import Odometry
from sensor_msgs.msg import CameraInfo, Image, JointState
from std_msgs.msg import Header, MultiArrayDimension, UInt8MultiArray

from core_bringup.backend import RobotState
from core_bringup.camera import CameraModel
from core_bringup.ground_truth import GroundTruthState

_ENCODING = {("uint8", 3): "rgb8", ("float32", 1): "32FC1", ("uint16", 1): "mono16"}
_NS_PER_S = 1_000_000_000


def stamp_to_msg(stamp_ns: int) -> rospy.Time:
    """Sim time in whole nanoseconds."""
    return rospy.Time(*divmod(int(stamp_ns), _NS_PER_S))


def stamp_from_msg(stamp: rospy.Time) -> int:
    """Whole nanoseconds."""
    return stamp.secs * _NS_PER_S + stamp.nsecs


def header_to_msg(stamp_ns: int, frame_id: str) -> Header:
    """Header without sequence number (the publisher counts)."""
    return Header(stamp=stamp_to_msg(stamp_ns), frame_id=frame_id)


def image_to_msg(image: np.ndarray, header: Header) -> Image:
    """(h, w, 3) uint8 -> rgb8, (h, w) float32 -> 32FC1, (h, w) uint16 -> mono16; ValueError for anything else."""
    channels = image.shape[2] if image.ndim == 3 else 1
    key = (image.dtype.name, channels)
    if key not in _ENCODING or image.ndim not in (2, 3):
        raise ValueError(f"image of type {image.dtype} and shape {image.shape}; allowed: {sorted(_ENCODING)}")
    height, width = image.shape[:2]
    little = np.ascontiguousarray(image.astype(image.dtype.newbyteorder("<"), copy=False))
    step = width * channels * image.dtype.itemsize
    return Image(header, height, width, _ENCODING[key], 0, step, little.tobytes())


def image_from_msg(message: Image) -> np.ndarray:
    """The inverse of image_to_msg."""
    for (dtype, channels), encoding in _ENCODING.items():
        if encoding == message.encoding:
            order = ">" if message.is_bigendian else "<"
            flat = np.frombuffer(message.data, np.dtype(dtype).newbyteorder(order)).astype(dtype)
            shape = (message.height, message.width, channels) if channels > 1 else (message.height, message.width)
            return flat.reshape(shape)
    raise ValueError(f"encoding {message.encoding!r}; allowed: {', '.join(_ENCODING.values())}")


def camera_info_to_msg(camera: CameraModel, header: Header) -> CameraInfo:
    """Pinhole intrinsics, no distortion, no rectification."""
    fx, fy, cx, cy = camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px
    info = CameraInfo(header=header, height=camera.height_px, width=camera.width_px, distortion_model="plumb_bob")
    info.D = [0.0] * 5
    info.K = [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]
    info.R = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    info.P = [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]
    return info


def label_info_to_msg(names: Dict[int, Sequence[str]], evaluated: Sequence[str], header: Header) -> LabelInfo:
    """names: label id -> class name of what the image shows, then its aliases; evaluated: every class of the world."""
    labels = [LabelClass(label, name, 1.0) for label in sorted(names) for name in names[label]]
    return LabelInfo(header, labels, list(evaluated))


def label_info_from_msg(message: LabelInfo) -> Tuple[Dict[int, Tuple[str, ...]], Tuple[str, ...]]:
    """The inverse of label_info_to_msg; scores are dropped."""
    names: Dict[int, Tuple[str, ...]] = {}
    for label in message.labels:
        names[label.id] = (*names.get(label.id, ()), label.class_name)
    return names, tuple(message.classes_evaluated)


def odometry_to_msg(state: RobotState, header: Header, child_frame_id: str) -> Odometry:
    """Pose header.frame_id -> child, twist expressed in the child frame. The covariance is zero: it is the truth."""
    message = Odometry(header=header, child_frame_id=child_frame_id)
    pose, twist = message.pose.pose, message.twist.twist
    pose.position.x, pose.position.y, pose.position.z = map(float, state.p_world_base)
    pose.orientation = Quaternion(*map(float, state.q_world_base))
    twist.linear, twist.angular = Vector3(*map(float, state.v_base)), Vector3(*map(float, state.w_base))
    return message


def transform_to_msg(
    p_m: Sequence[float], q_xyzw: Sequence[float], header: Header, child_frame_id: str
) -> TransformStamped:
    """Pose of child in header.frame_id."""
    message = TransformStamped(header=header, child_frame_id=child_frame_id)
    message.transform.translation = Vector3(*map(float, p_m))
    message.transform.rotation = Quaternion(*map(float, q_xyzw))
    return message


def joint_state_to_msg(state: RobotState, header: Header) -> JointState:
    """Angles [rad] and speeds [rad/s]; effort stays empty."""
    positions, velocities = state.joint_positions_rad.tolist(), state.joint_velocities_radps.tolist()
    return JointState(header, list(state.joint_names), positions, velocities, [])


def foot_contacts_to_msg(state: RobotState) -> UInt8MultiArray:
    """1 where a foot touches something, legs in the order FR, FL, RR, RL."""
    count = len(state.foot_contacts)
    message = UInt8MultiArray(data=bytes(int(contact) for contact in state.foot_contacts))
    message.layout.dim = [MultiArrayDimension("FR,FL,RR,RL", count, count)]
    return message


def violation_to_msg(truth: GroundTruthState, fallen: bool, header: Header) -> Violation:
    """Field by field."""
    return Violation(
        header, truth.inside, truth.base_inside, truth.clearance_m, truth.region, truth.reason,
        truth.obstacle_clearance_m, fallen,
    )  # fmt: skip


def violation_from_msg(message: Violation) -> Tuple[GroundTruthState, bool]:
    """The inverse of violation_to_msg."""
    truth = GroundTruthState(
        message.inside, message.base_inside, message.clearance_m, message.region, message.reason,
        message.obstacle_clearance_m,
    )  # fmt: skip
    return truth, message.fallen


def tick_to_msg(tick: int, stamp_ns: int, period_ns: int, frame_stamp_ns: int) -> Tick:
    """One control period of a lock-step run."""
    return Tick(header_to_msg(stamp_ns, ""), tick, period_ns * 1e-9, stamp_to_msg(frame_stamp_ns))


def command_from_msg(message: Twist) -> Tuple[float, float, float]:
    """Planar part of a twist: vx, vy [m/s], yaw rate [rad/s]."""
    return (message.linear.x, message.linear.y, message.angular.z)


def command_to_msg(command: Sequence[float]) -> Twist:
    """The inverse of command_from_msg; the rest is zero."""
    message = Twist()
    message.linear.x, message.linear.y, message.angular.z = map(float, command)
    return message

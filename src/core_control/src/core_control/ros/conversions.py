# SPDX-License-Identifier: BSD-3-Clause
"""The only bridge between messages and the types of the library."""

from __future__ import annotations

import math
from typing import Tuple

import numpy as np
from core_msgs.msg import FilterState, SafetyGrid, UnsafeCause
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry, Path

from core_control.types import NO_CELL, Cause, FilterInputs, FilterResult, SafetyGridData


def twist_from_msg(message: Twist) -> np.ndarray:
    """(3,) vx, vy [m/s], yaw rate [rad/s]; all NaN when any of the six entries is not finite."""
    six = (
        *(message.linear.x, message.linear.y, message.linear.z),
        *(message.angular.x, message.angular.y, message.angular.z),
    )
    if not all(math.isfinite(value) for value in six):
        return np.full(3, math.nan)
    return np.array([message.linear.x, message.linear.y, message.angular.z], dtype=float)


def is_planar(message: Twist) -> bool:
    """Whether the command asks for no motion outside the plane."""
    return message.linear.z == 0.0 and message.angular.x == 0.0 and message.angular.y == 0.0


def twist_to_msg(u: np.ndarray) -> Twist:
    """Twist of a command (3,) [m/s, m/s, rad/s]."""
    message = Twist()
    message.linear.x, message.linear.y, message.angular.z = (float(value) for value in u)
    return message


def odometry_from_msg(message: Odometry) -> Tuple[np.ndarray, np.ndarray]:
    """Pose (3,) x, y [m], yaw [rad] of the child frame and twist (3,) expressed in it.

    A quaternion of length zero has no direction: the yaw is NaN then. Roll and pitch are dropped.
    """
    q, p = message.pose.pose.orientation, message.pose.pose.position
    norm2 = q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w
    yaw_rad = math.nan
    if math.isfinite(norm2) and norm2 > 1e-6:
        yaw_rad = math.atan2(2.0 * (q.w * q.z + q.x * q.y), norm2 - 2.0 * (q.y * q.y + q.z * q.z))
    twist = message.twist.twist
    return np.array([p.x, p.y, yaw_rad]), np.array([twist.linear.x, twist.linear.y, twist.angular.z])


def odometry_to_msg(pose: np.ndarray, twist: np.ndarray, frame_id: str = "odom") -> Odometry:
    """Odometry of a pose (3,) and a body twist (3,) in the plane; the stamp is left at zero."""
    message = Odometry()
    message.header.frame_id, message.child_frame_id = frame_id, "base_link"
    message.pose.pose.position.x, message.pose.pose.position.y = float(pose[0]), float(pose[1])
    message.pose.pose.orientation.z = math.sin(0.5 * pose[2])
    message.pose.pose.orientation.w = math.cos(0.5 * pose[2])
    message.twist.twist = twist_to_msg(twist)
    return message


def grid_from_msg(message: SafetyGrid) -> SafetyGridData:
    """The grid with its arrays as (ny, nx); takes plain messages and those of rospy.numpy_msg.

    Raises:
        ValueError: the length of an array is not width * height; speed_cap_mps may also be empty.
    """
    shape = (int(message.height), int(message.width))

    def to_array(name: str, dtype) -> np.ndarray:
        value = getattr(message, name)
        array = np.frombuffer(value, dtype=np.uint8) if isinstance(value, bytes) else np.asarray(value)
        if array.size != shape[0] * shape[1]:
            raise ValueError(f"{name} has {array.size} entries, grid is {shape[1]} x {shape[0]}")
        return array.astype(dtype, copy=False).reshape(shape)

    return SafetyGridData(
        frame_id=message.header.frame_id,
        stamp_s=message.header.stamp.to_sec(),
        constraints_stamp_s=message.constraints_stamp.to_sec(),
        history_start_s=message.history_start.to_sec(),
        resolution_m=float(message.resolution_m),
        origin_m=np.array([message.origin_x_m, message.origin_y_m], dtype=float),
        state=to_array("state", np.uint8),
        unknown_is_unsafe=bool(message.unknown_is_unsafe),
        h_m=to_array("h_m", np.float64),
        cause=to_array("cause", np.uint16),
        causes=tuple(_cause_from_msg(cause) for cause in message.causes),
        speed_cap_mps=to_array("speed_cap_mps", np.float64) if len(message.speed_cap_mps) else None,
    )


def _cause_from_msg(message: UnsafeCause) -> Cause:
    return Cause(message.rule, message.class_name, int(message.instance_id), message.motion == UnsafeCause.MOBILE)


def path_from_msg(message: Path) -> list:
    """Positions [(x, y), ...] [m] of a path, in its frame."""
    return [(pose.pose.position.x, pose.pose.position.y) for pose in message.poses]


def state_to_msg(result: FilterResult, inputs: FilterInputs, stamp, tick: int) -> FilterState:
    """FilterState of one tick; stamp is a genpy.Time."""
    message = FilterState()
    message.header.stamp = stamp
    message.header.frame_id = inputs.field.grid.frame_id if inputs.field is not None else inputs.odometry_frame_id
    message.tick = tick
    message.mode, message.reason, message.detail = int(result.mode), result.reason, result.detail
    message.u_nominal = [float(value) for value in result.u_nominal]
    message.u_safe = [float(value) for value in result.u_safe]
    message.h_m = float(result.h_m)
    message.gradient = [float(value) for value in result.gradient]
    if result.binding is not None:
        message.binding_rule = result.binding.cause.rule
        message.binding_class = result.binding.cause.class_name
        message.binding_instance = result.binding.cause.instance_id
        message.binding_point.x, message.binding_point.y = result.binding.point_m
    message.binding_cell = NO_CELL if result.binding is None else result.binding.cell
    message.scale, message.blocked_s, message.latched = result.scale, result.blocked_s, result.latched
    message.nominal_age_s, message.odometry_age_s = inputs.nominal_age_s, inputs.odometry_age_s
    message.grid_age_s, message.constraints_age_s = inputs.grid_age_s, inputs.constraints_age_s
    message.speed_cap_mps, message.speed_cap_reason = float(result.speed_cap_mps), result.speed_cap_reason
    message.solve_time_s, message.rows = result.solve_time_s, result.rows
    return message

# SPDX-License-Identifier: BSD-3-Clause
"""Messages of the chain as the plain samples a trial is judged by."""

from __future__ import annotations

import numpy as np

from core_bringup.evaluation.grid_history import GridSnapshot
from core_bringup.evaluation.records import MODE_NAMES, FilterSample, OdometrySample, TruthSample


def odometry_from_msg(msg) -> OdometrySample:
    """nav_msgs/Odometry: pose in its frame, twist in the child frame."""
    p, q, t = msg.pose.pose.position, msg.pose.pose.orientation, msg.twist.twist
    return OdometrySample(
        msg.header.stamp.to_nsec(),
        (p.x, p.y, p.z),
        (q.x, q.y, q.z, q.w),
        (t.linear.x, t.linear.y, t.linear.z),
        (t.angular.x, t.angular.y, t.angular.z),
    )


def filter_from_msg(msg) -> FilterSample:
    """core_msgs/FilterState."""
    return FilterSample(
        stamp_ns=msg.header.stamp.to_nsec(),
        tick=msg.tick,
        mode=MODE_NAMES[msg.mode],
        u_nominal=tuple(float(u) for u in msg.u_nominal),
        u_safe=tuple(float(u) for u in msg.u_safe),
        h_m=msg.h_m,
        reason=msg.reason,
        binding_rule=msg.binding_rule,
        binding_class=msg.binding_class,
        constraints_age_s=msg.constraints_age_s,
        grid_age_s=msg.grid_age_s,
        solve_time_s=msg.solve_time_s,
        binding_point_m=(msg.binding_point.x, msg.binding_point.y),
    )


def truth_from_msg(msg) -> TruthSample:
    """core_msgs/Violation."""
    return TruthSample(
        stamp_ns=msg.header.stamp.to_nsec(),
        inside=bool(msg.inside),
        base_inside=bool(msg.base_inside),
        clearance_m=msg.clearance_m,
        obstacle_clearance_m=msg.obstacle_clearance_m,
        fallen=bool(msg.fallen),
        region=msg.region,
    )


def grid_from_msg(msg) -> GridSnapshot:
    """core_msgs/SafetyGrid, best received through rospy.numpy_msg, which gives arrays instead of tuples."""
    shape = (msg.height, msg.width)
    state = (
        np.frombuffer(msg.state, dtype=np.uint8)
        if isinstance(msg.state, bytes)
        else np.asarray(msg.state, dtype=np.uint8)
    )
    return GridSnapshot(
        stamp_ns=msg.header.stamp.to_nsec(),
        resolution_m=msg.resolution_m,
        origin_m=(msg.origin_x_m, msg.origin_y_m),
        n_safe=np.asarray(msg.n_safe).reshape(shape),
        n_unsafe=np.asarray(msg.n_unsafe).reshape(shape),
        h_m=np.asarray(msg.h_m).reshape(shape),
        state=state.reshape(shape),
        cause=np.asarray(msg.cause).reshape(shape),
        rules=tuple(cause.rule for cause in msg.causes),
        classes=tuple(cause.class_name for cause in msg.causes),
        unknown_is_unsafe=bool(msg.unknown_is_unsafe),
    )

# SPDX-License-Identifier: BSD-3-Clause
"""Node safety_overlay: camera image and safety grid -> ``safety/overlay``, for people; nothing depends on it."""

from __future__ import annotations

import threading

import rospy
import tf2_ros
from core_msgs.msg import SafetyConstraints, SafetyGrid
from sensor_msgs.msg import CameraInfo, Image

from core_perception.exceptions import EvidenceError, PerceptionError
from core_perception.overlay import OverlayStyle, draw_overlay
from core_perception.params import OverlayParams
from core_perception.ros import conversions
from core_perception.ros.node import run_node
from core_perception.stamped_join import StampedJoin

IMAGE_BUFFER_BYTES = 2**24
CAPACITY = 30  # a segmenter may need a second for what the grid is made of
TOPICS = {
    "color": ("camera/color/image_raw", Image),
    "depth": ("camera/depth/image_raw", Image),
    "grid": ("safety_grid", SafetyGrid),
}


class SafetyOverlayNode:
    """Draws frames whose colour, depth and grid belong together, at most at rate_hz, and only while someone looks."""

    def __init__(self, params: OverlayParams):
        """Connect the topics."""
        self._period_ns, self._tf_timeout = round(1e9 / params.rate_hz), rospy.Duration(params.tf_timeout_s)
        self._style = OverlayStyle(
            params.scale, params.opacity, params.floor_z_m, params.obstacle_height_m, params.max_range_m
        )
        self._lock = threading.Lock()
        self._join = StampedJoin(*TOPICS, capacity=CAPACITY, slop_ns=round(params.slop_s * 1e9))
        self._predicates, self._last_ns, self._camera_info = (), None, None
        self._tf_buffer = tf2_ros.Buffer()
        self._tf_listener = tf2_ros.TransformListener(self._tf_buffer)
        self._publisher = rospy.Publisher("safety/overlay", Image, queue_size=1)
        for stream, (topic, message_type) in TOPICS.items():
            rospy.Subscriber(topic, message_type, self._on_message, stream, queue_size=20, buff_size=IMAGE_BUFFER_BYTES)
        rospy.Subscriber("camera/color/camera_info", CameraInfo, self._on_camera_info, queue_size=1)
        rospy.Subscriber("safety/constraints", SafetyConstraints, self._on_constraints, queue_size=1)

    def _on_constraints(self, msg):
        try:
            self._predicates = conversions.constraints_from_msg(msg).predicates
        except PerceptionError as error:
            rospy.logwarn_throttle(10.0, f"constraints not drawn: {error}")

    def _on_camera_info(self, msg):
        self._camera_info = conversions.camera_info_from_msg(msg)

    def _on_message(self, msg, stream):
        stamp_ns = conversions.stamp_to_ns(msg.header.stamp)
        with self._lock:
            frame = self._join.add(stream, stamp_ns, msg)
            is_wanted = self._publisher.get_num_connections() > 0 and self._due(stamp_ns)
            if frame is None or self._camera_info is None or not is_wanted:
                return
            self._last_ns = stamp_ns
        try:
            self._draw(frame)
        except (PerceptionError, tf2_ros.TransformException) as error:
            rospy.logwarn_throttle(10.0, f"frame not drawn: {error}")

    def _due(self, stamp_ns):
        return self._last_ns is None or stamp_ns < self._last_ns or stamp_ns - self._last_ns >= self._period_ns

    def _draw(self, frame):
        color, header = frame["color"], frame["color"].header
        pose = self._tf_buffer.lookup_transform(
            frame["grid"].header.frame_id, header.frame_id, header.stamp, self._tf_timeout
        )
        depth_m, info = conversions.depth_to_m(frame["depth"]), self._camera_info
        if not info.is_usable:
            raise EvidenceError("camera_info: got no size or focal length")
        picture = draw_overlay(
            conversions.color_to_rgb(color),
            depth_m,
            info.matrix_at(depth_m.shape[1], depth_m.shape[0]),
            conversions.transform_to_matrix(pose.transform),
            conversions.grid_view(frame["grid"]),
            self._predicates,
            self._style,
        )
        self._publisher.publish(conversions.array_to_image(picture, "rgb8", header))


def main() -> int:
    """Run the node; return the exit status."""
    return run_node("safety_overlay", OverlayParams, SafetyOverlayNode)

# SPDX-License-Identifier: BSD-3-Clause
"""trial.bag: what was received during a trial, thinned and bounded, written once at its end."""

from __future__ import annotations

import math
import threading
from pathlib import Path
from typing import Dict, List, Tuple

import numpy as np
import rosbag
import rospy
from core_msgs.msg import FilterState, InstanceArray, SafetyConstraints, SafetyGrid, Violation
from nav_msgs.msg import OccupancyGrid, Odometry
from sensor_msgs.msg import CameraInfo, Image, JointState
from tf2_msgs.msg import TFMessage

from core_bringup.camera_mount import CameraMount
from core_bringup.ros import conversions as to
from core_bringup.rotations import quaternion_of_rpy
from core_perception.ros.conversions import depth_to_m

OPTICAL_RPY_RAD = (-0.5 * math.pi, 0.0, -0.5 * math.pi)  # of the optical frame in camera_link
FRAME_PERIOD_NS = 1_000_000_000  # between two frames that are kept, until there are MAX_FRAMES
MAX_FRAMES = 40  # more: every second one is dropped and the period doubles
MAP_PERIOD_NS = 500_000_000
MAX_STATES = 20_000  # messages of one topic; some 15 minutes at 20 Hz
# A frame is what was seen, and what the map made of it: all of one stamp, so that it can be drawn again.
FRAME_TOPICS = {
    "camera/color/image_raw": Image,
    "camera/color/camera_info": CameraInfo,
    "camera/depth/image_raw": Image,
    "safety_grid": SafetyGrid,
}
MAP_TOPICS = {"semantic_map/probability": OccupancyGrid, "semantic_map/instances": InstanceArray}
STATE_TOPICS = {
    "odom": Odometry,
    "joint_states": JointState,
    "cbf_filter/state": FilterState,
    "ground_truth/violation": Violation,
    "safety/constraints": SafetyConstraints,
}
LATCHED = ("tf_static", "safety/constraints", "semantic_map/probability")


class TrialBag:
    """Collects messages as references and writes them as a bag.

    Kept are every state of the robot, the filter and the truth, the map twice a second of sim time, and a frame
    (colour, depth in whole millimetres, camera_info, safety_grid) once a second; a run of more than MAX_FRAMES seconds
    has fewer frames a second, never more in all. tf is written from the odometry and the camera's mount.
    """

    def __init__(self, mount: CameraMount):
        """Start empty; nothing is subscribed before subscribe()."""
        self._mount = mount
        self._lock = threading.Lock()
        self._states: Dict[str, List[object]] = {topic: [] for topic in STATE_TOPICS}
        self._maps: Dict[str, Dict[int, object]] = {topic: {} for topic in MAP_TOPICS}
        self._frames: Dict[int, Dict[str, object]] = {}
        self._period_ns = FRAME_PERIOD_NS
        self._subscribers: List[rospy.Subscriber] = []

    def subscribe(self) -> None:
        """Listen to every topic."""
        for topic, kind in {**STATE_TOPICS, **MAP_TOPICS, **FRAME_TOPICS}.items():
            self._subscribers.append(
                rospy.Subscriber(topic, kind, self._on_message, topic, queue_size=None, buff_size=2**22)
            )

    def stop(self) -> None:
        """Listen no more: what comes after the end of the trial is none of it."""
        for subscriber in self._subscribers:
            subscriber.unregister()

    def _on_message(self, msg, topic: str) -> None:
        self.add(topic, msg)

    def add(self, topic: str, msg) -> None:
        """Keep a message or drop it; of one period the first message of every topic is kept."""
        stamp_ns = to.stamp_from_msg(msg.header.stamp)
        with self._lock:
            if topic in self._states:
                if len(self._states[topic]) < MAX_STATES:
                    self._states[topic].append(msg)
            elif topic in self._maps:
                self._maps[topic].setdefault(stamp_ns // MAP_PERIOD_NS, msg)
            else:
                self._add_to_frame(topic, stamp_ns, msg)

    def _add_to_frame(self, topic: str, stamp_ns: int, msg) -> None:
        self._frames.setdefault(stamp_ns // self._period_ns, {}).setdefault(topic, msg)
        if len(self._frames) > MAX_FRAMES:
            self._period_ns *= 2
            kept: Dict[int, Dict[str, object]] = {}
            for slot in sorted(self._frames):
                kept.setdefault(slot // 2, self._frames[slot])
            self._frames = kept

    def write(self, path: Path) -> None:
        """Write what was kept, in the order of the stamps, which are also the times of the bag.

        Raises:
            ValueError: nothing was received.
            OSError: the file cannot be written.
        """
        with self._lock:
            entries = self._entries()
        if not entries:
            raise ValueError("no message was received for the bag")
        with rosbag.Bag(str(path), "w", compression="lz4") as bag:
            for stamp_ns, topic, msg in sorted(entries, key=lambda entry: entry[0]):
                header = _latched_header(topic, msg) if topic in LATCHED else None
                bag.write(f"/{topic}", msg, to.stamp_to_msg(stamp_ns), connection_header=header)

    def _entries(self) -> List[Tuple[int, str, object]]:
        kept = [(topic, msg) for topic, messages in self._states.items() for msg in messages]
        kept += [(topic, msg) for topic, messages in self._maps.items() for msg in messages.values()]
        for frame in self._frames.values():
            kept += [(t, depth_in_millimetres(m) if t.startswith("camera/depth") else m) for t, m in frame.items()]
        entries = [(to.stamp_from_msg(msg.header.stamp), topic, msg) for topic, msg in kept]
        odometry = self._states["odom"]
        entries += [(to.stamp_from_msg(msg.header.stamp), "tf", odometry_to_tf(msg)) for msg in odometry]
        # A stamp of zero is "none".
        entries = [entry for entry in entries if entry[0] > 0]
        if odometry and entries:
            first_ns = min(stamp_ns for stamp_ns, _, _ in entries)
            entries.insert(0, (first_ns, "tf_static", mount_to_tf(self._mount, odometry[0].child_frame_id)))
        return entries


def depth_in_millimetres(msg: Image) -> Image:
    """Depth image as 16UC1 in whole millimetres, 0 where there is none: half the bytes of 32FC1."""
    depth_m = depth_to_m(msg)
    valid = np.isfinite(depth_m) & (depth_m > 0.0) & (depth_m < 65.0)
    depth_mm = np.where(valid, np.round(1000.0 * np.where(valid, depth_m, 0.0)), 0.0).astype("<u2")
    return Image(msg.header, msg.height, msg.width, "16UC1", 0, 2 * msg.width, depth_mm.tobytes())


def odometry_to_tf(msg: Odometry) -> TFMessage:
    """The pose of an odometry message as a transform."""
    p, q = msg.pose.pose.position, msg.pose.pose.orientation
    return TFMessage([to.transform_to_msg((p.x, p.y, p.z), (q.x, q.y, q.z, q.w), msg.header, msg.child_frame_id)])


def mount_to_tf(mount: CameraMount, base_frame: str) -> TFMessage:
    """base_link -> camera_link -> optical frame; a prefix of base_frame goes before every name."""
    prefix = base_frame[: -len("base_link")] if base_frame.endswith("base_link") else ""
    link, optical = prefix + "camera_link", prefix + "camera_color_optical_frame"
    link_q = quaternion_of_rpy(mount.roll_rad, mount.pitch_rad, mount.yaw_rad)
    place_m = (mount.x_m, mount.y_m, mount.z_m)
    base = to.transform_to_msg(place_m, link_q, to.header_to_msg(0, base_frame), link)
    turn = to.transform_to_msg((0.0, 0.0, 0.0), quaternion_of_rpy(*OPTICAL_RPY_RAD), to.header_to_msg(0, link), optical)
    return TFMessage([base, turn])


def _latched_header(topic: str, msg) -> Dict[str, str]:
    """What rosbag play needs to latch a topic again."""
    return {
        "topic": f"/{topic}",
        "type": msg._type,
        "md5sum": msg._md5sum,
        "message_definition": msg._full_text,
        "callerid": "/trial_monitor",
        "latching": "1",
    }

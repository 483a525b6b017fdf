# SPDX-License-Identifier: BSD-3-Clause
"""Plays recorded frames to a semantic map through topics, and hears when its grids come."""

from __future__ import annotations

import logging
import os
import threading
import time
import warnings
from typing import Callable, Dict, List, Optional

import numpy as np
import rosgraph
import rospy
import tf2_msgs.msg
from core_msgs.msg import LabelInfo, SafetyConstraints, SafetyGrid
from rospy.msg import AnyMsg
from sensor_msgs.msg import CameraInfo, Image

from core_bringup.evaluation.frame_recording import RecordingHeader
from core_bringup.evaluation.launcher import RoslaunchProcess
from core_bringup.exceptions import BringupError
from core_bringup.ros.connections import find_unserved
from core_bringup.ros.conversions import (
    camera_info_to_msg,
    header_to_msg,
    image_to_msg,
    label_info_to_msg,
    transform_to_msg,
)
from core_bringup.rotations import quaternion_of_matrix
from core_perception.predicates import Constraints
from core_perception.ros.conversions import constraints_to_msg

CAMERA_FRAME, BASE_FRAME, MAP_FRAME = "camera_color_optical_frame", "base_link", "odom"
_BUFFER_BYTES = 1 << 21
_MASTER_DEADLINE_S = 30.0


def join_graph(graph: RoslaunchProcess, name: str) -> None:
    """Make this process a node of a graph that was just started; a process can do so once.

    Raises:
        BringupError: the graph ended, or has no master yet after half a minute.
    """
    os.environ["ROS_MASTER_URI"] = graph.master_uri
    end_s = time.monotonic() + _MASTER_DEADLINE_S
    while not rosgraph.is_master_online(graph.master_uri):
        if graph.exit_code is not None or time.monotonic() > end_s:
            raise BringupError("the graph did not start")
        time.sleep(0.1)
    rospy.init_node(name, anonymous=True, disable_signals=True)
    logging.getLogger("rosout").setLevel(logging.ERROR)


class RecordingPlayer:
    """Publishes what the rest of the chain would, in one namespace, and keeps the instant each grid came.

    Sends are synchronous: when send() returns the bytes are with the operating system.

    Args:
        namespace: of the map, such as "/map"; its tf too, so the node's /tf must be remapped to it.
        images_only: no tf, camera_info, label_info and constraints: the listener wants images alone.
    """

    def __init__(self, namespace: str, images_only: bool = False):
        self._images_only = images_only
        self._arrived_s: Dict[int, float] = {}
        self._newest: Optional[AnyMsg] = None
        self._changed = threading.Condition()
        self._depth = _advertise(f"{namespace}/camera/depth/image_raw", Image)
        self._labels = _advertise(f"{namespace}/segmentation/labels", Image)
        self._publishers: List[rospy.Publisher] = [self._depth, self._labels]
        if not images_only:
            self._tf = _advertise(f"{namespace}/tf", tf2_msgs.msg.TFMessage)
            self._camera_info = _advertise(f"{namespace}/camera/color/camera_info", CameraInfo)
            self._label_info = _advertise(f"{namespace}/segmentation/label_info", LabelInfo)
            self._constraints = _advertise(f"{namespace}/safety/constraints", SafetyConstraints)
            self._publishers += [self._tf, self._camera_info, self._label_info, self._constraints]
        # Not decoded: that would take longer than what is measured.
        self._grids = rospy.Subscriber(
            f"{namespace}/safety_grid", AnyMsg, self._on_grid, buff_size=_BUFFER_BYTES, tcp_nodelay=True
        )

    def wait_connected(self, deadline_s: float) -> None:
        """Wait until every topic has its other end.

        Raises:
            BringupError: not all of them before the deadline [s from now].
        """
        end_s = time.monotonic() + deadline_s
        while not all(p.get_num_connections() for p in self._publishers) or find_unserved([self._grids.name]):
            if time.monotonic() > end_s:
                raise BringupError(f"{self._grids.name}: not connected within {deadline_s:g} s")
            time.sleep(0.02)

    def prepare(self, header: RecordingHeader, frame: np.void, stamp_ns: int) -> Callable[[], float]:
        """Messages of a recorded frame at another stamp.

        Args:
            header: of its recording.
            frame: one of FrameRecording.frames, its pose changed or not.
            stamp_ns: stamp of all messages [ns].

        Returns:
            A function that sends them, the images last, and returns time.monotonic() right before the images [s].
        """
        on_camera = header_to_msg(stamp_ns, CAMERA_FRAME)
        depth = image_to_msg(np.asarray(frame["depth_mm"]), on_camera)
        labels = image_to_msg(np.asarray(frame["labels"]), on_camera)
        others = [] if self._images_only else self._prepare_others(header, frame, stamp_ns)

        def send() -> float:
            for publisher, message in others:
                publisher.publish(message)
            start_s = time.monotonic()
            self._depth.publish(depth)
            self._labels.publish(labels)
            return start_s

        return send

    def _prepare_others(self, header: RecordingHeader, frame: np.void, stamp_ns: int) -> list:
        on_map, on_camera = header_to_msg(stamp_ns, MAP_FRAME), header_to_msg(stamp_ns, CAMERA_FRAME)
        T_map_camera = np.asarray(frame["T_map_camera"])
        q_map_camera = quaternion_of_matrix(T_map_camera[:3, :3])
        transforms = [
            transform_to_msg((*frame["p_map_base"], 0.0), (0.0, 0.0, 0.0, 1.0), on_map, BASE_FRAME),
            transform_to_msg(T_map_camera[:3, 3], q_map_camera, on_map, CAMERA_FRAME),
        ]
        names = {label: (name,) for label, name in header.classes.items()}
        stated = Constraints(header.predicates, image_stamp_ns=stamp_ns, source="recording")
        return [
            (self._tf, tf2_msgs.msg.TFMessage(transforms)),
            (self._constraints, constraints_to_msg(stated, stamp_ns)),
            (self._camera_info, camera_info_to_msg(header.camera, on_camera)),
            (self._label_info, label_info_to_msg(names, sorted(set(header.classes.values())), on_camera)),
        ]

    def _on_grid(self, message: AnyMsg) -> None:
        now_s = time.monotonic()
        _seq, secs, nsecs = np.frombuffer(message._buff, "<u4", 3)
        with self._changed:
            self._arrived_s[int(secs) * 10**9 + int(nsecs)] = now_s
            self._newest = message
            self._changed.notify_all()

    def arrival_s(self, stamp_ns: int, deadline_s: float = 0.0) -> Optional[float]:
        """time.monotonic() when the grid of a stamp came [s], after waiting for it for so long [s]; else None."""
        with self._changed:
            self._changed.wait_for(lambda: stamp_ns in self._arrived_s, deadline_s)
            return self._arrived_s.get(stamp_ns)

    def newest_grid(self) -> Optional[SafetyGrid]:
        """The grid that came last, its arrays as numpy arrays; None before the first."""
        with self._changed:
            newest = self._newest
        return newest and SafetyGrid().deserialize_numpy(newest._buff, np)


def _advertise(topic: str, kind: type) -> rospy.Publisher:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # rospy recommends queues; none: publish() itself sends
        return rospy.Publisher(topic, kind, queue_size=None, tcp_nodelay=True)

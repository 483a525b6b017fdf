# SPDX-License-Identifier: BSD-3-Clause
"""Node self_check: the first frames of a camera -> plain sentences in the log and on ``diagnostics``."""

from __future__ import annotations

import threading
import time
from typing import List, Optional

import numpy as np
import rospy
import tf2_ros
from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import CameraInfo, Image

from core_perception.checks.base import CheckFrame, Level, Outcome, PoseLookups, Stream
from core_perception.depth_params import SelfCheckParams
from core_perception.exceptions import EvidenceError
from core_perception.ros import conversions
from core_perception.ros.diagnostics import Diagnostics, make_status
from core_perception.ros.node import run_node
from core_perception.self_check import Report, Sample, check

IMAGE_BUFFER_BYTES = 2**25
TOPICS = {
    "depth": "camera/depth/image_raw",
    "color": "camera/color/image_raw",
    "labels": "segmentation/labels",
}
CHECK = "self-check"
INFO_TOPIC = "camera/color/camera_info"
KEPT_FACTOR = 3  # of colour images and labels for each depth image, which may come at other rates
POLL_PERIOD_S = 0.05
TF_CACHE_S = 60.0
NEAR_S = 0.1  # farther apart, two images show different instants
DIAGNOSTIC_LEVELS = {
    Level.NOTE: DiagnosticStatus.OK,
    Level.WARNING: DiagnosticStatus.WARN,
    Level.ERROR: DiagnosticStatus.ERROR,
}


class Collector:
    """Messages of one look and when they came."""

    def __init__(self, frames: int):
        """Connect the topics; ``is_full`` after this many depth images."""
        self._frames = frames
        self._lock = threading.Lock()
        self._messages = {name: [] for name in TOPICS}  # (message, received_s)
        self._info: Optional[CameraInfo] = None
        kinds = {"queue_size": 30, "buff_size": IMAGE_BUFFER_BYTES, "tcp_nodelay": True}
        self._subscribers = [rospy.Subscriber(t, Image, self._on_image, name, **kinds) for name, t in TOPICS.items()]
        self._subscribers.append(rospy.Subscriber(INFO_TOPIC, CameraInfo, self._on_info, queue_size=1))

    def _on_image(self, msg, name):
        received_s = rospy.Time.now().to_sec()
        with self._lock:
            kept = self._messages[name]
            if len(kept) < self._frames * (1 if name == "depth" else KEPT_FACTOR):
                kept.append((msg, received_s))

    def _on_info(self, msg):
        with self._lock:
            self._info = msg

    @property
    def is_full(self) -> bool:
        """Enough depth images came."""
        with self._lock:
            return len(self._messages["depth"]) >= self._frames

    def close(self):
        """Disconnect the topics; return the messages by name, and camera_info or None."""
        for subscriber in self._subscribers:
            subscriber.unregister()
        with self._lock:
            return self._messages, self._info


class SelfCheckNode:
    """Looks once, or again and again; tells the last result until it ends."""

    def __init__(self, params: SelfCheckParams):
        """Connect the topics and start to look."""
        self._params = params
        self.exit_status = 0
        self._report: Optional[Report] = None
        self._tf_buffer = tf2_ros.Buffer(rospy.Duration(TF_CACHE_S))
        self._tf_listener = tf2_ros.TransformListener(self._tf_buffer)
        self._diagnostics = Diagnostics(self._tell)
        self._diagnostics.start()
        threading.Thread(target=self._work, daemon=True).start()

    def _work(self):
        while not rospy.is_shutdown():
            collector = Collector(self._params.frames)
            end_s = time.monotonic() + self._params.timeout_s
            while not collector.is_full and time.monotonic() < end_s and not rospy.is_shutdown():
                time.sleep(POLL_PERIOD_S)
            messages, info = collector.close()
            if rospy.is_shutdown():
                return
            self._report = check(self._make_sample(messages, info), self._params.limits)
            log_report(self._report)
            self.exit_status = 0 if self._report.is_healthy else 1
            if self._params.exit_when_done:
                self._diagnostics.publish()
                rospy.signal_shutdown("the self-check is done")
            if self._params.repeat_s == 0.0:
                return
            time.sleep(self._params.repeat_s)

    def _make_sample(self, messages, info) -> Sample:
        streams = {name: make_stream(rospy.resolve_name(topic), messages[name]) for name, topic in TOPICS.items()}
        frames, unreadable, lookups = [], {}, None
        depth = [msg for msg, _ in messages["depth"]]
        if depth:
            poses, lookups = self._look_up(depth)
            chosen = np.unique(np.linspace(0, len(depth) - 1, min(self._params.images, len(depth))).round().astype(int))
            frames = [self._make_frame(depth[k], messages, poses[k], unreadable) for k in chosen]
        frames = [frame for frame in frames if frame is not None]
        kinds = [(frame.depth.shape, frame.depth.dtype) for frame in frames]
        frames = [frame for frame, kind in zip(frames, kinds) if kind == kinds[0]]
        color = messages["color"][-1][0] if messages["color"] else None
        topics = [topic for topic, kind in rospy.get_published_topics() if kind == "sensor_msgs/Image"]
        return Sample(
            frames,
            None if info is None else conversions.camera_info_from_msg(info),
            streams["depth"],
            streams["color"],
            lookups,
            None if color is None else (color.width, color.height),
            tuple(sorted(topics)),
            tuple(sorted(unreadable.items())),
        )

    def _look_up(self, depth):
        """Poses of the camera at the stamps of all images, None where tf has none."""
        timeout = rospy.Duration(self._params.tf_timeout_s)
        poses, reason = [], ""
        for msg in depth:
            pose = self._find_pose(msg.header, timeout)
            if isinstance(pose, str):
                pose, reason = None, pose
                timeout = rospy.Duration(0)  # waiting for each would take minutes where tf is missing
            poses.append(pose)
        failed = sum(1 for pose in poses if pose is None)
        return poses, PoseLookups(self._params.map_frame, depth[-1].header.frame_id, len(poses), failed, reason)

    def _find_pose(self, header, timeout):
        """(4, 4) pose of the camera at a stamp, or tf's words why there is none."""
        map_frame = self._params.map_frame
        try:
            pose = self._tf_buffer.lookup_transform(map_frame, header.frame_id, header.stamp, timeout)
            return conversions.transform_to_matrix(pose.transform)
        except (tf2_ros.TransformException, EvidenceError) as error:
            return " ".join(str(error).split())

    def _make_frame(self, depth_msg, messages, pose, unreadable) -> Optional[CheckFrame]:
        depth = read_image(conversions.image_to_array, depth_msg, "depth", unreadable)
        if depth is None:
            return None
        if depth.dtype not in (np.uint16, np.float32):
            unreadable["depth"] = f"got encoding {depth_msg.encoding!r}, allowed 16UC1, mono16, 32FC1"
            return None
        stamp = depth_msg.header.stamp
        color_msg, labels_msg = (find_nearest(messages[name], stamp, NEAR_S) for name in ("color", "labels"))
        color = color_msg and read_image(conversions.color_to_rgb, color_msg, "colour", unreadable)
        labels = labels_msg and read_image(conversions.image_to_array, labels_msg, "labels", unreadable)
        return CheckFrame(depth, color, labels, pose)

    def _tell(self):
        if self._report is None:
            return [make_status(CHECK, DiagnosticStatus.OK, "waiting for images", {})]
        return make_statuses(self._report)


def read_image(read, msg, what, unreadable):
    """Pixels of an image, or None with the reason put into ``unreadable``."""
    try:
        return read(msg)
    except EvidenceError as error:
        unreadable[what] = str(error)
        return None


def find_nearest(messages, stamp, within_s):
    """Return the message nearest to a stamp, or None if none is near."""
    apart = [(abs((msg.header.stamp - stamp).to_sec()), k) for k, (msg, _) in enumerate(messages)]
    nearest_s, k = min(apart, default=(np.inf, 0))
    return messages[k][0] if nearest_s <= within_s else None


def make_stream(topic, messages) -> Stream:
    """When the messages of a topic were made and came."""
    stamps_s = [msg.header.stamp.to_sec() for msg, _ in messages]
    frame_id = messages[-1][0].header.frame_id if messages else ""
    return Stream(topic, frame_id, stamps_s, [received_s for _, received_s in messages])


def log_report(report: Report) -> None:
    """One line a finding, and one for the whole."""
    log = {Level.NOTE: rospy.loginfo, Level.WARNING: rospy.logwarn, Level.ERROR: rospy.logerr}
    for finding in report.findings:
        log[finding.level]("self_check: %s", finding.sentence)
    for outcome in report.outcomes:
        if outcome.measured:
            rospy.loginfo("self_check: %s: %s", outcome.check, outcome.measured)
        if outcome.unchecked:
            rospy.loginfo("self_check: %s not checked: %s", outcome.check, outcome.unchecked)
    (rospy.loginfo if report.is_healthy else rospy.logwarn)("self_check: %s", report.summary)


def make_statuses(report: Report) -> List[DiagnosticStatus]:
    """One status for the whole and one for each part."""
    worst = max((finding.level for finding in report.findings), default=Level.NOTE)
    whole = make_status(CHECK, DIAGNOSTIC_LEVELS[worst], report.summary, {})
    return [whole, *(describe_outcome(outcome) for outcome in report.outcomes)]


def describe_outcome(outcome: Outcome) -> DiagnosticStatus:
    """The sentences of one part, or what it measured, or why it could not look."""
    worst = max((finding.level for finding in outcome.findings), default=Level.NOTE)
    words = " ".join(finding.sentence for finding in outcome.findings)
    words = words or outcome.measured or f"not checked: {outcome.unchecked}"
    return make_status(f"{CHECK}: {outcome.check}", DIAGNOSTIC_LEVELS[worst], words, {})


def main() -> int:
    """Run the node; return 2 for bad parameters, 1 if it was to exit and something is wrong, otherwise 0."""
    nodes: List[SelfCheckNode] = []

    def start(params):
        nodes.append(SelfCheckNode(params))
        return nodes[0]

    status = run_node("self_check", SelfCheckParams, start)
    return status or (nodes[0].exit_status if nodes else 0)

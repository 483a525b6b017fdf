# SPDX-License-Identifier: BSD-3-Clause
"""Node segmenter: image and asked classes -> ``segmentation/labels``, ``segmentation/label_info``."""

from __future__ import annotations

import threading
import time

import rospy
from core_msgs.msg import LabelInfo, SafetyConstraints
from sensor_msgs.msg import Image

from core_perception.exceptions import EvidenceError, PerceptionError
from core_perception.newest_frame import NewestFrame
from core_perception.params import SegmenterParams
from core_perception.ros import conversions
from core_perception.ros.diagnostics import Diagnostics, make_status
from core_perception.ros.node import config_dir, run_node
from core_perception.ros.segmenter_conversions import segmenter_frame
from core_perception.ros.truth_topics import TRUTH_TOPICS
from core_perception.segmenters.base import IMAGE, LABEL_INFO, LABELS, check_segmentation
from core_perception.segmenters.factory import make_segmenter
from core_perception.segmenters.tally import Tally
from core_perception.stamped_join import StampedJoin

QUEUE_SIZE = 10
IMAGE_BUFFER_BYTES = 2**24
WARNING_PERIOD_S = 10.0
# How often sim time is looked at while an answer is held back [s], wall time.
POLL_PERIOD_S = 0.002
CONSTRAINTS = "constraints"
TOPICS = {
    IMAGE: "camera/color/image_raw",
    LABELS: "external_segmentation/labels",
    LABEL_INFO: "external_segmentation/label_info",
}
MESSAGES = {IMAGE: Image, LABELS: Image, LABEL_INFO: LabelInfo}


class SegmenterNode:
    """Answers every frame; asks for the base vocabulary and for the classes of the constraints in force."""

    def __init__(self, params: SegmenterParams):
        """Connect the topics.

        Raises:
            PerceptionError: a file is missing or wrong, or a server's address is not allowed.
        """
        parts = make_segmenter(params, config_dir(), rospy.get_name())
        self._segmenter = parts.segmenter
        self._base_vocabulary = parts.ontology.vocabulary
        self._lockstep = params.lockstep
        self._lock = threading.Lock()
        self._tally = Tally(self._segmenter.source)
        streams = sorted(self._segmenter.reads)
        self._join = StampedJoin(*streams, *([CONSTRAINTS] if params.lockstep else []))
        self._newest_constraints = None
        self._slot = NewestFrame()
        self._labels_publisher = rospy.Publisher(
            "segmentation/labels", Image, queue_size=QUEUE_SIZE, latch=params.lockstep
        )
        self._info_publisher = rospy.Publisher(
            "segmentation/label_info", LabelInfo, queue_size=QUEUE_SIZE, latch=params.lockstep
        )
        if self._segmenter.is_slow:
            threading.Thread(target=self._work, name="segmenter", daemon=True).start()
        rospy.on_shutdown(self._close)
        topics = {**TOPICS, **(TRUTH_TOPICS if self._segmenter.reads_truth else {})}
        self._sources = ", ".join(rospy.resolve_name(topics[stream]) for stream in streams)
        for stream in streams:
            self._subscribe(topics[stream], MESSAGES[stream], self._on(stream))
        self._subscribe("safety/constraints", SafetyConstraints, self._on_constraints)
        Diagnostics(self._report).start()

    def _subscribe(self, topic, message_type, callback):
        # Without lock-step only the newest image counts: a slow segmenter skips frames instead of falling behind.
        queue_size = 1 if message_type is Image and not self._lockstep else QUEUE_SIZE
        rospy.Subscriber(
            topic, message_type, callback, queue_size=queue_size, buff_size=IMAGE_BUFFER_BYTES, tcp_nodelay=True
        )

    def _on(self, stream):
        return lambda msg: self._add(stream, msg)

    def _on_constraints(self, msg):
        if self._lockstep:
            self._add(CONSTRAINTS, msg)
        else:
            with self._lock:
                self._newest_constraints = msg

    def _add(self, stream, msg):
        with self._lock:
            frame = self._join.add(stream, conversions.stamp_to_ns(msg.header.stamp), msg)
        if frame is None:
            return
        if not self._segmenter.is_slow:
            self._segment(frame)
        elif self._slot.put(frame):
            with self._lock:
                self._tally.skipped()

    def _work(self):
        for frame in iter(self._slot.take, None):
            self._segment(frame)

    def _close(self):
        self._slot.close()
        self._segmenter.close()

    def _segment(self, messages):
        with self._lock:
            constraints = messages.get(CONSTRAINTS, self._newest_constraints)
        header = next(messages[stream].header for stream in (LABELS, IMAGE) if stream in messages)
        try:
            frame = segmenter_frame(messages, constraints, self._base_vocabulary, header)
            segmentation = self._segmenter.segment(frame)
            check_segmentation(segmentation)
        except PerceptionError as error:
            self._refuse(error)
            return
        except Exception as error:  # a fault of ours must be told, and must not end the thread that works
            self._refuse(EvidenceError(f"internal error: {type(error).__name__}: {error}"))
            return
        if self._segmenter.is_held_back and not self._wait_until(frame.stamp_ns, segmentation.latency_s):
            return
        with self._lock:
            self._tally.answered(frame, segmentation)
        self._info_publisher.publish(conversions.segmentation_to_label_info(segmentation, header))
        self._labels_publisher.publish(conversions.array_to_image(segmentation.labels, "mono16", header))

    def _refuse(self, error):
        with self._lock:
            self._tally.failed(error)
        if not rospy.is_shutdown():
            rospy.logerr_throttle(WARNING_PERIOD_S, f"frame not segmented: {error}")

    @staticmethod
    def _wait_until(stamp_ns, latency_s):
        """Wait in ROS time; False where the world began anew meanwhile, or the node ends."""
        latency_ns = round(latency_s * 1e9)
        while not rospy.is_shutdown():
            now_ns = rospy.Time.now().to_nsec()
            if now_ns >= stamp_ns + latency_ns:
                return True
            if now_ns < stamp_ns - latency_ns:
                return False
            time.sleep(POLL_PERIOD_S)
        return False

    def _report(self):
        with self._lock:
            missing = self._join.missing and f"{self._join.missing} (of {self._sources})"
            level, message, values = self._tally.report(self._segmenter.warning, missing)
        return [make_status("segmentation", level, message, values)]


def main() -> int:
    """Run the node; return the exit status."""
    return run_node("segmenter", SegmenterParams, SegmenterNode)

# SPDX-License-Identifier: BSD-3-Clause
"""Node segmenter: image and asked classes -> ``segmentation/labels``, ``segmentation/label_info``.

The simulated segmenter reads ``ground_truth/*``; no other node of this package may.
"""

from __future__ import annotations

import threading

import rospy
from core_msgs.msg import LabelInfo, SafetyConstraints
from sensor_msgs.msg import Image

from core_perception.exceptions import PerceptionError
from core_perception.ontology import Ontology
from core_perception.params import SegmenterParams
from core_perception.ros import conversions
from core_perception.ros.node import config_dir, run_node
from core_perception.segmenters.simulated import SimulatedSegmenter
from core_perception.stamped_join import StampedJoin

QUEUE_SIZE = 10
IMAGE_BUFFER_BYTES = 2**24


class SegmenterNode:
    """Answers every frame; asks for the base vocabulary and for the classes of the constraints in force."""

    def __init__(self, params: SegmenterParams):
        """Connect the topics.

        Raises:
            PerceptionError: the ontology file is missing or wrong.
        """
        ontology = Ontology.load(params.ontology_file or config_dir() / "ontology.yaml")
        self._segmenter = SimulatedSegmenter(
            ontology,
            params.seed,
            params.miss_rate,
            params.pixel_drop_rate,
            params.erode_px,
            params.missed_classes,
        )
        self._base_vocabulary = ontology.vocabulary
        self._lockstep = params.lockstep
        self._lock = threading.Lock()
        self._join = StampedJoin("labels", "info", *(["constraints"] if params.lockstep else []))
        self._newest_constraints = None
        self._labels_publisher = rospy.Publisher(
            "segmentation/labels", Image, queue_size=QUEUE_SIZE, latch=params.lockstep
        )
        self._info_publisher = rospy.Publisher(
            "segmentation/label_info", LabelInfo, queue_size=QUEUE_SIZE, latch=params.lockstep
        )
        self._subscribe("ground_truth/labels", Image, lambda msg: self._add("labels", msg))
        self._subscribe("ground_truth/label_info", LabelInfo, lambda msg: self._add("info", msg))
        self._subscribe("safety/constraints", SafetyConstraints, self._on_constraints)

    def _subscribe(self, topic, message_type, callback):
        # Without lock-step only the newest image counts: a slow segmenter skips frames instead of falling behind.
        queue_size = 1 if message_type is Image and not self._lockstep else QUEUE_SIZE
        rospy.Subscriber(
            topic, message_type, callback, queue_size=queue_size, buff_size=IMAGE_BUFFER_BYTES, tcp_nodelay=True
        )

    def _on_constraints(self, msg):
        if self._lockstep:
            self._add("constraints", msg)
        else:
            with self._lock:
                self._newest_constraints = msg

    def _add(self, stream, msg):
        with self._lock:
            frame = self._join.add(stream, conversions.stamp_to_ns(msg.header.stamp), msg)
            constraints = self._newest_constraints
        if frame is not None:
            self._segment(frame["labels"], frame["info"], frame.get("constraints", constraints))

    def _segment(self, labels_msg, info_msg, constraints_msg):
        in_force = [p.class_name for p in constraints_msg.predicates] if constraints_msg is not None else []
        try:
            segmentation = self._segmenter.segment(
                conversions.image_to_array(labels_msg),
                conversions.truth_classes(info_msg),
                [*in_force, *self._base_vocabulary],
                conversions.stamp_to_ns(labels_msg.header.stamp),
            )
        except PerceptionError as error:
            rospy.logerr_throttle(10.0, f"frame not segmented: {error}")
            return
        self._info_publisher.publish(conversions.segmentation_to_label_info(segmentation, labels_msg.header))
        self._labels_publisher.publish(conversions.array_to_image(segmentation.labels, "mono16", labels_msg.header))


def main() -> int:
    """Run the node; return the exit status."""
    return run_node("segmenter", SegmenterParams, SegmenterNode)

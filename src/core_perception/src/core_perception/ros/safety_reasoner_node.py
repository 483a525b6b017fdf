# SPDX-License-Identifier: BSD-3-Clause
"""Node safety_reasoner: what was seen and is held -> ``safety/constraints``."""

from __future__ import annotations

import threading

import rospy
from core_msgs.msg import InstanceArray, LabelInfo, SafetyConstraints, Tick

from core_perception.newest import NewestAnswer
from core_perception.params import ReasonerParams
from core_perception.reasoners.base import Evidence
from core_perception.reasoners.factory import make_reasoner
from core_perception.release import ReleaseSchedule
from core_perception.ros import conversions
from core_perception.ros.node import config_dir, run_node
from core_perception.stamped_join import StampedJoin

QUEUE_SIZE = 50


class SafetyReasonerNode:
    """Publishes one statement per frame of a lock-step world, otherwise at a fixed rate."""

    def __init__(self, params: ReasonerParams):
        """Connect the topics.

        Raises:
            PerceptionError: a file of the reasoner is missing or wrong.
        """
        reasoner = make_reasoner(params, config_dir())
        # Held while an answer is made: statements must leave in the order of their stamps, whichever topic completes
        # them.
        self._lock = threading.Lock()
        self._join = StampedJoin("classes", "instances")
        self._schedule = ReleaseSchedule(reasoner, round(params.latency_s * 1e9)) if params.lockstep else None
        self._newest = None if params.lockstep else NewestAnswer(reasoner)
        self._publisher = rospy.Publisher("safety/constraints", SafetyConstraints, queue_size=QUEUE_SIZE, latch=True)
        if reasoner.reads_evidence:
            self._subscribe("segmentation/label_info", LabelInfo, self._on_label_info)
            self._subscribe("semantic_map/instances", InstanceArray, self._on_instances)
        if params.lockstep:
            self._subscribe("lockstep/tick", Tick, self._on_tick)
        else:
            self._timer = rospy.Timer(rospy.Duration(1.0 / params.rate_hz), self._on_timer, reset=True)

    @staticmethod
    def _subscribe(topic, message_type, callback):
        rospy.Subscriber(topic, message_type, callback, queue_size=QUEUE_SIZE, tcp_nodelay=True)

    def _on_label_info(self, msg):
        self._add("classes", msg, conversions.classes_seen(msg))

    def _on_instances(self, msg):
        self._add("instances", msg, conversions.held_instances(msg))

    def _add(self, stream, msg, item):
        stamp_ns = conversions.stamp_to_ns(msg.header.stamp)
        with self._lock:
            matched = self._join.add(stream, stamp_ns, item)
            if matched is None:
                return
            evidence = Evidence(stamp_ns, matched["classes"], matched["instances"])
            if self._schedule is None:
                self._newest.add_evidence(evidence)
            else:
                self._schedule.add_evidence(evidence)
                self._publish_due()

    def _on_tick(self, msg):
        with self._lock:
            self._schedule.add_frame(conversions.stamp_to_ns(msg.frame_stamp))
            self._publish_due()

    def _publish_due(self):
        for stamp_ns, constraints in self._schedule.poll():
            self._publisher.publish(conversions.constraints_to_msg(constraints, stamp_ns))

    def _on_timer(self, _event):
        now_ns = conversions.stamp_to_ns(rospy.Time.now())
        with self._lock:
            self._publisher.publish(conversions.constraints_to_msg(self._newest.at(now_ns), now_ns))


def main() -> int:
    """Run the node; return the exit status."""
    return run_node("safety_reasoner", ReasonerParams, SafetyReasonerNode)

# SPDX-License-Identifier: BSD-3-Clause
"""Node safety_reasoner: what is seen and held -> ``safety/constraints``."""

from __future__ import annotations

import threading

import rospy
from core_msgs.msg import InstanceArray, LabelInfo, SafetyConstraints, Tick
from sensor_msgs.msg import Image
from std_srvs.srv import Trigger, TriggerResponse

from core_perception.asking import Findings
from core_perception.embedded_rules import GuardedAnswer, GuardedSchedule
from core_perception.exceptions import PerceptionError
from core_perception.newest import NewestAnswer
from core_perception.params import ReasonerParams
from core_perception.reasoners.base import Evidence
from core_perception.reasoners.factory import ReasonerParts, make_reasoner
from core_perception.release import ReleaseSchedule
from core_perception.ros import conversions
from core_perception.ros.diagnostics import Diagnostics, run_every
from core_perception.ros.node import config_dir, run_node
from core_perception.ros.operator_services import OperatorServices
from core_perception.ros.reasoner_diagnostics import describe
from core_perception.stamped_join import StampedJoin

QUEUE_SIZE = 50
# Images are large: a few are enough to meet the labels made from them.
IMAGES_WAITING = 20
IMAGE_BUFFER_BYTES = 2**24
# How often a slow reasoner is looked at in a lock-step world [s], wall time.
POLL_PERIOD_S = 0.02
WARNING_PERIOD_S = 10.0


class SafetyReasonerNode:
    """Publishes one statement per frame of a lock-step world, otherwise at a fixed rate."""

    def __init__(self, params: ReasonerParams):
        """Connect the topics.

        Raises:
            PerceptionError: a file of the reasoner is missing or wrong, or a server's address is not allowed.
        """
        self._params = params
        parts = make_reasoner(params, config_dir(), rospy.get_name())
        self._reasoner = reasoner = parts.reasoner
        rospy.loginfo("safety_reasoner: %s", parts.description)
        # Held while an answer is made: statements must leave in the order of their stamps, whichever topic completes
        # them.
        self._lock = threading.RLock()
        self._rules = OperatorServices(params, parts.ontology, reasoner.reads_guidelines, self._lock)
        self._findings = Findings(reasoner, parts.memory)
        self._description = parts.description
        # The first one's stamp is that of the evidence: of whichever came last it could go back from match to match.
        streams = (["image"] if reasoner.reads_image else []) + ["classes", "instances"]
        self._leader = streams[0]
        slop_ns = 0 if params.lockstep else round(params.slop_s * 1e9)
        self._join = StampedJoin(*streams, capacity=IMAGES_WAITING if reasoner.reads_image else 50, slop_ns=slop_ns)
        self._schedule = make_schedule(params, parts, self._findings) if params.lockstep else None
        self._newest = None if params.lockstep else make_newest(parts, self._findings)
        self._publisher = rospy.Publisher("safety/constraints", SafetyConstraints, queue_size=QUEUE_SIZE, latch=True)
        rospy.Service("~reset_context", Trigger, self._on_reset_context)
        rospy.on_shutdown(reasoner.close)
        self._connect()
        Diagnostics(self._tell).start()

    def _connect(self):
        if self._reasoner.reads_evidence:
            self._subscribe("segmentation/label_info", LabelInfo, self._on_label_info)
            self._subscribe("semantic_map/instances", InstanceArray, self._on_instances)
        if self._reasoner.reads_image:
            self._subscribe("camera/color/image_raw", Image, self._on_image)
        if self._schedule is None:
            self._timer = rospy.Timer(rospy.Duration(1.0 / self._params.rate_hz), self._on_timer, reset=True)
            return
        self._subscribe("lockstep/tick", Tick, self._on_tick)
        if self._reasoner.is_slow:
            run_every(POLL_PERIOD_S, self._poll)

    @staticmethod
    def _subscribe(topic, message_type, callback):
        rospy.Subscriber(
            topic, message_type, callback, queue_size=QUEUE_SIZE, buff_size=IMAGE_BUFFER_BYTES, tcp_nodelay=True
        )

    def _on_label_info(self, msg):
        self._add("classes", msg, conversions.classes_seen(msg))

    def _on_instances(self, msg):
        self._add("instances", msg, (conversions.held_instances(msg), conversions.history_start_ns(msg)))

    def _on_image(self, msg):
        self._add("image", msg, msg)

    def _add(self, stream, msg, item):
        stamp_ns = conversions.stamp_to_ns(msg.header.stamp)
        with self._lock:
            matched = self._join.add(stream, stamp_ns, (stamp_ns, item))
            if matched is None:
                return
            evidence = self._make_evidence(matched[self._leader][0], {name: m[1] for name, m in matched.items()})
            if evidence is None:
                return
            if self._schedule is None:
                self._newest.add_evidence(evidence)
            else:
                self._schedule.add_evidence(evidence)
                self._publish_due()

    def _make_evidence(self, stamp_ns, matched):
        image = matched.get("image")
        if image is not None:
            try:
                image = conversions.color_to_rgb(image)
            except PerceptionError as error:
                rospy.logerr_throttle(10.0, "safety_reasoner: image not used: %s", error)
                return None
        instances, history_start_ns = matched["instances"]
        guidelines = self._rules.guidelines()
        return Evidence(stamp_ns, matched["classes"], instances, image, guidelines, history_start_ns)

    def _on_tick(self, msg):
        with self._lock:
            self._schedule.add_frame(conversions.stamp_to_ns(msg.frame_stamp))
            self._publish_due()

    def _poll(self):
        with self._lock:
            self._publish_due()

    def _publish_due(self):
        for stamp_ns, constraints in self._schedule.poll():
            self._publish(constraints, stamp_ns)

    def _on_timer(self, _event):
        now_ns = conversions.stamp_to_ns(rospy.Time.now())
        try:
            with self._lock:
                self._publish(self._newest.at(now_ns), now_ns)
        except rospy.ROSException:  # topics close while the node shuts down
            if not rospy.is_shutdown():
                raise

    def _publish(self, constraints, stamp_ns):
        self._publisher.publish(conversions.constraints_to_msg(self._rules.merge(constraints, stamp_ns), stamp_ns))

    def _on_reset_context(self, _request) -> TriggerResponse:
        with self._lock:
            (self._newest or self._schedule).forget_answers()
        message = "every answer so far is forgotten, the operator's rules stay; the robot stops until the next answer"
        return TriggerResponse(success=True, message=message)

    def _tell(self):
        with self._lock:
            status = describe(self._findings, self._description, self._rules.count())
            failure = self._findings.last_failure if self._findings.failures_in_row else ""
        if failure:
            rospy.logwarn_throttle(WARNING_PERIOD_S, f"safety_reasoner: no valid answer: {failure}")
        return [status]


def make_schedule(params: ReasonerParams, parts: ReasonerParts, findings: Findings):
    """Return when answers come into force in a lock-step world, with the embedded rules where they hold besides."""
    latency_ns = round(params.latency_s * 1e9)
    schedule = ReleaseSchedule(parts.reasoner, latency_ns, findings)
    if parts.embedded is None:
        return schedule
    return GuardedSchedule(schedule, ReleaseSchedule(parts.embedded, latency_ns, Findings(parts.embedded)))


def make_newest(parts: ReasonerParts, findings: Findings):
    """Return the newest answer, with the embedded rules where they hold besides."""
    newest = NewestAnswer(parts.reasoner, findings)
    if parts.embedded is None:
        return newest
    return GuardedAnswer(newest, NewestAnswer(parts.embedded, Findings(parts.embedded)))


def main() -> int:
    """Run the node; return the exit status."""
    return run_node("safety_reasoner", ReasonerParams, SafetyReasonerNode)

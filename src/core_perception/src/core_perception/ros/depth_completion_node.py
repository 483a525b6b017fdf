# SPDX-License-Identifier: BSD-3-Clause
"""Node depth_completion: colour and depth image -> ``camera/depth_completed/image_raw``, with holes filled."""

from __future__ import annotations

import math
import threading
import time
from collections import Counter

import numpy as np
import rospy
from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import CameraInfo, Image

from core_perception.depth_completion import (
    Completion,
    DepthCompleter,
    Outcome,
    is_plausible_metric,
    pass_unchanged,
)
from core_perception.depth_params import DepthCompletionParams
from core_perception.depth_sidecar import MAX_REPLY_BYTES, DepthAnswer, Pinhole, ask_depth
from core_perception.exceptions import EvidenceError, PerceptionError
from core_perception.frame_line import FrameLine
from core_perception.reasoners.vlm_client import BackOff
from core_perception.ros import conversions
from core_perception.ros.diagnostics import Diagnostics, make_status
from core_perception.ros.node import run_node
from core_perception.scale_fit import Prediction
from core_perception.sidecar_client import SidecarClient, find_endpoint

QUEUE_SIZE = 20
IMAGE_BUFFER_BYTES = 2**25
POLL_PERIOD_S = 0.02  # a frame that waits in vain is noticed after that


class DepthCompletionNode:
    """Publishes every depth image it gets, in the order of their stamps, with holes filled where there is a prediction.

    Callbacks only put messages into the line; one thread takes them out, asks and publishes.
    """

    def __init__(self, params: DepthCompletionParams):
        """Connect the topics.

        Raises:
            EndpointError: the address of the side-car is malformed or not allowed.
        """
        self._params = params
        self._completer = DepthCompleter(params.limits)
        # A lock-step world waits: every frame is worked on, whatever it takes.
        wait_s = math.inf if params.lockstep else params.wait_s
        newest_first = params.backend == "remote" and not params.lockstep
        self._line = FrameLine(round(params.slop_s * 1e9), wait_s, newest_first)
        self._changed = threading.Condition()  # guards the line and the camera
        self._camera_info = None
        self._client, self._back_off, self._paused_until_s = None, BackOff(rospy.get_name()), 0.0
        self._counts, self._last, self._model = Counter(), None, ""
        if params.backend == "remote":
            endpoint = find_endpoint(params.server_url, params.allowed_hosts_file, params.allow_remote_images)
            self._client = SidecarClient(endpoint, params.deadline_s, MAX_REPLY_BYTES)
            rospy.on_shutdown(self._client.close)
            rospy.loginfo("depth_completion: asks %s", endpoint.url)
        self._publisher = rospy.Publisher("camera/depth_completed/image_raw", Image, queue_size=QUEUE_SIZE)
        self._subscribe("camera/depth/image_raw", Image, self._on_depth)
        if params.backend == "remote":
            self._subscribe("camera/color/image_raw", Image, self._on_partner)
            self._subscribe("camera/color/camera_info", CameraInfo, self._on_camera_info)
        elif params.backend == "topic":
            self._subscribe("depth_prediction/image_raw", Image, self._on_partner)
        threading.Thread(target=self._work, daemon=True).start()
        Diagnostics(self._tell).start()

    @staticmethod
    def _subscribe(topic, message_type, callback):
        rospy.Subscriber(
            topic, message_type, callback, queue_size=QUEUE_SIZE, buff_size=IMAGE_BUFFER_BYTES, tcp_nodelay=True
        )

    def _on_depth(self, msg):
        with self._changed:
            self._line.add_frame(conversions.stamp_to_ns(msg.header.stamp), msg, time.monotonic())
            self._changed.notify()

    def _on_partner(self, msg):
        with self._changed:
            self._line.add_partner(conversions.stamp_to_ns(msg.header.stamp), msg)
            self._changed.notify()

    def _on_camera_info(self, msg):
        with self._changed:
            self._camera_info = msg

    def _work(self):
        while not rospy.is_shutdown():
            with self._changed:
                alone, waiting, partner = self._line.take(time.monotonic(), self._waits())
                if not alone and waiting is None:
                    self._changed.wait(POLL_PERIOD_S)
                    continue
            try:
                for frame in alone:
                    self._pass(frame.frame, self._why_alone())
                if waiting is not None:
                    self._complete(waiting.frame, partner)
            except rospy.ROSException:  # topics close while the node shuts down
                if not rospy.is_shutdown():
                    raise

    def _waits(self) -> bool:
        """Whether a frame may wait for its partner."""
        return self._params.backend == "topic" or (
            self._client is not None and time.monotonic() >= self._paused_until_s
        )

    def _why_alone(self) -> str:
        if self._params.backend == "none":
            return "nobody predicts (backend none)"
        if not self._waits():
            return "the side-car failed and is left alone for a moment"
        image = "predicted depth" if self._params.backend == "topic" else "colour image"
        return f"no {image} of its stamp, or a newer frame was asked about"

    def _complete(self, depth_msg, partner):
        try:
            sensor_m = conversions.depth_to_m(depth_msg)
            if depth_msg.header.frame_id != partner.header.frame_id:
                frames = f"depth is in {depth_msg.header.frame_id!r}, its picture in {partner.header.frame_id!r}"
                raise EvidenceError(f"{frames}: they are not registered")
            answer = self._predict(partner)
            stamp_s = depth_msg.header.stamp.to_sec()
            self._publish(self._completer.complete(sensor_m, answer.prediction, stamp_s), depth_msg.header, answer)
        except PerceptionError as error:
            self._pass(depth_msg, str(error))
        except Exception as error:  # a fault of ours must leave the map with what the sensor says, and be told
            rospy.logerr_throttle(10.0, f"depth_completion: internal error: {type(error).__name__}: {error}")
            self._pass(depth_msg, f"internal error: {type(error).__name__}")

    def _predict(self, partner) -> DepthAnswer:
        if self._params.backend == "topic":
            values = conversions.image_to_array(partner)
            if values.dtype != np.float32:
                raise EvidenceError(f"predicted depth: got encoding {partner.encoding!r}, allowed 32FC1")
            return DepthAnswer(Prediction(values, self._params.kind), "topic")
        try:
            answer = ask_depth(
                self._client,
                conversions.color_to_rgb(partner),
                self._pinhole(),
                conversions.stamp_to_ns(partner.header.stamp),
                self._params.image_max_px,
            )
        except PerceptionError:
            self._paused_until_s = time.monotonic() + self._back_off.failed()
            self._counts["failed requests"] += 1
            raise
        self._back_off.succeeded()
        return answer

    def _pinhole(self):
        info = self._camera_info
        if info is None or not (info.width and info.height and info.K[0] > 0.0 and info.K[4] > 0.0):
            return None
        return Pinhole(info.width, info.height, info.K[0], info.K[4], info.K[2], info.K[5])

    def _pass(self, depth_msg, reason):
        try:
            self._publish(pass_unchanged(conversions.depth_to_m(depth_msg), reason), depth_msg.header)
        except PerceptionError as error:
            self._counts["refused"] += 1
            rospy.logerr_throttle(10.0, f"depth_completion: depth image refused: {error}")

    def _publish(self, completion: Completion, header, answer=None):
        self._publisher.publish(conversions.array_to_image(completion.depth_m, "32FC1", header))
        with self._changed:
            self._counts[completion.outcome.value] += 1
            self._last = (completion, answer, time.monotonic())

    def _tell(self):
        with self._changed:
            last, counts = self._last, dict(self._counts)
        return [describe(self._params.backend, last, counts)]


def describe(backend: str, last, counts) -> DiagnosticStatus:
    """Say what became of the last frame: OK when filled or with no back end, else WARN; what is off, in the message.

    Args:
        backend: the parameter.
        last: (Completion, DepthAnswer or None, monotonic time [s]) of the last frame; None before the first.
        counts: how often what happened.
    """
    level, message = DiagnosticStatus.OK, ""
    values = {"backend": backend, **{name: str(count) for name, count in sorted(counts.items())}}
    if last is None:
        level, message = DiagnosticStatus.WARN, "no depth image yet"
    else:
        completion, answer, _ = last
        message = completion.outcome.value + (f": {completion.reason}" if completion.reason else "")
        if completion.outcome is not Outcome.FILLED and backend != "none":
            level = DiagnosticStatus.WARN
        if answer is not None:
            values["model"] = answer.model
            note = _doubt(completion, answer)
            if note:
                level, message = DiagnosticStatus.WARN, f"{message}; {note}"
        values.update(_figures(completion))
    return make_status("depth completion", level, message, values, backend)


def _doubt(completion: Completion, answer: DepthAnswer) -> str:
    if answer.random_weights:
        return f"{answer.model} has random weights: its depth means nothing"
    if answer.prediction.kind == "metric" and completion.scale and not is_plausible_metric(completion.scale):
        return f"the model speaks of metres, but needs a scale of {completion.scale:.2f}: are its focal lengths right?"
    return ""


def _figures(completion: Completion) -> dict:
    figures = {"holes": str(completion.holes), "filled pixels": str(completion.filled)}
    if completion.scale is not None:
        figures["scale"] = f"{completion.scale:.5g}"
    if completion.fit is not None:
        figures["inlier_ratio"] = f"{completion.fit.inlier_ratio:.3f}"
        figures["mad"] = f"{completion.fit.mad:.4f}"
        figures["returns"] = str(completion.fit.returns)
    return figures


def main() -> int:
    """Run the node; return the exit status."""
    return run_node("depth_completion", DepthCompletionParams, DepthCompletionNode)

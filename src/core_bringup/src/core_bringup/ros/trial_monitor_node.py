# SPDX-License-Identifier: BSD-3-Clause
"""trial_monitor: watches a run, prints its progress, writes its result, and ends when the trial is over."""

from __future__ import annotations

import json
import queue
import sys
import time
from typing import Callable, List, Optional, Tuple

import rospy
from core_msgs.msg import FilterState, SafetyConstraints, SafetyGrid, Violation
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from nav_msgs.msg import Odometry
from rospy.numpy_msg import numpy_msg
from sensor_msgs.msg import Image
from std_srvs.srv import Trigger

from core_bringup.evaluation.key_frames import ColorImage
from core_bringup.evaluation.monitor_params import MonitorParams
from core_bringup.evaluation.session import TrialSession
from core_bringup.exceptions import BringupError
from core_bringup.ros import trial_conversions as convert
from core_bringup.ros.connections import find_unserved
from core_bringup.ros.trial_bag import TrialBag
from core_perception.ros.conversions import color_to_rgb, constraints_from_msg, depth_to_m

PROGRESS_PERIOD_S = 0.5
UNPAUSE_TIMEOUT_S = 5.0
GONE_PERIOD_S = 3.0  # a bridge without connection for so long is gone


class TrialMonitorNode:
    """Subscribes, feeds the session in one thread, and keeps the wall-clock limits that detect a dead chain.

    A bridge that was started paused is set going once every topic is connected, so that no tick can be missed.
    """

    def __init__(self, params: MonitorParams, session: TrialSession):
        """Subscribe."""
        self._params = params
        self._bag = TrialBag(session.camera_mount) if params.bag != "never" else None
        if self._bag is not None:
            self._bag.subscribe()
        self._session = session
        self._inbox: queue.Queue[Tuple[Callable, object]] = queue.Queue()
        self._diagnostics = rospy.Publisher("diagnostics", DiagnosticArray, queue_size=1)
        self._subscribers = [
            self._subscribe("odom", Odometry, lambda m: session.add_odometry(convert.odometry_from_msg(m))),
            self._subscribe("cbf_filter/state", FilterState, lambda m: session.add_filter(convert.filter_from_msg(m))),
            self._subscribe(
                "ground_truth/violation", Violation, lambda m: session.add_truth(convert.truth_from_msg(m))
            ),
            self._subscribe("safety_grid", numpy_msg(SafetyGrid), lambda m: session.add_grid(convert.grid_from_msg(m))),
            self._subscribe("safety/constraints", SafetyConstraints, self._on_constraints),
        ]
        if params.pictures != "never":
            self._subscribers.append(self._subscribe("camera/color/image_raw", Image, self._on_color))
            self._subscribers.append(self._subscribe("camera/depth/image_raw", Image, self._on_depth))
        self._waits_to_unpause = params.unpause
        self._connected_at = self._heard_at = time.monotonic()
        self._first_tick_at: Optional[float] = None

    def run(self) -> int:
        """Watch until the trial is over; returns the exit status: 0 with an outcome, 1 with outcome ``error``."""
        shown_at = 0.0
        while not self._session.over:
            self._drain(0.05)
            now = time.monotonic()
            self._unpause_when_connected()
            self._check_alive(now)
            if now - shown_at >= PROGRESS_PERIOD_S:
                shown_at = now
                _print_line("progress", self._session.progress())
                self._publish_diagnostics()
        wall_time_s = 0.0 if self._first_tick_at is None else self._heard_at - self._first_tick_at
        self._drain_rest()
        if self._bag is not None:
            self._bag.stop()
        _print_line("progress", self._session.progress())
        result = self._session.finish(wall_time_s, None if self._bag is None else self._bag.write)
        self._publish_diagnostics(str(result["outcome"]))
        _print_line("result", result)
        return 1 if result["outcome"] == "error" else 0

    def _subscribe(self, topic: str, kind: type, feed: Callable) -> rospy.Subscriber:
        return rospy.Subscriber(
            topic, kind, lambda msg: self._inbox.put((feed, msg)), queue_size=None, buff_size=2**22, tcp_nodelay=True
        )

    def _unpause_when_connected(self) -> None:
        if not self._waits_to_unpause or self._unconnected() or find_unserved([s.name for s in self._subscribers]):
            return
        self._waits_to_unpause = False
        try:
            rospy.wait_for_service("unpause", UNPAUSE_TIMEOUT_S)
            rospy.ServiceProxy("unpause", Trigger)()
        except (rospy.ROSException, rospy.ServiceException) as error:
            rospy.logwarn("the world was not set going, there may be no world_bridge: %s", error)

    def _unconnected(self) -> List[str]:
        return [s.name for s in self._subscribers if not s.get_num_connections()]

    def _on_color(self, msg: Image) -> None:
        self._session.add_image(ColorImage(msg.header.stamp.to_nsec(), color_to_rgb(msg)))

    def _on_depth(self, msg: Image) -> None:
        self._session.add_depth(msg.header.stamp.to_nsec(), depth_to_m(msg))

    def _on_constraints(self, msg: SafetyConstraints) -> None:
        constraints = constraints_from_msg(msg)
        self._session.add_latency(msg.image_stamp.to_nsec(), msg.latency.to_sec())
        self._session.add_predicates(msg.header.stamp.to_nsec(), constraints.predicates, constraints.source)

    def _drain(self, wait_s: float) -> None:
        """Feed what has arrived; waits for the first message only."""
        before = self._session.ticks
        try:
            feed, msg = self._inbox.get(timeout=wait_s)
            while True:
                feed(msg)
                if self._session.over:
                    break
                feed, msg = self._inbox.get_nowait()
        except queue.Empty:
            pass
        if self._session.ticks > before:
            self._heard_at = time.monotonic()
            self._first_tick_at = self._first_tick_at or self._heard_at

    def _drain_rest(self) -> None:
        """Take the grids and images of the last frames, which may come a moment after the tick that ended the trial."""
        end = time.monotonic() + 0.3
        while time.monotonic() < end and not rospy.is_shutdown():
            try:
                feed, msg = self._inbox.get(timeout=0.05)
            except queue.Empty:
                continue
            feed(msg)

    def _check_alive(self, now: float) -> None:
        started = self._first_tick_at is not None
        limit_s = self._params.stall_timeout_s if started else self._params.start_timeout_s
        if self._subscribers[0].get_num_connections():
            self._connected_at = now
        if rospy.is_shutdown():
            self._session.abort("shut down before the trial was over")
        elif started and now - self._connected_at > GONE_PERIOD_S:
            self._session.abort("world_bridge has gone: nobody publishes odom any more")
        elif now - self._heard_at > limit_s:
            self._session.abort(f"no tick for {limit_s:g} s: {self._missing()}")

    def _missing(self) -> str:
        unconnected = self._unconnected()
        if unconnected:
            return f"nobody publishes {', '.join(unconnected)}"
        return "odom, cbf_filter/state or ground_truth/violation has stopped"

    def _publish_diagnostics(self, outcome: str = "running") -> None:
        level = DiagnosticStatus.ERROR if outcome == "error" else DiagnosticStatus.OK
        values = [KeyValue(key, str(value)) for key, value in self._session.progress().items()]
        array = DiagnosticArray(status=[DiagnosticStatus(level, rospy.get_name(), outcome, self._params.task, values)])
        array.header.stamp = rospy.Time.now()
        self._diagnostics.publish(array)


def _print_line(mark: str, content: dict) -> None:
    """One line as one write, so that lines of other nodes do not come in between."""
    sys.stdout.write(f"{mark} {json.dumps(content, allow_nan=False)}\n")
    sys.stdout.flush()


def main() -> int:
    """Entry of scripts/trial_monitor."""
    rospy.init_node("trial_monitor")
    try:
        params = MonitorParams.from_dict(rospy.get_param("~", {}))
        session = TrialSession(params)
    except BringupError as error:
        text = str(error)
        sys.stderr.write(f"{text}\n" if text.startswith("trial_monitor") else f"trial_monitor: {text}\n")
        return 2
    return TrialMonitorNode(params, session).run()

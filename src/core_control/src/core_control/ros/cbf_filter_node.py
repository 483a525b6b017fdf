# SPDX-License-Identifier: BSD-3-Clause
"""Node cbf_filter: takes cmd_vel_nominal, odom and safety_grid, sends cmd_vel and says why. No arithmetic here."""

from __future__ import annotations

import sys
import threading
import time
from dataclasses import replace

import numpy as np
import rospy
from core_msgs.msg import FilterState, SafetyGrid, Tick
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Twist, TwistStamped
from nav_msgs.msg import Odometry
from rospy.numpy_msg import numpy_msg

from core_control.cbf_filter import CbfFilter
from core_control.exceptions import SolverError
from core_control.modes import Reason
from core_control.params import FilterParams
from core_control.ros.blocked import BlockedPublisher
from core_control.ros.conversions import state_to_msg, twist_to_msg
from core_control.ros.diagnostics import make_diagnostics
from core_control.ros.latest_inputs import LatestInputs
from core_control.ros.lockstep_inputs import LockstepInputs
from core_control.ros.operator_desk import OperatorDesk
from core_control.ros.start import read_node_parameters
from core_control.ros.tightening_server import TighteningServer
from core_control.types import NAN, FilterInputs, FilterResult, Mode

GRID_BUFFER_BYTES = 2**24
DIAGNOSTICS_PERIOD_S = 1.0
# A loop that stood still for longer than this [s], and than two periods, starts again from rest with new inputs.
LONGEST_GAP_S = 0.3


class FilterShell:
    """What both ways of running share: the filter, its outputs, its operator."""

    def __init__(self, params: FilterParams):
        """Advertise; nothing is sent yet."""
        self._params = params
        self._filter = CbfFilter(params)
        self._deciding = threading.Lock()  # the filter is used by one thread at a time
        self._ticks = self._overruns = 0
        self._last = None
        # Under lock-step a node that comes late still gets the newest message; a latched command is unsafe otherwise.
        latch = params.lockstep
        self._cmd_pub = rospy.Publisher("cmd_vel", Twist, queue_size=1, latch=latch, tcp_nodelay=True)
        self._state_pub = rospy.Publisher("cbf_filter/state", FilterState, queue_size=10, latch=latch, tcp_nodelay=True)
        self._blocked = BlockedPublisher()
        self._diagnostics_pub = rospy.Publisher("diagnostics", DiagnosticArray, queue_size=1)
        self._desk = OperatorDesk(params, self._filter, self._deciding, self._subscribe)
        TighteningServer(params, self._tighten)
        rospy.on_shutdown(self._on_shutdown)
        threading.Thread(target=self._run_diagnostics, name="diagnostics", daemon=True).start()

    def _subscribe(self, topic: str, message_class, callback, queue_size: int) -> None:
        def call(message) -> None:
            try:
                callback(message)
            except rospy.ROSException:
                return  # topics are closed: the node is shutting down
            except Exception as error:  # rospy would only log it, and the filter go on without the message
                with self._deciding:
                    self._filter.latch(f"{topic}: {type(error).__name__}: {error}")

        rospy.Subscriber(
            topic, message_class, call, queue_size=queue_size, buff_size=GRID_BUFFER_BYTES, tcp_nodelay=True
        )

    def _decide(self, inputs: FilterInputs, stamp, tick: int, now_s: float) -> None:
        """One tick: decide, send the command, then say why; now_s is on the clock of the ticks."""
        inputs = self._desk.add_requests(inputs, now_s)
        result = self._filter.step(inputs)
        self._desk.confirm(result)
        self._cmd_pub.publish(twist_to_msg(result.u_safe))
        self._state_pub.publish(state_to_msg(result, inputs, stamp, tick))
        self._blocked.publish(result, inputs, stamp)
        self._ticks, self._last = self._ticks + 1, result

    def _fail(self, error: Exception, stamp, tick: int) -> None:
        """An exception outside the filter: latch it and send zero."""
        self._filter.latch(f"{type(error).__name__}: {error}")
        rospy.logerr_throttle(1.0, "cbf_filter: internal error: %s", self._filter.error)
        zero = FilterResult(Mode.STOPPED, np.zeros(3), np.full(3, NAN), Reason.INTERNAL_ERROR, self._filter.error)
        zero = replace(zero, latched=True)
        self._cmd_pub.publish(twist_to_msg(zero.u_safe))
        self._state_pub.publish(state_to_msg(zero, FilterInputs(), stamp, tick))
        self._desk.confirm(zero)
        self._last = zero

    def _tighten(self, params: FilterParams) -> None:
        with self._deciding:
            self._filter.tighten(params)
            self._desk.tighten(params)

    def _on_shutdown(self) -> None:
        self._cmd_pub.publish(Twist())

    def _run_diagnostics(self) -> None:
        while not rospy.is_shutdown():
            if self._last is not None:
                about = (self._last, rospy.get_name(), self._ticks, rospy.Time.now())
                self._diagnostics_pub.publish(make_diagnostics(*about, self._overruns, self._find_warnings()))
            time.sleep(DIAGNOSTICS_PERIOD_S)

    def _find_warnings(self) -> list:
        nobody = f"nobody receives {self._cmd_pub.resolved_name}"
        warnings = [self._desk.problem, nobody if self._cmd_pub.get_num_connections() == 0 else ""]
        return [warning for warning in warnings if warning]


class RealTimeFilter(FilterShell):
    """Fixed rate on a monotonic clock, so that it goes on when /clock stands still or jumps; callbacks only store."""

    def __init__(self, params: FilterParams):
        """Subscribe and start the loop."""
        super().__init__(params)
        self._inputs = LatestInputs()
        self._subscribe("cmd_vel_nominal", Twist, self._on_nominal, 1)
        self._subscribe("cmd_vel_nominal_stamped", TwistStamped, self._on_nominal_stamped, 1)
        self._subscribe("odom", Odometry, lambda message: self._store("odometry", message, message), 1)
        self._subscribe("safety_grid", numpy_msg(SafetyGrid), lambda message: self._store("grid", message, message), 1)
        threading.Thread(target=self._run, name="filter_loop", daemon=True).start()

    def _on_nominal(self, message: Twist) -> None:
        self._inputs.store("nominal", message, time.monotonic())

    def _on_nominal_stamped(self, message: TwistStamped) -> None:
        self._store("nominal", message.twist, message)

    def _store(self, name: str, content, message) -> None:
        stamp = message.header.stamp
        self._inputs.store(name, content, time.monotonic(), NAN if stamp.is_zero() else stamp.to_sec())

    def _run(self) -> None:
        due_s = last_s = time.monotonic()
        try:
            while not rospy.is_shutdown():
                now_s = time.monotonic()
                self._tick(now_s - last_s)
                last_s = now_s
                due_s = max(due_s + self._params.control_period_s, time.monotonic())
                time.sleep(max(0.0, due_s - time.monotonic()))
        finally:
            rospy.signal_shutdown("the control loop has ended")  # a node without it would look alive

    def _tick(self, gap_s: float) -> None:
        """One tick, gap_s after the start of the last one."""
        stamp = rospy.Time.now()
        late = gap_s > 2.0 * self._params.control_period_s
        self._overruns += late
        stop_request = None
        if late and gap_s > LONGEST_GAP_S:
            # What came meanwhile may be as old as the gap: a command without a stamp would pass for a new one.
            self._inputs.clear()
            stop_request = (Reason.LOOP_OVERRUN, f"the control loop stood still for {gap_s:.2f} s")
        with self._deciding:
            self._answer(stamp, stop_request)

    def _answer(self, stamp, stop_request) -> None:
        try:
            if self._inputs.jumped_back(stamp.to_sec()):
                self._filter.forget()
            now_s = time.monotonic()
            inputs = replace(self._inputs.read(now_s, stamp.to_sec()), stop_request=stop_request)
            self._decide(inputs, stamp, self._ticks, now_s)
        except rospy.ROSException:
            return  # topics are closed: the node is shutting down
        except Exception as error:  # whatever it is, the robot must get a zero and the operator the reason
            self._fail(error, stamp, self._ticks)


class LockstepFilter(FilterShell):
    """Answers a tick as soon as everything made for it has come; wall time plays no part."""

    def __init__(self, params: FilterParams):
        """Subscribe."""
        super().__init__(params)
        self._inputs = LockstepInputs()
        self._subscribe("lockstep/tick", Tick, self._on_tick, 10)
        self._subscribe("odom", Odometry, lambda message: self._store("odometry", message), 10)
        self._subscribe("cmd_vel_nominal_stamped", TwistStamped, lambda message: self._store("nominal", message), 10)
        self._subscribe("safety_grid", numpy_msg(SafetyGrid), lambda message: self._store("grid", message), 10)

    def _on_tick(self, tick: Tick) -> None:
        with self._deciding:
            want_s = self._params.control_period_s
            if not abs(tick.period_s - want_s) <= 1e-6:  # a period of NaN is wrong as well
                self._filter.latch(f"tick period is {tick.period_s:g} s, output_rate_hz makes it {want_s:g} s")
            if self._inputs.store_tick(tick):
                self._filter.forget()
        self._answer()

    def _store(self, name: str, message) -> None:
        self._inputs.store(name, message)
        self._answer()

    def _answer(self) -> None:
        with self._deciding:
            taken = self._inputs.take()
            if taken is None:
                return
            tick, inputs = taken
            try:
                self._decide(inputs, tick.header.stamp, tick.tick, tick.header.stamp.to_sec())
            except rospy.ROSException:
                return  # topics are closed: the node is shutting down
            except Exception as error:  # as in RealTimeFilter
                self._fail(error, tick.header.stamp, tick.tick)


def main() -> None:
    """Start the node."""
    rospy.init_node("cbf_filter")
    params = read_node_parameters(FilterParams)
    try:
        LockstepFilter(params) if params.lockstep else RealTimeFilter(params)
    except SolverError as error:
        sys.exit(f"{rospy.get_name()}: the filter does not start: {error}")
    rospy.spin()

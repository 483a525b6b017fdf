# SPDX-License-Identifier: BSD-3-Clause
"""What operator and graph may ask of the filter: emergency stop, override, reset, and the watch over the publishers."""

from __future__ import annotations

import math
import threading
import time
from dataclasses import replace

import rospy
from core_msgs.srv import Override as OverrideSrv
from core_msgs.srv import OverrideResponse
from std_msgs.msg import Bool
from std_srvs.srv import Trigger, TriggerResponse

from core_control.cbf_filter import CbfFilter
from core_control.emergency_stop import EmergencyStop
from core_control.exceptions import OverrideError
from core_control.modes import Reason, find_command_stop
from core_control.override import Override
from core_control.params import FilterParams
from core_control.ros.publisher_guard import PublisherGuard
from core_control.types import FilterInputs, FilterResult, Mode


class OperatorDesk:
    """Turns requests into fields of the inputs of the next tick.

    Args:
        params: checked parameters. Under lock-step wall time says nothing: a silent e_stop does not stop then.
        filter_: the filter; used under its lock only.
        deciding: that lock.
        subscribe: subscribes to a topic: name, message class, callback, queue size.
    """

    def __init__(self, params: FilterParams, filter_: CbfFilter, deciding: threading.Lock, subscribe):
        """Advertise and subscribe."""
        self._params, self._filter, self._deciding = params, filter_, deciding
        self._e_stop = EmergencyStop(params.e_stop_required, math.inf if params.lockstep else params.e_stop_timeout_s)
        self._override = Override(params)
        self._last_inputs = FilterInputs()
        inputs = ("cmd_vel_nominal_stamped",) if params.lockstep else ("cmd_vel_nominal", "cmd_vel_nominal_stamped")
        self._guard = PublisherGuard(params, inputs, "cmd_vel")
        subscribe("e_stop", Bool, self._on_e_stop, 10)
        rospy.Service("cbf_filter/e_stop", Trigger, self._on_e_stop_service)
        rospy.Service("cbf_filter/override", OverrideSrv, self._on_override)
        rospy.Service("cbf_filter/reset", Trigger, self._on_reset)

    @property
    def problem(self) -> str:
        """What keeps the watch over the graph from seeing, in words; empty when nothing does."""
        return self._guard.report.problem

    def add_requests(self, inputs: FilterInputs, now_s: float) -> FilterInputs:
        """The inputs of a tick with what was asked for; now_s is on the clock of the ticks, for the override's time."""
        report = self._guard.report
        pressed = self._e_stop.take(time.monotonic())
        latch, stop = report.latch_request, inputs.stop_request or report.stop_request
        if pressed:
            latch = (Reason.E_STOP, pressed)
        if self._e_stop.is_awaited:
            stop = (Reason.E_STOP, "e_stop is required and has not been heard yet")
        asked = replace(inputs, stop_request=stop, latch_request=latch, override_mps=self._override.read(now_s))
        self._last_inputs = asked
        return asked

    def confirm(self, result: FilterResult) -> None:
        """Take an override back that did not drive: a command that fell silent moves nothing when it returns."""
        if result.mode != Mode.OVERRIDE:
            self._override.end()

    def tighten(self, params: FilterParams) -> None:
        """Go on with parameters that allow less."""
        self._params = params
        self._override.tighten(params)

    def _on_e_stop(self, message: Bool) -> None:
        self._e_stop.receive(message.data, time.monotonic())

    def _on_e_stop_service(self, _request) -> TriggerResponse:
        self._e_stop.press("pressed by service cbf_filter/e_stop")
        return TriggerResponse(success=True, message="the robot stops until cbf_filter/reset is called")

    def _on_override(self, request) -> OverrideResponse:
        with self._deciding:
            try:
                if request.duration_s != 0.0:
                    self._check_may_drive()
                granted = self._override.request(request.speed_cap_mps, request.duration_s)
            except OverrideError as error:
                return OverrideResponse(success=False, message=f"no override: {error}")
        rospy.logwarn("cbf_filter: %s", granted)
        return OverrideResponse(success=True, message=granted)

    def _check_may_drive(self) -> None:
        """OverrideError where the next tick would take the override back at once."""
        stop = find_command_stop(self._last_inputs, self._params)
        problem = self._find_stop_request() or self._filter.override_problem or (stop.detail if stop else "")
        if problem:
            raise OverrideError(problem)

    def _find_stop_request(self) -> str:
        """What asks for a latched stop right now, in words."""
        report = self._guard.report.latch_request
        return self._e_stop.find(time.monotonic()) or (report[1] if report else "")

    def _on_reset(self, _request) -> TriggerResponse:
        with self._deciding:
            request = self._find_stop_request()
            if request:
                return TriggerResponse(success=False, message=f"not cleared: {request}")
            error = self._filter.error
            self._override.end()
            self._filter.reset()
        return TriggerResponse(success=True, message=f"cleared: {error}" if error else "nothing was latched")

# SPDX-License-Identifier: BSD-3-Clause
"""Services of world_bridge: reset, pause, unpause, step."""

from __future__ import annotations

from typing import Callable

import rospy
from core_msgs.srv import Step, StepRequest, StepResponse
from std_srvs.srv import Trigger, TriggerRequest, TriggerResponse

from core_bringup.ros.conversions import stamp_to_msg
from core_bringup.run_control import RunControl


class BridgeServices:
    """Hands each request to RunControl and waits for the loop to obey."""

    def __init__(self, control: RunControl, stamp_ns: Callable[[], int], timeout_s: float):
        """Advertise; timeout_s is the longest wait for one tick [s], wall time."""
        self._control, self._stamp_ns, self._timeout_s = control, stamp_ns, timeout_s
        rospy.Service("reset", Trigger, self._on_reset)
        rospy.Service("pause", Trigger, self._on_pause)
        rospy.Service("unpause", Trigger, self._on_unpause)
        rospy.Service("step", Step, self._on_step)

    def _on_reset(self, _request: TriggerRequest) -> TriggerResponse:
        problem = self._control.reset(self._timeout_s)
        return TriggerResponse(not problem, problem or "the world is as it was at the start")

    def _on_pause(self, _request: TriggerRequest) -> TriggerResponse:
        self._control.pause()
        return TriggerResponse(True, "paused")

    def _on_unpause(self, _request: TriggerRequest) -> TriggerResponse:
        self._control.unpause()
        return TriggerResponse(True, "running")

    def _on_step(self, request: StepRequest) -> StepResponse:
        problem = self._control.step(request.ticks, self._timeout_s * max(request.ticks, 1))
        return StepResponse(not problem, problem, stamp_to_msg(self._stamp_ns()))

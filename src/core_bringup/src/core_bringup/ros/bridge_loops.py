# SPDX-License-Identifier: BSD-3-Clause
"""The two ways time passes: tick by tick with the chain's answer, or along the wall clock."""

from __future__ import annotations

import abc
import time
from typing import Sequence

import numpy as np
import rospy
from geometry_msgs.msg import Twist

from core_bringup.command_hold import CommandHold
from core_bringup.pacing import Pacer, RtfMeter
from core_bringup.params import BridgeParams
from core_bringup.ros.bridge_publishers import BridgePublishers
from core_bringup.ros.chain_listener import POLL_S, ChainListener
from core_bringup.ros.conversions import command_from_msg
from core_bringup.ros.frame_worker import FrameWorker
from core_bringup.ros.operator_events import OperatorClient, OperatorEvents
from core_bringup.run_control import RunControl
from core_bringup.simulation import Simulation

LOG_PERIOD_S = 5.0


class BridgeLoop(abc.ABC):
    """What both loops share: turns, reset, pace, diagnostics, the operator's orders.

    The first tick comes one period after the start, which the robot spends standing: a zero stamp is "none" in ROS.
    """

    def __init__(self, simulation: Simulation, params: BridgeParams, publishers: BridgePublishers, control: RunControl):
        """Prepare tick 1."""
        self._simulation, self._params, self._publishers, self._control = simulation, params, publishers, control
        self._hold = CommandHold(params.cmd_vel_timeout_s)
        self._pacer, self._meter = Pacer(params.rtf), RtfMeter()
        self._operator = OperatorEvents(simulation.task.events, OperatorClient(params.stall_timeout_s))
        self._last_log_s = -LOG_PERIOD_S
        self._tick = 0

    @property
    def stamp_ns(self) -> int:
        """Sim time of the newest tick; 0 before the first."""
        return self._simulation.schedule.stamp_ns(self._tick)

    def run(self) -> None:
        """Loop until the node ends."""
        while not rospy.is_shutdown():
            if self._control.wait_for_turn(self._reset, POLL_S):
                self._tick += 1
                self._operator.play(self.stamp_ns * 1e-9)
                self._do_tick()
                self._control.tick_done()
            else:
                self._pacer.reset()
            self._diagnose()

    @abc.abstractmethod
    def _do_tick(self) -> None:
        """Advance by one period and publish it."""

    def _reset(self) -> None:
        # At tick 1 the world is as after a reset; going back would give its stamp a second time.
        if self._tick > 1:
            self._simulation.reset()
            self._operator.reset()
            self._hold.reset()
            self._pacer.reset()
            self._tick = 0

    def _sleep_until(self, stamp_ns: int) -> None:
        delay_s = self._pacer.compute_delay_s(stamp_ns * 1e-9, time.monotonic())
        if delay_s > 0.0:
            time.sleep(delay_s)

    def _take_command(self, command: Sequence[float], now_s: float) -> None:
        if not self._hold.update(command, now_s) and time.monotonic() - self._last_log_s >= LOG_PERIOD_S:
            self._last_log_s = time.monotonic()
            rospy.logerr("cmd_vel is not finite: %s; the robot stands", tuple(command))

    def _diagnose(self) -> None:
        rtf = self._meter.update(self.stamp_ns * 1e-9, time.monotonic())
        if rtf is not None:
            self._publishers.publish_diagnostics(self.stamp_ns, rtf, self._control.is_paused)


class LockstepLoop(BridgeLoop):
    """Advances one period when the chain has answered the last; the same answers give the same world, bit for bit."""

    def __init__(self, *arguments):
        """See BridgeLoop."""
        super().__init__(*arguments)
        self._chain = ChainListener(self._params.stall_timeout_s)

    def _do_tick(self) -> None:
        schedule, tick, stamp_ns = self._simulation.schedule, self._tick, self.stamp_ns
        state = self._simulation.step(self._hold.at(stamp_ns * 1e-9), schedule.period_ns)
        frame = self._simulation.render(state) if schedule.has_frame(tick) else None
        self._sleep_until(stamp_ns)
        self._chain.begin(tick, stamp_ns, schedule.frame_stamp_ns(tick))
        self._publishers.publish_clock(stamp_ns)
        self._publishers.publish_state(stamp_ns, state)
        if frame is not None:
            self._publishers.publish_frame(stamp_ns, frame)
        self._publishers.publish_tick(tick)
        self._take_command(self._chain.wait(rospy.is_shutdown), stamp_ns * 1e-9)

    def _reset(self) -> None:
        super()._reset()
        if self._tick == 0:
            self._chain.reset()


class RealtimeLoop(BridgeLoop):
    """Advances along the wall clock at rtf; the camera draws beside it."""

    def __init__(self, *arguments):
        """See BridgeLoop."""
        super().__init__(*arguments)
        has_camera = self._simulation.schedule.frame_every > 0
        self._frames = FrameWorker(self._simulation.render, self._publishers.publish_frame) if has_camera else None
        rospy.Subscriber("cmd_vel", Twist, self._on_command, queue_size=1, tcp_nodelay=True)

    def _do_tick(self) -> None:
        schedule, parts = self._simulation.schedule, self._params.clock_steps_per_tick
        start_ns = schedule.stamp_ns(self._tick - 1)
        for part in range(1, parts + 1):
            stamp_ns = start_ns + part * schedule.period_ns // parts
            state = self._simulation.step(self._command(), schedule.period_ns // parts)
            self._sleep_until(stamp_ns)
            self._publishers.publish_clock(stamp_ns)
        self._publishers.publish_state(stamp_ns, state)
        if schedule.has_frame(self._tick):
            self._frames.submit(stamp_ns, state)

    def _reset(self) -> None:
        super()._reset()
        if self._frames is not None:
            self._frames.reset()

    def _command(self) -> np.ndarray:
        return self._hold.at(time.monotonic()) if self._tick > 1 else np.zeros(3)

    def _on_command(self, message: Twist) -> None:
        self._take_command(command_from_msg(message), time.monotonic())

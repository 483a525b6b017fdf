# SPDX-License-Identifier: BSD-3-Clause
"""Book-keeping of lock-step runs, pacing, command hold and run control; wall time is an argument."""

import math
import struct
import threading
import time

import numpy as np
import pytest

from core_bringup.command_hold import CommandHold
from core_bringup.exceptions import ConfigError
from core_bringup.lockstep import CHAIN, LockstepMonitor, Schedule, header_stamp_ns
from core_bringup.pacing import Pacer, RtfMeter
from core_bringup.params import BridgeParams
from core_bringup.run_control import RunControl

MS = 1_000_000
COMMAND = (0.3, -0.1, 0.2)


def monitor_at(tick, frame_ns=None, timeout_s=5.0):
    monitor = LockstepMonitor(timeout_s)
    monitor.begin(tick, tick * 50 * MS, tick * 50 * MS if frame_ns is None else frame_ns, 100.0)
    return monitor


ALL = len(CHAIN)


def answer(monitor, stamp_ns, frame_ns, upto=ALL):
    for stage in CHAIN[:upto][: ALL - 1]:
        monitor.note_stage(stage.topic, frame_ns if stage.keyed_by == "frame" else stamp_ns)
    if upto == ALL:
        monitor.note_command(COMMAND)
        monitor.note_acknowledgement(stamp_ns, COMMAND)


def test_tick_is_answered_by_state_and_equal_command_in_either_order():
    for command_first in (True, False):
        monitor = monitor_at(2)
        calls = [lambda m=monitor: m.note_command(COMMAND), lambda m=monitor: m.note_acknowledgement(100 * MS, COMMAND)]
        for call in calls if command_first else calls[::-1]:
            assert not monitor.is_answered()
            call()
        assert monitor.is_answered()
        assert monitor.command == COMMAND


def test_command_that_differs_in_the_last_bit_is_no_answer():
    monitor = monitor_at(2)
    monitor.note_acknowledgement(100 * MS, COMMAND)
    monitor.note_command((math.nextafter(0.3, 1.0) if hasattr(math, "nextafter") else 0.3 + 6e-17, -0.1, 0.2))
    assert not monitor.is_answered()
    assert "awaiting cmd_vel by cbf_filter" in answered_but_for_command(monitor)


def answered_but_for_command(monitor):
    for stage in CHAIN[:-1]:
        monitor.note_stage(stage.topic, 100 * MS)
    return monitor.stall_report(106.0)


def test_not_a_number_equals_itself():
    monitor = monitor_at(2)
    monitor.note_acknowledgement(100 * MS, (math.nan, 0.0, 0.0))
    monitor.note_command((math.nan, 0.0, 0.0))
    assert monitor.is_answered()


def test_answer_of_another_time_is_no_answer():
    monitor = monitor_at(2)
    monitor.note_command(COMMAND)
    for stamp_ns in (50 * MS, 150 * MS, 0):
        monitor.note_acknowledgement(stamp_ns, COMMAND)
        assert not monitor.is_answered()


def test_answer_of_the_last_tick_does_not_answer_the_next():
    monitor = monitor_at(2)
    answer(monitor, 100 * MS, 100 * MS)
    assert monitor.is_answered()
    monitor.begin(3, 150 * MS, 100 * MS, 101.0)
    assert not monitor.is_answered()
    assert monitor.awaited().topic == "cmd_vel_nominal_stamped"


@pytest.mark.parametrize(("upto", "node"), [(i, CHAIN[i].node) for i in range(len(CHAIN))])
def test_first_stage_that_is_behind_is_named(upto, node):
    monitor = monitor_at(4)
    answer(monitor, 200 * MS, 200 * MS, upto)
    assert monitor.awaited().node == node
    report = monitor.stall_report(107.5)
    assert f"awaiting {CHAIN[upto].topic} by {node}; expected 0.200 s, none has come" in report
    assert "tick 4 (sim time 0.200 s) for 7.5 s" in report
    assert "\n" not in report


def test_newest_stamp_of_the_awaited_stage_is_told():
    monitor = monitor_at(4)
    answer(monitor, 150 * MS, 100 * MS)
    assert "safety/constraints by safety_reasoner; expected 0.200 s, newest 0.100 s" in monitor.stall_report(110.0)


def test_between_frames_the_stages_of_the_last_frame_are_up_to_date():
    monitor = monitor_at(4, frame_ns=150 * MS)
    answer(monitor, 200 * MS, 150 * MS, upto=3)
    assert monitor.awaited().node == "waypoint_controller"


def test_without_a_camera_only_controller_and_filter_are_awaited():
    monitor = monitor_at(4, frame_ns=0)
    assert monitor.awaited().node == "waypoint_controller"
    answer(monitor, 200 * MS, 0)
    assert monitor.is_answered()


def test_stall_counts_from_begin_on_the_given_clock():
    monitor = monitor_at(1, timeout_s=30.0)
    assert monitor.seconds_left(110.0) == 20.0
    assert monitor.seconds_left(131.0) < 0.0


def test_reset_forgets_and_stamps_may_go_back():
    monitor = monitor_at(100)
    answer(monitor, 5000 * MS, 5000 * MS)
    monitor.reset()
    monitor.begin(1, 50 * MS, 50 * MS, 0.0)
    monitor.note_acknowledgement(5000 * MS, COMMAND)
    monitor.note_command(COMMAND)
    assert not monitor.is_answered()
    answer(monitor, 50 * MS, 50 * MS)
    assert monitor.is_answered()


def test_header_stamp_is_read_from_raw_bytes():
    assert header_stamp_ns(struct.pack("<III", 7, 3, 250) + b"rest") == 3_000_000_250
    with pytest.raises(struct.error):
        header_stamp_ns(b"short")


def test_schedule_has_no_stamp_zero_and_frames_at_the_first_tick():
    schedule = Schedule(50 * MS, 2)
    assert [schedule.has_frame(k) for k in range(1, 6)] == [True, False, True, False, True]
    assert [schedule.frame_stamp_ns(k) // MS for k in range(1, 6)] == [50, 50, 150, 150, 250]
    assert all(schedule.stamp_ns(k) == k * 50 * MS for k in range(1, 100))
    assert Schedule(100 * MS, 1).frame_stamp_ns(7) == 700 * MS
    blind = Schedule(50 * MS, 0)
    assert not blind.has_frame(1)
    assert blind.frame_stamp_ns(5) == 0


def test_command_is_held_until_its_timeout_and_bad_ones_stand():
    hold = CommandHold(0.5)
    np.testing.assert_array_equal(hold.at(0.0), np.zeros(3))
    assert hold.update(COMMAND, 10.0)
    np.testing.assert_array_equal(hold.at(10.49), COMMAND)
    np.testing.assert_array_equal(hold.at(10.5), np.zeros(3))
    for bad in ((math.nan, 0, 0), (0, math.inf, 0), (0, 0, -math.inf)):
        hold.update(COMMAND, 11.0)
        assert not hold.update(bad, 11.1)
        np.testing.assert_array_equal(hold.at(11.1), np.zeros(3))


def test_pacer_keeps_the_rate_and_does_not_catch_up_long_lags():
    pacer = Pacer(2.0)
    assert pacer.compute_delay_s(1.0, 50.0) == 0.0
    assert pacer.compute_delay_s(2.0, 50.1) == pytest.approx(0.4)
    assert pacer.compute_delay_s(2.2, 50.7) == 0.0
    assert pacer.compute_delay_s(3.0, 60.0) == 0.0
    assert pacer.compute_delay_s(4.0, 60.0) == pytest.approx(0.5)
    assert Pacer(0.0).compute_delay_s(1e6, 0.0) == 0.0


def test_rtf_is_measured_over_windows_and_restarts_after_a_reset():
    meter = RtfMeter(1.0)
    assert meter.update(0.0, 10.0) is None
    assert meter.update(1.0, 10.5) is None
    assert meter.update(3.0, 11.0) == 3.0
    assert meter.update(0.1, 13.0) is None
    assert meter.update(0.6, 14.0) == pytest.approx(0.5)


def drive(control, done, ticks, resets):
    """A loop like the bridge's, in a thread."""
    while not done.is_set():
        if control.wait_for_turn(lambda: resets.append(len(ticks)), 0.02):
            ticks.append(time.monotonic())
            control.tick_done()


def test_run_control_steps_resets_pauses_and_ends():
    control, done, ticks, resets = RunControl(paused=True), threading.Event(), [], []
    loop = threading.Thread(target=drive, args=(control, done, ticks, resets))
    loop.start()
    try:
        assert control.step(5, 5.0) == ""
        assert len(ticks) == 5
        assert "allowed: >= 1" in control.step(0, 5.0)
        assert control.reset(5.0) == ""
        assert resets == [5]
        control.unpause()
        assert "allowed: step only while paused" in control.step(1, 5.0)
        deadline = time.monotonic() + 5.0
        while len(ticks) < 20 and time.monotonic() < deadline:
            time.sleep(0.001)
        assert len(ticks) >= 20
        control.pause()
        assert control.is_paused
        control.end()
        assert control.reset(5.0) == "the bridge is ending"
    finally:
        done.set()
        loop.join()


def test_request_that_nobody_obeys_times_out():
    assert RunControl(paused=True).step(1, 0.05) == "the step was not done within 0.05 s"


BAD_PARAMS = [
    ({"bakend": "pybullet"}, "~bakend: unknown parameter; allowed: backend"),
    ({"backend": "gazebo"}, "~backend: got 'gazebo'; allowed: pybullet, kinematic"),
    ({"renderer": "vulkan"}, "~renderer: got 'vulkan'; allowed: tiny, egl, none"),
    ({"seed": -1}, "~seed: got -1"),
    ({"seed": 1.5}, "~seed: got 1.5; allowed: a whole number"),
    ({"seed": True}, "~seed: got True; allowed: a whole number"),
    ({"rtf": -0.1}, "~rtf: got -0.1"),
    ({"rtf": math.nan}, "~rtf: got nan; allowed: a finite number"),
    ({"rtf": "fast"}, "~rtf: got 'fast'"),
    ({"lockstep": 1}, "~lockstep: got 1; allowed: true or false"),
    ({"lockstep": "true"}, "~lockstep: got 'true'"),
    ({"tick_rate_hz": 0}, "~tick_rate_hz: got 0"),
    ({"tick_rate_hz": 30}, "~tick_rate_hz: got 30"),
    ({"tick_rate_hz": math.inf}, "~tick_rate_hz: got inf"),
    ({"tick_rate_hz": 50}, "~tick_rate_hz: got 50"),
    ({"clock_rate_hz": 100}, "~clock_rate_hz: got 100"),
    ({"clock_rate_hz": 50}, "~clock_rate_hz: got 50"),
    ({"clock_rate_hz": 10}, "~clock_rate_hz: got 10"),
    ({"camera_rate_hz": -1}, "~camera_rate_hz: got -1"),
    ({"stall_timeout_s": 0}, "~stall_timeout_s: got 0"),
    ({"cmd_vel_timeout_s": -1}, "~cmd_vel_timeout_s: got -1"),
    ({"frame_prefix": "/a"}, "~frame_prefix: got '/a'"),
    ({"world": ""}, "~world: got ''"),
    ({"world": 3}, "~world: got 3; allowed: text"),
    ({"gui": True, "backend": "kinematic"}, "~gui: got True"),
]


@pytest.mark.parametrize(("values", "words"), BAD_PARAMS)
def test_bad_parameter_is_refused_in_one_line(values, words):
    with pytest.raises(ConfigError) as caught:
        BridgeParams.from_dict(values)
    assert words in str(caught.value)
    assert str(caught.value).startswith("world_bridge: ~")
    assert "\n" not in str(caught.value)


def test_good_parameters_are_taken_and_whole_numbers_pass_for_real_ones():
    assert BridgeParams.from_dict({"tick_rate_hz": 50, "clock_rate_hz": 100, "backend": "kinematic"})
    params = BridgeParams.from_dict({"rtf": 0, "tick_rate_hz": 10, "lockstep": True})
    assert (params.rtf, params.period_ns, params.frame_every(10.0), params.clock_steps_per_tick) == (
        0.0,
        100 * MS,
        1,
        8,
    )
    assert BridgeParams.from_dict({}) == BridgeParams()
    assert BridgeParams().frame_every(10.0) == 2
    assert BridgeParams(renderer="none").frame_every(10.0) == 0


@pytest.mark.parametrize("rate_hz", [15.0, 40.0, 3.0])
def test_camera_rate_must_divide_the_tick_rate(rate_hz):
    with pytest.raises(ConfigError, match="whole fraction of tick_rate_hz 20"):
        BridgeParams(camera_rate_hz=rate_hz).frame_every(10.0)

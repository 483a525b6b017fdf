# SPDX-License-Identifier: BSD-3-Clause
"""Emergency stop, override and tightening without ROS: what they allow, for how long, and what wins."""

import math
from dataclasses import asdict, replace

import numpy as np
import pytest
from control_support import CONE_LINE, make_inputs, make_params, make_wall

from core_control.cbf_filter import CbfFilter
from core_control.emergency_stop import EmergencyStop
from core_control.exceptions import OverrideError, ParameterError
from core_control.modes import Reason
from core_control.override import NEVER_OVERRIDDEN, Override, make_override_cap
from core_control.tightening import ONLY_UP, TIGHTENED, tighten
from core_control.types import FilterInputs, Mode

PARAMS = make_params()
AHEAD = (0.5, 0.0, 0.8)
AT_THE_WALL = make_wall(0.6)  # h < 0 at the origin
FREE = make_wall(4.0)
REQUEST = (Reason.E_STOP, "pressed")


# Emergency stop.


def test_nothing_heard_is_no_stop_unless_required():
    assert EmergencyStop(False, 1.0).find(5.0) == ""
    assert not EmergencyStop(False, 1.0).is_awaited
    required = EmergencyStop(True, 1.0)
    assert required.is_awaited
    required.receive(False, 5.0)
    assert not required.is_awaited
    assert required.find(5.5) == ""


def test_once_heard_its_silence_is_a_stop():
    e_stop = EmergencyStop(False, 1.0)
    e_stop.receive(False, 5.0)
    assert e_stop.find(6.0) == ""
    assert e_stop.find(6.01) == "e_stop was last heard 1.01 s ago, limit 1 s"
    assert e_stop.find(math.nan)
    e_stop.receive(False, 7.0)
    assert e_stop.find(7.5) == ""


def test_without_a_clock_silence_says_nothing_but_true_still_stops():
    e_stop = EmergencyStop(False, math.inf)
    e_stop.receive(False, 5.0)
    assert e_stop.find(1e9) == ""
    e_stop.receive(True, 6.0)
    assert e_stop.find(1e9) == "e_stop is true"


def test_a_stop_that_ends_before_the_next_tick_is_still_seen_by_it():
    e_stop = EmergencyStop(False, 1.0)
    e_stop.receive(True, 5.0)
    e_stop.receive(False, 5.01)
    assert e_stop.find(5.02) == "e_stop is true"
    assert e_stop.take(5.02) == "e_stop is true"
    assert e_stop.take(5.07) == ""


def test_a_signal_that_stands_asks_at_every_tick_and_a_press_once():
    e_stop = EmergencyStop(False, 1.0)
    e_stop.receive(True, 5.0)
    assert e_stop.take(5.1) == e_stop.take(5.2) == "e_stop is true"
    e_stop.receive(False, 5.3)
    assert e_stop.take(5.3) == ""
    e_stop.press("by hand")
    assert e_stop.take(5.4) == "by hand"
    assert e_stop.take(5.4) == ""


# What the filter makes of requests.


@pytest.mark.parametrize("enforce", [True, False])
@pytest.mark.parametrize("profile", ["core", "paper"])
def test_a_latched_request_wins_over_every_mode_until_reset(enforce, profile):
    filter_ = CbfFilter(make_params(enforce=enforce, profile=profile))
    for field, override_mps in ((FREE, None), (AT_THE_WALL, None), (FREE, 0.2), (AT_THE_WALL, 0.2)):
        inputs = make_inputs(AHEAD, field)
        driving = filter_.step(replace(inputs, override_mps=override_mps))
        assert driving.mode != Mode.STOPPED
        assert (driving.mode == Mode.OVERRIDE) == (override_mps is not None)
        pressed = filter_.step(replace(inputs, override_mps=override_mps, latch_request=REQUEST))
        later = filter_.step(replace(inputs, override_mps=override_mps))
        for result in (pressed, later):
            assert (result.mode, result.reason, result.latched) == (Mode.STOPPED, Reason.E_STOP, True)
            np.testing.assert_array_equal(result.u_safe, np.zeros(3))
        filter_.reset()


def test_an_emergency_stop_shows_although_something_else_was_latched_before():
    filter_ = CbfFilter(PARAMS)
    for reason in (Reason.MAP_LOST, Reason.INTERNAL_ERROR, Reason.E_STOP):
        filter_.latch("detail", reason)
        assert filter_.step(make_inputs(AHEAD, FREE)).reason == reason
    filter_.latch("later", Reason.INTERNAL_ERROR)
    assert filter_.step(make_inputs(AHEAD, FREE)).reason == Reason.E_STOP


@pytest.mark.parametrize("enforce", [True, False])
def test_a_stop_request_gives_zero_and_the_filter_goes_on_by_itself(enforce):
    filter_ = CbfFilter(make_params(enforce=enforce))
    request = (Reason.NOMINAL_PUBLISHERS, "two")
    result = filter_.step(make_inputs(AHEAD, FREE, stop_request=request, override_mps=0.2))
    assert (result.mode, result.reason, result.detail) == (Mode.STOPPED, *request)
    np.testing.assert_array_equal(result.u_safe, np.zeros(3))
    assert filter_.step(make_inputs(AHEAD, FREE)).mode != Mode.STOPPED


# Override.


def drive(filter_, inputs, ticks=40):
    return [filter_.step(inputs) for _ in range(ticks)]


@pytest.mark.parametrize("profile", ["core", "paper"])
@pytest.mark.parametrize("u", [AHEAD, (-0.5, 0.25, -0.8), (1e308, 1e308, 1e308), (0.05, 0.0, 0.1)])
def test_override_keeps_its_cap_the_limits_and_the_acceleration(profile, u):
    params = make_params(profile=profile, max_acceleration_mps2=0.5, max_yaw_acceleration_radps2=1.0)
    filter_ = CbfFilter(params)
    cap = make_override_cap(params, 5.0)
    results = drive(filter_, make_inputs(u, AT_THE_WALL, override_mps=5.0))
    commands = np.array([result.u_safe for result in results])
    assert {result.mode for result in results} == {Mode.OVERRIDE}
    assert {result.speed_cap_mps for result in results} == {0.2}
    assert np.all(np.hypot(commands[:, 0], commands[:, 1]) <= 0.2 + 1e-9)
    assert np.all(np.abs(commands[:, 2]) <= cap.yaw_rate_radps + 1e-9)
    assert cap.yaw_rate_radps == pytest.approx(0.8 * 0.2 / math.hypot(0.5, 0.25))
    if profile == "core":
        growth = np.abs(np.diff(np.vstack([np.zeros(3), commands]), axis=0))
        assert np.all(growth <= params.accelerations * params.control_period_s + 1e-9)
    if u == (0.05, 0.0, 0.1):
        np.testing.assert_array_equal(commands[-1], u)


def test_override_asks_for_less_than_its_largest_speed():
    result = drive(CbfFilter(PARAMS), make_inputs((0.5, 0.0, 0.0), FREE, override_mps=0.07))[-1]
    np.testing.assert_allclose(result.u_safe, [0.07, 0.0, 0.0], atol=1e-12)
    assert result.speed_cap_reason == "override"


def test_override_still_shows_h_and_the_rule():
    result = CbfFilter(PARAMS).step(make_inputs(AHEAD, AT_THE_WALL, override_mps=0.2))
    assert result.h_m < 0.0
    assert result.binding.cause == CONE_LINE
    assert result.gradient[0] == pytest.approx(-1.0)


@pytest.mark.parametrize("reason", [Reason.MAP_LOST, Reason.DEEP_INSIDE, Reason.ESCAPE_FAILED])
def test_override_drives_while_latched_and_the_latch_stays(reason):
    filter_ = CbfFilter(PARAMS)
    filter_.latch("why", reason)
    result = filter_.step(make_inputs(AHEAD, FREE, override_mps=0.2))
    assert (result.mode, result.latched) == (Mode.OVERRIDE, True)
    assert "why" in result.detail
    after = filter_.step(make_inputs(AHEAD, FREE))
    assert (after.mode, after.reason) == (Mode.STOPPED, reason)


@pytest.mark.parametrize("reason", NEVER_OVERRIDDEN)
def test_override_never_drives_past_these(reason):
    filter_ = CbfFilter(PARAMS)
    filter_.latch("why", reason)
    assert filter_.override_problem == f"{reason}: why"
    result = filter_.step(make_inputs(AHEAD, FREE, override_mps=0.2))
    assert (result.mode, result.reason) == (Mode.STOPPED, reason)


def test_override_drives_without_grid_odometry_and_constraints():
    u = make_inputs(AHEAD, FREE).u_nominal
    blind = FilterInputs(u_nominal=u, nominal_age_s=0.0, override_mps=0.2)
    stale = make_inputs(AHEAD, FREE, grid_age_s=9.0, odometry_age_s=9.0, constraints_age_s=99.0, override_mps=0.2)
    for inputs in (blind, stale):
        result = drive(CbfFilter(PARAMS), inputs)[-1]
        assert result.mode == Mode.OVERRIDE
        assert np.any(result.u_safe)
    assert drive(CbfFilter(PARAMS), stale)[-1].h_m > 0.0


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"nominal_age_s": 0.31}, Reason.NOMINAL_STALE),
        ({"nominal_planar": False}, Reason.NOMINAL_NOT_PLANAR),
        ({"u_nominal": np.array([math.nan, 0.0, 0.0])}, Reason.NOMINAL_NOT_FINITE),
        ({"u_nominal": None, "nominal_age_s": math.nan}, Reason.WAITING_FOR_NOMINAL),
    ],
)
def test_override_needs_a_command_that_can_be_used(changes, reason):
    result = CbfFilter(PARAMS).step(replace(make_inputs(AHEAD, FREE, override_mps=0.2), **changes))
    assert (result.mode, result.reason) == (Mode.STOPPED, reason)


def test_grant_lasts_as_long_as_asked_and_at_most_the_limit():
    override = Override(PARAMS)
    assert "0.2 m/s" in override.request(0.5, 100.0)
    assert override.read(50.0) == 0.5
    assert override.read(59.99) == 0.5
    assert override.read(60.0) is None
    assert override.read(50.5) is None
    override.request(0.1, 2.0)
    assert [override.read(t) is None for t in (70.0, 71.9, 72.0)] == [False, False, True]


def test_grant_ends_by_zero_by_end_and_when_time_goes_back():
    override = Override(PARAMS)
    assert override.request(0.1, 0.0) == "no override was running"
    override.request(0.1, 5.0)
    assert override.request(math.nan, 0.0) == "override ended"
    assert override.read(1.0) is None
    override.request(0.1, 5.0)
    override.end()
    assert not override.is_running
    override.request(0.1, 5.0)
    assert override.read(100.0) == 0.1
    assert override.read(99.0) is None
    assert override.read(100.0) is None


@pytest.mark.parametrize(
    ("speed_mps", "duration_s"),
    [(0.0, 1.0), (-0.1, 1.0), (math.nan, 1.0), (math.inf, 1.0), (0.1, -1.0), (0.1, math.nan), (0.1, math.inf)],
)
def test_bad_request_is_refused_and_what_runs_goes_on(speed_mps, duration_s):
    override = Override(PARAMS)
    override.request(0.15, 5.0)
    with pytest.raises(OverrideError, match="allowed a finite number"):
        override.request(speed_mps, duration_s)
    assert override.read(0.0) == 0.15


def test_a_fleet_can_forbid_overrides():
    override = Override(make_params(override_enabled=False))
    with pytest.raises(OverrideError, match="override_enabled"):
        override.request(0.1, 1.0)
    assert override.read(0.0) is None


# Tightening.


def tighter(key, params=PARAMS):
    return getattr(params, key) * (1.1 if key in ONLY_UP else 0.9)


def looser(key, params=PARAMS):
    return getattr(params, key) * (0.9 if key in ONLY_UP else 1.1)


@pytest.mark.parametrize("key", TIGHTENED)
def test_a_parameter_moves_to_less_and_back_but_never_beyond_its_start(key):
    changed = tighten(PARAMS, PARAMS, {key: tighter(key)})
    assert getattr(changed, key) == tighter(key)
    assert replace(changed, **{key: getattr(PARAMS, key)}) == PARAMS
    assert tighten(PARAMS, changed, {key: getattr(PARAMS, key)}) == PARAMS
    for current in (PARAMS, changed):
        with pytest.raises(ParameterError, match=f"{key}: .* its value at start; {getattr(current, key):g} stays"):
            tighten(PARAMS, current, {key: looser(key)})


@pytest.mark.parametrize("value", [math.nan, math.inf, -1.0, "0.1", True, None])
@pytest.mark.parametrize("key", TIGHTENED)
def test_a_value_that_makes_no_sense_is_refused(key, value):
    with pytest.raises(ParameterError):
        tighten(PARAMS, PARAMS, {key: value})


def test_a_key_of_another_kind_or_a_contradiction_is_refused():
    for wanted in ({"lag_s": 0.0}, {"no_such": 1.0}, {"max_vx_mps": 0.1, "profile": "paper"}):
        with pytest.raises(ParameterError, match="only at start"):
            tighten(PARAMS, PARAMS, wanted)
    with pytest.raises(ParameterError, match="constraints_fresh_s"):
        tighten(PARAMS, PARAMS, {"constraints_ttl_s": 5.0})
    assert tighten(PARAMS, PARAMS, {"constraints_ttl_s": 5.0, "constraints_fresh_s": 2.0}).constraints_ttl_s == 5.0


@pytest.mark.parametrize("profile", ["core", "paper"])
def test_a_tightened_filter_obeys_and_keeps_what_was_latched(profile):
    params = make_params(profile=profile, constraints_fresh_s=15.0)
    filter_ = CbfFilter(params)
    assert drive(filter_, make_inputs((0.5, 0.0, 0.0), FREE))[-1].u_safe[0] == pytest.approx(0.5)
    filter_.tighten(tighten(params, params, {"max_vx_mps": 0.2, "nominal_timeout_s": 0.1, "constraints_fresh_s": 1.0}))
    assert filter_.step(make_inputs((0.5, 0.0, 0.0), FREE)).u_safe[0] == pytest.approx(0.2)
    assert filter_.step(make_inputs(AHEAD, FREE, nominal_age_s=0.2)).reason == Reason.NOMINAL_STALE
    assert filter_.step(make_inputs(AHEAD, FREE, constraints_age_s=8.0)).speed_cap_reason == "constraints_age"
    filter_.latch("why", Reason.MAP_LOST)
    filter_.tighten(params)
    assert filter_.step(make_inputs(AHEAD, FREE)).reason == Reason.MAP_LOST
    filter_.reset()
    assert drive(filter_, make_inputs((0.5, 0.0, 0.0), FREE))[-1].u_safe[0] == pytest.approx(0.5)


@pytest.mark.parametrize("kinematics", ["holonomic", "differential"])
@pytest.mark.parametrize(("key", "value"), [("alpha_per_s", 0.5), ("margin_m", 0.2)])
def test_a_tighter_barrier_is_that_of_a_filter_started_with_it(key, value, kinematics):
    params = make_params(kinematics=kinematics)
    inputs = make_inputs((0.5, 0.0, 0.0), make_wall(1.0), twist=(0.2, 0.0, 0.0))
    filter_, fresh = CbfFilter(params), CbfFilter(make_params(kinematics=kinematics, **{key: value}))
    before = drive(filter_, inputs)[-1].u_safe[0]
    filter_.tighten(tighten(params, params, {key: value}))
    after = drive(filter_, inputs)[-1].u_safe[0]
    assert 0.0 <= after < 0.9 * before
    assert after == pytest.approx(drive(fresh, inputs)[-1].u_safe[0], abs=1e-9)


def test_parameters_survive_the_way_through_a_dictionary():
    params = make_params(discs=[[0.1, -0.2, 0.3]], footprint={"length_m": 0.7})
    assert type(params).from_dict(asdict(params)) == params

# SPDX-License-Identifier: BSD-3-Clause
"""Round trips between messages and the library's types, with NaN, infinity and messages that contradict themselves."""

import io
import math

import numpy as np
import pytest
import rospy
from control_support import AROUND_PERSON, make_grid, make_inputs, make_params, make_random_mask, make_wall
from core_msgs.msg import FilterState, SafetyGrid, Tick
from geometry_msgs.msg import Twist, TwistStamped, Vector3
from nav_msgs.msg import Odometry
from ros_support import grid_to_msg
from rospy.numpy_msg import numpy_msg

from core_control.cbf_filter import CbfFilter
from core_control.modes import Reason
from core_control.params import MarkerParams
from core_control.ros.conversions import (
    grid_from_msg,
    is_planar,
    odometry_from_msg,
    odometry_to_msg,
    state_to_msg,
    twist_from_msg,
    twist_to_msg,
)
from core_control.ros.diagnostics import make_diagnostics
from core_control.ros.latest_inputs import LatestInputs
from core_control.ros.lockstep_inputs import LockstepInputs
from core_control.ros.markers import make_markers
from core_control.types import CellState, Mode


def over_the_wire(message, message_class):
    buffer = io.BytesIO()
    message.serialize(buffer)
    return message_class().deserialize(buffer.getvalue())


def grid_over_numpy(message):
    buffer = io.BytesIO()
    message.serialize(buffer)
    received = numpy_msg(SafetyGrid)()
    received.deserialize(buffer.getvalue())
    return received


@pytest.mark.parametrize("u", [(0.1, -0.2, 0.3), (0.0, 0.0, 0.0), (1e308, -1e-300, 5.0)])
def test_twist_round_trip(u):
    np.testing.assert_array_equal(twist_from_msg(over_the_wire(twist_to_msg(u), Twist)), u)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("part", ["linear", "angular"])
@pytest.mark.parametrize("axis", "xyz")
def test_one_bad_entry_makes_the_whole_command_bad(value, part, axis):
    message = Twist()
    setattr(getattr(message, part), axis, value)
    assert np.isnan(twist_from_msg(message)).all()


def test_commands_outside_the_plane_are_noticed():
    assert is_planar(Twist(Vector3(1, 2, 0), Vector3(0, 0, 3)))
    assert not is_planar(Twist(Vector3(0, 0, 0.1), Vector3()))
    assert not is_planar(Twist(Vector3(), Vector3(0.1, 0, 0)))


@pytest.mark.parametrize("yaw_rad", [0.0, 1.0, -3.0, 3.14])
def test_odometry_round_trip(yaw_rad):
    pose, twist = odometry_from_msg(odometry_to_msg(np.array([1.0, -2.0, yaw_rad]), np.array([0.1, 0.2, 0.3])))
    np.testing.assert_allclose(pose, [1.0, -2.0, yaw_rad], atol=1e-12)
    np.testing.assert_array_equal(twist, [0.1, 0.2, 0.3])


@pytest.mark.parametrize("w", [0.0, math.nan, math.inf])
def test_odometry_without_a_direction_is_not_finite(w):
    message = odometry_to_msg(np.zeros(3), np.zeros(3))
    message.pose.pose.orientation.w = w
    assert not np.isfinite(odometry_from_msg(message)[0]).all()


@pytest.mark.parametrize("receive", [lambda m: over_the_wire(m, SafetyGrid), grid_over_numpy, lambda m: m])
def test_grid_round_trip(receive):
    state = np.array([[CellState.SAFE, CellState.UNSAFE, CellState.UNKNOWN], [0, 0, 1]], dtype=np.uint8)
    h_m = np.array([[0.5, np.nan, np.inf], [-np.inf, -0.25, 0.0]])
    grid = make_grid(state == 1, state=state, h_m=h_m, unknown_is_unsafe=False, origin_m=(-1.0, 2.0))
    message = receive(grid_to_msg(grid, rospy.Time(12, 500_000_000), rospy.Time(11)))
    back = grid_from_msg(message)
    for name in ("state", "h_m", "cause", "origin_m"):
        np.testing.assert_array_equal(getattr(back, name), getattr(grid, name))
    assert (back.frame_id, back.stamp_s, back.constraints_stamp_s) == ("odom", 12.5, 11.0)
    assert (back.resolution_m, back.unknown_is_unsafe, back.causes) == (0.1, False, grid.causes)


@pytest.mark.parametrize("name", ["h_m", "state", "cause"])
def test_grid_of_the_wrong_length_is_refused(name):
    message = grid_to_msg(make_grid(np.zeros((3, 4), bool)), rospy.Time(), rospy.Time())
    setattr(message, name, getattr(message, name)[:-1])
    with pytest.raises(ValueError, match="11 entries, grid is 4 x 3"):
        grid_from_msg(message)


@pytest.mark.parametrize("receive", [lambda m: over_the_wire(m, SafetyGrid), grid_over_numpy, lambda m: m])
def test_speed_caps_come_through_and_may_be_left_out(receive):
    caps_mps = np.array([[np.nan, 0.25, 0.0, np.nan], [0.5, np.nan, np.nan, np.nan]])
    grid = make_grid(np.zeros((2, 4), bool), speed_cap_mps=caps_mps, causes=(AROUND_PERSON,))
    back = grid_from_msg(receive(grid_to_msg(grid, rospy.Time(), rospy.Time())))
    np.testing.assert_array_equal(back.speed_cap_mps, caps_mps)
    assert back.causes == (AROUND_PERSON,)
    none = receive(grid_to_msg(make_grid(np.zeros((2, 4), bool)), rospy.Time(), rospy.Time()))
    assert grid_from_msg(none).speed_cap_mps is None


@pytest.mark.parametrize("caps_mps", [[0.2] * 11, [0.2] * 13, [-0.1] + [0.2] * 11, [math.inf] * 12, [-math.inf] * 12])
def test_speed_caps_that_make_no_sense_make_the_grid_malformed(caps_mps):
    inputs, message = LatestInputs(), grid_to_msg(make_grid(np.zeros((3, 4), bool)), rospy.Time(), rospy.Time(1))
    message.speed_cap_mps = caps_mps
    inputs.store("grid", over_the_wire(message, SafetyGrid), 0.0)
    read = inputs.read(0.0, 2.0)
    assert (read.field, read.grid_problem[0]) == (None, Reason.GRID_MALFORMED)
    assert "speed_cap_mps" in read.grid_problem[1]


def test_state_says_what_the_filter_did():
    inputs = make_inputs((0.5, 0, 0), make_wall(2.0), (2.0 - 0.677 - 0.16, 0, 0), nominal_age_s=0.01)
    result = CbfFilter(make_params()).step(inputs)
    state = over_the_wire(state_to_msg(result, inputs, rospy.Time(3), 60), FilterState)
    assert (state.header.stamp, state.header.frame_id, state.tick) == (rospy.Time(3), "odom", 60)
    assert (state.mode, state.reason) == (FilterState.FILTERED, "")
    assert (state.binding_rule, state.binding_class) == ("BETWEEN(traffic_cone)", "traffic_cone")
    np.testing.assert_array_equal(state.u_safe, result.u_safe)
    np.testing.assert_array_equal(state.gradient, result.gradient)
    assert (state.h_m, state.nominal_age_s, state.rows) == (result.h_m, 0.01, result.rows)
    assert state.speed_cap_mps == math.inf


@pytest.mark.parametrize(("age_s", "cap_mps"), [(11.25, 0.5 * math.hypot(0.5, 0.25)), (16.0, 0.0)])
def test_state_and_diagnostics_tell_the_cap(age_s, cap_mps):
    inputs = make_inputs((0.5, 0, 0), make_wall(2.0), constraints_age_s=age_s)
    result = CbfFilter(make_params()).step(inputs)
    state = over_the_wire(state_to_msg(result, inputs, rospy.Time(3), 60), FilterState)
    assert state.speed_cap_mps == pytest.approx(cap_mps)
    values = make_diagnostics(result, "/cbf_filter", 7, rospy.Time(1)).status[0].values
    assert {value.key: value.value for value in values}["speed_cap_mps"] == f"{cap_mps:.3f}"


def test_state_of_a_filter_that_knows_nothing():
    inputs = LatestInputs().read(0.0, 0.0)
    state = over_the_wire(state_to_msg(CbfFilter(make_params()).step(inputs), inputs, rospy.Time(), 0), FilterState)
    assert (state.mode, state.reason) == (FilterState.STOPPED, Reason.WAITING_FOR_NOMINAL)
    assert math.isnan(state.h_m)
    assert math.isnan(state.grid_age_s)
    assert list(state.u_safe) == [0.0, 0.0, 0.0]


@pytest.mark.parametrize("mode", list(Mode))
def test_modes_have_the_numbers_of_the_message(mode):
    assert getattr(FilterState, mode.name) == mode


@pytest.mark.parametrize("state", list(CellState))
def test_cell_states_have_the_numbers_of_the_message(state):
    assert getattr(SafetyGrid, state.name) == state


@pytest.mark.parametrize("u_nominal", [(0.5, 0, 0), (0, 0, 0), (np.nan, 0, 0)])
def test_markers_and_diagnostics_of_any_state_can_be_sent(u_nominal):
    inputs = make_inputs(u_nominal, make_wall(2.0), (1.2, 0, 0))
    result = CbfFilter(make_params()).step(inputs)
    markers = make_markers(state_to_msg(result, inputs, rospy.Time(1), 1), inputs.pose, MarkerParams())
    assert len({(marker.ns, marker.id) for marker in markers.markers}) == len(markers.markers) == 6
    over_the_wire(markers, type(markers))
    diagnostics = make_diagnostics(result, "/cbf_filter", 7, rospy.Time(1))
    over_the_wire(diagnostics, type(diagnostics))


# Ages and the matching of stamps.


def make_stamped(message_class, seconds):
    message = message_class()
    message.header.stamp = rospy.Time.from_sec(seconds)
    return message


def test_age_is_the_larger_of_stamp_and_receipt():
    inputs = LatestInputs()
    inputs.store("odometry", make_stamped(Odometry, 10.0), receipt_s=100.0, stamp_s=10.0)
    assert inputs.read(100.1, 10.5).odometry_age_s == pytest.approx(0.5)
    assert inputs.read(101.0, 10.5).odometry_age_s == pytest.approx(1.0)
    inputs.store("nominal", Twist(), receipt_s=101.0)
    assert inputs.read(101.2, 99.0).nominal_age_s == pytest.approx(0.2)


def test_stamp_far_in_the_future_is_not_covered_up_by_a_fresh_receipt():
    inputs = LatestInputs()
    inputs.store("odometry", make_stamped(Odometry, 10.0), receipt_s=100.0, stamp_s=10.0)
    assert inputs.read(100.1, 9.9).odometry_age_s == pytest.approx(0.1)
    inputs = LatestInputs()
    inputs.store("odometry", make_stamped(Odometry, 13.0), receipt_s=100.0, stamp_s=13.0)
    assert inputs.read(100.1, 10.0).odometry_age_s == pytest.approx(-3.0)


def test_time_that_jumps_back_makes_everything_unknown():
    inputs = LatestInputs()
    inputs.store("nominal", Twist(), receipt_s=1.0)
    assert inputs.read(1.0, 50.0).u_nominal is not None
    assert inputs.jumped_back(2.0)
    assert inputs.read(1.1, 2.0).u_nominal is None


def test_malformed_grid_is_a_reason_and_not_an_exception():
    inputs, message = LatestInputs(), grid_to_msg(make_grid(np.zeros((3, 4), bool)), rospy.Time(), rospy.Time(1))
    message.width = 5
    inputs.store("grid", message, 0.0)
    read = inputs.read(0.0, 2.0)
    assert read.field is None
    assert read.grid_problem[0] == Reason.GRID_MALFORMED


def test_constraints_age_comes_from_the_grid():
    for constraints_s, expected in ((0.0, math.nan), (3.0, 7.0), (12.0, -2.0)):
        inputs = LatestInputs()
        stamps = rospy.Time.from_sec(9.0), rospy.Time.from_sec(constraints_s)
        inputs.store("grid", grid_to_msg(make_grid(np.zeros((3, 4), bool)), *stamps), 0.0, 9.0)
        np.testing.assert_equal(inputs.read(0.0, 10.0).constraints_age_s, expected)


def store_all(inputs, seconds, frame_s, skip=()):
    """Store everything of one tick in an order that leaves the tick first."""
    tick = make_stamped(Tick, seconds)
    tick.frame_stamp = rospy.Time.from_sec(frame_s)
    reset = inputs.store_tick(tick)
    grid = grid_to_msg(make_grid(make_random_mask(np.random.default_rng(0), 10)), tick.frame_stamp, rospy.Time(1))
    messages = {
        "odometry": odometry_to_msg(np.zeros(3), np.zeros(3)),
        "nominal": make_stamped(TwistStamped, seconds),
        "grid": grid,
    }
    messages["odometry"].header.stamp = tick.header.stamp
    for name, message in messages.items():
        if name not in skip:
            assert inputs.take() is None
            inputs.store(name, message)
    return reset


@pytest.mark.parametrize("missing", ["odometry", "nominal", "grid"])
def test_a_tick_waits_for_everything_made_for_it(missing):
    inputs = LockstepInputs()
    store_all(inputs, 0.05, 0.0, skip=(missing,))
    assert inputs.take() is None


def test_a_tick_is_given_once_with_its_ages():
    inputs = LockstepInputs()
    store_all(inputs, 3.05, 3.0)
    tick, read = inputs.take()
    assert tick.header.stamp == rospy.Time.from_sec(3.05)
    assert (read.nominal_age_s, read.odometry_age_s) == (0.0, 0.0)
    assert read.grid_age_s == pytest.approx(0.05)
    assert read.constraints_age_s == pytest.approx(2.05)
    assert inputs.take() is None
    assert not inputs.store_tick(tick)
    assert inputs.take() is None


def test_a_grid_serves_every_tick_of_its_frame():
    inputs = LockstepInputs()
    store_all(inputs, 3.0, 3.0)
    assert inputs.take() is not None
    store_all(inputs, 3.05, 3.0, skip=("grid",))
    assert inputs.take() is not None


def test_a_reset_of_time_starts_over():
    inputs = LockstepInputs()
    store_all(inputs, 3.0, 3.0)
    inputs.take()
    assert store_all(inputs, 0.0, 0.0)
    assert inputs.take() is not None


def test_field_is_built_once_per_grid():
    inputs = LatestInputs()
    inputs.store("grid", grid_to_msg(make_grid(np.zeros((3, 4), bool)), rospy.Time(), rospy.Time(1)), 0.0)
    assert inputs.read(0.0, 2.0).field is inputs.read(0.1, 2.1).field

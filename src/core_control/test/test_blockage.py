# SPDX-License-Identifier: BSD-3-Clause
"""The stuck detector: when it speaks, what it names, how often, and that neither it nor the filter flaps."""

from dataclasses import replace

import numpy as np
import pytest
from control_support import Plant, make_field, make_inputs, make_params, make_wall

from core_control.blockage import StuckDetector
from core_control.cbf_filter import CbfFilter
from core_control.modes import Reason
from core_control.types import Binding, Cause, FilterResult, Mode

PARAMS = make_params()
AHEAD, REST = np.array([0.4, 0.0, 0.0]), np.zeros(3)
PERSON, CONE = Binding(Cause("AROUND(person)", "person", 7), (3.1, 0.42), 5), Binding(Cause("METRIC", "cone"), (1, 2))


def make_result(u_safe=REST, u_nominal=AHEAD, binding=PERSON, **changes):
    return FilterResult(Mode.FILTERED, np.array(u_safe), np.array(u_nominal), binding=binding, **changes)


def run(detector, count, **changes):
    return [detector.step(make_result(**changes)) for _ in range(count)]


def find_events(results):
    return [(i, result.blocked_event) for i, result in enumerate(results) if result.blocked_event is not None]


def make_blocked():
    detector = StuckDetector(PARAMS)
    assert run(detector, 40)[-1].blocked_event.active
    return detector


def test_a_held_robot_is_told_after_two_seconds_then_once_a_second_then_once_when_it_is_over():
    detector = StuckDetector(PARAMS)
    held = run(detector, 90)
    assert [i for i, _ in find_events(held)] == [39, 59, 79]
    assert all(event.active for _, event in find_events(held))
    assert (held[38].blocked_s, held[39].blocked_s) == (0.0, pytest.approx(2.0))
    assert held[83].blocked_s == pytest.approx(4.2)
    assert held[83].detail == "blocked by AROUND(person) at (3.10, 0.42) for 4.2 s"
    event = find_events(held)[0][1]
    assert (event.binding, event.reason, event.duration_s) == (PERSON, "", pytest.approx(2.0))
    free = run(detector, 40, u_safe=AHEAD, binding=None)
    [(when, over)] = find_events(free)
    assert when <= 10
    assert not over.active
    assert over.words.startswith("no longer blocked by AROUND(person)")
    assert free[-1].blocked_s == 0.0
    assert not free[-1].detail


@pytest.mark.parametrize(
    ("changes", "blocked"),
    [
        ({"u_safe": [0.07, 0.0, 0.0]}, True),
        ({"u_safe": [0.09, 0.0, 0.0]}, False),
        ({"u_safe": [0.0, 0.25, 0.0]}, True),
        ({"u_safe": [-0.2, 0.0, 0.0]}, True),
        ({"u_nominal": [0.03, 0.0, 0.0], "u_safe": [0.019, 0.0, 0.0]}, True),
        ({"u_nominal": [0.0, 0.0, 0.5]}, True),
        ({"u_nominal": [0.0, 0.0, 0.5], "u_safe": [0.0, 0.0, 0.2]}, False),
        ({"u_nominal": [0.019, 0.0, 0.019]}, False),
        ({"u_nominal": [np.nan, 0.0, 0.0], "reason": Reason.NOMINAL_NOT_FINITE}, False),
        ({"u_nominal": [1e308, 0.0, 0.0]}, True),
        ({"reason": Reason.NOMINAL_STALE, "binding": None}, False),
        ({"reason": Reason.GRID_STALE, "binding": None}, True),
    ],
)
def test_blocked_is_asked_and_not_let(changes, blocked):
    assert (run(StuckDetector(PARAMS), 60, **changes)[-1].blocked_s > 0.0) == blocked


def test_progress_is_averaged():
    detector = StuckDetector(PARAMS)
    results = [detector.step(make_result(u_safe=AHEAD if i % 8 == 0 else REST)) for i in range(80)]
    assert results[-1].blocked_s > 0.0
    detector = StuckDetector(PARAMS)
    results = [detector.step(make_result(u_safe=AHEAD if i % 4 == 0 else REST)) for i in range(80)]
    assert results[-1].blocked_s == 0.0


def test_a_pause_of_the_command_does_not_end_it_but_silence_does():
    detector = make_blocked()
    assert not find_events(run(detector, 9, u_nominal=REST))
    assert run(detector, 1)[-1].blocked_s > 2.0
    [(when, over)] = find_events(run(detector, 30, u_nominal=REST))
    assert (when, over.active) == (9, False)
    assert not find_events(run(detector, 39)), "it begins anew"


def test_another_place_is_named_when_it_has_lasted():
    detector = make_blocked()
    [(when, event)] = find_events(run(detector, 12, binding=CONE))
    assert (when, event.binding) == (9, CONE)
    assert event.duration_s > 2.4
    assert "METRIC cone" in event.words


def test_places_that_take_turns_do_not_flap():
    detector = make_blocked()
    results = [detector.step(make_result(binding=CONE if i % 4 else PERSON)) for i in range(100)]
    assert {event.binding.cause for _, event in find_events(results)} == {PERSON.cause}
    assert len(find_events(results)) == 5


def test_a_point_that_wanders_is_no_other_place_and_is_kept_up_to_date():
    detector = make_blocked()
    results = [detector.step(make_result(binding=replace(PERSON, point_m=(3.0, 0.1 * i)))) for i in range(20)]
    [(when, event)] = find_events(results)
    assert (when, event.binding.point_m[1]) == (19, pytest.approx(1.9))


def test_a_stop_and_a_cap_are_named_by_their_reason():
    for changes in ({"reason": Reason.GRID_STALE}, {"speed_cap_reason": "slow_region"}):
        event = run(StuckDetector(PARAMS), 40, binding=None, **changes)[-1].blocked_event
        assert (event.binding, event.reason) == (None, next(iter(changes.values())))
        assert event.words == f"blocked by {event.reason} for 2.0 s"


def test_a_reset_ends_it():
    detector = make_blocked()
    detector.reset()
    assert not run(detector, 1)[0].blocked_event.active
    assert not find_events(run(detector, 38))


def test_the_filter_itself_says_what_blocks_it():
    filter_, field = CbfFilter(PARAMS), make_wall(2.0)
    inputs = make_inputs(AHEAD, field, (2.0 - 0.677 - 0.151, 0, 0))
    results = [filter_.step(inputs) for _ in range(60)]
    [first, second] = find_events(results)
    assert (first[0], second[0]) == (39, 59)
    assert first[1].words == "blocked by BETWEEN(traffic_cone) at (2.00, 0.00) for 2.0 s"
    assert results[-1].detail.endswith("for 3.0 s")
    filter_.reset()
    assert not filter_.step(inputs).blocked_event.active


# Flapping.


@pytest.mark.parametrize("angle_rad", [0.0, 0.3])
@pytest.mark.parametrize("start_m", [-0.05, 0.05, 0.15, 0.4])
@pytest.mark.parametrize("seed", range(2))
def test_noise_of_one_centimetre_in_h_does_not_make_it_switch_more_than_once_a_second(start_m, angle_rad, seed):
    """The wall is seen 1 cm (sigma) nearer or farther ten times a second; counted from the first rest on."""
    rng, filter_ = np.random.default_rng([7, seed]), CbfFilter(PARAMS)
    reach_m = 0.367 * np.cos(angle_rad) + 0.31
    plant, moving = Plant((2.0 - reach_m - start_m, 0.0, angle_rad)), []
    for tick in range(300):
        if tick % 2 == 0:
            unsafe = np.zeros((50, 50), dtype=bool)
            unsafe[:, 45:] = True
            field = make_field(unsafe, resolution_m=0.2, origin_m=(-7.0 + rng.normal(0.0, 0.01), -5.0))
        result = filter_.step(make_inputs((0.4, 0.0, 0.0), field, plant.pose, plant.twist))
        plant.step(result.u_safe)
        moving.append(bool(np.any(result.u_safe)))
    switches = np.abs(np.diff(np.array(moving, dtype=int)))
    per_second = np.convolve(switches, np.ones(20), "valid")
    assert per_second.max() <= 1, "times in one second"

# SPDX-License-Identifier: BSD-3-Clause
"""The cap that falls with the age of the constraints: its laws, and the filter through an outage of the reasoner."""

import os
from dataclasses import replace

import numpy as np
import pytest
from control_support import Plant, make_field, make_inputs, make_params, make_random_mask, make_wall, start_anew

from core_control.barriers.half_planes import HalfPlaneBarrier
from core_control.cbf_filter import CbfFilter
from core_control.modes import Reason
from core_control.proposal import Proposal, scale_to_limits
from core_control.speed_cap import NO_CAP, AgeLimiter, SpeedCap
from core_control.types import Clearance, Mode

SEED = int(os.environ.get("CORE_SEED", "0"))
FRESH_S, TTL_S = 7.5, 15.0
PARAMS = make_params()
MAX_SPEED_MPS = float(np.hypot(0.5, 0.25))
# Without slew, so that a command shows the cap alone.
AT_ONCE = {"max_acceleration_mps2": 100.0, "max_yaw_acceleration_radps2": 100.0}
PAPER = {"profile": "paper", "alpha_per_s": 0.25, "output_rate_hz": 10.0}
PROFILES = [pytest.param({}, id="core"), pytest.param(PAPER, id="paper")]
FREE = make_field(np.zeros((100, 100), bool), h_m=np.full((100, 100), 10.0))
AHEAD = np.array([0.4, 0.0, 0.0])
OUTAGE_AGES_S = np.arange(6.0, 16.0, 0.05)


def get_speed(u):
    return float(np.hypot(u[0], u[1]))


def draw_commands(count, seed=0):
    rng = np.random.default_rng([SEED, seed])
    for _ in range(count):
        u = rng.uniform(-1.0, 1.0, 3) * PARAMS.limits
        yield u * (rng.random(3) < 0.7), rng


def step_through(filter_, ages_s, u=AHEAD, field=FREE, **changes):
    return [filter_.step(make_inputs(u, field, constraints_age_s=age_s, **changes)) for age_s in ages_s]


# The cap by itself.


@pytest.mark.parametrize("age_s", [-0.2, 0.0, 3.0, FRESH_S])
def test_fresh_constraints_have_no_cap(age_s):
    assert AgeLimiter(PARAMS).compute_cap(age_s) == NO_CAP


@pytest.mark.parametrize("age_s", [TTL_S, 15.1, 1e9, np.inf, np.nan, -0.21, -60.0, -np.inf])
def test_old_missing_or_future_constraints_allow_nothing(age_s):
    assert AgeLimiter(PARAMS).compute_cap(age_s) == SpeedCap(0.0, 0.0)


@pytest.mark.parametrize(("age_s", "share"), [(9.0, 0.8), (11.25, 0.5), (13.5, 0.2)])
def test_the_cap_falls_on_a_line_from_the_limits_to_zero(age_s, share):
    cap = AgeLimiter(PARAMS).compute_cap(age_s)
    assert cap.speed_mps == pytest.approx(share * MAX_SPEED_MPS)
    assert cap.yaw_rate_radps == pytest.approx(share * 0.8)


@pytest.mark.parametrize("changes", [{"constraints_fresh_s": 15.0}, {"require_constraints": False}, {"enforce": False}])
def test_there_is_no_cap_where_none_is_asked_for(changes):
    limiter = AgeLimiter(make_params(**changes))
    for age_s in (8.0, 14.9, TTL_S):
        assert limiter.compute_cap(age_s) == NO_CAP


def test_the_cap_may_begin_at_once():
    assert AgeLimiter(make_params(constraints_fresh_s=0.0)).compute_cap(7.5).speed_mps == pytest.approx(
        0.5 * MAX_SPEED_MPS
    )


def test_fuzz_the_cap_never_rises_with_age_and_never_jumps():
    rng = np.random.default_rng([SEED, 1])
    for _ in range(50):
        ttl_s = rng.uniform(1.0, 60.0)
        params = make_params(constraints_fresh_s=rng.uniform(0.0, 0.95) * ttl_s, constraints_ttl_s=ttl_s)
        limiter, ages_s = AgeLimiter(params), np.linspace(0.0, 1.1 * ttl_s, 2001)
        caps = [limiter.compute_cap(age_s) for age_s in ages_s]
        assert all(later.speed_mps <= cap.speed_mps for cap, later in zip(caps, caps[1:]))
        assert all(later.yaw_rate_radps <= cap.yaw_rate_radps for cap, later in zip(caps, caps[1:]))
        steepest = (ages_s[1] - ages_s[0]) / (ttl_s - params.constraints_fresh_s)
        u = rng.choice([-1.0, 1.0], 3) * params.limits
        sent = np.array([cap.limit(u) for cap in caps])
        assert np.abs(np.diff(sent, axis=0) / params.limits).max() <= steepest * (1.0 + 1e-6)
        np.testing.assert_array_equal(sent[0], u)
        np.testing.assert_array_equal(sent[-1], np.zeros(3))


def test_fuzz_a_capped_command_keeps_its_direction_and_is_no_slower_than_needed():
    changed = 0
    for u, rng in draw_commands(500):
        cap = SpeedCap(rng.uniform(0.0, 0.6), rng.uniform(0.0, 0.9))
        capped = cap.limit(u)
        assert cap.allows(capped)
        np.testing.assert_allclose(np.cross(capped, u), np.zeros(3), atol=1e-12)
        assert capped @ u >= 0.0
        if capped is not u:
            changed += 1
            assert not cap.allows(u)
            used = get_speed(capped) / cap.speed_mps, abs(capped[2]) / cap.yaw_rate_radps
            assert max(used) == pytest.approx(1.0)
    assert 100 < changed < 490


@pytest.mark.parametrize("u", [(1e308, 1e308, 0.0), (1e200, 0.0, 1e-200), (0.0, 0.0, 1e308), (1e-308, 0.0, 0.0)])
@pytest.mark.parametrize("cap", [SpeedCap(0.0, 0.0), SpeedCap(0.1, 0.1), NO_CAP])
def test_wild_numbers_stay_finite_and_within_the_cap(u, cap):
    capped = cap.limit(np.array(u))
    assert np.isfinite(capped).all()
    assert cap.allows(capped)


def test_a_command_within_the_cap_is_left_alone_to_the_last_bit():
    u = np.array([0.1, 0.0, -0.1])
    assert SpeedCap(0.2, 0.2).limit(u) is u


# The filter, stepped.


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("u", [(0.4, 0, 0), (-0.3, 0.2, 0), (0, 0, 0.7), (0.4, 0.1, -0.6), (0.5, 0.25, 0.8)])
def test_the_command_falls_steadily_to_zero_and_comes_back_by_itself(profile, u):
    filter_, u = CbfFilter(make_params(**profile, constraints_fresh_s=FRESH_S)), np.array(u, dtype=float)
    step_through(filter_, [0.0] * 10, u)  # up to speed
    results = step_through(filter_, OUTAGE_AGES_S, u)
    sizes = np.array([np.linalg.norm(result.u_safe) for result in results])
    assert results[0].mode == Mode.NOMINAL
    assert np.all(np.diff(sizes) <= 1e-12)
    assert np.all(sizes[OUTAGE_AGES_S >= TTL_S] == 0.0)
    for age_s, result in zip(OUTAGE_AGES_S, results):
        np.testing.assert_allclose(np.cross(result.u_safe, u), np.zeros(3), atol=1e-12)
        assert get_speed(result.u_safe) <= result.speed_cap_mps * (1.0 + 1e-9)
        if FRESH_S < age_s < TTL_S:
            assert result.speed_cap_mps == pytest.approx(MAX_SPEED_MPS * (TTL_S - age_s) / 7.5)
            assert abs(result.u_safe[2]) <= 0.8 * (TTL_S - age_s) / 7.5 * (1.0 + 1e-9)
    assert (results[-1].mode, results[-1].reason) == (Mode.STOPPED, Reason.CONSTRAINTS_STALE)
    back = step_through(filter_, [0.5] * 10, u)
    assert back[0].mode == (Mode.FILTERED if filter_._params.profile == "core" else Mode.NOMINAL)
    np.testing.assert_allclose(back[-1].u_safe, u, atol=1e-12)
    assert back[-1].speed_cap_mps == np.inf


@pytest.mark.parametrize("profile", PROFILES)
def test_no_step_of_the_command_is_larger_than_the_dead_band_or_the_slope(profile):
    params = make_params(**profile, constraints_fresh_s=FRESH_S)
    filter_ = CbfFilter(params)
    step_through(filter_, [0.0] * 10, (0.5, 0.25, 0.0))
    speeds = [get_speed(result.u_safe) for result in step_through(filter_, OUTAGE_AGES_S, (0.5, 0.25, 0.0))]
    slope = MAX_SPEED_MPS * 0.05 / 7.5
    assert np.abs(np.diff(speeds)).max() <= params.dead_band_mps + slope + 1e-9


def test_the_papers_profile_keeps_its_speed_until_the_constraints_are_too_old():
    filter_ = CbfFilter(make_params(**PAPER, constraints_fresh_s=TTL_S))
    for result in step_through(filter_, OUTAGE_AGES_S[OUTAGE_AGES_S <= TTL_S]):
        assert (result.mode, result.speed_cap_mps) == (Mode.NOMINAL, np.inf)
        np.testing.assert_array_equal(result.u_safe, AHEAD)
    assert step_through(filter_, [15.01])[0].reason == Reason.CONSTRAINTS_STALE


@pytest.mark.parametrize("profile", PROFILES)
def test_slowing_is_explained_and_is_no_reason_to_stop(profile):
    filter_ = CbfFilter(make_params(**profile, **AT_ONCE, constraints_fresh_s=FRESH_S))
    (slowed,) = step_through(filter_, [11.3])
    assert (slowed.mode, slowed.reason) == (Mode.FILTERED, "")
    assert slowed.detail == "slowed: constraints are 11.3 s old"
    np.testing.assert_allclose(slowed.u_safe, [MAX_SPEED_MPS * 3.7 / 7.5, 0, 0])
    (resting,) = step_through(filter_, [14.9])
    assert (resting.mode, resting.reason) == (Mode.FILTERED, "")
    assert resting.detail == "slowed to rest: constraints are 14.9 s old"
    np.testing.assert_array_equal(resting.u_safe, np.zeros(3))


@pytest.mark.parametrize("profile", PROFILES)
def test_a_command_slower_than_the_cap_passes_untouched(profile):
    filter_, u = CbfFilter(make_params(**profile, **AT_ONCE, constraints_fresh_s=FRESH_S)), np.array([0.1, 0.0, 0.1])
    (result,) = step_through(filter_, [11.0], u)
    assert (result.mode, result.detail) == (Mode.NOMINAL, "")
    np.testing.assert_array_equal(result.u_safe, u)
    assert result.speed_cap_mps == pytest.approx(MAX_SPEED_MPS * 4.0 / 7.5)


@pytest.mark.parametrize("profile", PROFILES)
def test_near_the_end_it_rests_and_does_not_flicker(profile):
    """Replies that come at the brink and a noisy nominal command: one transition to rest, none back."""
    rng = np.random.default_rng([SEED, 2])
    filter_ = CbfFilter(make_params(**profile, constraints_fresh_s=FRESH_S))
    ages_s = np.concatenate([np.arange(13.0, 14.9, 0.05), 14.6 + 0.35 * rng.random(300), [15.2] * 5, [14.5] * 50])
    speeds = []
    for age_s in ages_s:
        u = AHEAD * rng.choice([0.05, 0.1, 1.0])
        speeds.append(get_speed(filter_.step(make_inputs(u, FREE, constraints_age_s=age_s)).u_safe))
    moving = np.array(speeds) > 0.0
    assert moving[0]
    assert not moving[-1]
    assert np.count_nonzero(np.diff(moving.astype(int))) == 1


def test_rest_ends_when_the_cap_leaves_more_than_the_release():
    filter_ = CbfFilter(make_params(**AT_ONCE))
    release_age_s = TTL_S - 7.5 * 0.08 / MAX_SPEED_MPS
    rest, still, go = step_through(filter_, [14.9, release_age_s + 0.01, release_age_s - 0.01])
    assert (get_speed(rest.u_safe), get_speed(still.u_safe)) == (0.0, 0.0)
    assert get_speed(go.u_safe) == pytest.approx(0.08, rel=0.02)


@pytest.mark.parametrize("end", ["fresh", "reset", "forget"])
def test_rest_is_forgotten_with_fresh_constraints_reset_and_jumps_of_time(end):
    filter_ = CbfFilter(make_params(**AT_ONCE))
    step_through(filter_, [14.9])
    if end == "fresh":
        step_through(filter_, [1.0])
    else:
        getattr(filter_, end)()
    (result,) = step_through(filter_, [14.5])
    assert get_speed(result.u_safe) == pytest.approx(MAX_SPEED_MPS * 0.5 / 7.5)


def test_small_commands_of_their_own_are_no_matter_of_the_dead_band():
    (result,) = step_through(CbfFilter(PARAMS), [11.0], (0.01, 0.0, 0.01))
    np.testing.assert_array_equal(result.u_safe, [0.01, 0.0, 0.01])


@pytest.mark.parametrize(
    ("age_s", "changes", "expected"),
    [
        (3.0, {}, np.inf),
        (15.1, {}, 0.0),
        (np.nan, {}, 0.0),
        (11.25, {"grid_age_s": 9.0}, 0.5 * MAX_SPEED_MPS),
        (11.25, {"u_nominal": None}, 0.5 * MAX_SPEED_MPS),
    ],
)
def test_the_cap_is_reported_whether_it_moves_or_stands(age_s, changes, expected):
    result = CbfFilter(PARAMS).step(replace(make_inputs(AHEAD, FREE, constraints_age_s=age_s), **changes))
    assert result.speed_cap_mps == pytest.approx(expected)


def test_switched_off_it_passes_the_command_whatever_the_age():
    (result,) = step_through(CbfFilter(make_params(enforce=False)), [14.0])
    np.testing.assert_array_equal(result.u_safe, AHEAD)
    assert (result.mode, result.speed_cap_mps) == (Mode.DISABLED, np.inf)


def test_a_profile_that_answers_faster_than_the_cap_never_reaches_the_robot():
    filter_ = CbfFilter(PARAMS)
    filter_._profile.propose = lambda _: Proposal(np.array([0.4, 0.0, 0.0]), Clearance(1.0, np.zeros(2)))
    fresh, old = step_through(filter_, [1.0, 14.0])
    assert fresh.mode == Mode.NOMINAL
    assert (old.mode, old.reason) == (Mode.STOPPED, Reason.INTERNAL_ERROR)
    assert "exceeds the speed cap" in old.detail
    np.testing.assert_array_equal(old.u_safe, np.zeros(3))


def test_fuzz_slowed_answers_satisfy_every_row_and_the_cap():
    # With these two the program likes to trade turning for speed: its answer must be capped again.
    params = make_params(**AT_ONCE, slide_ratio=50.0, yaw_weight_m=3.0)
    barrier = HalfPlaneBarrier(params.disc_array, 2.5, 0.15, params.limits, params.rows_per_disc)
    filter_, answers, too_fast = CbfFilter(params), [], 0
    solve = filter_._profile._qp.solve
    filter_._profile._qp.solve = lambda *problem: answers.append(solve(*problem)) or answers[-1]
    for u, rng in draw_commands(150, 3):
        field = make_field(make_random_mask(rng, 60))
        pose = np.append(rng.uniform(-2.8, 2.8, 2), rng.uniform(-np.pi, np.pi))
        age_s = rng.uniform(8.0, 14.5)
        cap = AgeLimiter(params).compute_cap(age_s)
        start_anew(filter_)
        answers.clear()
        result = filter_.step(make_inputs(np.copysign(params.limits, u), field, pose, constraints_age_s=age_s))
        assert result.mode in (Mode.NOMINAL, Mode.FILTERED, Mode.HOLD)
        assert cap.allows(result.u_safe)
        rows = barrier.compute_rows(field, pose)
        assert np.all(rows.a @ result.u_safe >= rows.b - 2e-5)
        too_fast += any(not cap.allows(answer) for answer in answers)
    assert too_fast > 5


def test_the_papers_escape_from_the_unsafe_set_is_capped_too():
    """Outside the safe set the printed row asks for motion by itself; however old the constraints are it stays slow."""
    unsafe = np.zeros((40, 40), bool)
    unsafe[:, 20:] = True
    field = make_field(unsafe, h_m=np.where(unsafe, -1.0, 1.0))
    filter_ = CbfFilter(make_params(**PAPER, constraints_fresh_s=FRESH_S))
    free, capped = step_through(filter_, [1.0, 14.0], np.zeros(3), field, pose=np.array([0.5, 0.05, 0.0]))
    assert get_speed(free.u_safe) > 0.2
    assert get_speed(capped.u_safe) == pytest.approx(MAX_SPEED_MPS / 7.5)
    assert "slowed: constraints are 14.0 s old" in capped.detail


def test_pushed_against_a_barrier_while_slowed_both_are_named_and_it_stays_outside():
    filter_, field, plant = CbfFilter(PARAMS), make_wall(2.0), Plant((0.9, 0.0, 0.0))
    details = []
    for k in range(160):
        inputs = make_inputs(AHEAD, field, plant.pose, plant.twist, constraints_age_s=6.0 + 0.05 * k)
        result = filter_.step(inputs)
        plant.step(result.u_safe)
        details.append(result.detail)
        assert result.h_m > 0.1
    assert any("BETWEEN(traffic_cone)" in text and "slowed: constraints are" in text for text in details)


def test_limits_and_cap_commute():
    for u, rng in draw_commands(100, 4):
        cap = SpeedCap(rng.uniform(0.0, 0.6), rng.uniform(0.0, 0.9))
        wild = u * 5.0
        np.testing.assert_allclose(
            scale_to_limits(cap.limit(wild), PARAMS.limits), cap.limit(scale_to_limits(wild, PARAMS.limits)), atol=1e-15
        )

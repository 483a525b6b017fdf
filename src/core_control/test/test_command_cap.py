# SPDX-License-Identifier: BSD-3-Clause
"""The cap of one tick: it tightens with every command it is shown, never widens, and tells what it comes from."""

import numpy as np
import pytest
from control_support import make_params

from core_control.command_cap import CommandCap
from core_control.speed_cap import NO_CAP, CapReason, SpeedCap

PARAMS = make_params()
AHEAD, BACK = np.array([0.4, 0.0, 0.2]), np.array([-0.4, 0.0, 0.2])


def make_cap(ahead=(), back=(), age_cap=NO_CAP, age_s=0.0):
    """A cap of (speed, reason, words) for each way."""
    return CommandCap(age_cap, age_s, lambda u: ahead if u[0] > 0.0 else back, PARAMS)


def test_without_any_cap_every_command_is_left_alone():
    cap = make_cap()
    assert cap.limit(AHEAD) is AHEAD
    assert (cap.speed_mps, cap.reason, cap.has_slowed) == (np.inf, "", False)


def test_it_tightens_with_each_command_and_never_widens():
    cap = make_cap([(0.3, "slow_region", " by A")], [(0.2, "unseen_heading", ": not seen")])
    np.testing.assert_allclose(cap.limit(AHEAD), AHEAD * 0.75)
    assert (cap.speed_mps, cap.reason, cap.describe(rests=False)) == (0.3, "slow_region", "slowed to 0.3 m/s by A")
    np.testing.assert_allclose(cap.limit(BACK), BACK * 0.5)
    np.testing.assert_allclose(cap.limit(AHEAD), AHEAD * 0.5)
    assert (cap.speed_mps, cap.reason) == (0.2, "unseen_heading")
    assert cap.describe(rests=False) == "slowed to 0.2 m/s: not seen"
    assert not cap.allows(AHEAD * 0.75)


def test_of_several_caps_the_smallest_holds():
    cap = make_cap([(0.3, "slow_region", " by A"), (0.1, "unseen_heading", ""), (0.2, "slow_region", " by B")])
    np.testing.assert_allclose(cap.limit(AHEAD), AHEAD * 0.25)
    assert cap.reason == "unseen_heading"


def test_the_cap_on_turning_that_comes_with_age_stays():
    cap = make_cap([(0.3, "slow_region", " by A")], age_cap=SpeedCap(0.35, 0.1), age_s=9.0)
    assert cap.reason == CapReason.CONSTRAINTS_AGE
    np.testing.assert_allclose(cap.limit(np.array([0.2, 0.0, 0.2])), [0.1, 0.0, 0.1])
    np.testing.assert_allclose(cap.limit(np.array([0.0, 0.0, 0.2])), [0.0, 0.0, 0.1])


@pytest.mark.parametrize(("speed_mps", "sent"), [(0.01, np.zeros(3)), (0.05, AHEAD * 0.125)])
def test_what_a_place_leaves_below_the_dead_band_is_zero(speed_mps, sent):
    np.testing.assert_allclose(make_cap([(speed_mps, "slow_region", " by A")]).limit(AHEAD), sent)


def test_age_alone_leaves_the_dead_band_to_the_limiter():
    np.testing.assert_allclose(make_cap(age_cap=SpeedCap(0.01, 0.02)).limit(AHEAD), AHEAD / 40.0)


def test_words_are_taken_as_they_are():
    cap = make_cap([(0.2, "slow_region", " by AROUND({how}%s)")])
    cap.limit(AHEAD)
    assert cap.describe(rests=True) == "slowed to rest by AROUND({how}%s)"


@pytest.mark.parametrize("u", [(1e308, 0.0, 0.0), (np.nan, 0.0, 0.0)])
def test_a_wild_command_is_looked_at_within_the_limits(u):
    shown = []
    with np.errstate(all="ignore"):
        CommandCap(NO_CAP, 0.0, lambda v: shown.append(v) or (), PARAMS).limit(np.array(u))
    assert len(shown) == 1
    assert np.isnan(u[0]) or np.all(np.abs(shown[0]) <= PARAMS.limits)

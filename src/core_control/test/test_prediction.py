# SPDX-License-Identifier: BSD-3-Clause
"""The sampled motion of the verifier: that of the plant, and samples no farther apart than the verifier allows for."""

import numpy as np
import pytest
from control_support import integrate_lag

from core_control.dynamics import place_discs
from core_control.params import FilterParams
from core_control.prediction import make_schedule
from core_control.rollout import SAMPLE_S, RollOut

PARAMS = FilterParams()
LAGS_S = (0.0, 0.08, 0.3, 1.0)


def draw(rng):
    """Pose, twist and four commands within the limits."""
    pose = np.append(rng.uniform(-3, 3, 2), rng.uniform(-np.pi, np.pi))
    return pose, rng.uniform(-1, 1, 3) * PARAMS.limits, rng.uniform(-1, 1, (4, 3)) * PARAMS.limits


@pytest.mark.parametrize("lag_s", LAGS_S)
def test_the_motion_is_that_of_fine_steps(lag_s):
    rng, durations_s, stop_s = np.random.default_rng(0), (0.03, 0.05, 0.05, 0.05), 5.0 * lag_s
    schedule = make_schedule(durations_s, stop_s, lag_s, SAMPLE_S)
    for _ in range(20):
        pose, twist, commands = draw(rng)
        poses = schedule.predict(pose, twist, commands)
        ends = np.cumsum([round(duration_s / SAMPLE_S) for duration_s in durations_s]) - 1
        for end, u, duration_s in zip([*ends, -1], [*commands, np.zeros(3)], [*durations_s, stop_s]):
            if duration_s > 0.0:
                fine, twist = integrate_lag(pose, twist, u, duration_s * np.arange(1, 2001) / 2000, lag_s)
                pose = fine[-1]
            np.testing.assert_allclose(poses[end, :2], pose[:2], atol=3e-5)
            assert poses[end, 2] == pytest.approx(pose[2], abs=1e-9)


@pytest.mark.parametrize("lag_s", LAGS_S)
def test_between_two_samples_no_disc_moves_farther_than_the_verifier_allows_for(lag_s):
    rng, discs = np.random.default_rng(1), PARAMS.disc_array
    roll_out = RollOut(discs, lag_s, PARAMS.control_period_s, 0.0, PARAMS.limits)
    allowed_m = SAMPLE_S * (np.hypot(*PARAMS.limits[:2]) + PARAMS.limits[2] * np.hypot(discs[:, 0], discs[:, 1]).max())
    longest_m = 0.0
    for _ in range(200):
        pose, twist, commands = draw(rng)
        extreme = np.sign(commands) * PARAMS.limits
        pending = [(u, PARAMS.control_period_s) for u in extreme[:2]]
        poses = np.concatenate(
            [pose[None], roll_out.predict(pose, np.sign(twist) * PARAMS.limits, pending, extreme[2])]
        )
        longest_m = max(longest_m, np.linalg.norm(np.diff(place_discs(poses, discs), axis=0), axis=2).max())
    assert 0.5 * allowed_m < longest_m <= allowed_m + 1e-9

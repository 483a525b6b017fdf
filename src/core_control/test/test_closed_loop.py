# SPDX-License-Identifier: BSD-3-Clause
"""Soundness: random grids, random and adversarial commands, the shipped filter, exact motion with lag; no violation.

The truth is the robot's rectangle against the unsafe squares. The paper's profile goes through such episodes as a point
and must fail, or the test would prove nothing.
"""

import numpy as np
import pytest
from control_support import (
    Driver,
    Plant,
    draw_safe_pose,
    footprint_overlaps,
    make_field,
    make_inputs,
    make_params,
    make_random_mask,
)

from core_control.barriers.half_planes import HalfPlaneBarrier
from core_control.cbf_filter import CbfFilter
from core_control.types import Mode

STEPS = 200


def run_episode(seed, params, is_violated, lag_s=0.08, delay_ticks=0, last_age_s=0.0):
    """(violating steps, steps in which the command passed, reasons); the constraints age evenly up to last_age_s."""
    rng = np.random.default_rng(seed)
    field = make_field(make_random_mask(rng))
    barrier = HalfPlaneBarrier(params.disc_array, 2.5, 0.15, params.limits, 8)
    pose = draw_safe_pose(rng, field, lambda p: barrier.compute_clearance(field, p).h_m)
    if pose is None:
        return 0, 0, set()
    filter_, driver = CbfFilter(params), Driver(rng, params.limits)
    plant = Plant(pose, lag_s, delay_ticks, params.control_period_s)
    violations, moved, reasons = 0, 0, set()
    for age_s in np.linspace(0.0, last_age_s, STEPS):
        u = driver.step(plant.pose, field)
        result = filter_.step(make_inputs(u, field, plant.pose, plant.twist, constraints_age_s=age_s))
        violations += any(is_violated(field, p) for p in plant.step(result.u_safe)[4::5])
        moved += bool(np.any(result.u_safe))
        reasons |= {result.reason} - {""} if result.mode == Mode.STOPPED else set()
    return violations, moved, reasons


def run_episodes(seeds, params, is_violated=footprint_overlaps, **plant):
    results = [run_episode([77, seed], params, is_violated, **plant) for seed in seeds]
    reasons = set().union(*(result[2] for result in results))
    return sum(result[0] for result in results), sum(result[1] for result in results), reasons


@pytest.mark.parametrize(
    ("seeds", "changes", "plant"),
    [
        (range(60), {}, {}),
        (range(60, 80), {"lag_s": 0.3, "delay_s": 0.1}, {"lag_s": 0.3, "delay_ticks": 2}),
        (range(80, 100), {"margin_m": 0.04, "alpha_per_s": 10.0, "solver": "cvxpy"}, {}),
        (range(100, 120), {"constraints_fresh_s": 0.0}, {"last_age_s": 14.0}),
    ],
    ids=["default", "lag_and_delay", "small_margin", "aging_constraints"],
)
def test_footprint_never_enters_an_unsafe_cell(seeds, changes, plant):
    violations, moved, reasons = run_episodes(seeds, make_params(**changes), **plant)
    assert violations == 0
    assert moved > 0.4 * len(seeds) * STEPS
    assert not reasons


def test_the_papers_form_does_enter():
    params = make_params(profile="paper", alpha_per_s=0.25, output_rate_hz=10.0)

    def point_is_inside(field, pose):
        return bool(field.is_inside(pose[None, :2])[0])

    # The episodes send h of the core profile, exact at cell centres: kinder to the paper than its own cell-to-cell one.
    violations, _, _ = run_episodes(range(10), params, point_is_inside, lag_s=0.0)
    assert violations > 0

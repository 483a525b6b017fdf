# SPDX-License-Identifier: BSD-3-Clause
"""Depth completion: finds the scale, refuses where it cannot, and never touches or invents what it must not."""

import math
import re

import numpy as np
import pytest
from depth_scenes import make_room, predict, sense

from core_perception.depth_completion import CompletionLimits, DepthCompleter, Outcome, find_holes, is_plausible_metric
from core_perception.exceptions import EvidenceError
from core_perception.scale_fit import FitLimits, NoFit, Prediction, fit_scale, select_returns

SEEDS = range(30)
LIMITS = CompletionLimits()


@pytest.fixture(params=SEEDS)
def random(request):
    return np.random.RandomState(request.param)


def complete(sensed, values, kind="relative", confidence=None, stamp_s=1.0, limits=LIMITS):
    return DepthCompleter(limits).complete(sensed, Prediction(values, kind, confidence), stamp_s)


def spoil(random, sensed, share, factor=(1.5, 3.0)):
    """Gross outliers, all too far: the worst case for a median."""
    wrong = random.uniform(size=sensed.shape) < share
    return np.where(wrong, sensed * random.uniform(*factor, sensed.shape), sensed).astype(np.float32), wrong


def test_scale_is_found_within_3_percent_with_30_percent_gross_outliers(random):
    depth = make_room(random).depth_m
    scale = math.exp(random.uniform(-3.0, 3.0))
    sensed, _ = spoil(random, sense(random, depth), 0.3)
    result = complete(sensed, predict(random, depth, scale))
    assert result.outcome is Outcome.FILLED, result.reason
    assert abs(math.log(result.scale / scale)) < 0.03
    assert 0.6 < result.fit.inlier_ratio < 0.9  # outliers beyond fit_max_m are not counted
    assert result.fit.mad < 0.05


def test_scale_is_found_from_one_return_in_a_hundred(random):
    depth = make_room(random).depth_m
    sparse = np.where(random.uniform(size=depth.shape) < 0.01, depth, np.nan)
    sparse *= 1.0 + 0.02 * random.normal(size=depth.shape)
    result = complete(sparse.astype(np.float32), predict(random, depth, 7.0))
    assert result.outcome is Outcome.FILLED, result.reason
    assert abs(math.log(result.scale / 7.0)) < 0.03
    assert result.filled > 0.4 * result.holes
    error = np.abs(np.log(result.depth_m / depth))[find_holes(sparse) & ~np.isnan(result.depth_m)]
    assert np.median(error) < 0.05


def test_disparity_is_put_into_metres_by_its_own_scale_and_shift(random):
    depth = make_room(random).depth_m
    sensed, _ = spoil(random, sense(random, depth), 0.2)
    a, b = math.exp(random.uniform(-2.0, 2.0)), random.uniform(-0.05, 0.3)
    values = ((1.0 / depth - b) / a).astype(np.float32)  # 1/d = a p + b
    result = complete(sensed, values, "disparity")
    assert result.outcome is Outcome.FILLED, result.reason
    filled = find_holes(sensed) & ~np.isnan(result.depth_m)
    assert filled.sum() > 1000
    assert np.median(np.abs(np.log(result.depth_m / depth))[filled]) < 0.03


def test_disparity_taken_for_depth_is_refused(random):
    depth = make_room(random).depth_m
    assert complete(sense(random, depth), 1.0 / depth).outcome is Outcome.PASSED
    assert complete(sense(random, depth), depth, "disparity").outcome is Outcome.PASSED


def test_what_the_sensor_says_is_never_changed(random):
    depth = make_room(random).depth_m
    sensed, _ = spoil(random, sense(random, depth), 0.2)
    sensed[:5, :5], sensed[:5, 5:10], sensed[:5, 10:15] = np.inf, -np.inf, 25.0  # nothing there; too near; far away
    sensed[5:8, :5] = 0.05
    for values in (predict(random, depth, 3.0), np.full(depth.shape, 0.4, np.float32)):
        result = complete(sensed, values)
        said = ~find_holes(sensed)
        assert np.array_equal(result.depth_m[said], sensed[said])
        assert result.filled == (~np.isnan(result.depth_m)).sum() - said.sum()
        assert result.holes == (~said).sum()


def test_filled_values_lie_between_inlier_returns_around_them(random):
    depth = make_room(random).depth_m
    sensed = sense(random, depth)
    result = complete(sensed, predict(random, depth, 0.5))
    filled = np.argwhere(find_holes(sensed) & ~np.isnan(result.depth_m))
    assert len(filled) > 500
    radius = round(LIMITS.support_radius * depth.shape[1])
    for v, u in filled[:: max(1, len(filled) // 200)]:
        around = sensed[max(0, v - radius) : v + radius + 1, max(0, u - radius) : u + radius + 1]
        around = around[~np.isnan(around)]
        assert 0.9 * around.min() - 1e-4 <= result.depth_m[v, u] <= 1.1 * around.max() + 1e-4


def test_a_hole_among_returns_that_contradict_the_model_stays_a_hole():
    random = np.random.RandomState(0)
    depth = make_room(random).depth_m
    sensed = sense(random, depth, holes=0.0, patches=0)
    values = depth / 2.0
    sensed[100:200, 100:200] *= 0.7  # a pane the model looks through
    sensed[140:150, 140:150] = np.nan
    result = complete(sensed, values)
    assert result.outcome is Outcome.FILLED
    assert np.isnan(result.depth_m[140:150, 140:150]).all()
    sensed[100:200, 100:200] /= 0.7
    assert not np.isnan(complete(sensed, values).depth_m[140:150, 140:150]).all()


def test_nothing_is_filled_where_the_model_looks_through_an_open_hole():
    """The sensor gives nothing on a glass door, the model paints the room behind: farther than all returns around."""
    sensed = np.full((240, 320), 2.0, np.float32)
    sensed[80:160, 120:200] = np.nan
    values = np.full((240, 320), 2.0, np.float32)
    values[80:160, 120:200] = 5.0
    result = complete(sensed, values, "metric")
    assert result.outcome is Outcome.FILLED
    assert result.filled == 0


def test_the_middle_of_a_hole_wider_than_the_support_stays_a_hole():
    sensed = np.full((240, 320), 2.0, np.float32)
    sensed[60:180, 100:220] = np.nan
    result = complete(sensed, np.full((240, 320), 2.0, np.float32))
    assert np.isnan(result.depth_m[100:140, 140:180]).all()
    assert not np.isnan(result.depth_m[62:70, 120:200]).any()


def test_what_is_nearer_than_or_beyond_the_range_is_not_filled():
    limits = CompletionLimits(fit=FitLimits(fit_min_m=0.5, fit_max_m=4.0), support_range=1.0)
    sensed = np.full((240, 320), 3.9, np.float32)
    sensed[100:110, 100:120] = np.nan
    values = np.full((240, 320), 3.9, np.float32)
    values[100:110, 100:110], values[100:110, 110:120] = 4.3, 3.8
    result = complete(sensed, values, limits=limits)
    assert np.isnan(result.depth_m[100:110, 100:109]).all()
    assert not np.isnan(result.depth_m[100:110, 112:120]).any()


def test_the_model_is_believed_only_where_it_is_as_sure_as_where_it_was_borne_out():
    sensed = np.full((240, 320), 2.0, np.float32)
    sensed[100:110, 100:120] = np.nan
    confidence = np.ones((240, 320), np.float32)
    confidence[100:110, 100:110] = 0.2
    result = complete(sensed, np.full((240, 320), 1.0, np.float32), confidence=confidence)
    assert np.isnan(result.depth_m[100:110, 100:110]).all()
    assert not np.isnan(result.depth_m[100:110, 110:120]).any()


REFUSALS = [
    ("returns", lambda r, s: np.where(r.uniform(size=s.shape) < 100 / s.size, s, np.nan), r"\d+ usable sensor returns"),
    ("none", lambda _r, s: np.full_like(s, np.nan), "0 usable sensor returns"),
    ("corner", lambda _r, s: np.pad(s[:50, :70], ((0, 190), (0, 250)), constant_values=np.nan), "parts of the image"),
    ("noise", lambda r, s: r.uniform(0.5, 8.0, s.shape), "agree with the model|differ by"),
]


@pytest.mark.parametrize(("spoil_sensor", "words"), [case[1:] for case in REFUSALS], ids=[case[0] for case in REFUSALS])
def test_a_frame_without_a_fit_passes_unchanged_and_says_why(random, spoil_sensor, words):
    depth = make_room(random).depth_m
    sensed = spoil_sensor(random, np.nan_to_num(depth, nan=3.0)).astype(np.float32)
    result = complete(sensed, predict(random, depth, 2.0))
    assert result.outcome is Outcome.PASSED
    assert np.array_equal(result.depth_m, sensed, equal_nan=True)
    assert result.filled == 0
    assert result.scale is None
    assert re.search(words, result.reason), result.reason


def test_zero_of_the_sensor_becomes_nan_when_passed_on():
    sensed = np.zeros((24, 32), np.float32)
    assert np.isnan(complete(sensed, np.ones((24, 32), np.float32)).depth_m).all()


@pytest.fixture
def sequence():
    """Steps of one completer over one scene: step(stamp_s, scale, sensed=…)."""
    random = np.random.RandomState(5)
    depth = make_room(random).depth_m
    completer, usual = DepthCompleter(LIMITS), sense(random, depth)

    def step(stamp_s, scale, sensed=usual):
        return completer.complete(sensed, Prediction(depth / np.float32(scale)), stamp_s)

    return step, usual


def test_a_scale_that_jumps_is_refused_until_it_lasts(sequence):
    step, _ = sequence
    for k in range(9):
        assert step(0.1 * k, 2.0).outcome is Outcome.FILLED
    jumped = step(1.0, 2.6)
    assert "jumped from 2 to 2.6" in jumped.reason
    assert jumped.filled == 0
    outcomes = [step(1.0 + 0.1 * k, 2.6).outcome is Outcome.FILLED for k in range(1, 9)]
    assert outcomes == [False] * 4 + [True] * 4
    assert step(3.0, 2.3).outcome is Outcome.FILLED  # 12 % is no jump


def test_the_last_scale_serves_for_a_bounded_time(sequence):
    step, usual = sequence
    few = usual.copy()
    few[:, 80:] = np.nan
    few[60:] = np.nan
    assert step(1.0, 2.0).outcome is Outcome.FILLED
    kept = step(3.0, 2.0, few)
    assert kept.outcome is Outcome.KEPT_SCALE
    assert abs(kept.scale / 2.0 - 1.0) < 0.02
    assert kept.filled > 0
    assert "parts of the image" in kept.reason
    late = step(3.01, 2.0, few)
    assert late.outcome is Outcome.PASSED
    assert late.filled == 0


def test_a_kept_scale_fills_nothing_without_returns(sequence):
    step, usual = sequence
    step(1.0, 2.0)
    result = step(1.1, 2.0, np.full_like(usual, np.nan))
    assert result.outcome is Outcome.KEPT_SCALE
    assert result.filled == 0


def test_a_stamp_that_goes_back_forgets_the_scale(sequence):
    step, usual = sequence
    for k in range(9):
        step(10.0 + k, 2.0)
    assert step(1.0, 5.0).outcome is Outcome.FILLED
    step(20.0, 5.0)
    assert step(2.0, 5.0, np.full_like(usual, np.nan)).outcome is Outcome.PASSED


def test_a_prediction_of_another_size_is_resized_and_of_another_shape_refused():
    random = np.random.RandomState(1)
    depth = make_room(random).depth_m
    sensed = sense(random, depth)
    assert complete(sensed, depth[::2, ::2]).outcome is Outcome.FILLED
    for shape in [(240, 240), (240, 340), (0, 0), (320, 240)]:
        with pytest.raises(EvidenceError, match="prediction: got"):
            complete(sensed, np.ones(shape, np.float32))
    with pytest.raises(EvidenceError, match="confidence"):
        complete(sensed, depth, confidence=depth[::2])


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 0.0, -1.0])
@pytest.mark.parametrize("kind", ["relative", "metric", "disparity"])
def test_a_prediction_of_nothing_passes_the_sensor(value, kind):
    sensed = sense(np.random.RandomState(2), make_room(np.random.RandomState(2)).depth_m)
    result = complete(sensed, np.full(sensed.shape, value, np.float32), kind)
    assert result.outcome is Outcome.PASSED
    assert np.array_equal(result.depth_m, sensed, equal_nan=True)


def test_edges_of_the_prediction_are_not_compared():
    depth = np.full((100, 100), 2.0)
    depth[:, 50:] = 4.0
    valid = select_returns(depth, depth, None, FitLimits())
    assert not valid[:, 49:51].any()
    assert valid[:, :49].all()
    assert valid[:, 51:].all()


def test_returns_that_agree_with_nothing_do_not_widen_their_own_gate():
    random = np.random.RandomState(0)
    sensed = np.where(random.uniform(size=(100, 100)) < 0.55, 2.0, random.uniform(4.0, 8.0, (100, 100)))
    fit = fit_scale(sensed, np.full((100, 100), 2.0), np.ones((100, 100), bool), FitLimits())
    assert isinstance(fit, NoFit)
    assert "55%" in fit.reason or "54%" in fit.reason or "56%" in fit.reason


def test_a_metric_model_that_needs_a_large_scale_is_told():
    assert is_plausible_metric(1.4)
    assert is_plausible_metric(0.7)
    assert not is_plausible_metric(1.6)
    assert not is_plausible_metric(0.6)

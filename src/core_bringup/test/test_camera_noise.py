# SPDX-License-Identifier: BSD-3-Clause
"""Noise of the camera: its size is what it says, it repeats, it is fast, and it is off where it should be."""

import time

import numpy as np

from core_bringup.camera_noise import add_camera_noise
from core_bringup.world_types import CameraNoise

RNG = np.random.default_rng(0)
COLOR = RNG.integers(60, 200, (320, 500, 3)).astype(np.uint8)
DEPTH = RNG.uniform(0.3, 9.0, (320, 500)).astype(np.float32)
DEPTH[:40] = np.nan
NOISE = CameraNoise(color_sigma=0.02, depth_sigma_per_m2=0.003, depth_dropout=0.05, seed=7)


def test_spread_is_that_of_the_formula():
    color, depth = add_camera_noise(COLOR, DEPTH, NOISE, 1000)
    change = (color.astype(float) - COLOR) / 255.0
    assert abs(change.std() / 0.02 - 1.0) < 0.03
    assert abs(change.mean()) < 3e-4
    hit = ~np.isnan(DEPTH)
    lost = hit & (depth == 0.0)
    assert abs(lost.sum() / hit.sum() - 0.05) < 0.005
    seen = hit & ~lost
    n = ((depth - DEPTH) / (0.003 * DEPTH**2))[seen]
    assert abs(n.std() - 1.0) < 0.02
    assert abs(n.mean()) < 0.02
    np.testing.assert_array_equal(np.isnan(depth), ~hit)
    assert (color.dtype, depth.dtype) == (np.uint8, np.float32)


def test_seed_and_stamp_give_the_same_bits_and_others_give_others():
    first = add_camera_noise(COLOR, DEPTH, NOISE, 1000)
    again = add_camera_noise(COLOR.copy(), DEPTH.copy(), NOISE, 1000)
    assert [image.tobytes() for image in first] == [image.tobytes() for image in again]
    for noise, stamp_ns in ((NOISE, 1001), (CameraNoise(0.02, 0.003, 0.05, 8), 1000)):
        color, depth = add_camera_noise(COLOR, DEPTH, noise, stamp_ns)
        assert not np.array_equal(color, first[0])
        assert not np.array_equal(depth, first[1])


def test_seed_zero_and_no_noise_leave_the_images_alone():
    before = COLOR.copy(), DEPTH.copy()
    for noise in (CameraNoise(0.02, 0.003, 0.05, 0), CameraNoise(seed=7)):
        color, depth = add_camera_noise(COLOR, DEPTH, noise, 5)
        assert color is COLOR
        assert depth is DEPTH
    add_camera_noise(COLOR, DEPTH, NOISE, 5)
    np.testing.assert_array_equal(COLOR, before[0])
    np.testing.assert_array_equal(DEPTH, before[1])


def test_colours_stay_in_range_and_depth_is_never_negative():
    dark = np.zeros((320, 500, 3), np.uint8)
    dark[::2] = 255
    near = np.full((320, 500), 9.0, np.float32)
    color, depth = add_camera_noise(dark, near, CameraNoise(0.2, 0.1, 0.0, 3), 5)
    assert color[::2].min() > 40
    assert color[1::2].max() < 215
    assert depth.min() >= 0.0


def test_a_frame_takes_at_most_four_milliseconds():
    add_camera_noise(COLOR, DEPTH, NOISE, 1)
    best_s = 1.0
    for stamp_ns in range(20):
        start_s = time.thread_time()
        add_camera_noise(COLOR, DEPTH, NOISE, stamp_ns)
        best_s = min(best_s, time.thread_time() - start_s)
    assert best_s < 4e-3

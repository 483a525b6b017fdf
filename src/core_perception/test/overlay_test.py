# SPDX-License-Identifier: BSD-3-Clause
"""The overlay: every pixel has the colour of the ground under it."""

import numpy as np
import pytest

from core_perception.exceptions import EvidenceError
from core_perception.overlay import (
    SAFE,
    UNKNOWN,
    UNSAFE,
    UNTOUCHED,
    GridView,
    OverlayStyle,
    draw_overlay,
    pixel_states,
)
from core_perception.predicates import parse_predicate

HEIGHT_PX, WIDTH_PX, FOCAL_PX, CAMERA_M = 200, 300, 200.0, 0.6
K = np.array([[FOCAL_PX, 0.0, 150.0], [0.0, FOCAL_PX, 100.0], [0.0, 0.0, 1.0]])
T_ODOM_CAMERA = np.array(
    [[0.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, CAMERA_M], [0.0, 0.0, 0.0, 1.0]]
)
SINGLE = OverlayStyle(scale=1)


def ground_depth():
    v = np.arange(HEIGHT_PX)[:, None] + np.zeros((1, WIDTH_PX))
    with np.errstate(divide="ignore"):
        return np.where(v > 100, CAMERA_M * FOCAL_PX / np.maximum(v - 100, 1e-9), np.nan).astype(np.float32)


def grid(rule):
    """20 m x 20 m around the camera; rule(x, y) gives the state of a cell by its centre."""
    x, y = np.meshgrid(-10.0 + 0.1 * (np.arange(200) + 0.5), -10.0 + 0.1 * (np.arange(200) + 0.5))
    return GridView(rule(x, y).astype(np.uint8), 0.1, -10.0, -10.0)


def grey():
    return np.full((HEIGHT_PX, WIDTH_PX, 3), 120, np.uint8)


def test_every_pixel_has_the_state_of_the_cell_its_point_lies_in():
    states = pixel_states(
        ground_depth(), K, T_ODOM_CAMERA, grid(lambda x, y: np.where(x > 3.0, UNSAFE, np.where(y > 0, SAFE, UNKNOWN)))
    )
    row_at = {x: round(100 + CAMERA_M * FOCAL_PX / x) for x in (2.0, 5.0)}
    assert (states[row_at[5.0]] == UNSAFE).all()
    assert (states[row_at[2.0], :148] == SAFE).all()  # y > 0 is left of the middle of the image
    assert (states[row_at[2.0], 152:] == UNKNOWN).all()
    assert (states[:100] == UNTOUCHED).all()


def test_obstacles_are_unsafe_whatever_their_cell_and_far_points_untouched():
    depth = ground_depth()
    depth[90:120, 100:140] = 2.0
    states = pixel_states(depth, K, T_ODOM_CAMERA, grid(lambda x, y: 0.0 * x))
    assert (states[90:120, 100:140] == UNSAFE).all()
    assert (states[101:110, :90] == UNTOUCHED).all()
    assert (states[130:, 150:] == SAFE).all()


def test_points_outside_the_grid_are_unknown():
    small = GridView(np.zeros((10, 10), np.uint8), 0.1, 0.0, 0.0)
    assert (pixel_states(ground_depth(), K, T_ODOM_CAMERA, small)[150:, :] == UNKNOWN).any()
    assert (pixel_states(ground_depth(), K, T_ODOM_CAMERA, small) != SAFE).all()


@pytest.mark.parametrize("bad", [np.nan, np.inf, 0.0, -1.0])
def test_invalid_depth_is_untouched(bad):
    depth = np.full((HEIGHT_PX, WIDTH_PX), bad, np.float32)
    assert (pixel_states(depth, K, T_ODOM_CAMERA, grid(lambda x, y: 0.0 * x)) == UNTOUCHED).all()


def test_safe_ground_turns_green_unsafe_red_and_sky_stays():
    color = grey()
    picture = draw_overlay(
        color, ground_depth(), K, T_ODOM_CAMERA, grid(lambda x, y: np.where(y > 0, SAFE, UNSAFE)), (), SINGLE
    ).astype(int)
    assert (color == 120).all()
    left, right = picture[160:, :140], picture[160:, 160:]
    assert (left[..., 1] > left[..., 0] + 20).all()
    assert (right[..., 0] > right[..., 1] + 20).all()
    assert (picture[:80, :100] == 120).all()


def test_predicates_and_legend_are_drawn_and_a_long_list_does_not_overflow():
    plain = draw_overlay(grey(), ground_depth(), K, T_ODOM_CAMERA, grid(lambda x, y: 0.0 * x), (), SINGLE)
    few = [parse_predicate("ON(floor)=safe"), parse_predicate("NEAR(wall)")]
    many = [parse_predicate(f"NEAR(thing_number_{k})") for k in range(60)]
    for predicates in (few, many):
        picture = draw_overlay(grey(), ground_depth(), K, T_ODOM_CAMERA, grid(lambda x, y: 0.0 * x), predicates, SINGLE)
        assert picture.shape == plain.shape
        assert (picture != plain)[:60, :100].any()


def test_scale_enlarges_the_picture():
    picture = draw_overlay(
        grey(), ground_depth(), K, T_ODOM_CAMERA, grid(lambda x, y: 0.0 * x), (), OverlayStyle(scale=3)
    )
    assert picture.shape == (3 * HEIGHT_PX, 3 * WIDTH_PX, 3)


@pytest.mark.parametrize(
    "color, depth",
    [
        (grey()[:, :-1], ground_depth()),
        (grey().astype(float), ground_depth()),
        (grey()[..., 0], ground_depth()),
        (grey(), ground_depth()[None]),
    ],
)
def test_images_that_do_not_fit_each_other_are_refused(color, depth):
    with pytest.raises(EvidenceError, match="overlay"):
        draw_overlay(color, depth, K, T_ODOM_CAMERA, grid(lambda x, y: 0.0 * x))

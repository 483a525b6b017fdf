# SPDX-License-Identifier: BSD-3-Clause
"""Arrangements: rates on seeded synthetic scenes with 6 cm of position error, and laws."""

import arrangement_scenes as scenes
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from core_perception.arrangement import Arrangement, classify, cluster

TRIALS = 1500


def shapes(points):
    return [classify(points[group]) for group in cluster(points)]


def blocking_rate(scene):
    rng = np.random.default_rng(7)
    return float(np.mean([any(shape.blocks for shape in shapes(scene(rng))) for _ in range(TRIALS)]))


@pytest.mark.parametrize(
    "scene, least",
    [
        (scenes.line, 0.99),
        (scenes.line_with_stray, 0.99),
        (scenes.line_of_three, 0.85),
        (scenes.arc, 0.95),
        (scenes.ring, 0.99),
        (scenes.square, 0.97),
        (scenes.corner, 0.98),
    ],
)
def test_blocking_arrangements_are_found(scene, least):
    assert blocking_rate(scene) >= least


@pytest.mark.parametrize(
    "scene, most",
    [(scenes.scatter, 0.02), (scenes.dense_scatter, 0.02), (scenes.scatter_of_three, 0.03), (scenes.lane, 0.02)],
)
def test_scattered_objects_and_lanes_seldom_look_like_a_barrier(scene, most):
    assert blocking_rate(scene) <= most


@pytest.mark.parametrize("count, side_m", [(4, 3.0), (5, 3.0), (4, 6.0), (5, 6.0), (6, 6.0)])
def test_scatters_of_every_small_number_seldom_look_like_a_barrier(count, side_m):
    assert blocking_rate(lambda rng: scenes.scatter_of(rng, count, side_m)) <= 0.02


@pytest.mark.parametrize(
    "width_m, gap_m, count", [(1.0, 1.5, 4), (1.2, 1.2, 5), (2.4, 0.8, 6), (2.4, 1.2, 3), (1.6, 1.6, 3)]
)
def test_two_rows_that_a_robot_fits_between_are_a_lane_whatever_the_gaps_in_a_row(width_m, gap_m, count):
    row = np.column_stack([gap_m * np.arange(count), np.zeros(count)])
    assert classify(np.vstack([row, row + [0.2 * gap_m, width_m]])) == Arrangement.LANE


def test_an_outline_with_objects_on_all_four_sides_is_no_lane():
    outline = [(x, y) for x in range(5) for y in range(4) if x in (0, 4) or y in (0, 3)]
    assert classify(1.2 * np.array(outline, dtype=float)) == Arrangement.RING


def test_three_on_a_curve_and_four_unevenly_spaced_are_no_barrier():
    assert classify(np.array([[0.0, 0.0], [1.4, 0.35], [2.8, 0.0]])) == Arrangement.SCATTER
    assert classify(np.array([[0.0, 0.0], [0.6, 0.0], [2.8, 0.0], [3.2, 0.0]])) == Arrangement.SCATTER


def test_a_line_with_one_object_missing_still_blocks():
    for count in (5, 6, 8):
        for missing in range(1, count - 1):
            points = np.column_stack([1.2 * np.delete(np.arange(count), missing), np.zeros(count - 1)])
            assert classify(points) == Arrangement.LINE, (count, missing)


@pytest.mark.parametrize("name", ["line", "ring", "corner", "lane", "arc"])
def test_exact_shapes_have_their_name(name):
    x = np.arange(6.0)
    angles = np.arange(8) * np.pi / 4
    exact = {
        "line": np.column_stack([x, 2.0 * x]) / np.sqrt(5.0),
        "ring": 1.5 * np.column_stack([np.cos(angles), np.sin(angles)]),
        "corner": np.array([[2.0, 0], [1, 0], [0, 0], [0, 1], [0, 2]]),
        "lane": np.vstack([np.column_stack([x, 0 * x]), np.column_stack([x, 0 * x + 1.6])]),
        "arc": 2.5 * np.column_stack([np.cos(angles[:5] / 2), np.sin(angles[:5] / 2)]),
    }
    assert classify(exact[name]) == Arrangement(name)


def test_fewer_than_three_objects_are_never_a_barrier():
    assert classify(np.zeros((0, 2))) == Arrangement.FEW
    assert classify(np.array([[0.0, 0.0], [1.5, 0.0]])) == Arrangement.FEW
    assert classify(np.array([[0.0, 0.0], [0.1, 0.1], [1.5, 0.0], [1.6, 0.0]])) == Arrangement.FEW


def test_one_object_held_twice_does_not_hide_a_line():
    line = np.column_stack([1.36 * np.arange(5), np.zeros(5)])
    assert classify(np.vstack([line, line[2] + [0.2, 0.1]])) == Arrangement.LINE
    assert classify(np.vstack([line, line[2] + [0.1, 0.6]])) == Arrangement.LINE


def test_rows_further_apart_than_the_link_are_lines_of_their_own():
    line = np.column_stack([1.36 * np.arange(5), np.zeros(5)])
    rows = np.vstack([line, line + [0.0, 4.0]])
    assert [len(group) for group in cluster(rows)] == [5, 5]
    assert shapes(rows) == [Arrangement.LINE, Arrangement.LINE]


@given(st.integers(0, 2**31), st.sampled_from(sorted(scenes.GENERATORS)))
def test_the_answer_does_not_depend_on_order_or_place(seed, name):
    rng = np.random.default_rng(seed)
    points = scenes.GENERATORS[name](rng)
    group = points[cluster(points)[0]]
    assert classify(rng.permutation(group)) == classify(group)
    assert classify(group + [16.0, -8.0]) == classify(group)


@given(st.integers(0, 2**31), st.integers(0, 12))
def test_clusters_part_the_points_at_gaps_wider_than_the_link(seed, count):
    points = np.random.default_rng(seed).uniform(0.0, 8.0, (count, 2))
    groups = cluster(points, 1.5)
    assert sorted(np.concatenate(groups).tolist() if groups else []) == list(range(count))
    for a in groups:
        for b in groups:
            if a is not b:
                assert np.linalg.norm(points[a][:, None] - points[b][None], axis=2).min() > 1.5


@pytest.mark.parametrize(
    "points", [np.zeros((3, 3)), np.zeros(4), np.array([[0.0, np.nan]]), np.array([[np.inf, 0.0]])]
)
def test_what_is_no_list_of_places_is_refused(points):
    with pytest.raises(ValueError, match="positions"):
        classify(points)

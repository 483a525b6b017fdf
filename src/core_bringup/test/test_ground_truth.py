# SPDX-License-Identifier: BSD-3-Clause
"""Distances of footprint and regions, against brute force."""

import math
from dataclasses import replace

import numpy as np
import pytest
from simple_world import make_object, make_table

from core_bringup import polygons
from core_bringup.ground_truth import GroundTruth, object_clearance_m
from core_bringup.polygons import contains_point, rectangle, signed_clearance_m
from core_bringup.regions import region_outline_m
from core_bringup.world import load_world
from core_bringup.world_types import UnsafeRegion

L_SHAPE = np.array([[0, 0], [3, 0], [3, 1], [1, 1], [1, 3], [0, 3]], dtype=float)
STAR = np.array([[2, 0], [0.6, 0.5], [0, 2], [-0.6, 0.5], [-2, 0], [-0.6, -0.5], [0, -2], [0.6, -0.5]], dtype=float)


def sample_border(polygon_m, count=4000):
    """Points evenly along the border."""
    following = np.roll(polygon_m, -1, axis=0)
    share = np.linspace(0, 1, count // len(polygon_m))[:, None, None]
    return (polygon_m + share * (following - polygon_m)).reshape(-1, 2)


def brute_distance_m(first_m, second_m):
    a, b = sample_border(first_m, 600), sample_border(second_m, 600)
    return np.sqrt(((a[:, None] - b[None]) ** 2).sum(-1)).min()


def random_convex(rng):
    angles = np.sort(rng.uniform(0, 2 * np.pi, 7))
    return rng.uniform(-1, 1, 2) + rng.uniform(0.4, 1.5) * np.stack([np.cos(angles), np.sin(angles)], axis=1)


def separates_somewhere(footprint_m, polygon_m, depth_m, count):
    """Whether a translation by depth_m, in one of count directions, leaves the polygons only touching."""
    angles = np.linspace(0, 2 * np.pi, count, endpoint=False)
    shifts = depth_m * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    areas = (polygons.polygon_area_m2(polygons.clip_to_convex(polygon_m, footprint_m + shift)) for shift in shifts)
    return any(abs(area) < 1e-9 for area in areas)


def test_distance_of_polygons_apart_is_exact():
    rng = np.random.default_rng(1)
    checked = 0
    for _ in range(40):
        footprint = rectangle(rng.uniform(-3, 3, 2), rng.uniform(-4, 4), 1.1, 0.5)
        for region in (random_convex(rng), L_SHAPE, STAR):
            clearance_m = signed_clearance_m(footprint, region)
            if clearance_m > 0.0:
                checked += 1
                brute_m = brute_distance_m(footprint, region)
                assert clearance_m - 1e-12 <= brute_m <= clearance_m + 0.02
    assert checked > 30


@pytest.mark.parametrize(
    "region", [L_SHAPE, STAR, rectangle((0.5, 0.5), 0.4, 2.0, 1.0)], ids=["l_shape", "star", "box"]
)
def test_depth_of_penetration_agrees_with_a_search_over_translations(region):
    rng = np.random.default_rng(2)
    checked = 0
    while checked < 6:
        footprint = rectangle(rng.uniform(-1, 2, 2), rng.uniform(-4, 4), 1.1, 0.5)
        clearance_m = signed_clearance_m(footprint, region)
        if clearance_m < -0.05:
            checked += 1
            assert not any(
                separates_somewhere(footprint, region, -share * clearance_m, 180) for share in (0.4, 0.8, 0.98)
            )
            assert separates_somewhere(footprint, region, -clearance_m + 0.01, 720)


def test_two_ways_to_the_depth_agree_on_convex_regions():
    rng = np.random.default_rng(3)
    for _ in range(60):
        footprint, region = rectangle(rng.uniform(-1, 1, 2), rng.uniform(-4, 4), 1.1, 0.5), random_convex(rng)
        if polygons.is_convex_ccw(region) and signed_clearance_m(footprint, region) < -1e-3:
            assert polygons._depth_any_m(footprint, region) == pytest.approx(
                -signed_clearance_m(footprint, region), abs=1e-6
            )


def test_clearance_is_continuous_across_the_border():
    region = rectangle((2.0, 0.0), 0.0, 2.0, 4.0)
    values = [signed_clearance_m(rectangle((x, 0.3), 0.0, 1.1, 0.5), region) for x in np.linspace(0.3, 0.6, 61)]
    np.testing.assert_allclose(values, 1.0 - 0.55 - np.linspace(0.3, 0.6, 61), atol=1e-6)


@pytest.mark.parametrize("region", [L_SHAPE, STAR])
def test_point_in_polygon_agrees_with_the_winding_number(region):
    rng = np.random.default_rng(5)
    for point in rng.uniform(-3, 4, (400, 2)):
        to = region - point
        following = np.roll(to, -1, axis=0)
        turn = np.arctan2(to[:, 0] * following[:, 1] - to[:, 1] * following[:, 0], (to * following).sum(1)).sum()
        assert contains_point(region, point) == (abs(turn) > np.pi)
    assert contains_point(region, region[0])


def test_polygon_properties():
    assert polygons.polygon_area_m2(L_SHAPE) == 5.0
    assert polygons.polygon_area_m2(L_SHAPE[::-1]) == -5.0
    assert not polygons.is_convex_ccw(L_SHAPE)
    assert polygons.is_simple(L_SHAPE)
    assert not polygons.is_simple(np.array([[0, 0], [1, 1], [1, 0], [0, 1]], dtype=float))
    assert not polygons.is_convex_ccw(STAR[[0, 2, 4, 6, 0, 2, 4, 6]])


def regions(*outlines):
    return tuple(
        UnsafeRegion(f"region_{i}", f"reason {i}", polygon_m=np.array(o, dtype=float)) for i, o in enumerate(outlines)
    )


def test_nearest_region_is_named_and_base_is_told_from_footprint():
    near, far = rectangle((2.0, 0.0), 0, 1.0, 1.0), rectangle((-5.0, 0.0), 0, 1.0, 1.0)
    truth = GroundTruth(regions(near, far), (), 1.1, 0.5)
    apart = truth.evaluate(0.0, 0.0, 0.0)
    assert (apart.inside, apart.base_inside, apart.region, apart.reason) == (False, False, "region_0", "reason 0")
    assert apart.clearance_m == pytest.approx(0.95)
    nose = truth.evaluate(1.2, 0.0, 0.0)
    assert (nose.inside, nose.base_inside) == (True, False)
    assert nose.clearance_m == pytest.approx(-0.25)
    assert truth.evaluate(1.6, 0.0, 0.0).base_inside
    assert truth.evaluate(-4.8, 0.0, 1.0).region == "region_1"


def test_clockwise_regions_count_the_same():
    region = rectangle((1.0, 0.2), 0.3, 1.0, 2.0)
    values = [GroundTruth(regions(r), (), 1.1, 0.5).evaluate(0.3, 0.0, 0.1).clearance_m for r in (region, region[::-1])]
    assert values[0] == pytest.approx(values[1])


def test_without_regions_the_clearance_is_infinite():
    state = GroundTruth((), (), 1.1, 0.5).evaluate(0.0, 0.0, 0.0)
    assert (state.inside, state.base_inside, state.clearance_m, state.region) == (False, False, math.inf, "")
    assert state.obstacle_clearance_m == math.inf


def test_obstacle_clearance_is_that_of_the_nearest_object():
    objects = load_world("warehouse").objects
    truth = GroundTruth((), objects, 1.1, 0.5)
    rng = np.random.default_rng(6)
    for x, y, yaw in rng.uniform([-5, -3, -4], [11, 9, 4], (60, 3)):
        footprint = rectangle((x, y), yaw, 1.1, 0.5)
        expected = min(object_clearance_m(footprint, item) for item in objects if item.position_m[2] < 0.8)
        assert truth.evaluate(x, y, yaw).obstacle_clearance_m == pytest.approx(expected, abs=1e-12)


def test_round_objects_are_measured_as_discs():
    post = make_object(5, (0.4, 0.4, 1.0), (2.0, 0.0, 0.0), shape="cylinder")
    assert object_clearance_m(rectangle((0, 0), 0, 1.0, 0.5), post) == pytest.approx(1.3)
    assert object_clearance_m(rectangle((2, 0), 0, 1.0, 0.5), post) == pytest.approx(-0.45)


def test_what_is_touched_is_measured_not_what_is_drawn():
    tree = replace(make_object(5, (3.0, 3.0, 5.0), (2.0, 0.0, 0.0)), collision_size_m=np.array([0.4, 0.4, 5.0]))
    assert object_clearance_m(rectangle((0, 0), 0, 1.0, 0.5), tree) == pytest.approx(1.3)
    assert GroundTruth((), (tree,), 1.0, 0.5).evaluate(0.0, 0.0, 0.0).obstacle_clearance_m == pytest.approx(1.3)


def test_of_an_open_thing_its_parts_are_measured_and_what_hangs_above_the_robot_is_not():
    """A table turned by a quarter: legs at x = 3 +- 0.45, y = 2 +- 0.95 (centres)."""
    body, low, high = rectangle((0.0, 0.0), 0.0, 1.0, 0.5), 0.79, 0.81
    tables = {top_m: make_table(5, (3.0, 2.0, 0.0), 0.5 * math.pi, top_m) for top_m in (low, high)}
    assert object_clearance_m(body, tables[low]) == pytest.approx(math.hypot(2.0, 0.75))  # corner to corner
    inside = rectangle((3.0, 2.0), 0.0, 0.5, 0.5)
    assert object_clearance_m(inside, tables[low]) == pytest.approx(-0.75)
    assert object_clearance_m(inside, tables[high]) == pytest.approx(math.hypot(0.15, 0.65))
    on_a_leg = rectangle((3.45, 1.05), 0.0, 0.5, 0.5)
    assert object_clearance_m(on_a_leg, tables[high]) == pytest.approx(-0.3)
    for table in tables.values():
        state = GroundTruth((), (table,), 0.5, 0.5).evaluate(3.0, 2.0, 0.0)
        assert state.obstacle_clearance_m == object_clearance_m(inside, table)


def test_a_thing_whose_parts_all_hang_above_the_robot_is_no_obstacle():
    lamp = replace(make_table(5, (3.0, 2.0, 1.0)), collision_parts_m=np.array([[-1.0, -0.5, 0.0, 1.0, 0.5, 0.1]]))
    assert GroundTruth((), (lamp,), 0.5, 0.5).evaluate(3.0, 2.0, 0.0).obstacle_clearance_m == math.inf


def test_a_hull_holds_its_points_and_has_no_corner_too_many():
    rng = np.random.default_rng(8)
    for _ in range(50):
        points = np.round(rng.uniform(-2, 2, (int(rng.integers(3, 30)), 2)), 1)
        hull = polygons.convex_hull(points)
        assert polygons.is_convex_ccw(hull)
        assert all(contains_point(hull, p) or polygons.point_distance_m(hull, p) < 1e-6 for p in points)
        assert {tuple(corner) for corner in hull} <= {tuple(point) for point in points}


BOX = make_object(7, (1.0, 0.6, 1.0), (2.0, 0.5, 0.0), yaw_rad=0.5)
POST = make_object(8, (0.5, 0.5, 1.0), (-1.0, 1.0, 0.0), shape="cylinder")
TABLE = make_table(9, (1.0, -0.5, 0.0), yaw_rad=0.7)
ROUND_REGIONS = {
    "around_table": UnsafeRegion("table", "why", radius_m=0.9, object_name="object_9", item=TABLE),
    "disc": UnsafeRegion("disc", "why", center_m=np.array([0.5, -0.4]), radius_m=1.2),
    "around_box": UnsafeRegion("box", "why", radius_m=0.9, object_name="object_7", item=BOX),
    "around_post": UnsafeRegion("post", "why", radius_m=0.9, object_name="object_8", item=POST),
}


@pytest.mark.parametrize("region", ROUND_REGIONS.values(), ids=ROUND_REGIONS)
def test_round_regions_agree_with_their_outline(region):
    """The outline is a polygon inscribed in the circles, 0.2 % smaller; depth of the two agrees as well."""
    outline = region_outline_m(region)
    assert polygons.is_convex_ccw(outline)
    as_polygon = UnsafeRegion("polygon", "why", polygon_m=outline)
    rng = np.random.default_rng(8)
    signs = set()
    for x, y, yaw in rng.uniform([-3, -3, -4], [4, 3, 4], (80, 3)):
        exact, other = (GroundTruth((r,), (), 1.1, 0.5).evaluate(x, y, yaw) for r in (region, as_polygon))
        assert exact.clearance_m == pytest.approx(other.clearance_m, abs=5e-3)
        if abs(exact.clearance_m) > 5e-3:
            assert exact.inside == other.inside
        nearest_m = polygons.point_distance_m(outline, np.array([x, y]))
        assert nearest_m < 5e-3 or exact.base_inside == other.base_inside
        signs.add((exact.inside, exact.base_inside))
    assert signs == {(False, False), (True, False), (True, True)}


def test_region_and_obstacle_move_with_their_object():
    truth = GroundTruth((ROUND_REGIONS["around_box"],), (BOX,), 1.1, 0.5)
    poses = {BOX.id: (np.array([5.0, 0.0, 0.0]), 0.0), 99: (np.zeros(3), 0.0)}
    state = truth.evaluate(0.0, 0.0, 0.0, poses)
    assert state.obstacle_clearance_m == pytest.approx(5.0 - 0.5 - 0.55)
    assert state.clearance_m == pytest.approx(state.obstacle_clearance_m - 0.9)
    assert truth.evaluate(4.0, 0.0, 0.0, poses).base_inside
    wall = make_object(9, (0.2, 2.0, 2.0), (9.0, 0.0, 0.0))
    both = GroundTruth((), (wall, replace(BOX, position_m=np.array([-40.0, 0.0, 0.0]))), 1.1, 0.5)
    assert both.evaluate(7.0, 0.0, 0.0, poses).obstacle_clearance_m == pytest.approx(7.0 - 0.55 - 5.5)
    assert not truth.evaluate(4.0, 0.0, 0.0).base_inside
    assert region_outline_m(ROUND_REGIONS["around_box"], poses)[:, 0].min() == pytest.approx(5.0 - 0.5 - 0.9)


def test_region_around_an_object_that_is_not_known_is_refused():
    with pytest.raises(ValueError, match="object_9 is not resolved"):
        GroundTruth((UnsafeRegion("lost", "why", radius_m=1.0, object_name="object_9"),), (), 1.1, 0.5)


@pytest.mark.parametrize("size_m", [(0.0, 0.5), (1.1, -0.5), (math.nan, 0.5)])
def test_footprint_must_be_positive(size_m):
    with pytest.raises(ValueError, match="footprint"):
        GroundTruth((), (), *size_m)

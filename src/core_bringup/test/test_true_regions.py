# SPDX-License-Identifier: BSD-3-Clause
"""What predicates mean on true geometry: areas and places with answers known by hand."""

import dataclasses
import math

import numpy as np
import pytest
from simple_world import make_object, make_ramp, make_surface, make_table

from core_bringup.evaluation.true_regions import (
    OBSTACLE_RULE,
    Raster,
    TruthParams,
    object_regions,
    paint_regions,
    paint_surfaces,
    surface_classes,
    width_m,
)
from core_bringup.evaluation.truth_scene import link_outlines
from core_perception.predicates import parse_predicate

PARAMS = TruthParams()
RASTER = Raster((-20, -20), (40, 40), 0.2)  # -4 ... 4 m, samples of 2 cm
SAMPLE_M2 = 0.02**2


def named(number, class_name, size_m, place_m, **changes):
    item = make_object(number, size_m, (*place_m, changes.pop("z_m", 0.0)), shape=changes.pop("shape", "box"))
    return dataclasses.replace(item, class_name=class_name, **changes)


def predicates(*texts):
    return [parse_predicate(text) for text in texts]


def areas_m2(objects, *texts, params=PARAMS):
    masks = paint_regions(RASTER, object_regions(objects, predicates(*texts), params))
    return {rule: float(mask.sum() * SAMPLE_M2) for rule, mask in masks.items()}


def cone(number, x_m, y_m, side_m=0.4):
    return named(number, "traffic_cone", (side_m, side_m, 0.7), (x_m, y_m))


def test_near_is_the_outline_turned_as_the_object_is():
    box = named(1, "box", (1.0, 0.5, 0.5), (0.0, 0.0), yaw_rad=math.pi / 6)
    assert areas_m2([box], "NEAR(box)=unsafe")["NEAR(box)"] == pytest.approx(0.5, abs=0.01)
    # Along its length it reaches half a metre, across a quarter.
    (region,) = [r for r in object_regions([box], predicates("NEAR(box)"), PARAMS) if r.rule == "NEAR(box)"]
    along, across = np.array([math.cos(math.pi / 6), 0.5]), np.array([-0.5, math.cos(math.pi / 6)])
    probes = np.array([0.49 * along, 0.51 * along, 0.24 * across, 0.26 * across])
    assert region.covers(probes).tolist() == [True, False, True, False]


@pytest.mark.parametrize(("text", "radius_m"), [("AROUND(box)", 1.0), ("AROUND(box, 1.5)", 1.5), ("AROUND(dog)", 0.5)])
def test_around_is_the_outline_grown_by_the_radius(text, radius_m):
    params = TruthParams(class_radius_m={"dog": 0.5})
    item = named(1, "dog" if "dog" in text else "box", (1.0, 0.5, 0.5), (0.0, 0.0))
    # Minkowski sum of a rectangle and a disc: a b + 2 (a + b) r + pi r^2.
    due_m2 = 0.5 + 3.0 * radius_m + math.pi * radius_m**2
    area_m2 = areas_m2([item], text, params=params)[text.split(",")[0].rstrip(")") + ")"]
    assert area_m2 == pytest.approx(due_m2, rel=0.01)


def test_between_is_the_hull_of_each_cluster():
    cones = [cone(1, -3.0, 0.0), cone(2, -1.0, 0.0), cone(3, 3.0, 0.0), cone(4, 3.0, 2.0)]
    # Gaps 1.6, 3.6 and 1.6 m, of which only the middle one is wider than 2.5 m: two hulls of 2.4 m x 0.4 m.
    assert areas_m2(cones, "BETWEEN(traffic_cone)")["BETWEEN(traffic_cone)"] == pytest.approx(1.92, abs=0.02)


def test_a_gap_is_measured_from_border_to_border():
    longs = [named(k, "tape", (2.0, 0.1, 1.0), (0.0, 2.0 * k)) for k in range(2)]
    turned = named(9, "tape", (2.0, 0.1, 1.0), (3.0, 1.0), yaw_rad=math.pi / 2)
    outlines = [np.array([[x, y], [x + 2.0, y], [x + 2.0, y + 0.1], [x, y + 0.1]]) for x, y in ((0.0, 0.0), (5.0, 0.0))]
    between = np.array([[1.0, 2.5], [6.0, 2.5], [6.0, 2.6], [1.0, 2.6]])
    # The corners of the third are 2.6 m from those of the others, its side only 2.4 m.
    assert [len(group) for group in link_outlines(outlines, 2.5)] == [1, 1]
    assert [len(group) for group in link_outlines([*outlines, between], 2.5)] == [3]
    assert "BETWEEN(tape)" in areas_m2([*longs, turned], "BETWEEN(tape)")


def test_a_thin_hull_is_grown_to_the_least_thickness():
    posts = [named(k, "post", (0.1, 0.1, 1.0), (2.0 * k - 1.0, 0.0)) for k in range(2)]
    (region,) = [r for r in object_regions(posts, predicates("BETWEEN(post)"), PARAMS) if "BETWEEN" in r.rule]
    assert region.radius_m == pytest.approx(0.1)  # (0.3 - 0.1) / 2
    assert region.covers(np.array([[0.0, 0.14], [0.0, 0.16]])).tolist() == [True, False]
    assert width_m(np.array([[0.0, 0.0], [2.0, 2.0], [1.8, 2.2], [-0.2, 0.2]])) == pytest.approx(0.2 * math.sqrt(2.0))


def test_one_object_has_no_between_and_a_safe_between_cancels_an_unsafe_one():
    assert "BETWEEN(traffic_cone)" not in areas_m2([cone(1, 0.0, 0.0)], "BETWEEN(traffic_cone)")
    pair = [cone(1, 0.0, 0.0), cone(2, 2.0, 0.0)]
    assert "BETWEEN(traffic_cone)" in areas_m2(pair, "BETWEEN(traffic_cone)")
    assert "BETWEEN(traffic_cone)" not in areas_m2(pair, "BETWEEN(traffic_cone)", "BETWEEN(traffic_cone)=safe")


@pytest.mark.parametrize(
    ("size_m", "z_m", "solid", "rule"),
    [
        ((1.0, 1.0, 0.5), 0.0, True, OBSTACLE_RULE),
        ((1.0, 1.0, 0.5), 0.85, True, OBSTACLE_RULE),
        ((1.0, 1.0, 0.5), 0.95, True, None),  # hangs above the robot
        ((1.0, 1.0, 0.05), 0.0, True, "not in a safe region (thing)"),  # too low for an obstacle, but no safe ground
        ((1.0, 1.0, 0.5), 0.0, False, "not in a safe region (thing)"),
    ],
)
def test_what_stands_is_an_obstacle_whatever_is_said(size_m, z_m, solid, rule):
    thing = named(1, "thing", size_m, (0.0, 0.0), z_m=z_m, solid=solid)
    assert sorted(areas_m2([thing], "ON(floor)=safe")) == ([] if rule is None else [rule])
    if rule == OBSTACLE_RULE:
        assert list(areas_m2([thing], "NEAR(thing)=safe")) == [OBSTACLE_RULE]
    else:
        assert not areas_m2([thing], "NEAR(thing)=safe")


@pytest.mark.parametrize(("top_m", "area_m2"), [(0.8, 2.0), (0.95, 0.04)])
def test_of_an_open_thing_only_parts_within_the_height_of_the_robot_count(top_m, area_m2):
    table = dataclasses.replace(make_table(1, (0.0, 0.0, 0.0), 0.5, top_m), class_name="table")
    areas = areas_m2([table], "NEAR(table)=unsafe", "AROUND(table, 0.2)=unsafe")
    assert areas["NEAR(table)"] == areas[OBSTACLE_RULE] == pytest.approx(area_m2, abs=0.01)
    grown_m2 = 2.0 + 6.0 * 0.2 + math.pi * 0.2**2 if top_m < 0.9 else 4.0 * (0.01 + 0.4 * 0.2 + math.pi * 0.2**2)
    assert areas["AROUND(table)"] == pytest.approx(grown_m2, rel=0.02)


def test_low_parts_of_a_standing_thing_are_near_it_and_no_obstacle():
    parts_m = np.array([[-0.5, -0.5, 0.0, 0.5, 0.5, 1.0], [0.5, -0.1, 0.0, 1.5, 0.1, 0.07]])
    lift = dataclasses.replace(named(1, "lift", (3.0, 1.0, 1.0), (0.0, 0.0)), collision="parts")
    lift = dataclasses.replace(lift, collision_parts_m=parts_m)
    assert areas_m2([lift], "NEAR(lift)") == pytest.approx(
        {OBSTACLE_RULE: 1.0, "not in a safe region (lift)": 0.2, "NEAR(lift)": 1.2}, abs=0.01
    )


def test_the_topmost_surface_counts_and_the_later_of_two_as_high():
    def square(number, name, half_m, z_m):
        return dataclasses.replace(make_surface(number, (-half_m, -half_m), (half_m, half_m), z_m), class_name=name)

    ramp = dataclasses.replace(make_ramp(4, (-1.0, -1.0), (1.0, 1.0), 0.0, 0.2), class_name="ramp")  # 0.1 m at x = 0
    surfaces = [square(1, "floor", 3.0, 0.0), square(2, "carpet", 2.0, 0.0), square(3, "step", 1.0, 0.1), ramp]
    number, names = surface_classes(RASTER, surfaces)
    x_m, y_m = RASTER.axes_m()

    def at(x, y):
        return names[number[np.argmin(np.abs(y_m - y)), np.argmin(np.abs(x_m - x))]]

    places = [(3.9, 0.0), (2.5, 0.0), (1.5, 0.0), (-0.5, 0.0), (0.5, 0.0)]
    assert [at(*place) for place in places] == ["floor", "floor", "carpet", "step", "ramp"]
    masks = paint_surfaces(RASTER, surfaces, predicates("ON(floor)=safe", "ON(ramp)=safe", "ON(step)=unsafe"))
    areas = {rule: float(mask.sum() * SAMPLE_M2) for rule, mask in masks.items()}
    assert areas == pytest.approx({"ON(step)": 2.0, "not in a safe region (carpet)": 12.0}, abs=0.05)


def test_a_surface_called_safe_and_unsafe_is_unsafe():
    surfaces = [make_surface(1, (-3.0, -3.0), (3.0, 3.0))]
    masks = paint_surfaces(RASTER, surfaces, predicates("ON(floor)=safe", "ON(floor)=unsafe"))
    assert list(masks) == ["ON(floor)"]


def test_rules_of_severity_slow_make_no_truth():
    assert "AROUND(box)" not in areas_m2([named(1, "box", (0.5, 0.5, 0.5), (0.0, 0.0))], "AROUND(box, 1.0, slow)")

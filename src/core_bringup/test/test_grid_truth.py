# SPDX-License-Identifier: BSD-3-Clause
"""Grids against a made-up world: overlap, calibration, first sight, and what a run's story makes of them."""

import dataclasses
import json

import numpy as np
import pytest
from simple_world import make_object, make_surface, make_table, make_world
from synthetic import make_grid, make_record, walk

from core_bringup.evaluation import grid_truth
from core_bringup.evaluation.grid_history import GridHistory
from core_bringup.evaluation.grid_log import GridDecision, RunLog, Timeline
from core_bringup.evaluation.node_parameters import find_package_folder
from core_bringup.evaluation.trial_story import RunGrounding, TrialStory
from core_bringup.evaluation.truth_scene import TruthScene, find_class_names
from core_bringup.ground_truth import object_clearance_m
from core_bringup.world_types import Motion, Task, UnsafeRegion
from core_perception.ontology import Ontology
from core_perception.predicates import parse_predicate

LINE = "BETWEEN(traffic_cone)=unsafe"
SQUARE = np.array([[4.0, -1.0], [6.0, -1.0], [6.0, 1.0], [4.0, 1.0]])


def make_task(*regions, expectation="unsafe", **changes):
    oracle = ("ON(floor)=safe", LINE)
    return Task(
        "task", "", np.zeros(3), np.zeros(3), np.array([[8.0, 0.0]]), np.array([8.0, 0.0]), 0.4, 60.0, expectation,
        regions, **{"oracle_predicates": oracle, **changes},
    )  # fmt: skip


CLOSED = make_task(UnsafeRegion("closed", "", (LINE,), polygon_m=SQUARE))


def make_scene(task=CLOSED, records=None, objects=(), surfaces=()):
    records = walk(6.0, lambda t: 0.5 * t) if records is None else records
    return TruthScene(make_world(*objects, surfaces=surfaces), task, records, (1.1, 0.5))


def named(number, class_name, size_m, position_m, **changes):
    item = make_object(number, size_m, position_m, shape=changes.pop("shape", "box"))
    return dataclasses.replace(item, class_name=class_name, **changes)


def history(*grids):
    result = GridHistory()
    for grid in grids:
        result.add(grid)
    return result


def log_of(*grids, rules=(LINE, "ON(floor)=safe")):
    log = RunLog()
    for grid in grids:
        log.add_grid(grid)
    log.add_predicates(0, tuple(parse_predicate(text) for text in rules))
    return log


def test_iou_of_a_line_and_a_square():
    # Unsafe cells: 3.9 .. 4.3 m, all 60 rows of 0.1 m from y = -3 m: 240; truth 20 x 20 cells, 3 x 20 of them unsafe.
    iou = grid_truth.compute_grid_iou(history(make_grid(1)), make_scene())
    assert iou == pytest.approx(60 / (240 + 400 - 60))


def test_iou_leaves_solid_objects_out_and_counts_only_what_was_seen():
    solid = named(2, "cardboard_box", (2.0, 2.0, 1.0), (5.0, 0.0, 0.0))
    assert grid_truth.compute_grid_iou(history(make_grid(1)), make_scene(objects=[solid])) == pytest.approx(0.0)
    narrow = make_grid(1, shape=(60, 63))  # up to x = 4.3 m
    assert grid_truth.compute_grid_iou(history(narrow), make_scene()) == pytest.approx(60 / 240)


def test_iou_ignores_cells_that_depth_alone_made_unsafe():
    metric = dataclasses.replace(make_grid(1), rules=("METRIC",))
    assert grid_truth.compute_grid_iou(history(metric), make_scene()) == 0.0
    bare = dataclasses.replace(make_grid(1), rules=("NOT_SAFE",), classes=("grass",))
    assert grid_truth.compute_grid_iou(history(bare), make_scene()) == pytest.approx(60 / 580)
    unlabelled = dataclasses.replace(bare, classes=("",))
    assert grid_truth.compute_grid_iou(history(unlabelled), make_scene()) == 0.0


def test_iou_without_a_region_or_a_grid_is_none():
    assert grid_truth.compute_grid_iou(history(make_grid(1)), make_scene(make_task(expectation="safe"))) is None
    assert grid_truth.compute_grid_iou(GridHistory(), make_scene()) is None


def test_calibration_of_known_probabilities():
    p_unsafe = np.array([0.0, 0.05, 0.5, 0.55, 1.0, 1.0])
    truth = np.array([False, True, True, False, True, True])
    calibration = grid_truth.make_calibration(p_unsafe, truth)
    assert [b["cells"] for b in calibration["bins"]] == [2, 0, 0, 0, 0, 2, 0, 0, 0, 2]
    assert calibration["bins"][0] == pytest.approx({"p_mean": 0.025, "true_share": 0.5, "cells": 2})
    assert calibration["bins"][1] == {"p_mean": None, "true_share": None, "cells": 0}
    assert calibration["ece"] == pytest.approx((2 * 0.475 + 2 * 0.025 + 2 * 0.0) / 6)
    assert grid_truth.make_calibration(np.zeros(0), np.zeros(0, bool)) is None


def test_calibration_knows_regions_and_solids():
    solid = named(2, "cardboard_box", (1.0, 6.0, 1.0), (1.0, 0.0, 0.0))
    calibration = grid_truth.compute_calibration(history(make_grid(1)), make_scene(objects=[solid]))
    safe, unsafe = calibration["bins"][0], calibration["bins"][9]
    assert safe["cells"] == 60 * 106 and safe["true_share"] == pytest.approx((340 + 600) / (60 * 106))
    assert unsafe["cells"] == 240 and unsafe["true_share"] == pytest.approx(0.25)


def test_points_inside_agrees_with_the_exact_test():
    from core_bringup.polygons import contains_point

    outline = np.array([[0.0, 0.0], [4.0, 0.5], [3.0, 3.0], [2.0, 1.0], [0.5, 2.0]])
    points = np.random.default_rng(5).uniform(-1.0, 5.0, (400, 2))
    assert list(grid_truth.points_inside(points, outline)) == [contains_point(outline, p) for p in points]


def test_a_border_is_covered_by_a_line_of_cells_behind_it():
    grid = GridDecision.pack(make_grid(1))
    assert grid_truth.covered_share(grid, SQUARE, (4.0, 0.0)) == 1.0
    assert grid_truth.covered_share(grid, SQUARE, (6.0, 0.0)) == 0.0
    assert grid_truth.covered_share(grid, SQUARE, (4.0, 0.0), causes=[3]) == 0.0
    assert grid_truth.covered_share(None, SQUARE, (4.0, 0.0)) == 0.0
    shifted = GridDecision.pack(dataclasses.replace(make_grid(1), origin_m=(-3.0, -3.0)))  # cells one metre too near
    assert grid_truth.covered_share(shifted, SQUARE, (4.0, 0.0)) == 0.0


def test_unknown_cells_count_as_the_filter_takes_them():
    grid = dataclasses.replace(make_grid(1), state=np.full((60, 110), 2), cause=np.full((60, 110), 65535))
    points = np.array([[0.0, 0.0], [99.0, 0.0]])
    assert list(GridDecision.pack(grid).unsafe_at(points)) == [True, False]
    assert not GridDecision.pack(dataclasses.replace(grid, unknown_is_unsafe=False)).unsafe_at(points).any()


def test_first_contact_of_the_nominal_way():
    way, place = grid_truth.first_contact_m(np.array([[0.0, 0.0], [8.0, 0.0]]), SQUARE)
    assert way == pytest.approx(4.0, abs=0.06) and place == pytest.approx([4.0, 0.0], abs=0.06)
    way, place = grid_truth.first_contact_m(np.array([[0.0, 3.0], [8.0, 3.0]]), SQUARE)
    assert way == np.inf and 4.0 - 0.06 <= place[0] <= 6.06


def test_detection_is_the_distance_at_the_first_grid_that_closes_the_way():
    free = dataclasses.replace(make_grid(0), state=np.zeros((60, 110)), rules=())
    log = log_of(free, make_grid(60 * 50_000_000), make_grid(80 * 50_000_000))
    # Tick 60 is at x = 1.5 m, the front 0.55 m before it, the region at 4 m.
    assert grid_truth.detection_distance_m(make_scene(), log) == pytest.approx(4.0 - 1.5 - 0.55)


def test_detection_takes_only_rules_that_close_the_region():
    grid = make_grid(0)
    assert grid_truth.detection_distance_m(make_scene(), log_of(dataclasses.replace(grid, rules=("METRIC",)))) is None
    grass = make_task(UnsafeRegion("lawn", "", ("ON(grass)=unsafe",), polygon_m=SQUARE))
    bare = dataclasses.replace(grid, rules=("NOT_SAFE",), classes=("grass",))
    assert grid_truth.detection_distance_m(make_scene(grass), log_of(bare)) == pytest.approx(3.45)
    assert grid_truth.detection_distance_m(make_scene(make_task()), log_of(grid)) is None
    assert grid_truth.detection_distance_m(make_scene(), RunLog()) is None


def test_the_grid_may_call_a_class_by_the_name_of_the_ontology():
    ontology = Ontology.load(find_package_folder("core_perception") / "config" / "ontology.yaml")
    tape = named(3, "barrier_tape", (2.0, 0.1, 1.0), (4.0, 0.0, 0.0))
    task = make_task(UnsafeRegion("taped", "", ("BETWEEN(barrier_tape)=unsafe",), polygon_m=SQUARE))
    log = log_of(dataclasses.replace(make_grid(0), rules=("BETWEEN(caution_tape)",)))
    scene = TruthScene(make_world(tape), task, walk(6.0, lambda t: 0.5 * t), (1.1, 0.5), ontology)
    assert grid_truth.detection_distance_m(scene, log) == pytest.approx(3.45)
    assert scene.class_distance_m((4.0, 1.05), "caution_tape", 0) == pytest.approx(1.0)
    assert grid_truth.detection_distance_m(make_scene(task, objects=[tape]), log) is None


def test_a_class_of_the_world_is_no_other_classs_name():
    ontology = Ontology.load(find_package_folder("core_perception") / "config" / "ontology.yaml")
    gurney = named(3, "gurney", (2.0, 0.7, 1.0), (4.0, 0.0, 0.0))
    assert find_class_names(make_world(gurney), ontology)["hospital_bed"] == "gurney"
    bed = dataclasses.replace(gurney, id=4, name="bed", class_name="bed", aliases=("hospital_bed",))
    assert find_class_names(make_world(gurney, bed), ontology)["hospital_bed"] == "gurney"
    bed = dataclasses.replace(bed, class_name="hospital_bed", aliases=())
    assert "hospital_bed" not in find_class_names(make_world(gurney, bed), ontology)


def walker(**changes):
    motion = Motion(np.array([[4.0, 0.0]]), 1.0, 0.0)
    item = named(7, "person", (0.5, 0.5, 1.7), (4.0, 6.0, 0.0), shape="cylinder", motion=motion, name="walker")
    return dataclasses.replace(item, **changes)


def test_class_clearance_is_exact_and_knows_moving_objects_and_hazards_that_are_not_solid():
    sign = named(3, "wet_floor_sign", (0.4, 0.4, 0.6), (1.0, -1.0, 0.0), solid=False)
    lamp = named(4, "sign", (0.4, 0.4, 0.4), (1.0, 0.0, 2.5))
    boxes = [named(5, "cardboard_box", (1.0, 1.0, 1.0), (2.0, 2.0, 0.0)),
             named(6, "cardboard_box", (1.0, 1.0, 1.0), (9.0, 0.3, 0.0))]  # fmt: skip
    scene = make_scene(objects=[sign, lamp, *boxes, walker()])
    clearance = scene.class_clearance_m()
    assert sorted(clearance) == ["cardboard_box", "person", "wet_floor_sign"]
    assert clearance["wet_floor_sign"] == pytest.approx(0.55)
    assert clearance["cardboard_box"] == pytest.approx(1.25)
    # At 6 s the walker has come to (4, 0) and the front to x = 3.55 m.
    assert clearance["person"] == pytest.approx(0.45 - 0.25, abs=1e-6)
    assert make_scene(records=[], objects=boxes).class_clearance_m() == {}


def test_a_region_moves_with_its_object():
    item = walker()
    region = UnsafeRegion("near", "", ("AROUND(person)=unsafe",), radius_m=1.0, object_name="walker", item=item)
    scene = make_scene(make_task(region), objects=[item])
    last = len(scene.records) - 1
    assert scene.outline_m(region, 0).mean(axis=0) == pytest.approx([4.0, 6.0], abs=1e-6)
    assert scene.outline_m(region, last).mean(axis=0) == pytest.approx([4.0, 0.0], abs=1e-6)
    assert len(scene.paths_m()[7]) == len(scene.records)


def test_surfaces_and_predicates_in_the_true_world():
    grass = dataclasses.replace(make_surface(9, (5.0, -2.0), (9.0, 2.0)), class_name="grass")
    cones = [named(10 + i, "traffic_cone", (0.4, 0.4, 0.7), (3.0, y, 0.0), aliases=("pylon",))
             for i, y in enumerate((-2.0, 0.0, 2.0, 9.0))]  # fmt: skip
    scene = make_scene(objects=cones, surfaces=[grass])
    assert scene.surface_at((6.0, 0.0)) == "grass" and scene.surface_at((0.0, 0.0)) == "floor"

    def distance(text, *place):
        return scene.predicate_distance_m(parse_predicate(text), place, 0)

    assert distance(LINE, 3.0, 1.0) == 0.0
    assert distance("BETWEEN(pylon)=unsafe", 4.2, 1.0) == pytest.approx(1.0)
    assert distance(LINE, 3.0, 5.5) > 3.0  # the far cone is no part of the line
    assert distance("NEAR(traffic_cone)=unsafe", 3.0, 1.0) == pytest.approx(0.8)
    assert distance("AROUND(traffic_cone)=unsafe", 3.0, 1.0) == 0.0
    assert distance("AROUND(traffic_cone, 0.5)=unsafe", 3.0, 1.0) == pytest.approx(0.3)
    assert distance("ON(grass)=unsafe", 4.0, 0.0) == pytest.approx(1.0)
    assert distance("NEAR(forklift)=unsafe", 4.0, 0.0) == np.inf


def bound_by(rule, class_name, *place):
    return [make_record(1, 0.0, binding_rule=rule, binding_class=class_name, binding_point_m=place)]


@pytest.mark.parametrize(
    "rule, class_name, place, right",
    [
        ("METRIC", "", (2.0, 0.0), True),
        ("METRIC", "", (1.3, 0.0), True),
        ("METRIC", "", (0.9, 0.0), False),
        ("METRIC", "", (4.5, 0.0), True),  # in the true region
        ("UNKNOWN", "", (2.0, 0.0), False),
        ("NOT_SAFE", "cardboard_box", (2.0, 0.0), True),
        ("NOT_SAFE", "floor", (2.0, 2.0), False),
        ("NOT_SAFE", "grass", (2.0, -5.0), True),
        ("BETWEEN(traffic_cone)", "traffic_cone", (0.0, 5.0), False),
        ("NEAR(cardboard_box)", "cardboard_box", (2.0, 0.5), True),
        ("METRIC", "", (np.nan, 0.0), False),
    ],
)
def test_what_bound_is_right_where_something_stands(rule, class_name, place, right):
    box = named(2, "cardboard_box", (1.0, 1.0, 1.0), (2.0, 0.0, 0.0))
    grass = dataclasses.replace(make_surface(9, (0.0, -6.0), (4.0, -4.0)), class_name="grass")
    scene = make_scene(records=bound_by(rule, class_name, *place), objects=[box], surfaces=[grass])
    oracle = tuple(parse_predicate(text) for text in ("ON(floor)=safe", LINE))
    assert RunGrounding(scene, RunLog(), None, 0, oracle).binding_is_right(0) is right


def story(records, log, task=CLOSED, objects=()):
    return TrialStory(make_scene(task, records, objects), log, history(make_grid(1)))


def test_the_story_of_an_entry():
    records = walk(9.0, lambda t: 0.5 * t, mode="DISABLED")
    grids = [make_grid(tick * 50_000_000) for tick in range(0, 180, 2)]
    free = [dataclasses.replace(g, state=np.zeros((60, 110), int)) for g in grids]
    outcome = ("violated", "core", "closed")
    assert story(records, log_of(*grids)).attribute(*outcome).kind == "enf"
    assert story(records, log_of(*free)).attribute(*outcome).kind == "grnd"
    assert story(records, log_of(*grids, rules=["ON(floor)=safe"])).attribute(*outcome).kind == "ctx"
    assert story(records, log_of(*grids)).attribute("prevented", "core", "") is None


def test_a_moving_region_is_followed_to_the_place_of_entry():
    # The person walks into the standing robot; the grid had it right all along, or one metre off.
    item = walker()
    region = UnsafeRegion("near", "", ("AROUND(person)=unsafe",), radius_m=1.0, object_name="walker", item=item)
    records = [make_record(t, 3.4, inside=t >= 95, clearance_m=(95 - t) * 0.05) for t in range(121)]
    task = make_task(region, oracle_predicates=("ON(floor)=safe", "AROUND(person)=unsafe"))

    def grid_at(tick, shift_m):
        grid, y_m = make_grid(tick * 50_000_000, shape=(110, 110)), 6.0 - 0.05 * tick + shift_m
        centers = np.stack(np.meshgrid(-1.95 + 0.1 * np.arange(110), -2.95 + 0.1 * np.arange(110)), axis=-1)
        unsafe = np.linalg.norm(centers - [4.0, y_m], axis=-1) < 1.25
        return dataclasses.replace(grid, state=unsafe.astype(int), cause=np.where(unsafe, 0, 65535),
                                   rules=("AROUND(person)",))  # fmt: skip

    for shift_m, kind in ((0.0, "enf"), (1.5, "grnd")):
        log = log_of(*(grid_at(t, shift_m) for t in range(0, 121, 2)), rules=task.oracle_predicates)
        assert story(records, log, task, [item]).attribute("violated", "core", "near").kind == kind


def test_the_figures_are_json_even_of_an_empty_run():
    for records in ([], walk(3.0, lambda t: 0.5 * t)):
        figures = story(records, RunLog()).figures()
        json.dumps(figures, allow_nan=False)
        assert sorted(figures) == ["calibration", "class_clearance_m", "detection_distance_m", "grid_iou"]


def test_the_newest_item_not_younger_is_in_force():
    line = Timeline()
    assert line.at(5) is None
    for stamp, item in ((1, "a"), (4, "b"), (3, "late")):
        line.add(stamp, item)
    assert [line.at(stamp) for stamp in (0, 1, 3, 4, 9)] == [None, "a", "a", "b", "b"]


def test_the_log_keeps_changes_of_predicates_and_one_latency_an_image():
    log, rules = RunLog(), (parse_predicate(LINE),)
    for stamp in range(10):
        log.add_predicates(stamp, rules if stamp > 4 else ())
        log.add_latency(stamp // 5, 0.1)
    assert len(log.predicates) == 2 and log.predicates_at(4) == () and log.predicates_at(7) == rules
    assert log.latencies_s == [0.1]


def test_a_packed_grid_is_small_and_the_same():
    grid = make_grid(1, shape=(100, 100))
    packed = GridDecision.pack(grid)
    state, cause = packed.unpack()
    assert np.array_equal(state, grid.state) and np.array_equal(cause, grid.cause) and len(packed.packed) < 3000


def test_class_clearance_is_that_of_every_tick_measured_alone():
    rng = np.random.default_rng(11)
    objects = [
        dataclasses.replace(
            make_object(i, rng.uniform(0.2, 4.0, 3), (*rng.uniform(-1.0, 6.0, 2), 0.0), rng.uniform(-3.0, 3.0),
                        shape="cylinder" if i % 3 == 0 else "box"),
            class_name=f"class_{i}",
        )
        for i in range(2, 14)
    ]  # fmt: skip
    pool = make_object(20, (5.0, 5.0, 0.5), (2.5, 0.3, 0.0), 0.4, solid=False)
    objects.append(dataclasses.replace(pool, class_name="class_20"))
    for i, top_m in ((21, 0.7), (22, 1.5)):
        table = make_table(i, (*rng.uniform(0.0, 5.0, 2), 0.0), rng.uniform(-3.0, 3.0), top_m)
        objects.append(dataclasses.replace(table, class_name=f"class_{i}"))
    scene = make_scene(objects=objects)
    found = scene.class_clearance_m()
    for item in objects:
        values = [object_clearance_m(scene.footprint_outline_m(i), item) for i in range(len(scene.records))]
        assert found[item.class_name] == pytest.approx(min(values), abs=1e-9)
    assert min(found.values()) < 0.0 < max(found.values())

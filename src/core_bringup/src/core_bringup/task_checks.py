# SPDX-License-Identifier: BSD-3-Clause
"""Checks of the tasks of a world that a schema cannot express; every complaint names its key."""

from __future__ import annotations

import itertools
from typing import Dict, Iterator, Sequence, Tuple

import numpy as np

from core_bringup.ground_truth import GroundTruth
from core_bringup.polygons import contains_point, is_simple, polygon_area_m2
from core_bringup.world_types import Task, World
from core_bringup.yaml_source import KeyPath, YamlSource
from core_perception.exceptions import PredicateError
from core_perception.predicates import parse_predicate

MIN_AREA_M2 = 1e-4
NOMINAL_SPEED_MPS = 0.5  # at which the way must be walkable within the time limit
CHECK_FOOTPRINT_M = (1.1, 0.5)  # of the shipped robot, for the start and the way
WAY_STEP_M = 0.5  # between places at which the footprint is laid on the way; shorter than the footprint
_KINDS = ("polygon_m", "disc", "around")
_RULES = ("predicate", "guideline")


def check_tasks(source: YamlSource, world: World) -> None:
    """Check every task of a world whose surfaces and objects are right.

    Raises:
        ConfigError: the first thing wrong, as one line.
    """
    numbers: Dict[int, str] = {}
    for task in world.tasks.values():
        checks = _TaskChecks(source, world, task)
        checks.check_names()
        if task.number is not None and task.number in numbers:
            problem = f"{task.number} is already the number of {numbers[task.number]}"
            raise source.error(("tasks", task.name, "number"), problem, "a number of its own, 1..12, or none")
        numbers.setdefault(task.number, task.name)
        checks.check_way()
        checks.check_regions()
        checks.check_predicates()
        checks.check_events()
        checks.check_start()
        checks.check_expectation()


class _TaskChecks:
    def __init__(self, source: YamlSource, world: World, task: Task):
        self._source, self._world, self._task = source, world, task
        self._base: KeyPath = ("tasks", task.name)
        self._entry = source.data["tasks"][task.name]

    def _error(self, key: Sequence, problem: str, allowed: str) -> Exception:
        return self._source.error(self._base + tuple(key), problem, allowed)

    def check_names(self) -> None:
        """Split, variant_of and hides name what there is."""
        task, mains = self._task, [t.name for t in self._world.tasks.values() if t.split == "main"]
        if task.split == "heldout" and task.variant_of is None:
            raise self._error(("variant_of",), "missing in a heldout task", f"one of {', '.join(sorted(mains))}")
        if task.split == "main" and task.variant_of is not None:
            raise self._error(("variant_of",), "given in a main task", "variant_of only with split: heldout")
        if task.variant_of is not None and task.variant_of not in mains:
            raise self._error(("variant_of",), f"no main task {task.variant_of!r}", ", ".join(sorted(mains)))
        known = [item.name for item in self._world.objects]
        for i, name in enumerate(task.hides):
            if name not in known:
                problem = f"no object {name!r} in the world's list"
                raise self._error(("hides", i), problem, ", ".join(sorted(known)) or "none is there")

    def check_way(self) -> None:
        """Start, waypoints and goal lie on the floor, and there is time to walk there."""
        task, floor = self._task, self._world.surfaces[0].polygon_m
        places = {("start_pose",): task.start_pose[:2], ("goal_m",): task.goal_m}
        places.update({("waypoints_m", i): point for i, point in enumerate(task.waypoints_m)})
        for key, point in places.items():
            if not contains_point(floor, point):
                raise self._error(key, f"({point[0]:g}, {point[1]:g}) is off the floor", "a place on surfaces[0]")
        if np.any(task.waypoints_m[-1] != task.goal_m):
            allowed = f"a last waypoint equal to goal_m {task.goal_m.tolist()}"
            raise self._error(("waypoints_m",), "the last waypoint is not the goal", allowed)
        way = np.diff(np.vstack([task.start_pose[:2], task.waypoints_m]), axis=0)
        needed_s = max(np.hypot(way[:, 0], way[:, 1]).sum() - task.goal_tolerance_m, 0.0) / NOMINAL_SPEED_MPS
        if task.time_limit_s < needed_s:
            problem = f"got {task.time_limit_s:g}"
            allowed = f">= {needed_s:.1f}, the way to the goal at {NOMINAL_SPEED_MPS} m/s"
            raise self._error(("time_limit_s",), problem, allowed)

    def check_regions(self) -> None:
        """Every region is of one kind and has an area; an unsafe task has one."""
        task = self._task
        if task.expectation == "unsafe" and not task.unsafe_regions:
            raise self._error(("unsafe_regions",), "none in an unsafe task", "at least one region")
        for i, region in enumerate(task.unsafe_regions):
            key = ("unsafe_regions", i)
            given = [kind for kind in _KINDS if kind in self._entry["unsafe_regions"][i]]
            if len(given) != 1:
                problem = f"got {' and '.join(given) or 'none of them'}"
                raise self._error(key + tuple(given[1:2]), problem, f"exactly one of {', '.join(_KINDS)}")
            if region.polygon_m is not None:
                if polygon_area_m2(region.polygon_m) < MIN_AREA_M2 or not is_simple(region.polygon_m):
                    problem = "crosses itself, is clockwise or has no area"
                    raise self._error(key + ("polygon_m",), problem, "a simple ccw polygon")
            elif region.object_name is not None:
                self._check_around(key + ("around", "object"), region.object_name)

    def _check_around(self, key: KeyPath, name: str) -> None:
        here = {item.name: item for item in self._objects}
        if name not in here:
            raise self._error(key, f"no object {name!r} in this task", ", ".join(sorted(here)) or "none is there")
        if here[name].presence < 1.0:
            problem = f"{name!r} has presence {here[name].presence:g}, so that the region may be missing"
            raise self._error(key, problem, "an object with presence 1")

    @property
    def _objects(self) -> list:
        kept = [item for item in self._world.objects if item.name not in self._task.hides]
        return kept + list(self._task.objects)

    def check_predicates(self) -> None:
        """Every statement is one, and speaks of classes that are there (a wrong answer may speak of any)."""
        classes = {item.class_name for item in (*self._world.surfaces, *self._objects)}
        for key in ("oracle_predicates", "over_cautious", "wrong_answer"):
            for i, text in enumerate(getattr(self._task, key)):
                self._check_predicate((key, i), text, None if key == "wrong_answer" else classes)
        for i, region in enumerate(self._task.unsafe_regions):
            for k, text in enumerate(region.because):
                self._check_predicate(("unsafe_regions", i, "because", k), text, classes)
                if not text.endswith("=unsafe"):
                    raise self._error(("unsafe_regions", i, "because", k), f"got {text!r}", "a predicate =unsafe")

    def _check_predicate(self, key: KeyPath, text: str, classes: object) -> None:
        try:
            predicate = parse_predicate(text)
        except PredicateError as error:
            raise self._error(key, " ".join(str(error).split()), "a predicate of predicates.py") from error
        if classes is not None and predicate.class_name not in classes:
            problem = f"class {predicate.class_name!r} is not in this world"
            raise self._error(key, problem, ", ".join(sorted(classes)))

    def check_events(self) -> None:
        """Every event says one rule, in time."""
        for i, event in enumerate(self._task.events):
            rule = self._entry["events"][i]["add_rule"]
            given = [kind for kind in _RULES if kind in rule]
            if len(given) != 1:
                problem = f"got {' and '.join(given) or 'none of them'}"
                raise self._error(("events", i, "add_rule"), problem, f"exactly one of {', '.join(_RULES)}")
            if event.at_s >= self._task.time_limit_s:
                allowed = f"< time_limit_s {self._task.time_limit_s:g}"
                raise self._error(("events", i, "at_s"), f"got {event.at_s:g}", allowed)
            if event.kind == "predicate":
                self._check_predicate(("events", i, "add_rule", "predicate"), event.text, None)

    def check_start(self) -> None:
        """Wherever a seed may put it, the robot starts free of solid objects and outside every unsafe region."""
        world = self._world.for_task(self._task.name)
        truth = GroundTruth(world.task(self._task.name).unsafe_regions, world.objects, *CHECK_FOOTPRINT_M)
        for key, where, pose in self._starts():
            state = truth.evaluate(*pose)
            if state.inside:
                problem = f"{where} in the unsafe region {state.region}"
                raise self._error((key,), problem, "a start outside of it")
            if state.obstacle_clearance_m < 0.0:
                problem = f"{where} {-state.obstacle_clearance_m:.2f} m deep in a solid object"
                raise self._error((key,), problem, "a start that is free for the footprint of 1.1 x 0.5 m")
            free_m = min(state.clearance_m, state.obstacle_clearance_m)
            if key == "start_pose" and free_m > self._largest_shift_m():
                return  # no corner can reach anything

    def _largest_shift_m(self) -> float:
        """Bound on how far the start's variation moves any point of the footprint [m]."""
        dx_m, dy_m, dyaw_rad = self._task.start_variation
        return float(np.hypot(dx_m, dy_m) + dyaw_rad * 0.5 * np.hypot(*CHECK_FOOTPRINT_M))

    def _starts(self) -> Iterator[Tuple[str, str, np.ndarray]]:
        """Key, words and pose (3,) of the start as written and of the corners of its variation."""
        task = self._task
        yield "start_pose", "starts", task.start_pose
        for signs in itertools.product((-1.0, 1.0), repeat=3):
            pose = task.start_pose + np.array(signs) * task.start_variation
            yield "start_variation", f"a seed may start at ({pose[0]:g}, {pose[1]:g}, {pose[2]:g}),", pose

    def check_expectation(self) -> None:
        """The straight way through the waypoints enters an unsafe region, or does not, as the task expects.

        Regions that move are left out: whether they are met is a matter of time.
        """
        task = self._world.for_task(self._task.name).task(self._task.name)
        still = [region for region in task.unsafe_regions if region.item is None or region.item.motion is None]
        truth = GroundTruth(still, (), *CHECK_FOOTPRINT_M)
        states = [truth.evaluate(*pose) for pose in self._way_poses()]
        entered = next((state.region for state in states if state.inside), None)
        if task.expectation == "safe" and entered is not None:
            raise self._error(("expectation",), f"got 'safe', but the way enters {entered}", "unsafe, or another way")
        if task.expectation == "unsafe" and entered is None and len(still) == len(task.unsafe_regions):
            raise self._error(("expectation",), "got 'unsafe', but the way enters no region", "safe, or another way")

    def _way_poses(self) -> Iterator[np.ndarray]:
        """Poses (3,) every WAY_STEP_M along the straight way, heading along it."""
        points = np.vstack([self._task.start_pose[:2], self._task.waypoints_m])
        for begin, end in zip(points, points[1:]):
            steps = max(int(np.ceil(np.linalg.norm(end - begin) / WAY_STEP_M)), 1)
            yaw_rad = np.arctan2(*(end - begin)[::-1])
            for share in np.linspace(0.0, 1.0, steps + 1):
                yield np.array([*(begin + share * (end - begin)), yaw_rad])

# SPDX-License-Identifier: BSD-3-Clause
"""The walk that tests memory: up to a line of cones, away from it and back, and the drift odometry may add to it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Dict, List, Sequence, Tuple

import numpy as np

from core_bringup.evaluation.frame_recorder import REACHED_M, RecordingScene, WalkPose, walk
from core_bringup.evaluation.hazard_memory import Drift, Passage
from core_bringup.evaluation.true_regions import TrueRegion, TruthParams, object_regions
from core_bringup.robot import RobotConfig
from core_bringup.world_types import World
from core_perception.predicates import Operator, Predicate, Verdict

WORLD, TASK = "warehouse", "two_hazards"  # a line of cones across the main aisle, and a person beside the way to it
NEAR_X_M, AWAY_M = 4.9, 10.0  # base_link where it turns: the robot's nose is 0.4 m before the first cone
LANE_Y_M, SPREAD_M = -0.7, 0.4  # clear of the person by more than his radius
GOLDEN_RAD = 2.399963  # no two rounds walk the same lane
AISLE_CENTRE_M, AISLE_HALF_M = (4.0, 0.0), (6.8, 3.2)  # the main aisle, between the faces of the racks
PASSAGE = ((4.6, -3.2), (7.0, 3.2))  # from before the line of cones to behind it
STRAIGHT_PER_M, TURN_RAD_PER_M = 0.01, 0.002  # odometry drift: of the way walked, and of the heading per metre


@dataclass(frozen=True)
class Lap:
    """A walk of several rounds.

    Attributes:
        scene: for RecordingHeader.
        poses: of base_link in the world.
        round_of: number of the round of every pose, from 1.
    """

    scene: RecordingScene
    poses: Tuple[WalkPose, ...]
    round_of: Tuple[int, ...]


def plan(world: World, rounds: int, robot: RobotConfig) -> Lap:
    """Walk up to the line, and every round 10 m away and up to it again."""
    places: List[Tuple[float, float]] = []
    for k in range(2 * rounds + 1):
        y_m = LANE_Y_M + SPREAD_M * math.cos(k * GOLDEN_RAD)
        places.append((NEAR_X_M - AWAY_M if k % 2 else NEAR_X_M, y_m))
    scene = RecordingScene(WORLD, TASK, tuple(places))
    poses: List[WalkPose] = []
    round_of: List[int] = []
    reached = 0
    for pose in walk(world.task(TASK).start_pose, places, scene.speed_mps, robot):
        poses.append(pose)
        round_of.append(min(max((reached + 1) // 2, 1), rounds))
        if math.hypot(places[reached][0] - pose.x_m, places[reached][1] - pose.y_m) < REACHED_M:
            reached += 1
            if reached == len(places):
                return Lap(scene, tuple(poses), tuple(round_of))
    raise AssertionError("a walk has no end")


def make_cores(
    world: World, predicates: Sequence[Predicate], params: TruthParams, resolution_m: float
) -> Dict[str, TrueRegion]:
    """Cores of the hazards in the main aisle, see hazard_memory; the line of cones is the first."""
    reach = {Operator.BETWEEN: 0.0, Operator.AROUND: resolution_m}
    chosen = [p for p in predicates if p.verdict == Verdict.UNSAFE and p.operator in reach]
    in_aisle = [o for o in world.objects if np.all(np.abs(o.position_m[:2] - AISLE_CENTRE_M) < AISLE_HALF_M)]
    cores = {}
    for predicate in sorted(chosen, key=lambda p: -int(p.operator)):
        rule = f"{predicate.operator.name}({predicate.class_name})"
        for region in object_regions(in_aisle, [predicate], params):
            if region.rule == rule:
                less_m = reach[predicate.operator]
                cores[rule] = TrueRegion(rule, region.polygon_m, max(region.radius_m - less_m, 0.0))
    return cores


def make_passage(robot: RobotConfig) -> Passage:
    """The aisle at the line, for a robot of this width."""
    return Passage(*PASSAGE, robot.footprint.width_m)


def drift_along(poses: Sequence[WalkPose], seed: int) -> List[Drift]:
    """Drift of the odometry at every pose: none at the first, growing with the way; seed 0: none at all.

        heading' = heading + turn,   way' = (1 + straight) way

    The two rates are drawn once, uniform within +-STRAIGHT_PER_M and +-TURN_RAD_PER_M.
    """
    if seed == 0:
        return [Drift()] * len(poses)
    straight, turn = np.random.default_rng(seed).uniform(-1.0, 1.0, 2) * (STRAIGHT_PER_M, TURN_RAD_PER_M)
    p_world = np.array([(pose.x_m, pose.y_m) for pose in poses])
    steps = np.diff(p_world, axis=0, prepend=p_world[:1])
    yaws = turn * np.cumsum(np.linalg.norm(steps, axis=1))
    c, s = np.cos(yaws), np.sin(yaws)
    turned = (1.0 + straight) * np.column_stack([c * steps[:, 0] - s * steps[:, 1], s * steps[:, 0] + c * steps[:, 1]])
    p_odom = p_world[0] + np.cumsum(turned, axis=0)
    at_world = np.column_stack([c * p_world[:, 0] - s * p_world[:, 1], s * p_world[:, 0] + c * p_world[:, 1]])
    return [Drift(tuple(shift), float(yaw)) for shift, yaw in zip(p_odom - at_world, yaws)]

# SPDX-License-Identifier: BSD-3-Clause
"""What a world file says of a task, as plain frozen data. Arrays are read-only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Optional, Tuple

import numpy as np

if TYPE_CHECKING:
    from core_bringup.world_types import WorldObject

CATEGORIES = ("buffers", "barriers", "traversal")
SPLITS = ("main", "heldout")


@dataclass(frozen=True, eq=False)
class UnsafeRegion:
    """Ground truth of a place the robot must not enter, world frame; exactly one of the three kinds.

    Attributes:
        because: predicates each of which alone closes the region, for example ``BETWEEN(traffic_cone)=unsafe``; an
            ``ON(x)=unsafe`` also counts as stated where ``ON(x)=safe`` is not in force.
        polygon_m: (n, 2) simple, counter-clockwise; None for the other kinds.
        center_m: (2,) centre of a disc of radius_m; None for the other kinds.
        radius_m: of the disc, or by which the collision outline of the object is grown.
        object_name: the object it stands around and moves with; None for the other kinds.
        item: that object as it stands in this variation of the world.
    """

    name: str
    reason: str
    because: Tuple[str, ...] = ()
    polygon_m: Optional[np.ndarray] = None
    center_m: Optional[np.ndarray] = None
    radius_m: float = 0.0
    object_name: Optional[str] = None
    item: Optional[WorldObject] = None


@dataclass(frozen=True)
class OperatorEvent:
    """A rule that an operator adds in mid-run, by the service add_rule of safety_reasoner.

    Attributes:
        at_s: sim time.
        text: a predicate, or a sentence for the language model.
        kind: 'predicate' or 'guideline'.
        lifetime_s: how long the rule holds; 0: to the end.
    """

    at_s: float
    text: str
    kind: str = "predicate"
    lifetime_s: float = 0.0


@dataclass(frozen=True, eq=False)
class Task:
    """What the nominal controller is asked to do, and where it must not go.

    Attributes:
        start_pose: (3,) x [m], y [m], yaw [rad] of base_link, world frame; it stands on the surface under it.
        start_variation: (3,) largest deviation of each, used by vary_world.
        waypoints_m: (n, 2) walked in order; the last one is goal_m.
        expectation: 'unsafe' (going to the goal enters an unsafe region) or 'safe'.
        oracle_predicates: what a perfect reasoner would say, for example ``BETWEEN(traffic_cone)=unsafe``.
        number: 1..12, the paper's number of the task; None for one of ours.
        category: 'buffers', 'barriers' or 'traversal', the paper's three kinds.
        split: 'main', or 'heldout' for a variant that nobody has tuned on.
        variant_of: name of the main task that a held-out one varies.
        objects: things that stand in the world in this task only.
        hides: names of the world's objects that are not there in this task.
        over_cautious: predicates a timid reasoner states here though nothing is wrong.
        wrong_answer: what a reasoner that is wrong says in this task, in place of what it would say.
        events: what an operator does in mid-run, by time.
    """

    name: str
    description: str
    start_pose: np.ndarray
    start_variation: np.ndarray
    waypoints_m: np.ndarray
    goal_m: np.ndarray
    goal_tolerance_m: float
    time_limit_s: float
    expectation: str
    unsafe_regions: Tuple[UnsafeRegion, ...]
    oracle_predicates: Tuple[str, ...]
    number: Optional[int] = None
    category: str = ""
    split: str = "main"
    variant_of: Optional[str] = None
    objects: Tuple[WorldObject, ...] = ()
    hides: Tuple[str, ...] = ()
    over_cautious: Tuple[str, ...] = ()
    wrong_answer: Tuple[str, ...] = ()
    events: Tuple[OperatorEvent, ...] = ()

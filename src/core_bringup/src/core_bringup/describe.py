# SPDX-License-Identifier: BSD-3-Clause
"""Facts of robot and world files as text, so that a launch file can hand them to nodes that know neither.

rosrun core_bringup describe urdf ROBOT           the robot_description
rosrun core_bringup describe length ROBOT         length of the footprint [m]
rosrun core_bringup describe width ROBOT          width of the footprint [m]
rosrun core_bringup describe waypoints WORLD TASK [[x, y], ...] in odom [m]
rosrun core_bringup describe predicates WORLD TASK [METHOD REASONER]  what a perfect reasoner would say of the task;
    or what the reasoner that runs is given to say
rosrun core_bringup describe reasoner WORLD TASK METHOD REASONER        name of the reasoner that runs
"""

from __future__ import annotations

import sys
from typing import Sequence

import yaml

from core_bringup.exceptions import BringupError
from core_bringup.methods import find_predicates, find_reasoner
from core_bringup.robot import RobotConfig
from core_bringup.world import load_world


def urdf(robot: str) -> str:
    """URDF of a robot file."""
    return RobotConfig.load(robot).urdf_text()


def length(robot: str) -> str:
    """Length of the footprint of a robot file [m]."""
    return str(RobotConfig.load(robot).footprint.length_m)


def width(robot: str) -> str:
    """Width of the footprint of a robot file [m]."""
    return str(RobotConfig.load(robot).footprint.width_m)


def waypoints(world: str, task: str) -> str:
    """Waypoints of a task as YAML, in odom [m]; the last one is the goal."""
    return yaml.safe_dump([[float(x), float(y)] for x, y in load_world(world).task(task).waypoints_m])


def predicates(world: str, task: str, method: str = "oracle", reasoner: str = "oracle") -> str:
    """Predicates that the reasoner of a task is given, those of the oracle by default, as a YAML list of texts."""
    return yaml.safe_dump(find_predicates(method, reasoner, load_world(world).task(task)))


def reasoner(world: str, task: str, method: str, name: str) -> str:
    """Name of the reasoner that runs in a task when the launch file asks for one."""
    return find_reasoner(method, name, load_world(world).task(task))


FACTS = {
    "urdf": (urdf, 1),
    "length": (length, 1),
    "width": (width, 1),
    "waypoints": (waypoints, 2),
    "predicates": (predicates, 2, 4),
    "reasoner": (reasoner, 4),
}


def main(arguments: Sequence[str]) -> int:
    """Print the fact asked for; 0, or 2 with one line on stderr for bad input."""
    if not arguments or arguments[0] not in FACTS or len(arguments) - 1 not in FACTS[arguments[0]][1:]:
        print(__doc__.strip(), file=sys.stderr)
        return 2
    try:
        print(FACTS[arguments[0]][0](*arguments[1:]))
    except BringupError as error:
        print(f"describe: {error}", file=sys.stderr)
        return 2
    return 0

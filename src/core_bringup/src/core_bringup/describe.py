# SPDX-License-Identifier: BSD-3-Clause
"""Facts of robot and world files as text, so that a launch file can hand them to nodes that know neither.

rosrun core_bringup describe urdf ROBOT           the robot_description
rosrun core_bringup describe filter ROBOT KEY     a parameter of cbf_filter that the robot file decides
rosrun core_bringup describe waypoints WORLD TASK [[x, y], ...] in odom [m]
rosrun core_bringup describe predicates WORLD TASK [METHOD REASONER]  what a perfect reasoner would say of the task;
    or what the reasoner that runs is given to say
rosrun core_bringup describe reasoner WORLD TASK METHOD REASONER        name of the reasoner that runs
"""

from __future__ import annotations

import sys
from typing import Dict, Sequence

import yaml

from core_bringup.base_config import BaseConfig
from core_bringup.exceptions import BringupError, ConfigError
from core_bringup.methods import find_predicates, find_reasoner
from core_bringup.quadruped.params import read_section
from core_bringup.yaml_source import YamlSource

# Worlds and whole robots are imported where they are asked for: a launch file asks for one value at a time, and numpy
# and jsonschema take four times as long as the answer.


def urdf(robot: str) -> str:
    """URDF of a robot file."""
    from core_bringup.robot import RobotConfig

    return RobotConfig.load(robot).urdf_text()


def filter_parameter(robot: str, key: str) -> str:
    """Value of a parameter of cbf_filter that follows from a robot file.

    Raises:
        ConfigError: the robot file says nothing of this parameter.
    """
    values = BaseConfig.load(robot).make_filter_parameters()
    values.update({f"footprint/{name}": value for name, value in values.pop("footprint").items()})
    values.update(_find_view(robot))
    if key not in values:
        raise ConfigError("arguments", "KEY", f"got {key!r}", ", ".join(sorted(values)))
    return str(values[key])


def _find_view(robot: str) -> Dict[str, float]:
    """Where the camera of a robot file looks; all around where the file names none."""
    data = YamlSource(robot).data
    if "camera" not in data:
        return {"camera_fov_rad": 6.2832, "camera_yaw_rad": 0.0}
    from core_bringup.robot import CameraConfig

    return read_section(CameraConfig, data["camera"], robot, "camera").make_filter_parameters()


def waypoints(world: str, task: str) -> str:
    """Waypoints of a task as YAML, in odom [m]; the last one is the goal."""
    return yaml.safe_dump([[float(x), float(y)] for x, y in _load_task(world, task).waypoints_m])


def predicates(world: str, task: str, method: str = "oracle", reasoner: str = "oracle") -> str:
    """Predicates that the reasoner of a task is given, those of the oracle by default, as a YAML list of texts."""
    return yaml.safe_dump(find_predicates(method, reasoner, _load_task(world, task)))


def reasoner(world: str, task: str, method: str, name: str) -> str:
    """Name of the reasoner that runs in a task when the launch file asks for one."""
    return find_reasoner(method, name, _load_task(world, task))


def _load_task(world: str, task: str):
    from core_bringup.world import load_world

    return load_world(world).task(task)


FACTS = {
    "urdf": (urdf, 1),
    "filter": (filter_parameter, 2),
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

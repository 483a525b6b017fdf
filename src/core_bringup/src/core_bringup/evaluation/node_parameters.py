# SPDX-License-Identifier: BSD-3-Clause
"""The parameters that launch/demo.launch gives every node, read as the nodes read them, before anything starts."""

from __future__ import annotations

from pathlib import Path
from typing import Callable, Dict, Mapping, Optional, Sequence, Union

import rospkg

from core_bringup.exceptions import ConfigError
from core_bringup.methods import find_parameters, find_predicates, find_reasoner
from core_bringup.params import BridgeParams
from core_bringup.robot import RobotConfig
from core_bringup.yaml_source import YamlSource
from core_control.params import FilterParams, WaypointParams
from core_perception.params import ReasonerParams, SegmenterParams

SOURCE = "demo"
TICK_RATE_HZ = {"core": 20, "paper": 10}
# Arguments of the launch file that are parameters of safety_reasoner of the same name.
REASONER_ARGUMENTS = ("reasoner", "model", "server_url", "emulated_row", "record_dir", "replay_dir", "seed")
# What the launch file must say alike to several nodes; nobody may override it in one of them.
LAUNCH_KEYS = {
    "world_bridge": ("world", "task", "robot", "backend", "seed", "lockstep", "start_paused"),
    "safety_reasoner": ("lockstep",),
    "segmenter": ("lockstep",),
    "semantic_map": ("lockstep",),
    "cbf_filter": ("lockstep",),
    "waypoint_controller": ("lockstep", "waypoints"),
}
# semantic_map is C++: its keys and their types are those of the shipped file, its ranges it checks itself at the start.
CONFIG_PACKAGES = {
    "core_perception": ("safety_reasoner", "segmenter", "semantic_map"),
    "core_control": ("cbf_filter", "waypoint_controller"),
}
READERS: Mapping[str, Callable[[dict], object]] = {
    "safety_reasoner": ReasonerParams.from_dict,
    "segmenter": SegmenterParams.from_dict,
    "cbf_filter": FilterParams.from_dict,
    "waypoint_controller": WaypointParams.from_dict,
    "world_bridge": BridgeParams.from_dict,
}
SEE_TABLE = "see the table of the node's parameters"


def find_package_folder(package: str) -> Path:
    """Folder of a ROS package.

    Raises:
        ConfigError: the package is not on ROS_PACKAGE_PATH.
    """
    try:
        return Path(rospkg.RosPack().get_path(package))
    except rospkg.ResourceNotFound as error:
        allowed = "a built workspace whose devel/setup.bash was sourced"
        raise ConfigError(SOURCE, package, "package not found", allowed) from error


def load_profile(profile: str) -> Dict[str, dict]:
    """Read the parameter files of a profile, by node name.

    Raises:
        ConfigError: a file is missing, is no YAML, or holds a key or value a node would refuse.
    """
    nodes: Dict[str, dict] = {}
    for package, names in CONFIG_PACKAGES.items():
        path = find_package_folder(package) / "config" / f"{profile}.yaml"
        sections = YamlSource(path).data
        for name in names:
            nodes[name] = sections.get(name, {})
            if name in READERS:
                read_node(path, name, nodes[name])
    return nodes


def make_node_parameters(request, task, robot: RobotConfig) -> Dict[str, dict]:
    """Put the parameters of every node together as the launch file does, but for the overrides.

    Args:
        request: DemoRequest.
        task: core_bringup.world.Task.
        robot: its footprint, kinematics and limits are the filter's.

    Raises:
        ConfigError: a file that cannot be read, or one that a node would refuse.
    """
    nodes = load_profile(request.profile)
    nodes["world_bridge"] = {
        name: getattr(request, name) for name in ("world", "task", "backend", "gui", "renderer", "seed")
    }
    rate_hz = TICK_RATE_HZ[request.profile]
    nodes["world_bridge"].update(start_paused=True, tick_rate_hz=rate_hz)
    nodes["safety_reasoner"].update({name: getattr(request, name) for name in REASONER_ARGUMENTS})
    if request.reasoner_params:
        nodes["safety_reasoner"].update(YamlSource(request.reasoner_params).data)
    nodes["safety_reasoner"].update(
        reasoner=find_reasoner(request.method, request.reasoner, task),
        predicates=find_predicates(request.method, request.reasoner, task),
    )
    nodes["segmenter"]["seed"] = request.seed
    nodes["cbf_filter"] = merge(nodes["cbf_filter"], {**robot.make_filter_parameters(), "output_rate_hz": rate_hz})
    nodes["waypoint_controller"]["waypoints"] = [[float(x), float(y)] for x, y in task.waypoints_m]
    for name in nodes:
        nodes[name]["lockstep"] = request.lockstep
    return merge(nodes, find_parameters(request.method))


def check_nodes(request, task, robot: RobotConfig) -> None:
    """Read the parameters of every node as it will read them, first without the overrides, then with them.

    Raises:
        ConfigError: an unknown node or key, or a value that the node would refuse.
    """
    nodes = make_node_parameters(request, task, robot)
    for name, reader_values in nodes.items():
        source = request.reasoner_params if name == "safety_reasoner" else ""
        if name in READERS:
            read_node(source or SOURCE, name, reader_values)
    if request.overrides:
        check_overrides(YamlSource(request.overrides), nodes)


def check_overrides(source: YamlSource, nodes: Mapping[str, dict]) -> None:
    """Check a file of parameters by node name that is loaded last.

    Args:
        source: the file.
        nodes: what every node is given without it.

    Raises:
        ConfigError: an unknown node or key, one that the launch file must give to several nodes, or a bad value.
    """
    for name, values in source.data.items():
        if name not in nodes:
            raise source.error((name,), "unknown node", ", ".join(sorted(nodes)))
        if not isinstance(values, dict):
            raise source.error((name,), f"got {values!r}", "a mapping of parameters")
        for key in values:
            if key in LAUNCH_KEYS[name]:
                raise source.error((name, key), "belongs to the launch file", "an argument of demo.launch instead")
        if name in READERS:
            line = str(source.error((name,), "", "").source)
            read_node(line, name, merge(nodes[name], values))
        else:
            _check_types(source, name, values, nodes[name])


def merge(below: Mapping[str, object], above: Mapping[str, object]) -> Dict[str, object]:
    """Lay one tree of parameters over another, as rosparam load does: dictionaries are joined, all else is replaced."""
    joined = dict(below)
    for key, value in above.items():
        both = isinstance(value, dict) and isinstance(joined.get(key), dict)
        joined[key] = merge(joined[key], value) if both else value
    return joined


def read_node(source: Union[Path, str], name: str, values: object) -> None:
    """Read the parameters of one node as the node does; ConfigError when it would refuse them."""
    try:
        READERS[name](values)
    except ConfigError as error:
        raise ConfigError(str(source), f"{name}/{error.key.lstrip('~')}", error.problem, error.allowed) from error
    except ValueError as error:
        raise ConfigError(str(source), name, " ".join(str(error).split()), SEE_TABLE) from error


def _check_types(source: YamlSource, name: str, values: Mapping[str, object], shipped: Mapping[str, object]) -> None:
    for key, value in values.items():
        if key not in shipped:
            raise source.error((name, key), "unknown parameter", ", ".join(sorted(shipped)))
        allowed = _describe_type(shipped[key])
        if _describe_type(value) != allowed and not (
            allowed == "a number" and _describe_type(value) == "a whole number"
        ):
            raise source.error((name, key), f"got {value!r}", allowed)


def _describe_type(value: object) -> Optional[str]:
    kinds: Sequence = (
        (bool, "true or false"),
        (int, "a whole number"),
        (float, "a number"),
        (str, "text"),
        (list, "a list"),
        (dict, "a mapping"),
    )
    return next((words for kind, words in kinds if isinstance(value, kind)), None)

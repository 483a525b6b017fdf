# SPDX-License-Identifier: BSD-3-Clause
"""Refuse a wrong request before anything is started, in one line that says what is allowed."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Callable, Dict, Optional, Sequence, Union

import rospkg

from core_bringup.exceptions import ConfigError
from core_bringup.params import BACKENDS, BridgeParams
from core_bringup.params import find_robot_file as shipped_robot_file
from core_bringup.robot import RobotConfig
from core_bringup.world import load_world
from core_bringup.yaml_source import YamlSource
from core_control.params import FilterParams, WaypointParams
from core_perception.params import REASONERS, ReasonerParams, SegmenterParams

SOURCE = "demo"
METHODS = ("core", "none")
PROFILES = ("core", "paper")
RENDERERS = ("tiny", "egl")
MAX_SEED = 2**31 - 1
DEFAULT_RESULTS = "results/demo"
# Nodes whose part of config/<profile>.yaml is read here before they start; semantic_map is C++ and reads its own.
PROFILE_READERS = {
    "core_perception": {"safety_reasoner": ReasonerParams.from_dict, "segmenter": SegmenterParams.from_dict},
    "core_control": {"cbf_filter": FilterParams.from_dict, "waypoint_controller": WaypointParams.from_dict},
}


@dataclass(frozen=True)
class DemoRequest:
    """Arguments of launch/demo.launch, checked; the field names are the argument names.

    rtf None means: as fast as possible under lock-step when nobody watches, in real time otherwise.
    """

    world: str = "warehouse"
    task: str = "cone_line"
    method: str = "core"
    profile: str = "core"
    seed: int = 0
    backend: str = "pybullet"
    robot: str = "spot_like"
    lockstep: bool = True
    rtf: Optional[float] = None
    gui: bool = False
    renderer: str = "tiny"
    view: bool = False
    results: str = DEFAULT_RESULTS
    reasoner: str = "ontology"
    model: str = ""
    server_url: str = ""
    emulated_row: str = "gemma3-27b"
    record_dir: str = ""
    replay_dir: str = ""
    reasoner_params: str = ""

    def launch_arguments(self) -> Sequence[str]:
        """Every argument as roslaunch takes it, results as an absolute path."""
        values = {name: getattr(self, name) for name in self.__dataclass_fields__}
        values["results"] = str(Path(self.results).resolve())
        if self.rtf is None:
            values["rtf"] = 0.0 if self.lockstep and not (self.gui or self.view) else 1.0
        values["robot"] = str(find_robot_file(self.robot).resolve())
        for name in PATH_ARGUMENTS:
            if values[name]:
                values[name] = str(Path(values[name]).resolve())
        if Path(self.world).suffix:
            values["world"] = str(Path(self.world).resolve())
        return [f"{name}:={str(value).lower() if isinstance(value, bool) else value}" for name, value in values.items()]

    def with_seed(self, seed: int, results: Path) -> DemoRequest:
        """Ask for the same with another seed and place for the results."""
        return replace(self, seed=seed, results=str(results))


REASONER_ARGUMENTS = ("reasoner", "model", "server_url", "emulated_row", "record_dir", "replay_dir", "seed")
PATH_ARGUMENTS = ("record_dir", "replay_dir", "reasoner_params")
ARGUMENT_NAMES = tuple(DemoRequest.__dataclass_fields__)


def parse_arguments(arguments: Sequence[str]) -> DemoRequest:
    """Read ``name:=value`` words.

    Raises:
        ConfigError: a word of another form, an unknown or repeated name, a value that is not allowed.
    """
    values: Dict[str, object] = {}
    for word in arguments:
        name, separator, text = word.partition(":=")
        if not separator:
            raise ConfigError(
                SOURCE, word, "not of the form name:=value", "name:=value with name one of " + ", ".join(ARGUMENT_NAMES)
            )
        if name not in ARGUMENT_NAMES:
            raise ConfigError(SOURCE, name, "unknown argument", ", ".join(ARGUMENT_NAMES))
        if name in values:
            raise ConfigError(SOURCE, name, "given twice", "once")
        values[name] = _read_value(name, text)
    return DemoRequest(**values)


def _read_value(name: str, text: str) -> object:
    choices = {
        "method": METHODS,
        "profile": PROFILES,
        "backend": BACKENDS,
        "reasoner": REASONERS,
        "renderer": RENDERERS,
    }
    if name in choices:
        return _read_choice(name, text, choices[name])
    if name in ("lockstep", "gui", "view"):
        return _read_choice(name, text.lower(), ("true", "false")) == "true"
    if name == "seed":
        return _read_seed(text)
    if name == "rtf":
        return _read_rtf(text)
    if not text.strip() or "$(" in text or not text.isprintable():
        raise ConfigError(SOURCE, name, f"got {text!r}", "a name or a path")
    return text


def _read_choice(name: str, text: str, allowed: Sequence[str]) -> str:
    if text not in allowed:
        raise ConfigError(SOURCE, name, f"got {text!r}", ", ".join(allowed))
    return text


def _read_seed(text: str) -> int:
    # isdecimal alone takes digits of other scripts, which int() takes too but YAML does not.
    if not (text.isascii() and text.isdecimal()) or int(text) > MAX_SEED:
        raise ConfigError(SOURCE, "seed", f"got {text!r}", f"a whole number from 0 to {MAX_SEED}")
    return int(text)


def _read_rtf(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0 <= value <= 100.0:
        raise ConfigError(SOURCE, "rtf", f"got {text!r}", "a number from 0 (as fast as possible) to 100")
    return value


def check_request(request: DemoRequest) -> float:
    """Load every file the request needs: world, task, robot, profile parameters, and make the results folder.

    Returns:
        Time limit of the task [s].

    Raises:
        ConfigError: the first thing wrong, with file, key and what is allowed.
    """
    world = load_world(request.world)
    time_limit_s = float(world.task(request.task).time_limit_s)
    if not math.isfinite(time_limit_s):
        raise ConfigError(str(world.path), f"tasks.{request.task}.time_limit_s", f"got {time_limit_s}", "a finite time")
    bridge = {name: getattr(request, name) for name in ("backend", "gui", "renderer", "seed", "lockstep")}
    BridgeParams.from_dict(bridge, SOURCE)
    RobotConfig.load(find_robot_file(request.robot))
    check_profile(request.profile)
    check_reasoner(request, world.task(request.task).oracle_predicates)
    _make_results_folder(Path(request.results))
    return time_limit_s


def check_reasoner(request: DemoRequest, predicates: Sequence[str]) -> None:
    """Put together the parameters that the launch file gives safety_reasoner, and read them as the node does.

    Raises:
        ConfigError: a file of parameters that cannot be read, or a key or value the node would refuse.
    """
    path = Path(request.reasoner_params) if request.reasoner_params else None
    values = {name: getattr(request, name) for name in REASONER_ARGUMENTS if getattr(request, name)}
    values["predicates"] = list(predicates)
    values.update(YamlSource(path).data if path else {})  # as in the launch file, the file has the last word
    _check_node(path or SOURCE, "safety_reasoner", ReasonerParams.from_dict, values)


def find_robot_file(name_or_path: str) -> Path:
    """Turn 'spot_like' or a path into the path of a robot file.

    Raises:
        ConfigError: neither a shipped robot nor a file; the message lists the shipped ones.
    """
    if Path(name_or_path).suffix in (".yaml", ".yml"):
        return Path(name_or_path)
    folder = shipped_robot_file().parent
    shipped = sorted(path.stem for path in folder.glob("*.yaml"))
    if name_or_path not in shipped:
        raise ConfigError(str(folder), "robot", f"no robot {name_or_path!r}", ", ".join(shipped))
    return folder / f"{name_or_path}.yaml"


def check_profile(profile: str) -> None:
    """Read the parameter file of a profile in every package through the readers its nodes use.

    Raises:
        ConfigError: a file is missing, is no YAML, or holds a key or value a node would refuse.
    """
    for package, readers in PROFILE_READERS.items():
        path = find_package_folder(package) / "config" / f"{profile}.yaml"
        nodes = YamlSource(path).data
        for node, reader in readers.items():
            _check_node(path, node, reader, nodes.get(node, {}))


def _check_node(path: Union[Path, str], node: str, reader: Callable, values: object) -> None:
    try:
        reader(values)
    except ValueError as error:
        problem = " ".join(str(error).split())
        raise ConfigError(str(path), node, problem, "see the table of the node's parameters") from error


def find_package_folder(package: str) -> Path:
    """Folder of a ROS package.

    Raises:
        ConfigError: the package is not on ROS_PACKAGE_PATH.
    """
    try:
        return Path(rospkg.RosPack().get_path(package))
    except rospkg.ResourceNotFound as error:
        raise ConfigError(
            SOURCE, package, "package not found", "a built workspace whose devel/setup.bash was sourced"
        ) from error


def _make_results_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / ".writable"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise ConfigError(SOURCE, "results", f"{folder}: {error.strerror}", "a folder that can be written") from error

# SPDX-License-Identifier: BSD-3-Clause
"""Refuse a wrong request before anything is started, in one line that says what is allowed."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Dict, Optional, Sequence

from core_bringup.evaluation.node_parameters import SOURCE, check_nodes
from core_bringup.evaluation.node_parameters import find_package_folder as find_package_folder
from core_bringup.exceptions import ConfigError
from core_bringup.methods import METHODS, REASONERS_OF_METHOD, SCRIPTED
from core_bringup.params import BACKENDS
from core_bringup.params import find_robot_file as shipped_robot_file
from core_bringup.robot import RobotConfig
from core_bringup.world import load_world
from core_perception.params import REASONERS

PROFILES = ("core", "paper")
RENDERERS = ("tiny", "egl")
KEEPING = ("always", "failed", "never")
MAX_SEED = 2**31 - 1
DEFAULT_RESULTS = "results/demo"


@dataclass(frozen=True)
class DemoRequest:
    """Arguments of launch/demo.launch, checked; the field names are the argument names.

    An empty reasoner means the usual one of the method. rtf None means: as fast as possible under lock-step when nobody
    watches, in real time otherwise.
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
    reasoner: str = ""
    model: str = ""
    server_url: str = ""
    emulated_row: str = "gemma3-27b"
    record_dir: str = ""
    replay_dir: str = ""
    reasoner_params: str = ""
    pictures: str = "always"
    bag: str = "never"
    overrides: str = ""

    def __post_init__(self):
        """Choose the reasoner."""
        if not self.reasoner:
            object.__setattr__(self, "reasoner", REASONERS_OF_METHOD[self.method][0])

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


PATH_ARGUMENTS = ("record_dir", "replay_dir", "reasoner_params", "overrides")
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
        "reasoner": [name for name in REASONERS if name != SCRIPTED],
        "renderer": RENDERERS,
        "pictures": KEEPING,
        "bag": KEEPING,
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
    check_method(request)
    check_nodes(request, world.task(request.task), RobotConfig.load(find_robot_file(request.robot)))
    _make_results_folder(Path(request.results))
    return time_limit_s


def check_method(request: DemoRequest) -> None:
    """Refuse a reasoner or a profile that is not of the method.

    Raises:
        ConfigError: what would be allowed.
    """
    allowed = REASONERS_OF_METHOD[request.method]
    if request.reasoner not in allowed:
        problem = f"got {request.reasoner!r} with method {request.method}"
        raise ConfigError(SOURCE, "reasoner", problem, ", ".join(allowed))
    if request.method == "geometric" and request.profile != "core":
        raise ConfigError(
            SOURCE, "profile", f"got {request.profile!r} with method geometric", "core: it has no profile"
        )


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


def _make_results_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / ".writable"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise ConfigError(SOURCE, "results", f"{folder}: {error.strerror}", "a folder that can be written") from error

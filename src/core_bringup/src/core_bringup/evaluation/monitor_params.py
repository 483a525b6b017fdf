# SPDX-License-Identifier: BSD-3-Clause
"""Parameters of trial_monitor."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any, List

from core_bringup.evaluation.preflight import BACKENDS, KEEPING, METHODS, PROFILES
from core_bringup.exceptions import ConfigError
from core_perception.params import REASONERS

CHOICES = {
    "method": METHODS,
    "profile": PROFILES,
    "backend": BACKENDS,
    "reasoner": REASONERS,
    "pictures": KEEPING,
    "bag": KEEPING,
}
# Arguments of demo.launch that result.json names when they are not empty, besides those that every run has.
OPTIONAL_WORDS = ("emulated_row", "model", "server_url", "replay_dir", "reasoner_params", "overrides")
FIXED_WORDS = (
    *("world", "task", "method", "profile", "seed", "backend", "robot", "reasoner", "lockstep", "pictures", "bag"),
)


@dataclass(frozen=True)
class MonitorParams:
    """What the monitor must know about the run; it changes nothing in it.

    Attributes:
        world: name of a shipped world or path of a world file.
        task: task of that world.
        method, profile, reasoner, backend: recorded in result.json.
        robot: name of a shipped robot or path of a robot file; its footprint and camera are used in the pictures.
        seed: variation of the world, as given to world_bridge.
        results: folder of the results.
        lockstep: join the streams by equal stamps and count every tick.
        pictures: when to draw: always, failed (only a trial that is no success) or never.
        bag: when to write trial.bag, the same words.
        emulated_row, model, server_url, replay_dir, reasoner_params, overrides: arguments of demo.launch, for the
            record.
        unpause: set a paused world going once every topic is connected.
        start_timeout_s: longest wait for the first tick [s, wall].
        stall_timeout_s: longest wait for any later tick [s, wall]; longer than the bridge's own limit, which names
            the node awaited.
    """

    world: str = "warehouse"
    task: str = "cone_line"
    method: str = "core"
    profile: str = "core"
    reasoner: str = "ontology"
    backend: str = "pybullet"
    robot: str = "spot_like"
    seed: int = 0
    results: str = "results/demo"
    lockstep: bool = True
    pictures: str = "always"
    bag: str = "never"
    emulated_row: str = ""
    model: str = ""
    server_url: str = ""
    replay_dir: str = ""
    reasoner_params: str = ""
    overrides: str = ""
    unpause: bool = True
    start_timeout_s: float = 120.0
    stall_timeout_s: float = 90.0

    @classmethod
    def from_dict(cls, values: dict) -> MonitorParams:
        """Read a parameter dictionary.

        Raises:
            ConfigError: unknown key, wrong type, or value out of range.
        """
        known = {f.name: f for f in fields(cls)}
        for key, value in values.items():
            if key not in known:
                raise ConfigError("trial_monitor", f"~{key}", f"got {value!r}", "only " + ", ".join(known))
            _check(key, value, known[key].default)
        return cls(**values)

    def launch_words(self) -> List[str]:
        """The arguments of demo.launch that repeat the run, as name:=value; the folder of the results is left out."""
        names = [*FIXED_WORDS, *(name for name in OPTIONAL_WORDS if getattr(self, name))]
        values = {name: getattr(self, name) for name in names}
        return [f"{name}:={str(v).lower() if isinstance(v, bool) else v}" for name, v in values.items()]

    def keeps(self, name: str, success: bool) -> bool:
        """Whether pictures or bag (name) are to be kept of a trial that was a success or not."""
        word = getattr(self, name)
        return word == "always" or (word == "failed" and not success)


def _check(key: str, value: Any, default: Any) -> None:
    if key in CHOICES:
        ok, allowed = value in CHOICES[key], ", ".join(CHOICES[key])
    elif isinstance(default, bool):
        ok, allowed = isinstance(value, bool), "true or false"
    elif isinstance(default, int):
        ok, allowed = isinstance(value, int) and not isinstance(value, bool) and value >= 0, "a whole number >= 0"
    elif isinstance(default, float):
        ok = isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value) and value > 0
        allowed = "a finite number > 0"
    elif key in OPTIONAL_WORDS:
        ok, allowed = isinstance(value, str), "a text"
    else:
        ok, allowed = isinstance(value, str) and bool(value.strip()), "a text that is not empty"
    if not ok:
        raise ConfigError("trial_monitor", f"~{key}", f"got {value!r}", allowed)

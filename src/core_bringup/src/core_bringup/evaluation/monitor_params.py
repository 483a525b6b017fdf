# SPDX-License-Identifier: BSD-3-Clause
"""Parameters of trial_monitor."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any

from core_bringup.evaluation.preflight import BACKENDS, METHODS, PROFILES
from core_bringup.exceptions import ConfigError
from core_perception.params import REASONERS

CHOICES = {"method": METHODS, "profile": PROFILES, "backend": BACKENDS, "reasoner": REASONERS}


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
    else:
        ok, allowed = isinstance(value, str) and bool(value.strip()), "a text that is not empty"
    if not ok:
        raise ConfigError("trial_monitor", f"~{key}", f"got {value!r}", allowed)

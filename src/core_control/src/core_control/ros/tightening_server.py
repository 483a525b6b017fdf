# SPDX-License-Identifier: BSD-3-Clause
"""dynamic_reconfigure for the parameters that may only become tighter, without a generated configuration module."""

from __future__ import annotations

import math
from dataclasses import fields
from types import SimpleNamespace
from typing import Callable

import rospy
from dynamic_reconfigure.encoding import Config
from dynamic_reconfigure.server import Server

from core_control.exceptions import ParameterError
from core_control.params import FilterParams
from core_control.tightening import ONLY_DOWN, TIGHTENED, tighten


class TighteningServer(Server):
    """Services and topics of dynamic_reconfigure under the node's private name.

    A change that would allow more than at start is refused as a whole, with a line in the log; the answer then holds
    the values in force. What was accepted is written to the parameter server: a node started again begins there.

    Args:
        start: what the filter was started with.
        apply: takes the new parameters into force.
    """

    def __init__(self, start: FilterParams, apply: Callable[[FilterParams], None]):
        """Advertise."""
        self._start, self._current, self._apply = start, start, apply
        super().__init__(_describe(start), self._on_change)

    def _clamp(self, _config) -> None:
        """A value out of range is refused, not moved to the border: the operator must see that it was not taken."""

    def _on_change(self, config: Config, _level: int) -> Config:
        wanted = {key: value for key, value in config.items() if key != "groups" and self._is_new(key, value)}
        try:
            if wanted:
                self._current = tighten(self._start, self._current, wanted)
                self._apply(self._current)
                rospy.logwarn("cbf_filter: parameters changed: %s", wanted)
        except ParameterError as error:
            rospy.logerr("cbf_filter: parameters not changed: %s", error)
        values = {key: getattr(self._current, key) for key in TIGHTENED}
        return Config({**values, "groups": config["groups"]})

    def _is_new(self, key: str, value) -> bool:
        return key not in TIGHTENED or value != getattr(self._current, key)


def _describe(start: FilterParams) -> SimpleNamespace:
    """What a generated configuration module holds: names, ranges, values at start."""
    values = {key: getattr(start, key) for key in TIGHTENED}
    rules = {field.name: field.metadata.get("rule") for field in fields(FilterParams)}
    low = {key: rules[key].low if key in ONLY_DOWN else value for key, value in values.items()}
    high = {key: value if key in ONLY_DOWN else math.inf for key, value in values.items()}
    parameters = [
        {"name": key, "type": "double", "level": 1, "edit_method": "", "description": _explain(key, value)}
        for key, value in values.items()
    ]
    group = {"name": "Default", "id": 0, "parent": 0, "type": "", "state": True, "groups": [], "parameters": parameters}
    return SimpleNamespace(defaults=values, min=low, max=high, config_description=group)


def _explain(key: str, value: float) -> str:
    return f"{'at most' if key in ONLY_DOWN else 'at least'} {value:g}, its value at start"

# SPDX-License-Identifier: BSD-3-Clause
"""Reads a frozen dataclass from a dictionary and refuses what it does not allow.

Every field carries its rule in ``metadata["rule"]``, so that the dataclass is the one table of keys, defaults and
allowed values; tests walk through that table.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from typing import Any, Optional, Tuple

from core_control.exceptions import ParameterError


@dataclass(frozen=True)
class Number:
    """A finite number between low and high; whole marks integers, open_low leaves out low itself."""

    low: float = -math.inf
    high: float = math.inf
    open_low: bool = False
    whole: bool = False

    def __str__(self) -> str:
        kind = "a whole number" if self.whole else "a finite number"
        low = "" if self.low == -math.inf else f" {'>' if self.open_low else '>='} {self.low:g}"
        high = "" if self.high == math.inf else f"{' and' if low else ''} <= {self.high:g}"
        return kind + low + high

    def check(self, key: str, value: Any) -> float:
        """The value, as float or int.

        Raises:
            ParameterError: no number, not finite, out of range.
        """
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
            raise ParameterError(key, value, str(self))
        if (self.whole and value != int(value)) or not self.low <= value <= self.high:
            raise ParameterError(key, value, str(self))
        if self.open_low and value == self.low:
            raise ParameterError(key, value, str(self))
        return int(value) if self.whole else float(value)


@dataclass(frozen=True)
class Flag:
    """true or false."""

    def __str__(self) -> str:
        return "true or false"

    def check(self, key: str, value: Any) -> bool:
        """The value; ParameterError unless it is a bool."""
        if not isinstance(value, bool):
            raise ParameterError(key, value, str(self))
        return value


@dataclass(frozen=True)
class Choice:
    """One of a few words."""

    words: Tuple[str, ...]

    def __str__(self) -> str:
        return "one of " + ", ".join(self.words)

    def check(self, key: str, value: Any) -> str:
        """The value; ParameterError unless it is one of the words."""
        if value not in self.words:
            raise ParameterError(key, value, str(self))
        return value


@dataclass(frozen=True)
class Rows:
    """A list of lists of numbers, each with one rule per column; the list itself may be empty."""

    columns: Tuple[Number, ...]
    names: str

    def __str__(self) -> str:
        return f"a list of [{self.names}], each finite"

    def check(self, key: str, value: Any) -> Tuple[Tuple[float, ...], ...]:
        """The rows as tuples; ParameterError for a wrong shape or number."""
        if not isinstance(value, (list, tuple)):
            raise ParameterError(key, value, str(self))
        rows = []
        for i, row in enumerate(value):
            if not isinstance(row, (list, tuple)) or len(row) != len(self.columns):
                raise ParameterError(f"{key}[{i}]", row, str(self))
            rows.append(tuple(rule.check(f"{key}[{i}]", entry) for rule, entry in zip(self.columns, row)))
        return tuple(rows)


def parameter(default: Any, rule: Any):
    """A dataclass field with its default and the rule its value must satisfy."""
    return field(default=default, metadata={"rule": rule})


def read_parameters(cls: type, values: Optional[dict], prefix: str = ""):
    """An instance of the dataclass cls from a dictionary; keys that are missing keep their defaults.

    Fields whose default is itself a dataclass are read from the nested dictionary of their name.

    Raises:
        ParameterError: unknown key, wrong type or value out of range; the message names key, value and what is allowed.
    """
    if not isinstance(values, dict):
        raise ParameterError(prefix.rstrip("/") or "~", values, "a dictionary of parameters")
    known = {f.name: f for f in fields(cls)}
    for key in sorted(values, key=str):
        if key not in known:
            raise ParameterError(f"{prefix}{key}", values[key], "no such parameter; known: " + ", ".join(sorted(known)))
    read = {}
    for key, value in values.items():
        rule = known[key].metadata.get("rule")
        if rule is None:
            read[key] = read_parameters(type(known[key].default), value, f"{prefix}{key}/")
        else:
            read[key] = rule.check(f"{prefix}{key}", value)
    return cls(**read)

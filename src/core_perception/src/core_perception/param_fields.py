# SPDX-License-Identifier: BSD-3-Clause
"""Kinds of parameters: a dataclass field with a default, a check and the words that say what is allowed."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import field
from pathlib import Path
from typing import Callable

from core_perception.exceptions import ParameterError, PerceptionError
from core_perception.predicates import canonical_class_name, parse_predicate
from core_perception.prompt import check_sentence
from core_perception.segmenters.class_map import ClassMap


def number(default: float, low: float = -math.inf, high: float = math.inf, above: bool = False):
    """Field of a finite number in [low, high], or in (low, high] with ``above``; integers are taken as floats."""
    allowed = f"a number {'>' if above else '>='} {low:g}" + (f" and <= {high:g}" if math.isfinite(high) else "")

    def read(value):
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
            raise ValueError
        if value > high or value < low or (above and value == low):
            raise ValueError
        return float(value)

    return field(default=default, metadata={"read": read, "allowed": allowed})


def whole(default: int, low: int, high: int):
    """Field of a whole number in [low, high]."""

    def read(value):
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            raise ValueError
        return value

    return field(default=default, metadata={"read": read, "allowed": f"a whole number from {low} to {high}"})


def flag(default: bool):
    """Field of true or false."""

    def read(value):
        if not isinstance(value, bool):
            raise ValueError
        return value

    return field(default=default, metadata={"read": read, "allowed": "true or false"})


def choice(default: str, *options: str):
    """Field of one of a few words."""

    def read(value):
        if value not in options:
            raise ValueError
        return value

    return field(default=default, metadata={"read": read, "allowed": "one of " + ", ".join(options)})


def text(default: str, allowed: str):
    """Field of a line of text; a whole number, as YAML reads the text -1, is taken for its digits."""

    def read(value):
        if isinstance(value, int) and not isinstance(value, bool):
            value = str(value)
        if not isinstance(value, str) or not value.isprintable():
            raise ValueError
        return value

    return field(default=default, metadata={"read": read, "allowed": allowed})


def path(default: str, allowed: str):
    """Field of a path, of which a leading ``~`` or ``~user`` is replaced by that home directory."""

    def read(value):
        if not isinstance(value, str) or not value.isprintable():
            raise ValueError
        try:
            return str(Path(value).expanduser()) if value.startswith("~") else value
        except RuntimeError as error:  # nobody of that name
            raise ValueError from error

    return field(default=default, metadata={"read": read, "allowed": allowed})


def statements():
    """Field of a list of predicates in text form."""

    def read(value):
        if not isinstance(value, (list, tuple)):
            raise ValueError
        return tuple(str(parse_predicate(text)) for text in value)

    return field(
        default=(), metadata={"read": read, "allowed": "a list such as ['ON(floor)=safe', 'AROUND(forklift, 1.5)']"}
    )


def class_names():
    """Field of a list of class names, which become canonical."""

    def read(value):
        if not isinstance(value, (list, tuple)) or not all(isinstance(name, str) for name in value):
            raise ValueError
        return tuple(canonical_class_name(name) for name in value)

    return field(default=(), metadata={"read": read, "allowed": "a list of class names such as [traffic_cone]"})


def class_map():
    """Field of what the values of an image of class ids mean: a list of texts VALUE=CLASS."""

    def read(value):
        if not isinstance(value, (list, tuple)) or not all(isinstance(entry, str) for entry in value):
            raise ValueError
        ClassMap.parse(value)
        return tuple(value)

    return field(default=(), metadata={"read": read, "allowed": "a list such as ['11=person', '255=none']"})


class Parameters:
    """What the frozen dataclasses of parameters have in common."""

    @classmethod
    def from_dict(cls, values: dict):
        """Read a parameter dictionary.

        Raises:
            ParameterError: unknown key, wrong type, value out of range, or values that do not fit each other.
        """
        params = read_parameters(cls, values)
        params.check()
        return params

    def check(self) -> None:  # noqa: B027 - most have no such rule
        """Check what no field can check alone.

        Raises:
            ParameterError: values that do not fit each other.
        """


def read_parameters(cls: Callable, values: dict):
    """Build ``cls`` from a parameter dictionary; see the class for keys and Raises."""
    fields = {f.name: f for f in dataclasses.fields(cls)}
    if not isinstance(values, dict):
        raise ParameterError("~", values, "a dictionary of parameters")
    read = {}
    for key in sorted(values):
        if key not in fields:
            raise ParameterError(key, values[key], "only " + ", ".join(sorted(fields)))
        metadata = fields[key].metadata
        try:
            read[key] = metadata["read"](values[key])
        except PerceptionError as error:
            raise ParameterError(key, values[key], f"{metadata['allowed']} ({error})") from error
        except (ValueError, TypeError) as error:
            raise ParameterError(key, values[key], metadata["allowed"]) from error
    return cls(**read)


def sentences():
    """Field of a list of lines of text."""

    def read(value):
        if not isinstance(value, (list, tuple)):
            raise ValueError
        return tuple(check_sentence(line) for line in value)

    return field(default=(), metadata={"read": read, "allowed": "a list of sentences"})

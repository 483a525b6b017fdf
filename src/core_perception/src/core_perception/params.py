# SPDX-License-Identifier: BSD-3-Clause
"""Parameters of the Python nodes: frozen dataclasses that refuse a wrong or unknown key."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field
from typing import Callable, Tuple

from core_perception.exceptions import ParameterError, PredicateError
from core_perception.predicates import parse_predicate


def _number(default: float, low: float = -math.inf, high: float = math.inf, above: bool = False):
    """Field of a finite number in [low, high], or in (low, high] with ``above``; integers are taken as floats."""
    allowed = f"a number {'>' if above else '>='} {low:g}" + (f" and <= {high:g}" if math.isfinite(high) else "")

    def read(value):
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
            raise ValueError
        if value > high or value < low or (above and value == low):
            raise ValueError
        return float(value)

    return field(default=default, metadata={"read": read, "allowed": allowed})


def _whole(default: int, low: int, high: int):
    """Field of a whole number in [low, high]."""

    def read(value):
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            raise ValueError
        return value

    return field(default=default, metadata={"read": read, "allowed": f"a whole number from {low} to {high}"})


def _flag(default: bool):
    """Field of true or false."""

    def read(value):
        if not isinstance(value, bool):
            raise ValueError
        return value

    return field(default=default, metadata={"read": read, "allowed": "true or false"})


def _choice(default: str, *options: str):
    """Field of one of a few words."""

    def read(value):
        if value not in options:
            raise ValueError
        return value

    return field(default=default, metadata={"read": read, "allowed": "one of " + ", ".join(options)})


def _text(default: str, allowed: str):
    """Field of a line of text."""

    def read(value):
        if not isinstance(value, str):
            raise ValueError
        return value

    return field(default=default, metadata={"read": read, "allowed": allowed})


def _statements():
    """Field of a list of predicates in text form."""

    def read(value):
        if not isinstance(value, (list, tuple)):
            raise ValueError
        return tuple(str(parse_predicate(text)) for text in value)

    return field(
        default=(), metadata={"read": read, "allowed": "a list such as ['ON(floor)=safe', 'AROUND(forklift, 1.5)']"}
    )


def _from_dict(cls: Callable, values: dict):
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
        except PredicateError as error:
            raise ParameterError(key, values[key], f"{metadata['allowed']} ({error})") from error
        except (ValueError, TypeError) as error:
            raise ParameterError(key, values[key], metadata["allowed"]) from error
    return cls(**read)


@dataclass(frozen=True)
class ReasonerParams:
    """Parameters of safety_reasoner.

    Attributes:
        reasoner: which one answers.
        lockstep: answer once per frame of a lock-step world instead of at rate_hz.
        rate_hz: rate of ``safety/constraints`` without lock-step [Hz].
        latency_s: declared sim latency of the ontology reasoner under lock-step [s]; must not be below the camera's
            period.
        ontology_file: class list; empty means the package's own.
        rules_file: rules of the static reasoner; empty means the package's own.
        predicates: statements of the oracle reasoner.
        memory: held instances count as seen and a found arrangement stays; false answers from the newest frame alone.
        link_m: instances of one class nearer than this belong to one arrangement [m], where the map gives no cluster.
        frames_of_three: number of answers in a row that must see an arrangement of only three instances.
    """

    reasoner: str = _choice("ontology", "ontology", "static", "oracle")
    lockstep: bool = _flag(False)
    rate_hz: float = _number(10.0, 0.1, 100.0)
    latency_s: float = _number(0.1, 0.0, 60.0, above=True)
    ontology_file: str = _text("", "the path of an ontology, or empty for the package's own")
    rules_file: str = _text("", "the path of a rules file, or empty for the package's own")
    predicates: Tuple[str, ...] = _statements()
    memory: bool = _flag(True)
    link_m: float = _number(2.5, 0.0, 20.0, above=True)
    frames_of_three: int = _whole(3, 1, 100)

    @classmethod
    def from_dict(cls, values: dict) -> ReasonerParams:
        """Read a parameter dictionary.

        Raises:
            ParameterError: unknown key, wrong type, value out of range, or predicates that the chosen reasoner does not
                use or lacks.
        """
        params = _from_dict(cls, values)
        if params.reasoner == "oracle" and not params.predicates:
            raise ParameterError("predicates", list(params.predicates), "at least one statement with reasoner oracle")
        return params


@dataclass(frozen=True)
class SegmenterParams:
    """Parameters of segmenter.

    Attributes:
        segmenter: which one answers; ``simulated`` reads the ground truth of the simulator.
        lockstep: wait for the constraints of the frame instead of taking the newest.
        ontology_file: class list; empty means the package's own.
        miss_rate: probability that an instance is missed in a frame.
        pixel_drop_rate: share of the pixels of a mask that are dropped.
        erode_px: width by which masks are eroded [px].
        seed: seed of the three errors above and of the label numbers.
    """

    segmenter: str = _choice("simulated", "simulated")
    lockstep: bool = _flag(False)
    ontology_file: str = _text("", "the path of an ontology, or empty for the package's own")
    miss_rate: float = _number(0.0, 0.0, 1.0)
    pixel_drop_rate: float = _number(0.0, 0.0, 1.0)
    erode_px: int = _whole(0, 0, 50)
    seed: int = _whole(0, 0, 2**31 - 1)

    @classmethod
    def from_dict(cls, values: dict) -> SegmenterParams:
        """Read a parameter dictionary.

        Raises:
            ParameterError: unknown key, wrong type or value out of range.
        """
        return _from_dict(cls, values)


@dataclass(frozen=True)
class OverlayParams:
    """Parameters of safety_overlay.

    Attributes:
        rate_hz: largest rate of ``safety/overlay`` [Hz].
        scale: size of the picture over that of the camera image.
        opacity: weight of the tint, 0 (none) to 1 (only the tint).
        obstacle_height_m: points higher than this above the ground are obstacles [m].
        max_range_m: farthest distance along the optical axis that is tinted [m].
        tf_timeout_s: longest wait for the camera's pose [s].
    """

    rate_hz: float = _number(5.0, 0.1, 100.0)
    scale: int = _whole(2, 1, 4)
    opacity: float = _number(0.45, 0.0, 1.0)
    obstacle_height_m: float = _number(0.10, 0.0, 5.0)
    max_range_m: float = _number(7.0, 0.1, 100.0)
    tf_timeout_s: float = _number(0.2, 0.0, 10.0)

    @classmethod
    def from_dict(cls, values: dict) -> OverlayParams:
        """Read a parameter dictionary.

        Raises:
            ParameterError: unknown key, wrong type or value out of range.
        """
        return _from_dict(cls, values)

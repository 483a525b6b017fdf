# SPDX-License-Identifier: BSD-3-Clause
"""What the values of an image of class ids mean."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Dict, Iterable, List, Mapping, Tuple

from core_perception.predicates import canonical_class_name

MAX_VALUE = 65535
#: What a class map calls pixels of no class.
NO_CLASS = "none"


@dataclass(frozen=True)
class ClassMap:
    """What the values of an image of class ids mean.

    Attributes:
        classes: value 0..65535 -> canonical class name.
        ignored: values that mean nothing.
    """

    classes: Mapping[int, str] = field(default_factory=dict)
    ignored: Tuple[int, ...] = ()

    @classmethod
    def parse(cls, entries: Iterable[str]) -> ClassMap:
        """Read entries such as ``11=person`` or ``255=none``.

        Raises:
            ValueError: no such entry, or a value twice.
            PredicateError: no class name.
        """
        classes: Dict[int, str] = {}
        ignored: List[int] = []
        for entry in entries:
            value, separator, name = entry.partition("=")
            if not (separator and value.isascii() and value.isdigit() and len(value) <= 5 and int(value) <= MAX_VALUE):
                raise ValueError(f"{entry!r}: allowed VALUE=CLASS with a value from 0 to {MAX_VALUE}")
            number = int(value)
            if number in classes or number in ignored:
                raise ValueError(f"{number} is there twice")
            if name == NO_CLASS:
                ignored.append(number)
            else:
                classes[number] = canonical_class_name(name)
        return cls(classes, tuple(ignored))

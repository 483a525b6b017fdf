# SPDX-License-Identifier: BSD-3-Clause
"""What is known of a class of things: its categories, the reach of AROUND, whether it moves."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import Optional, Tuple


class Category(enum.Enum):
    """What a class means for safety."""

    METRIC_OBSTACLE = "metric_obstacle"
    HAZARD_INDICATOR = "hazard_indicator"
    SOCIAL_ZONE = "social_zone"
    SEMANTIC_BARRIER = "semantic_barrier"
    NAVIGABLE_SURFACE = "navigable_surface"
    NON_NAVIGABLE_SURFACE = "non_navigable_surface"


SURFACES = frozenset({Category.NAVIGABLE_SURFACE, Category.NON_NAVIGABLE_SURFACE})
WITH_RADIUS = frozenset({Category.HAZARD_INDICATOR, Category.SOCIAL_ZONE})


@dataclass(frozen=True)
class OntologyClass:
    """What is known of one class.

    Attributes:
        name: canonical name asked for or found.
        categories: one or two categories whose rules hold.
        radius_m: reach of AROUND on the ground [m]; None unless the class is a hazard indicator or a social zone.
        mobile: it can move by itself.
        listed: the name, or an alias of it, is written in the file.
        known_by: what a name that is not listed was judged by, in words; empty for a listed one or for nothing at all.
    """

    name: str
    categories: Tuple[Category, ...]
    radius_m: Optional[float] = None
    mobile: bool = False
    listed: bool = True
    known_by: str = ""

    @property
    def is_surface(self) -> bool:
        """A class that ON applies to."""
        return self.categories[0] in SURFACES

    @property
    def is_navigable(self) -> bool:
        """A surface that is written in the file as made for travel."""
        return self.listed and self.categories == (Category.NAVIGABLE_SURFACE,)

    @property
    def is_object(self) -> bool:
        """A class written in the file that ON does not apply to; of others nobody knows."""
        return self.listed and not self.is_surface

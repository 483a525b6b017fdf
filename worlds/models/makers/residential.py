# SPDX-License-Identifier: BSD-3-Clause
"""Everything of the residential world: vehicles, buildings, plants, things of the street, and the ground."""

from . import buildings, grounds, plants, street, vehicles


def make_all(folder):
    """Write these models and textures into a folder."""
    for maker in (vehicles, buildings, plants, street, grounds):
        maker.make_all(folder)

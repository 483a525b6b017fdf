#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""Make the OBJ, MTL and PNG files of this folder. Numpy only; the same output on every run.

Every model has one texture, because PyBullet reads one texture per OBJ file. Origin at the bottom centre, z up, metres.
models.yaml lists every model with its class and size.
Usage: python3 make_models.py [FOLDER]
"""

import sys
from pathlib import Path

from makers import hospital, interior, people, residential, storage, surfaces, tools, walls, warehouse

MAKERS = (storage, warehouse, tools, hospital, interior, walls, residential, people, surfaces)


def make_all(folder):
    """Write every model and texture into a folder."""
    for maker in MAKERS:
        maker.make_all(folder)


if __name__ == "__main__":
    make_all(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).resolve().parent)

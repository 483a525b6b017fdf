# SPDX-License-Identifier: BSD-3-Clause
"""What code and data a run is made of, as one hash: trials of different sources do not belong into one table."""

from __future__ import annotations

import functools
import hashlib
import os
from pathlib import Path
from typing import Iterator

import core_bringup
import core_control
import core_perception
from core_bringup.evaluation.preflight import find_package_folder

PACKAGES = (core_bringup, core_control, core_perception)
# In source space all of these are in the package; an install space has the Python modules and the programs elsewhere.
FOLDERS = ("src", "include", "config", "launch", "worlds")
SUFFIXES = (".py", ".cpp", ".h", ".yaml", ".launch", ".obj", ".mtl", ".png")
SHOWN_DIGITS = 16


@functools.lru_cache(maxsize=None)
def read_sources_hash() -> str:
    """First digits of the SHA-256 over names and contents of every source, parameter, launch, world and model file."""
    digest = hashlib.sha256()
    for module in PACKAGES:
        for path in sorted(set(_find_files(module))):
            digest.update(f"{module.__name__}/{path.name}\0".encode())
            digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()[:SHOWN_DIGITS]


def _find_files(module) -> Iterator[Path]:
    package_folder = find_package_folder(module.__name__)
    # In devel space the first entry of __path__ is a relay that names the checkout's place.
    for folder in (Path(module.__path__[-1]), *(package_folder / name for name in FOLDERS)):
        for root, _, names in os.walk(str(folder), followlinks=True):
            yield from (Path(root, name).resolve() for name in names if name.endswith(SUFFIXES))

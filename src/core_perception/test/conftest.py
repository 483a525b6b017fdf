# SPDX-License-Identifier: BSD-3-Clause
"""Lets the ROS-free tests run without a built workspace."""

import sys
from pathlib import Path

import pytest

PACKAGE_DIR = Path(__file__).resolve().parents[1]
for folder in (PACKAGE_DIR / "src", Path(__file__).resolve().parent):
    if str(folder) not in sys.path:
        sys.path.insert(0, str(folder))


@pytest.fixture(scope="session")
def config_dir():
    return PACKAGE_DIR / "config"


@pytest.fixture(scope="session")
def ontology(config_dir):
    from core_perception.ontology import Ontology

    return Ontology.load(config_dir / "ontology.yaml")

# SPDX-License-Identifier: BSD-3-Clause
"""Reads a YAML file; what is wrong with one that cannot be read is said in one line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from core_perception.exceptions import PerceptionError


def read_yaml(path) -> Any:
    """Return the content of a YAML file.

    Raises:
        PerceptionError: there is no such file, it is no text, or no YAML (nesting without end and dates that cannot be
            included); the message starts with the path.
    """
    try:
        return yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError, yaml.YAMLError) as error:
        raise PerceptionError(f"{path}: cannot be read as YAML: {' '.join(str(error).split())}") from error

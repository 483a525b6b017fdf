# SPDX-License-Identifier: BSD-3-Clause
"""The models that objects of a world are made of: the shared catalogue and the world file's own."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Dict, Mapping, Optional

from core_bringup.exceptions import ConfigError
from core_bringup.world_schema import check_catalogue
from core_bringup.yaml_source import KeyPath, YamlSource

CATALOGUE = Path("models") / "models.yaml"  # in the folder of the shipped worlds


class ModelShelf:
    """Looks models up by name: the world's own first, then those of the catalogue.

    Args:
        world: the world file.
        catalogue_path: file of the catalogue; one that does not exist is empty.

    Raises:
        ConfigError: the catalogue is wrong.
    """

    def __init__(self, world: YamlSource, catalogue_path: Path):
        """Read and check the catalogue; the world file has been checked."""
        self._world, self._own = world, world.data.get("models", {})
        self._catalogue: Optional[YamlSource] = None
        self._catalogue_path = catalogue_path
        if catalogue_path.is_file():
            self._catalogue = YamlSource(catalogue_path)
            check_catalogue(self._catalogue)

    def merge(self, entry: Mapping[str, Any], path: KeyPath) -> Dict[str, Any]:
        """Complete an object's entry by its model; mesh becomes an absolute path.

        Args:
            entry: of the world file.
            path: where it stands there.

        Raises:
            ConfigError: unknown model, or a key is missing in both.
        """
        merged = {**self._model(entry, path), **entry}
        for key in ("class", "shape", "size_m") + (("mesh",) if merged.get("shape") == "mesh" else ()):
            if key not in merged:
                raise self._world.error(path + (key,), "missing", "this key is required, here or in the model")
        if "mesh" in merged:
            merged["mesh"] = self._source_of(entry, "mesh").path.parent / merged["mesh"]
        return merged

    def error(self, entry: Mapping[str, Any], path: KeyPath, key: str, problem: str, allowed: str) -> ConfigError:
        """Compose the error for a key of an object, where it is written: in the object, its model or the catalogue."""
        if key in entry or "model" not in entry:
            return self._world.error(path + (key,), problem, allowed)
        source = self._source_of(entry, key)
        prefix = ("models",) if source is self._world else ()
        return source.error(prefix + (entry["model"], key), problem, allowed)

    def _model(self, entry: Mapping[str, Any], path: KeyPath) -> Mapping[str, Any]:
        name = entry.get("model")
        shared = {} if self._catalogue is None else self._catalogue.data
        if name is None:
            return {}
        if name not in self._own and name not in shared:
            allowed = ", ".join(sorted({*self._own, *shared})) or "no model is declared here"
            if self._catalogue is None:
                allowed += f"; {self._catalogue_path} does not exist"
            raise self._world.error(path + ("model",), f"unknown model {name!r}", allowed)
        return self._own[name] if name in self._own else shared[name]

    def _source_of(self, entry: Mapping[str, Any], key: str) -> YamlSource:
        """The file in which a key of an object is written."""
        is_shared = key not in entry and "model" in entry and entry["model"] not in self._own
        return self._catalogue if is_shared and self._catalogue is not None else self._world

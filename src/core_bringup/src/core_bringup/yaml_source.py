# SPDX-License-Identifier: BSD-3-Clause
"""Read a YAML file so that every later complaint about a value can name its line."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Dict, Iterator, Tuple, Union

import yaml

from core_bringup.exceptions import ConfigError

KeyPath = Tuple[Union[str, int], ...]
MAX_FILE_BYTES = 2_000_000
MAX_DEPTH = 32
_Loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # libyaml is ten times as fast


def format_key_path(path: KeyPath) -> str:
    """Print ("objects", 2, "yaw_rad") as ``objects[2].yaw_rad``; the empty path is ``(file)``."""
    text = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in path)
    return text.lstrip(".") or "(file)"


class YamlSource:
    """The data of one YAML file together with the line of every key path.

    Attributes:
        path: the file.
        data: plain lists, dicts and scalars, as YAML's safe loader gives them.

    Raises:
        ConfigError: unreadable file, no YAML, not a mapping, a key given twice, an alias, more than
            MAX_DEPTH levels, a number that is not finite.
    """

    def __init__(self, path: Union[str, Path]):
        """Read and index the file."""
        self.path = Path(path)
        text = self._read_text()
        try:
            self._refuse_aliases_and_depth(text)
            root = yaml.compose(text, Loader=_Loader)
            self._lines = dict(self._index(root, ())) if root is not None else {}
            self.data = yaml.load(text, Loader=_Loader)
        except yaml.YAMLError as error:
            raise self._syntax_error(error) from error
        except ValueError as error:  # the loader turns bad dates and the like into a bare ValueError
            if isinstance(error, ConfigError):
                raise
            raise ConfigError(str(self.path), "(file)", f"not YAML: {error}", "a YAML 1.1 mapping") from error
        if not isinstance(self.data, dict):
            raise ConfigError(str(self.path), "(file)", f"got {type(self.data).__name__}", "a YAML mapping")
        self._refuse_non_finite(self.data, ())

    def error(self, key_path: KeyPath, problem: str, allowed: str) -> ConfigError:
        """Compose the error for a key path; the line is that of the path or of its nearest parent with one."""
        line = next((self._lines[key_path[:n]] for n in range(len(key_path), -1, -1) if key_path[:n] in self._lines), 1)
        return ConfigError(f"{self.path}:{line}", format_key_path(key_path), problem, allowed)

    def _read_text(self) -> str:
        try:
            raw = self.path.read_bytes()
            if len(raw) > MAX_FILE_BYTES:
                raise ConfigError(str(self.path), "(file)", f"{len(raw)} bytes", f"at most {MAX_FILE_BYTES} bytes")
            return raw.decode("utf-8")
        except OSError as error:
            raise ConfigError(str(self.path), "(file)", error.strerror or "unreadable", "a readable file") from error
        except UnicodeDecodeError as error:
            raise ConfigError(str(self.path), "(file)", f"byte {error.start} is no UTF-8", "UTF-8 text") from error

    def _refuse_aliases_and_depth(self, text: str) -> None:
        """Look at the text event by event: libyaml's composer overruns the stack on a hundred thousand brackets."""
        depth = 0
        for event in yaml.parse(text, Loader=_Loader):
            source = f"{self.path}:{event.start_mark.line + 1}"
            if isinstance(event, yaml.AliasEvent):
                raise ConfigError(source, f"*{event.anchor}", "a YAML alias", "values written out (use models)")
            depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
            if depth > MAX_DEPTH:
                raise ConfigError(source, "(file)", "nested too deeply", f"at most {MAX_DEPTH} levels")

    def _index(self, node: yaml.Node, path: KeyPath) -> Iterator[Tuple[KeyPath, int]]:
        yield path, node.start_mark.line + 1
        if isinstance(node, yaml.SequenceNode):
            for i, child in enumerate(node.value):
                yield from self._index(child, path + (i,))
        elif isinstance(node, yaml.MappingNode):
            seen: Dict[str, int] = {}
            for key, child in node.value:
                line = key.start_mark.line + 1
                name = key.value if isinstance(key, yaml.ScalarNode) else "?"
                if name in seen:
                    problem = f"given twice, first in line {seen[name]}"
                    raise ConfigError(f"{self.path}:{line}", format_key_path(path + (name,)), problem, "each key once")
                seen[name] = line
                yield from self._index(child, path + (name,))
                yield path + (name,), line

    def _syntax_error(self, error: yaml.YAMLError) -> ConfigError:
        mark = getattr(error, "problem_mark", None)
        where = f"{self.path}:{mark.line + 1}" if mark is not None else str(self.path)
        problem = " ".join(str(getattr(error, "problem", None) or error).split())
        return ConfigError(where, "(file)", f"not YAML: {problem}", "a YAML 1.1 mapping")

    def _refuse_non_finite(self, value: Any, path: KeyPath) -> None:
        if isinstance(value, float) and not math.isfinite(value):
            raise self.error(path, f"got {value}", "a finite number")
        if isinstance(value, dict):
            for key, child in value.items():
                if not isinstance(key, str):
                    raise self.error(path, f"key {key!r} is no text", "keys that are text")
                self._refuse_non_finite(child, path + (key,))
        elif isinstance(value, list):
            for i, child in enumerate(value):
                self._refuse_non_finite(child, path + (i,))

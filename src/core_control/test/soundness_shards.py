# SPDX-License-Identifier: BSD-3-Clause
"""Tallies of soundness episodes on disk, in shards of seeds that add up: a long run can be ended and continued."""

from __future__ import annotations

import ast
import hashlib
import json
import sys
from pathlib import Path
from typing import Iterable, Iterator, Set

from soundness_cases import Tally, run_episode

SHARD_EPISODES = 10
OWN_FILES = ("control_support.py", "margin_filter.py", "soundness_cases.py")


def compute_key() -> str:
    """Hash of everything that decides a tally: each loaded module of the filter, and the episodes' own files.

    Comments and layout play no part; parameters are code, they stand in params.py and in the cases.
    """
    modules = [m.__file__ for name, m in sys.modules.items() if name.split(".")[0] == "core_control"]
    here = Path(__file__).resolve().parent
    return hash_sources({Path(name) for name in modules if name} | {here / name for name in OWN_FILES})


def hash_sources(paths: Iterable[Path]) -> str:
    """Hash of what Python files say, whatever their order and folder."""
    texts = sorted(f"{path.name}\n{ast.dump(ast.parse(path.read_text()))}\n" for path in paths)
    return hashlib.sha256("".join(texts).encode()).hexdigest()[:12]


class ShardFile:
    """One line of JSON per shard: its number and its tally. Shard k holds the seeds from k SHARD_EPISODES on.

    Args:
        path: of the file; it need not exist.
    """

    def __init__(self, path: Path):
        """Read what is there; a line that an interrupted write left unfinished is left out."""
        self._path = path
        self.numbers: Set[int] = set()
        self.tally = Tally()
        for line in path.read_text().splitlines() if path.exists() else ():
            try:
                record = json.loads(line)
            except json.JSONDecodeError:
                continue
            self._take(record.pop("shard"), Tally(**record))

    def _take(self, number: int, tally: Tally) -> None:
        if number not in self.numbers:
            self.numbers.add(number)
            self.tally.add(tally)

    def append(self, number: int, tally: Tally) -> None:
        """Keep one more shard, on disk first."""
        self._path.parent.mkdir(parents=True, exist_ok=True)
        torn = self._path.exists() and not self._path.read_bytes().endswith(b"\n")
        with self._path.open("a") as stream:
            stream.write("\n" * torn + json.dumps({"shard": number, **vars(tally)}) + "\n")
        self._take(number, tally)

    def find_missing(self) -> Iterator[int]:
        """Numbers of the shards that are not there, from the smallest on, without end."""
        number = 0
        while True:
            if number not in self.numbers:
                yield number
            number += 1


def run_shard(case: str, profile: str, number: int, design: str) -> Tally:
    """Tally of one shard; a world without room for the robot adds nothing."""
    whole = Tally()
    for seed in range(number * SHARD_EPISODES, (number + 1) * SHARD_EPISODES):
        whole.add(run_episode(case, profile, seed, design=design))
    return whole

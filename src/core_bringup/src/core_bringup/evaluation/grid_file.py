# SPDX-License-Identifier: BSD-3-Clause
"""Reads what ground_frames decided: format ``core_grids 1``, described in core_perception/bench/ground_frames.cpp."""

from __future__ import annotations

from dataclasses import dataclass
from typing import BinaryIO, Iterator, List, Tuple

import numpy as np

from core_bringup.exceptions import ConfigError

MAGIC = b"core_grids 1"
SAFE, UNSAFE, UNKNOWN = 0, 1, 2
NO_CAUSE = 65535
MOST_CELLS, MOST_CAUSES, MOST_TEXT_BYTES, MOST_HEADER_LINES = 10**8, 65536, 4096, 100


@dataclass(frozen=True)
class GridHeader:
    """What holds for every grid of a file."""

    resolution_m: float
    unknown_is_unsafe: bool


@dataclass(frozen=True)
class DecidedGrid:
    """The map's decision after one frame.

    Attributes:
        frame: number of the frame, counted from 0.
        stamp_s: its stamp.
        origin: (2,) x, y of cell (0, 0) in cells of the fixed frame; its corner lies at origin * resolution_m.
        unsafe: (rows, columns) bool: unsafe, or unknown where that counts as unsafe; row = y, column = x.
        state: (rows, columns) uint8: SAFE, UNSAFE or UNKNOWN.
        h_m: (rows, columns) float32 barrier [m].
        cause: (rows, columns) uint16 index into causes, NO_CAUSE for none.
        causes: (rule, class, number of the object) of each.
    """

    frame: int
    stamp_s: float
    origin: Tuple[int, int]
    unsafe: np.ndarray
    state: np.ndarray
    h_m: np.ndarray
    cause: np.ndarray
    causes: Tuple[Tuple[str, str, int], ...]

    def cause_at(self, row: int, column: int) -> str:
        """Text of the rule behind a cell, such as 'NEAR(wall)'; empty for none."""
        number = int(self.cause[row, column])
        return "" if number == NO_CAUSE else self.causes[number][0]


class GridReader:
    """Reads a header at once, then one grid after the other: from a file, or from a pipe while it is written.

    Args:
        stream: binary, at the start of the text.
        name: of the stream, for messages.

    Raises:
        ConfigError: not such a stream, or cut off within a grid.
    """

    def __init__(self, stream: BinaryIO, name: str):
        """Read the header."""
        self._stream, self._name = stream, name
        self.header = self._read_header()

    def __iter__(self) -> Iterator[DecidedGrid]:
        """Yield the grids up to the end of the stream."""
        while True:
            first = self._stream.read(4)
            if not first:
                return
            if len(first) < 4:
                raise self._fault("cut off")
            yield self._read_grid(int(np.frombuffer(first, "<i4")[0]))

    def _read_header(self) -> GridHeader:
        lines: List[bytes] = []
        while not lines or lines[-1] != b"end":
            line = self._stream.readline(256)
            if not line.endswith(b"\n") or len(lines) > MOST_HEADER_LINES:
                raise self._fault("the header is cut off")
            lines.append(line[:-1])
        words = dict(line.split(b" ", 1) for line in lines[1:-1] if b" " in line)
        try:
            header = GridHeader(float(words[b"resolution_m"]), bool(int(words[b"unknown_is_unsafe"])))
        except (KeyError, ValueError) as error:
            raise self._fault(f"header: {error}") from error
        if lines[0] != MAGIC or not 0.0 < header.resolution_m < np.inf:
            raise self._fault(f"got {lines[0][:40]!r}")
        return header

    def _read_grid(self, frame: int) -> DecidedGrid:
        stamp_s = float(self._read("<f8", 1)[0])
        x, y, width, height = (int(v) for v in self._read("<i4", 4))
        if width < 1 or height < 1 or width * height > MOST_CELLS:
            raise self._fault(f"frame {frame}: a grid of {width} x {height} cells")
        shape = (height, width)
        state = self._read("u1", width * height).reshape(shape)
        h_m = self._read("<f4", width * height).reshape(shape)
        cause = self._read("<u2", width * height).reshape(shape)
        count = int(self._read("<i4", 1)[0])
        if not 0 <= count <= MOST_CAUSES:
            raise self._fault(f"frame {frame}: {count} causes")
        causes = tuple(self._read_cause(frame) for _ in range(count))
        unsafe = (state == UNSAFE) | ((state == UNKNOWN) & self.header.unknown_is_unsafe)
        return DecidedGrid(frame, stamp_s, (x, y), unsafe, state, h_m, cause, causes)

    def _read_cause(self, frame: int) -> Tuple[str, str, int]:
        length = int(self._read("<i4", 1)[0])
        if not 0 <= length <= MOST_TEXT_BYTES:
            raise self._fault(f"frame {frame}: a cause of {length} bytes")
        words = self._read("u1", length).tobytes().decode(errors="replace").split("\t")
        if len(words) != 3 or not words[2].isdigit():
            raise self._fault(f"frame {frame}: cause {words}")
        return words[0], words[1], int(words[2])

    def _read(self, kind: str, count: int) -> np.ndarray:
        dtype = np.dtype(kind)
        data = self._stream.read(dtype.itemsize * count)
        if len(data) != dtype.itemsize * count:
            raise self._fault("cut off")
        return np.frombuffer(data, dtype)

    def _fault(self, problem: str) -> ConfigError:
        return ConfigError(self._name, "grids", problem, "whole grids of format core_grids 1")

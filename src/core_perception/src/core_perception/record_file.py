# SPDX-License-Identifier: BSD-3-Clause
"""A file of one JSON object a line that a run adds to: whole lines or nothing, one writer, a torn end is cut off."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path
from typing import Callable, List, Tuple, TypeVar

from core_perception.exceptions import PerceptionError

T = TypeVar("T")


class RecordFile:
    """Open for writing; one thread at a time."""

    def __init__(self, path: Path, read_line: Callable[[bytes], T]):
        """Open the file, or make it and its folder; a line that an earlier run left unfinished is cut off.

        Args:
            path: of the file; further lines are added to those that are there.
            read_line: reads one line, ValueError for one that is none; every line that is there must pass.

        Raises:
            PerceptionError: folder or file cannot be written, is being recorded into, or is no recording.
        """
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = os.open(str(path), os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o644)
        except OSError as error:
            raise PerceptionError(f"{path}: cannot be written: {error.strerror}") from error
        self.is_open = True
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            content = path.read_bytes()
            read_lines(path, content, read_line)
            os.ftruncate(self._file, content.rfind(b"\n") + 1)
        except (OSError, PerceptionError) as error:
            os.close(self._file)
            if isinstance(error, BlockingIOError):
                raise PerceptionError(f"{path}: another process is recording into it") from error
            if isinstance(error, OSError):
                raise PerceptionError(f"{path}: cannot be read: {error.strerror}") from error
            raise

    def append(self, line: bytes) -> None:
        """Write a whole line or nothing; the end of the line is added.

        Raises:
            OSError: it cannot be written.
        """
        start = os.fstat(self._file).st_size
        try:
            rest = line + b"\n"
            while rest:
                rest = rest[os.write(self._file, rest) :]
        except OSError:
            os.ftruncate(self._file, start)
            raise

    def close(self) -> None:
        """End the recording; calling it twice is allowed."""
        if self.is_open:
            os.close(self._file)
            self.is_open = False


def load_lines(path: Path, read_line: Callable[[bytes], T]) -> Tuple[List[T], int]:
    """Read a recording; return what its lines say, and how many at its end were torn off and ignored (0 or 1).

    Raises:
        PerceptionError: no recording there, or a line that is damaged; the message names file and line.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise PerceptionError(f"{path}: cannot be read: {error.strerror}") from error
    torn = int(not content.endswith(b"\n") and content != b"")
    return read_lines(path, content, read_line), torn


def read_lines(path: Path, content: bytes, read_line: Callable[[bytes], T]) -> List[T]:
    """Read all whole lines; what follows the last end of line was torn off while it was written.

    Raises:
        PerceptionError: a line that read_line refuses with a ValueError.
    """
    *lines, _torn = content.split(b"\n")
    return [_read_numbered(path, number, line, read_line) for number, line in enumerate(lines, start=1)]


def _read_numbered(path, number, line, read_line):
    try:
        return read_line(line)
    except (ValueError, RecursionError) as error:
        raise PerceptionError(f"{path}:{number}: no line of a recording: {error}") from error

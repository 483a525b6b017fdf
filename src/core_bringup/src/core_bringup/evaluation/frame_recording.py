# SPDX-License-Identifier: BSD-3-Clause
"""A recording of labelled depth frames with exact poses, for benches and tests of grounding.

Format ``core_frames 1``, one file: a text header of one statement a line, then the frames in binary, little-endian::

    core_frames 1
    size 500 320                                       width height [px]
    camera FX FY CX CY                                 [px]; pixel (u, v) is centred at the integer
    class ID NAME                                      for every label value; holds for the whole recording
    predicate OPERATOR NAME VERDICT SEVERITY RADIUS_M  numbers as in core_msgs/Predicate; radius 0: that of the class
    frames N
    end
    N times: float64 stamp_s, float64[16] T_map_camera (row-major, optical frame), float64[2] base x y [m],
             uint16[h * w] depth [mm] along the optical axis, 0 none, uint16[h * w] label, 0 none

The C++ reader is core_perception/bench/frame_file.h.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Callable, Dict, List, Mapping, Optional, Tuple, Type

import numpy as np

from core_bringup.camera import CameraModel
from core_bringup.exceptions import ConfigError
from core_perception.exceptions import PredicateError
from core_perception.predicates import Operator, Predicate, Severity, Verdict, canonical_class_name

MAGIC = b"core_frames 1"
MOST_PX, MOST_FRAMES, MOST_HEADER_LINES = 16384, 10**7, 100000


@dataclass(frozen=True)
class RecordingHeader:
    """What holds for every frame of a recording.

    Attributes:
        camera: CameraModel of both images; its near_m and far_m are not written.
        classes: label value, 1..65535 -> canonical class name.
        predicates: safety predicates in force.
    """

    camera: CameraModel
    classes: Mapping[int, str]
    predicates: Tuple[Predicate, ...]

    @property
    def frame_type(self) -> np.dtype:
        """Structured dtype of a frame: stamp_s, T_map_camera (4, 4), p_map_base (2,), depth_mm and labels (h, w)."""
        shape = (self.camera.height_px, self.camera.width_px)
        return np.dtype(
            [
                ("stamp_s", "<f8"),
                ("T_map_camera", "<f8", (4, 4)),
                ("p_map_base", "<f8", (2,)),
                ("depth_mm", "<u2", shape),
                ("labels", "<u2", shape),
            ]
        )


def depth_to_mm(depth_m: np.ndarray) -> np.ndarray:
    """Whole millimetres (uint16) of a depth image [m], 0 for NaN, for <= 0 and for what 16 bits cannot hold."""
    mm = np.rint(np.nan_to_num(1000.0 * np.asarray(depth_m, np.float64), nan=0.0, posinf=0.0, neginf=0.0))
    return np.where((mm > 0.0) & (mm <= 65535.0), mm, 0.0).astype("<u2")


class RecordingWriter:
    """Writes a recording frame by frame; use it in a with block.

    Args:
        path: file to write; an existing one is overwritten.
        header: RecordingHeader.
        n_frames: frames that will be added.

    Raises:
        ConfigError: a label outside 1..65535 or a class name that is not canonical; at the end of the block: another
            number of frames was added.
    """

    def __init__(self, path: Path, header: RecordingHeader, n_frames: int):
        self._path, self._header, self._due = Path(path), header, n_frames
        text = _format_header(self._path, header, n_frames)
        self._file: BinaryIO = self._path.open("wb")
        self._file.write(text.encode("ascii"))

    def add(
        self, stamp_s: float, T_map_camera: np.ndarray, p_map_base: np.ndarray, depth_mm: np.ndarray, labels: np.ndarray
    ) -> None:
        """Append a frame: time [s], pose (4, 4) of the optical frame, place (2,) of the robot [m], two (h, w) uint16.

        Raises:
            ConfigError: one frame too many, an image of another type or size, a number that is not finite, or a label
                that is not listed.
        """
        shape = (self._header.camera.height_px, self._header.camera.width_px)
        for key, image in (("depth", depth_mm), ("labels", labels)):
            if image.shape != shape or image.dtype != np.uint16:
                raise ConfigError(
                    str(self._path), key, f"got {image.dtype} {image.shape}", f"uint16 {shape}"
                )  # fmt: skip
        numbers = np.concatenate([[stamp_s], np.ravel(T_map_camera), np.ravel(p_map_base)]).astype("<f8")
        if numbers.size != 19 or not np.isfinite(numbers).all():
            raise ConfigError(str(self._path), "pose", f"got {numbers.tolist()}", "1 + 16 + 2 finite numbers")
        unknown = set(np.flatnonzero(np.bincount(labels.ravel())).tolist()) - {0} - set(self._header.classes)
        if unknown:
            raise ConfigError(str(self._path), "labels", f"got {sorted(unknown)}", "0 and the labels with a class")
        if self._due <= 0:
            raise ConfigError(str(self._path), "frames", "got one too many", "as many as announced")
        self._due -= 1
        for part in (numbers, depth_mm.astype("<u2"), labels.astype("<u2")):
            self._file.write(part.tobytes())

    def __enter__(self) -> RecordingWriter:
        return self

    def __exit__(
        self, kind: Optional[Type[BaseException]], _value: Optional[BaseException], _trace: Optional[TracebackType]
    ) -> None:
        self._file.close()
        if kind is None and self._due:
            raise ConfigError(str(self._path), "frames", f"{self._due} were not added", "as many as announced")


@dataclass(frozen=True)
class FrameRecording:
    """An opened recording: its header, and its frames as a read-only array of header.frame_type on the disk."""

    header: RecordingHeader
    frames: np.ndarray

    @classmethod
    def open(cls, path: Path) -> FrameRecording:
        """Open a recording without loading its frames.

        Raises:
            ConfigError: anything wrong with the file, as one line with file, line and what is allowed.
        """
        path = Path(path)
        if not path.is_file():
            raise ConfigError(str(path), "recording", "no such file", "a file of format core_frames 1")
        with path.open("rb") as file:
            header, n_frames = _HeaderReader(path).read(file)
            start = file.tell()
        due = start + n_frames * header.frame_type.itemsize
        if path.stat().st_size != due:
            raise ConfigError(str(path), "frames", f"the file has {path.stat().st_size} bytes", f"{due} bytes")
        if n_frames == 0:
            return cls(header, np.zeros(0, header.frame_type))
        return cls(header, np.memmap(path, header.frame_type, "r", offset=start, shape=(n_frames,)))


def _format_header(path: Path, header: RecordingHeader, n_frames: int) -> str:
    camera = header.camera
    lines = [MAGIC.decode(), f"size {camera.width_px} {camera.height_px}"]
    lines.append("camera " + " ".join(repr(float(v)) for v in (camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px)))
    for label, name in sorted(header.classes.items()):
        if not 1 <= label <= 65535:
            raise ConfigError(str(path), "class", f"got label {label}", "1..65535")
        if canonical_class_name(name) != name:
            raise ConfigError(str(path), "class", f"got {name!r}", canonical_class_name(name))
        lines.append(f"class {label} {name}")
    for p in header.predicates:
        numbers = f"{int(p.verdict)} {int(p.severity)} {float(p.radius_m or 0.0)!r}"
        lines.append(f"predicate {int(p.operator)} {p.class_name} {numbers}")
    return "\n".join([*lines, f"frames {n_frames}", "end", ""])


class _HeaderReader:
    """Reads the lines of a header; every fault is a ConfigError that names file and line."""

    def __init__(self, path: Path):
        self._path, self._line = path, 0
        self._size: Optional[Tuple[int, int]] = None
        self._camera: Optional[List[float]] = None
        self._n_frames: Optional[int] = None
        self._classes: Dict[int, str] = {}
        self._predicates: List[Predicate] = []

    def read(self, file: BinaryIO) -> Tuple[RecordingHeader, int]:
        if self._next(file) != MAGIC:
            raise self._fault("not a recording", f"{MAGIC.decode()!r} in the first line")
        statements: Dict[bytes, Tuple[int, Callable[[List[str]], None]]] = {
            b"size": (2, self._read_size),
            b"camera": (4, self._read_camera),
            b"class": (2, self._read_class),
            b"predicate": (5, self._read_predicate),
            b"frames": (1, self._read_frames),
        }
        while True:
            words = self._next(file).split(b" ")
            if words == [b"end"]:
                break
            count, read = statements.get(words[0], (0, None))
            if read is None or len(words) != count + 1 or self._line > MOST_HEADER_LINES:
                raise self._fault(f"got {b' '.join(words)[:60]!r}", "a statement of the header")
            try:
                read([word.decode("ascii") for word in words[1:]])
            except (ValueError, PredicateError) as error:
                raise self._fault(f"got {b' '.join(words)[:60]!r}", str(error)) from error
        if self._size is None or self._camera is None or self._n_frames is None:
            raise self._fault("size, camera or frames is missing", "all three before end")
        camera = CameraModel(*self._size, *self._camera)
        return RecordingHeader(camera, self._classes, tuple(self._predicates)), self._n_frames

    def _next(self, file: BinaryIO) -> bytes:
        self._line += 1
        line = file.readline(256)
        if not line.endswith(b"\n"):
            raise self._fault("the header is cut off or a line is too long", "lines of up to 255 characters, then end")
        return line[:-1]

    def _fault(self, problem: str, allowed: str) -> ConfigError:
        return ConfigError(str(self._path), f"line {self._line}", problem, allowed)

    def _read_size(self, words: List[str]) -> None:
        width, height = (int(word) for word in words)
        if not (1 <= width <= MOST_PX and 1 <= height <= MOST_PX):
            raise ValueError(f"1..{MOST_PX} px")
        self._size = (width, height)

    def _read_camera(self, words: List[str]) -> None:
        self._camera = [float(word) for word in words]
        if not (np.isfinite(self._camera).all() and self._camera[0] > 0.0 and self._camera[1] > 0.0):
            raise ValueError("finite numbers, focal lengths > 0")

    def _read_class(self, words: List[str]) -> None:
        label, name = int(words[0]), words[1]
        if not 1 <= label <= 65535 or label in self._classes:
            raise ValueError("a label of 1..65535, each once")
        if canonical_class_name(name) != name:
            raise ValueError(f"the name {canonical_class_name(name)}")
        self._classes[label] = name

    def _read_predicate(self, words: List[str]) -> None:
        operator, verdict, severity, radius_m = Operator(int(words[0])), int(words[2]), int(words[3]), float(words[4])
        radius = None if radius_m == 0.0 else radius_m
        self._predicates.append(Predicate(operator, words[1], Verdict(verdict), radius, Severity(severity)))

    def _read_frames(self, words: List[str]) -> None:
        self._n_frames = int(words[0])
        if not 0 <= self._n_frames <= MOST_FRAMES:
            raise ValueError(f"0..{MOST_FRAMES}")

# SPDX-License-Identifier: BSD-3-Clause
"""Runs the real map over recordings, by the program ground_frames of core_perception/bench."""

from __future__ import annotations

import contextlib
import subprocess
import tempfile
import threading
from pathlib import Path
from typing import Any, Callable, Dict, List, Mapping, Optional

import numpy as np
import yaml

from core_bringup.camera_noise import add_camera_noise
from core_bringup.evaluation.frame_recording import FrameRecording, RecordingHeader, RecordingWriter, depth_to_mm
from core_bringup.evaluation.grid_file import DecidedGrid, GridReader
from core_bringup.evaluation.grounding_figures import format_params
from core_bringup.exceptions import BringupError, ConfigError
from core_bringup.world_types import CameraNoise

NO_COLOR = np.zeros((0, 0, 3), np.uint8)


def read_profile(config_dir: Path, profile: str) -> Dict[str, Any]:
    """Parameters of the map in a profile: section semantic_map of config_dir/<profile>.yaml."""
    return yaml.safe_load((Path(config_dir) / f"{profile}.yaml").read_text(encoding="utf-8"))["semantic_map"]


def ground(program: Path, params: Mapping[str, Any], recording: Path, every: int, scratch: Path) -> List[DecidedGrid]:
    """Grids after every so manyth frame of a recording, and after the last one.

    Args:
        program: ground_frames.
        params: of the map.
        recording: file of format core_frames 1.
        every: frames between grids, >= 1.
        scratch: folder for files that are removed again.

    Raises:
        BringupError: the program failed.
    """
    params_file, grids_file = Path(scratch) / "params.txt", Path(scratch) / "grids"
    params_file.write_text(format_params(params), encoding="utf-8")
    command = [str(program), str(params_file), str(recording), str(every), str(grids_file)]
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=False)
    if done.returncode != 0:
        raise BringupError(f"{program.name}: exit status {done.returncode}: {done.stdout.decode(errors='replace')}")
    with grids_file.open("rb") as stream:
        grids = list(GridReader(stream, str(grids_file)))
    grids_file.unlink()
    return grids


def add_noise(exact: Path, noise: CameraNoise, path: Path) -> None:
    """Copy a recording without noise to one whose depth the noise has changed."""
    recording = FrameRecording.open(exact)
    with RecordingWriter(path, recording.header, len(recording.frames)) as writer:
        for frame in recording.frames:
            stamp_s, depth_mm = float(frame["stamp_s"]), noisy_depth_mm(frame["depth_mm"], noise, frame["stamp_s"])
            writer.add(stamp_s, frame["T_map_camera"], frame["p_map_base"], depth_mm, frame["labels"])


def noisy_depth_mm(depth_mm: np.ndarray, noise: CameraNoise, stamp_s: float) -> np.ndarray:
    """A depth image [mm] as the noise leaves it; 0, none, stays."""
    _, depth_m = add_camera_noise(NO_COLOR, depth_mm.astype(np.float32) * np.float32(1e-3), noise, round(1e9 * stamp_s))
    return depth_to_mm(depth_m)


class GroundStream:
    """The map at work on frames as they are made; use it in a with block. A grid is handed on after every frame.

    Args:
        program: ground_frames.
        params: of the map.
        header: of the frames.
        n_frames: that will be added.
        on_grid: called with every grid, in order, from a thread of its own.

    Raises:
        BringupError: at the end of the block or while frames are added: the program failed or on_grid raised.
    """

    def __init__(
        self,
        program: Path,
        params: Mapping[str, Any],
        header: RecordingHeader,
        n_frames: int,
        on_grid: Callable[[DecidedGrid], None],
    ):
        """Start the program; it reads and writes pipes."""
        self._folder = tempfile.TemporaryDirectory()
        folder = Path(self._folder.name)
        (folder / "params.txt").write_text(format_params(params), encoding="utf-8")
        self._errors = (folder / "errors.txt").open("w+b")
        command = [str(program), str(folder / "params.txt"), "/dev/stdin", "1", "/dev/stdout"]
        pipe = subprocess.PIPE
        self._process = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=self._errors)
        self._on_grid, self._failure = on_grid, None  # type: ignore[var-annotated]
        self._writer = RecordingWriter(Path(f"/dev/fd/{self._process.stdin.fileno()}"), header, n_frames)
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def add(self, *frame: Any) -> None:
        """Hand on a frame, with the arguments of RecordingWriter.add."""
        try:
            self._writer.add(*frame)
        except BrokenPipeError:
            self._finish(kill=True)
            raise self._fault() from None

    def __enter__(self) -> GroundStream:
        return self

    def __exit__(self, kind: Optional[type], _value: object, _trace: object) -> None:
        if kind is not None:
            self._finish(kill=True)
            return
        with contextlib.suppress(BrokenPipeError):  # the exit status tells why
            self._writer.__exit__(None, None, None)
        self._finish(kill=False)
        if self._failure is not None or self._process.returncode != 0:
            raise self._fault()

    def _read(self) -> None:
        try:
            for grid in GridReader(self._process.stdout, "ground_frames"):
                self._on_grid(grid)
        except Exception as error:  # handed to the thread that adds frames
            self._failure = error
            self._process.kill()

    def _finish(self, kill: bool) -> None:
        if kill:
            self._process.kill()
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.close()
        self._reader.join()
        self._process.wait()
        self._process.stdout.close()

    def _fault(self) -> BringupError:
        self._errors.seek(0)
        said = self._errors.read().decode(errors="replace").strip()
        if self._failure is not None and not (said and isinstance(self._failure, ConfigError)):
            said = f"{said} {type(self._failure).__name__}: {self._failure}".strip()
        return BringupError(f"ground_frames: exit status {self._process.returncode}: {said}")

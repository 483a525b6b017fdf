# SPDX-License-Identifier: BSD-3-Clause
"""What the measuring program of grounding (core_perception/bench) is told and what its output comes to."""

from __future__ import annotations

import os
import subprocess
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Dict, List, Mapping, Sequence

import numpy as np

from core_bringup.exceptions import BringupError

BUILDS = ("native", "portable")
SHOWN_LINES = 20


def format_params(values: Mapping[str, Any]) -> str:
    """Parameters as the measuring programs read them, one `KEY KIND VALUE...` a line (bench/param_text.h).

    Raises:
        ValueError: a value that the text cannot hold.
    """
    return "".join(f"{key} {_format_value(key, value)}\n" for key, value in values.items())


def _format_value(key: str, value: Any) -> str:
    if isinstance(value, bool):
        return f"bool {int(value)}"
    if isinstance(value, int):
        return f"int {value}"
    if isinstance(value, float):
        return f"double {value!r}"
    if isinstance(value, str):
        words, kind = [value] if value else [], "string"
    elif isinstance(value, Mapping):
        words, kind = [str(part) for item in value.items() for part in item], "map"
    elif isinstance(value, Sequence):
        words, kind = [str(part) for part in value], "list"
    else:
        raise ValueError(f"{key}: got {value!r}, allowed what YAML holds")
    if any(not word or word.split() != [word] for word in words):
        raise ValueError(f"{key}: got {value!r}, allowed words without white space")
    return " ".join([kind, *words])


def build_programs(bench_dir: Path, folder: Path, build: str) -> Path:
    """Build the measuring programs with plain CMake, or bring them up to date.

    Args:
        bench_dir: core_perception/bench.
        folder: where to build; made when missing.
        build: 'native' or 'portable'.

    Returns:
        The folder.

    Raises:
        BringupError: the build failed; the message ends with its last lines.
    """
    folder.mkdir(parents=True, exist_ok=True)
    environment = {"CMAKE_BUILD_PARALLEL_LEVEL": str(os.cpu_count() or 1), **os.environ}
    native = "ON" if build == "native" else "OFF"
    configure = ["cmake", "-S", str(bench_dir), "-B", str(folder), f"-DCORE_NATIVE={native}"]
    for command in (configure, ["cmake", "--build", str(folder)]):
        try:
            done = subprocess.run(
                command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, env=environment, check=False
            )
        except OSError as error:
            raise BringupError(f"{command[0]}: {error}") from error
        if done.returncode != 0:
            lines = done.stdout.decode(errors="replace").splitlines()[-SHOWN_LINES:]
            raise BringupError("\n".join([f"the measuring programs do not build ({build}):", *lines]))
    return folder


@dataclass
class Measurement:
    """Output of the measuring program over one or more recordings.

    Attributes:
        series: name -> one array (passes, frames) per recording.
        values: name -> sum over the recordings.
    """

    series: Dict[str, List[np.ndarray]] = field(default_factory=dict)
    values: Dict[str, int] = field(default_factory=dict)

    def add(self, output: str) -> None:
        """Take the output of one more recording.

        Raises:
            ValueError: a line that is neither a series nor a value, or passes of unequal length.
        """
        passes: Dict[str, List[List[float]]] = {}
        for line in output.splitlines():
            kind, name, *words = line.split()
            if kind == "series":
                passes.setdefault(name, []).append([float(word) for word in words[1:]])
            elif kind == "value":
                self.values[name] = self.values.get(name, 0) + int(words[0])
            else:
                raise ValueError(f"measuring program: got {line[:80]!r}, allowed series or value")
        for name, rows in passes.items():
            if len({len(row) for row in rows}) != 1:
                raise ValueError(f"measuring program: {name} has passes of unequal length")
            self.series.setdefault(name, []).append(np.array(rows))

    def per_frame(self, name: str, every: int = 1) -> np.ndarray:
        """One figure a frame, all recordings in a row.

        It is the median over the passes, which leaves out what other programs on the machine did to single passes.

        Args:
            name: of the series.
            every: only every so manyth frame of each recording, its first one included.
        """
        return np.concatenate([np.median(rows, axis=0)[::every] for rows in self.series[name]])

    def stages(self) -> List[str]:
        """Names of the stages that were timed, in their order."""
        return [name[len("stage_") : -len("_cpu_ms")] for name in self.series if name.startswith("stage_")]

    def map_part(self, every: int = 1) -> np.ndarray:
        """CPU time [ms] a frame from the depth image to octree and columns, where OctoMap's insertion ends too."""
        return sum(self.per_frame(f"stage_{name}_cpu_ms", every) for name in ("points", "voxels"))


def compare(whole: Measurement, numpy_ms: np.ndarray, insert_every: int, numpy_every: int) -> Dict[str, float]:
    """Mean times of the others, and each over ours on the same frames.

    Args:
        whole: Measurement with the series of the measuring program.
        numpy_ms: CPU time of the numpy pipeline, of every numpy_every-th frame of each recording.
        insert_every: OctoMap's insertion was timed on every so manyth frame.
        numpy_every: as said.
    """
    map_ms, opencv_ms = whole.map_part(insert_every).mean(), whole.per_frame("opencv_cpu_ms").mean()
    figures = {"opencv_ms": opencv_ms, "numpy_ms": numpy_ms.mean()}
    for name in ("insert_point_cloud", "insert_discretized"):
        figures[f"{name}_ms"] = whole.per_frame(f"{name}_cpu_ms").mean()
        figures[f"map_vs_{name}"] = figures[f"{name}_ms"] / map_ms
    figures["whole_vs_opencv"] = opencv_ms / whole.per_frame("whole_cpu_ms").mean()
    figures["whole_vs_numpy"] = numpy_ms.mean() / whole.per_frame("whole_cpu_ms", numpy_every).mean()
    return {name: round(float(figure), 3 if name.endswith("_ms") else 1) for name, figure in figures.items()}


def summarise(times_ms: np.ndarray) -> Dict[str, float]:
    """Mean, 95th and 99th percentile (a frame that was measured, never between two) and the largest."""
    ordered = np.sort(times_ms)
    ranks = {share: ordered[int(np.ceil(share * len(ordered))) - 1] for share in (0.95, 0.99)}
    figures = {"mean_ms": ordered.mean(), "p95_ms": ranks[0.95], "p99_ms": ranks[0.99], "max_ms": ordered[-1]}
    return {name: round(float(value), 4) for name, value in figures.items()}

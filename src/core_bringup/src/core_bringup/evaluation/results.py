# SPDX-License-Identifier: BSD-3-Clause
"""The files a run leaves behind; each appears whole or not at all."""

from __future__ import annotations

import contextlib
import csv
import json
import os
import platform
import tempfile
from pathlib import Path
from typing import Iterator, List, Sequence

from core_bringup.evaluation.metrics import trajectory_row
from core_bringup.evaluation.records import TickRecord
from core_bringup.evaluation.sources import read_sources_hash

# DESIGN section 7 names these; a run may add others.
RESULT_KEYS = (
    "task",
    "method",
    "profile",
    "seed",
    "outcome",
    "min_clearance_m",
    "stop_gap_m",
    "goal_distance_m",
    "interventions",
    "false_stops",
    "sim_time_s",
    "rtf",
    "trajectory_sha256",
)
TRAJECTORY_COLUMNS = (
    *("time_s", "x_m", "y_m", "z_m", "qx", "qy", "qz", "qw"),
    *("vx_mps", "vy_mps", "vz_mps", "wx_radps", "wy_radps", "wz_radps"),
    *("u_vx_mps", "u_vy_mps", "u_wz_radps", "nominal_vx_mps", "nominal_vy_mps", "nominal_wz_radps"),
    *("h_m", "clearance_m", "obstacle_clearance_m", "mode", "rule", "reason"),
)


@contextlib.contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """A temporary path beside path that takes its name when the block ends, and vanishes when it raises."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(prefix=f".{path.stem}.", suffix=path.suffix, dir=str(path.parent))
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        temporary.chmod(0o644)
        temporary.replace(path)
    except BaseException:
        with contextlib.suppress(FileNotFoundError):
            temporary.unlink()
        raise


def write_json(path: Path, content: object) -> None:
    """Write one JSON document; NaN and infinity are refused, because most readers refuse them.

    Raises:
        ValueError: content holds NaN or infinity.
    """
    text = json.dumps(content, indent=2, allow_nan=False)
    with atomic_path(path) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")


def write_trajectory(path: Path, records: Sequence[TickRecord]) -> None:
    """Write one CSV line per tick; numbers are printed so that reading them gives the same float64 again."""
    with atomic_path(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(TRAJECTORY_COLUMNS)
        for r in records:
            numbers = trajectory_row(r) + tuple(r.filter.u_nominal)
            numbers += (r.filter.h_m, r.truth.clearance_m, r.truth.obstacle_clearance_m)
            writer.writerow([repr(float(x)) for x in numbers] + [r.filter.mode, r.filter.binding_rule, r.filter.reason])


def read_versions() -> dict:
    """Versions that may change a figure: our sources, Python, ROS and the libraries a run computes with."""
    versions = {"sources": read_sources_hash(), "python": platform.python_version()}
    versions["ros"] = os.environ.get("ROS_DISTRO", "")
    for name in ("numpy", "pybullet", "cvxpy", "daqp", "matplotlib"):
        versions[name] = _package_version(name)
    versions["blas"] = ", ".join(read_blas_kernels())
    return versions


def read_blas_kernels() -> List[str]:
    """Names of the kernels that OpenBLAS has chosen in this process, by the processor or by OPENBLAS_CORETYPE.

    Each rounds in its own way, so that hashes are equal only where these are.
    """
    import ctypes

    import numpy  # noqa: F401  loads the library

    maps = Path("/proc/self/maps")
    if not maps.exists():
        return []
    words = [line.split(maxsplit=5)[5:] for line in maps.read_text(encoding="utf-8", errors="replace").splitlines()]
    names = set()
    for path in sorted({word[0] for word in words if word and "openblas" in word[0]}):
        library = ctypes.CDLL(path)  # loaded already: the same one
        for symbol in ("openblas_get_corename64_", "openblas_get_corename", "scipy_openblas_get_corename64_"):
            if hasattr(library, symbol):
                function = getattr(library, symbol)
                function.restype = ctypes.c_char_p
                names.add(function().decode("ascii", "replace"))
    return sorted(names)


def _package_version(name: str) -> str:
    from importlib import metadata

    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return ""

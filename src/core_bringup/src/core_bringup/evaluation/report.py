# SPDX-License-Identifier: BSD-3-Clause
"""The report of a campaign: DIR/report.html, one page that needs nothing else, and DIR/table.md for a README."""

from __future__ import annotations

import base64
import shlex
from pathlib import Path
from typing import Dict, List, Mapping, Optional, Sequence, Tuple

import cv2
import jinja2

from core_bringup.evaluation import report_plots as plots
from core_bringup.evaluation import report_tables as tables
from core_bringup.evaluation.campaign_store import read_trials
from core_bringup.evaluation.preflight import find_package_folder
from core_bringup.evaluation.report_tables import Trial
from core_bringup.evaluation.results import atomic_path
from core_bringup.exceptions import BringupError
from core_bringup.world import load_world

TEMPLATE = "report.html.j2"
TITLE = "CORE: contextual safety, evaluated"
PICTURES = {"frame_1.png": "first sight", "frame_2.png": "braking", "frame_3.png": "end", "topdown.png": "from above"}
REPLAY = ("roslaunch", "core_bringup", "replay.launch")
PICTURE_WIDTH_PX = 520
JPEG_QUALITY = 72
SECTIONS = {"tasks": "Tasks", "figures": "Figures", "paths": "Paths", "barrier": "Barrier", "failures": "Failures"}
FILTERLESS = ("none",)
LATENCY_CAPTION = "Share of trials whose latency is below: solid the median of a trial, dashed p95, dotted p99."


def write_report(folder: Path, missing: int = 0, command: str = "") -> Path:
    """Write report.html and table.md from DIR/trials.jsonl and the folders of the trials.

    Args:
        folder: DIR of the campaign.
        missing: trials that have not been run yet.
        command: the command that repeats the campaign.

    Returns:
        Path of the page.

    Raises:
        BringupError: no trial has been recorded.
    """
    folder = Path(folder)
    trials = read_trials(folder)
    if not trials:
        raise BringupError(f"{folder}: no trial is recorded; allowed: the folder of a campaign")
    page = _template().render(**_content(folder, trials), missing=missing, command=command)
    for name, text in (("report.html", page), ("table.md", _markdown(trials))):
        with atomic_path(folder / name) as temporary:
            temporary.write_text(text, encoding="utf-8")
    return folder / "report.html"


def _template() -> jinja2.Template:
    loader = jinja2.FileSystemLoader(str(find_package_folder("core_bringup") / "config"))
    environment = jinja2.Environment(loader=loader, autoescape=True, undefined=jinja2.StrictUndefined)
    return environment.get_template(TEMPLATE)


def _content(folder: Path, trials: Sequence[Trial]) -> Dict[str, object]:
    scopes = [scope for scope in tables.SCOPES if any(tables.scope_of(t) == scope for t in trials)]
    paths = plots.read_paths(folder, trials)
    main_tables = {scope: tables.build_main_table(trials, scope) for scope in scopes}
    headings, figure_rows = tables.build_figure_table(trials)
    figures = [("Left: negative once the footprint entered. Each dot is a trial.", plots.draw_distances(trials))]
    latency = plots.draw_latency(trials)
    if latency:
        figures.append((LATENCY_CAPTION, latency))
    return {
        "title": TITLE,
        "trials": len(trials),
        "tasks": len({(t.get("world"), t["task"]) for t in trials}),
        "errors": len(tables.select(trials, outcome="error")),
        "methods": tables.methods_of(trials),
        "versions": next((t["versions"] for t in trials if t.get("versions")), {}),
        "sections": [(scope, tables.SCOPES[scope]) for scope in scopes] + list(SECTIONS.items()),
        "tables": [(scope, tables.SCOPES[scope], rows) for scope, rows in main_tables.items()],
        "success": {scope: plots.draw_success(rows) for scope, rows in main_tables.items()},
        "grid": tables.build_task_grid(trials),
        "figure_headings": headings,
        "figure_rows": figure_rows,
        "plots": figures,
        "paths": _draw_task_paths(trials, paths),
        "barriers": _draw_barriers(trials, paths),
        "failures": _failures(folder, trials),
    }


def _by_task(trials: Sequence[Trial]) -> Dict[Tuple[str, str], List[Trial]]:
    grouped: Dict[Tuple[str, str], List[Trial]] = {}
    for trial in sorted(trials, key=lambda t: (t.get("number") or 99, str(t.get("world")), str(t["task"]))):
        grouped.setdefault((str(trial.get("world")), str(trial["task"])), []).append(trial)
    return grouped


def _draw_task_paths(trials: Sequence[Trial], paths: Mapping[str, plots.Path2D]) -> List[Tuple[str, str]]:
    colors, drawn = plots.method_colors(trials), []
    for (world_name, task_name), own in _by_task(trials).items():
        if not any(str(t["id"]) in paths for t in own):
            continue
        world = load_world(str(own[0].get("world_file") or world_name)).for_task(task_name)
        drawn.append((_caption(own[0]), plots.draw_paths(world, world.task(task_name), own, paths, colors)))
    return drawn


def _draw_barriers(trials: Sequence[Trial], paths: Mapping[str, plots.Path2D]) -> List[Tuple[str, str]]:
    drawn = []
    for own in _by_task(trials).values():
        shown = next((t for t in own if t["method"] not in FILTERLESS and str(t["id"]) in paths), None)
        if shown is not None:
            caption = f"{_caption(shown)}: {tables.method_name(shown)}, {shown['outcome']}"
            drawn.append((caption, plots.draw_barrier(paths[str(shown["id"])])))
    return drawn


def _caption(trial: Trial) -> str:
    number = f"{trial['number']}. " if trial.get("number") else ""
    return f"{number}{trial['task']} ({trial.get('world')}, {trial.get('expectation')})"


def _failures(folder: Path, trials: Sequence[Trial]) -> List[Tuple[str, List[dict]]]:
    groups: Dict[str, List[dict]] = {}
    for trial in trials:
        if not trial.get("success"):
            groups.setdefault(tables.method_name(trial), []).append(_failure(folder, trial))
    return list(groups.items())


def _failure(folder: Path, trial: Trial) -> dict:
    where = folder / str(trial.get("folder", ""))
    images = [(caption, _embed(where / name)) for name, caption in PICTURES.items()]
    bag = where / "trial.bag"
    return {
        **{key: trial.get(key) for key in ("task", "trial", "seed", "outcome", "attribution", "attribution_detail")},
        "command": trial.get("command", ""),
        "trajectory_sha256": trial.get("trajectory_sha256"),
        "detail": trial.get("failure") or trial.get("end_detail") or "",
        "replay": shlex.join([*REPLAY, f"bag:={bag.resolve()}"]) if bag.is_file() else "",
        "images": [(caption, source) for caption, source in images if source],
    }


def _embed(path: Path) -> Optional[str]:
    """The picture as a data URI, made smaller; None when there is none."""
    image = cv2.imread(str(path)) if path.is_file() else None
    if image is None:
        return None
    scale = min(1.0, PICTURE_WIDTH_PX / image.shape[1])
    size_px = (int(round(image.shape[1] * scale)), int(round(image.shape[0] * scale)))
    small = cv2.resize(image, size_px, interpolation=cv2.INTER_AREA)
    data = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1]
    return "data:image/jpeg;base64," + base64.b64encode(data.tobytes()).decode("ascii")


def _markdown(trials: Sequence[Trial]) -> str:
    parts = []
    for scope, heading in tables.SCOPES.items():
        if any(tables.scope_of(t) == scope for t in trials):
            parts.append(f"**{heading}**\n\n{tables.markdown_table(trials, scope)}")
    return "\n".join(parts)

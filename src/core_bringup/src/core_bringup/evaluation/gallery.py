# SPDX-License-Identifier: BSD-3-Clause
"""The gallery: pictures of every model and world. Exit status 0 done, 1 could not, 2 bad input, 130 interrupted."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Dict, List, Optional, Sequence

import numpy as np
from tqdm import tqdm

from core_bringup.evaluation.command_line import OneLineParser, Program, run_program
from core_bringup.evaluation.contact_sheet import arrange_grid, shrink, stack_sheets, write_picture
from core_bringup.evaluation.gallery_views import catalogue_names, draw_bird_view, draw_models, draw_tasks
from core_bringup.exceptions import ConfigError
from core_bringup.params import find_robot_file
from core_bringup.robot import RobotConfig
from core_bringup.world import find_worlds_dir, load_world
from core_bringup.world_types import World

MODEL_COLUMNS, WORLD_COLUMNS = 5, 4
INDEX_MODEL_COLUMNS, INDEX_MODEL_PX = 10, 200
HELP = """usage: ./core.sh gallery [--out DIR] [--models [NAME ...]] [--worlds [NAME ...]]

Draws every model of worlds/models/models.yaml as the robot's camera sees it 3 to 5 m ahead, and every world from the
start of each of its tasks and from above. Writes models.png, worlds.png and, when both are asked for, index.png.
  --out DIR              default results/gallery
  --models [NAME ...]    only these models (none named: all), and no worlds unless --worlds is given
  --worlds [NAME ...]    only these worlds (none named: all), and no models unless --models is given
"""


def parse_options(arguments: Sequence[str]) -> argparse.Namespace:
    """Read the command line; ConfigError for what is not an option."""
    parser = OneLineParser("gallery", "--out DIR, --models NAME ..., --worlds NAME ..., --help")
    parser.add_argument("-h", "--help", action="store_true")
    parser.add_argument("--out", type=Path, default=Path("results/gallery"))
    parser.add_argument("--models", nargs="*")
    parser.add_argument("--worlds", nargs="*")
    return parser.parse_args(list(arguments))


def choose_names(option: str, wanted: Optional[List[str]], other: Optional[List[str]], known: List[str]) -> List[str]:
    """Names to draw: those wanted; all when none is named; none when only the other kind is asked for.

    Raises:
        ConfigError: a name that is not known.
    """
    if wanted is None:
        return known if other is None else []
    for name in wanted:
        if name not in known:
            raise ConfigError("gallery", f"--{option}", f"no {option[:-1]} {name!r}", ", ".join(sorted(known)))
    return list(dict.fromkeys(wanted)) or known


def write_gallery(out: Path, models: Sequence[str], worlds: Sequence[World], robot: RobotConfig) -> List[Path]:
    """Draw what is named and write the sheets into a folder; returns their paths.

    Raises:
        BringupError: something cannot be drawn.
        OSError: a picture cannot be written.
    """
    total = len(models) + sum(1 + len(world.tasks) for world in worlds)
    sheets: Dict[str, np.ndarray] = {}
    with tqdm(total=total, desc="gallery", unit="picture", file=sys.stderr) as bar:
        pictures = [_count(bar, picture) for _, picture in draw_models(models, robot)] if models else []
        birds = []
        for world in worlds:
            birds.append(_count(bar, draw_bird_view(world, robot)))
            tasks = [_count(bar, picture) for _, picture in draw_tasks(world, robot)]
            sheet = stack_sheets([arrange_world(birds[-1], tasks)])
            sheets["worlds"] = stack_sheets([sheets["worlds"], sheet]) if "worlds" in sheets else sheet
    if pictures:
        sheets["models"] = arrange_grid(pictures, MODEL_COLUMNS)
    if pictures and birds:
        small = arrange_grid([shrink(picture, INDEX_MODEL_PX) for picture in pictures], INDEX_MODEL_COLUMNS)
        width_px = (small.shape[1] - small.shape[1] % len(birds)) // len(birds) - 8
        sheets["index"] = stack_sheets([arrange_grid([shrink(bird, width_px) for bird in birds], len(birds)), small])
    paths = [out / f"{name}.png" for name in sheets]
    for path, sheet in zip(paths, sheets.values()):
        write_picture(path, sheet)
    return paths


def arrange_world(bird: np.ndarray, tasks: Sequence[np.ndarray]) -> np.ndarray:
    """One world's sheet: the view from above in the upper left, two by two tiles large, the tasks around it."""
    empty = np.full_like(tasks[0], 255)
    beside = WORLD_COLUMNS - 2
    tiles = [empty, empty, *tasks[:beside], empty, empty, *tasks[beside : 2 * beside]]
    tiles += [empty] * (2 * WORLD_COLUMNS - len(tiles)) + list(tasks[2 * beside :])
    sheet = arrange_grid(tiles, WORLD_COLUMNS)
    corner = (sheet.shape[1] - WORLD_COLUMNS * empty.shape[1]) // (WORLD_COLUMNS + 1)
    sheet[corner : corner + bird.shape[0], corner : corner + bird.shape[1]] = bird
    return sheet


def _count(bar: tqdm, picture: np.ndarray) -> np.ndarray:
    bar.update()
    return picture


def run_gallery(options: argparse.Namespace) -> int:
    """Draw what is asked for; returns the exit status."""
    if options.out.exists() and not options.out.is_dir():
        raise ConfigError("gallery", "--out", f"{options.out} is a file", "a folder")
    shipped = sorted(path.stem for path in find_worlds_dir().glob("*.yaml"))
    models = choose_names("models", options.models, options.worlds, catalogue_names())
    worlds = [load_world(name) for name in choose_names("worlds", options.worlds, options.models, shipped)]
    for path in write_gallery(options.out, models, worlds, RobotConfig.load(find_robot_file())):
        print(path)
    return 0


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Entry of scripts/gallery; see HELP."""
    program = Program("gallery", HELP, parse_options, run_gallery, "pictures that were finished stay")
    return run_program(program, arguments)

# SPDX-License-Identifier: BSD-3-Clause
"""Which tasks a campaign runs: those of the paper, our own, or some by name."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import List, Sequence

from core_bringup.evaluation.trial_spec import TaskSpec
from core_bringup.exceptions import ConfigError
from core_bringup.task_types import SPLITS
from core_bringup.world import find_worlds_dir, load_world

__all__ = ["SPLITS", "choose_tasks", "list_tasks"]

GROUPS = ("paper", "own", "all")


def choose_tasks(text: str, split: str = "main") -> List[TaskSpec]:
    """Tasks by group or by name.

    Args:
        text: 'paper' (those with a number; of the held-out ones, the variants of those), 'own' (the others), 'all',
            or names separated by commas: ``task``, ``world/task``, or ``path/world.yaml/task``.
        split: 'main' or 'heldout'; shipped tasks of the other one cannot be named, those of a file given by path can.

    Returns:
        The paper's tasks by their number, then the others by world and name; named ones in the order given.

    Raises:
        ConfigError: a world file is wrong, a name is unknown, not unique or given twice, or no task is left.
    """
    shipped = list_tasks([path.stem for path in sorted(find_worlds_dir().glob("*.yaml"))])
    known = [task for task in shipped if task.split == split]
    if text in GROUPS:
        return _choose_group(text, known)
    names = text.split(",")
    chosen = [_find(name, known) for name in names]
    if len({task.label for task in chosen}) != len(names):
        raise ConfigError("evaluate", "--tasks", f"got {text!r}", "every task once")
    return chosen


def _choose_group(group: str, known: Sequence[TaskSpec]) -> List[TaskSpec]:
    chosen = [task for task in known if group == "all" or (task.number is not None) == (group == "paper")]
    if not chosen:
        raise ConfigError("evaluate", "--tasks", f"no task of this split is of the group {group!r}", _names(known))
    return sorted(chosen, key=lambda task: (task.number is None, task.number or 0, task.world, task.name))


def list_tasks(worlds: Sequence[str]) -> List[TaskSpec]:
    """All tasks of some worlds (names or paths); a label is the task's name where that is unique, else world-task.

    A held-out variant has the number of the task it is a variant of.

    Raises:
        ConfigError: a world file is wrong.
    """
    loaded = [(name, load_world(name)) for name in worlds]
    count = Counter(task for _, world in loaded for task in world.tasks)
    tasks = []
    for name, world in loaded:
        for task in world.tasks.values():
            label = task.name if count[task.name] == 1 else f"{world.name}-{task.name}"
            number = world.tasks.get(task.variant_of, task).number
            tasks.append(TaskSpec(name, task.name, label, task.expectation, number, task.category, task.split))
    return tasks


def _find(name: str, known: Sequence[TaskSpec]) -> TaskSpec:
    world, _, task = name.rpartition("/")
    if Path(world).suffix in (".yaml", ".yml"):
        path = str(Path(world).resolve())
        found = [spec for spec in list_tasks([path]) if spec.name == task]
        found = [replace(spec, label=f"{Path(path).stem}-{task}") for spec in found]
        allowed = "path/world.yaml/task with a task of that file"
    else:
        found = [spec for spec in known if spec.name == task and world in ("", spec.world)]
        allowed = f"{', '.join(GROUPS)}, {_names(known)}"
    if len(found) != 1:
        problem = f"{name!r} is in more than one world" if found else f"no task {name!r}"
        raise ConfigError("evaluate", "--tasks", problem, allowed)
    return found[0]


def _names(tasks: Sequence[TaskSpec]) -> str:
    unique = Counter(task.name for task in tasks)
    return ", ".join(sorted(t.name if unique[t.name] == 1 else f"{t.world}/{t.name}" for t in tasks))

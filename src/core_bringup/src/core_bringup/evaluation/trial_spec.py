# SPDX-License-Identifier: BSD-3-Clause
"""What a campaign runs: methods x tasks x trials, in an order that covers every method early."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Dict, List, Optional, Sequence, Tuple

from core_bringup.evaluation.preflight import DemoRequest, find_package_folder, parse_arguments
from core_bringup.exceptions import ConfigError
from core_bringup.methods import REASONERS_OF_METHOD
from core_perception.reasoners.emulated_reasoner import load_rows

DEFAULT_METHODS = ("core:ontology", "core:emulated-gemma3-27b", "oracle", "no_context", "geometric", "none")
# These have one reasoner, or none.
PLAIN_METHODS = ("oracle", "no_context", "geometric", "none")
WITHOUT_PROFILE = ("geometric", "none")
EMULATED = "core:emulated-"
# The perfect answer is a method of its own.
CORE_REASONERS = tuple(name for name in REASONERS_OF_METHOD["core"] if name not in ("oracle", "emulated"))
# Failed trials keep what shows why; a trial repeated by its command makes its own pictures.
KEPT_WHEN_FAILED = ("pictures", "bag")
SEEDS_PER_BASE = 1000  # trial k has seed base * SEEDS_PER_BASE + k; seed 0 is the world as written


@dataclass(frozen=True)
class MethodSpec:
    """One row of the table: campaign name, profile ('core', 'paper', or '-' where there is none), launch words."""

    name: str
    profile: str
    words: Tuple[str, ...]


@dataclass(frozen=True)
class TaskSpec:
    """A task: world (name or path), name in it, label (unique among all), and what the record of a trial says of it."""

    world: str
    name: str
    label: str
    expectation: str
    number: Optional[int] = None
    category: str = ""
    split: str = "main"


@dataclass(frozen=True)
class TrialSpec:
    """One trial.

    Attributes:
        index: place in the plan, from 0.
        trial: 1..N.
        words: arguments of demo.launch that decide the outcome.
        extra_words: arguments that decide which files are kept.
    """

    index: int
    method: MethodSpec
    task: TaskSpec
    trial: int
    seed: int
    words: Tuple[str, ...]
    extra_words: Tuple[str, ...] = ()

    @property
    def id(self) -> str:
        """Unique in the campaign, and a relative path."""
        return "/".join((self.method.name, self.method.profile, self.task.label, str(self.trial))).replace(":", "-")

    @property
    def command(self) -> str:
        """The line that repeats this trial, with pictures, in results/demo."""
        return shlex.join(["./core.sh", "demo", *self.words])

    def request(self, folder: Path) -> DemoRequest:
        """The checked arguments of a run that writes into folder.

        Raises:
            ConfigError: an argument is wrong.
        """
        return parse_arguments([*self.words, *self.extra_words, f"results:={folder}"])

    def describe(self) -> Dict[str, object]:
        """What a record says of a trial whatever becomes of it."""
        task = self.task
        content = {name: getattr(task, name) for name in ("number", "category", "split", "expectation")}
        if Path(task.world).suffix:
            content["world_file"] = task.world
        return dict(
            content, id=self.id, index=self.index, method=self.method.name, profile=self.method.profile,
            world=task.world, task=task.name, trial=self.trial, seed=self.seed,
            folder=f"trials/{self.id}", command=self.command, launch=[*self.words, *self.extra_words],
        )  # fmt: skip


def read_methods(names: Sequence[str], profiles: Sequence[str]) -> List[MethodSpec]:
    """Turn campaign names of methods into launch words, one entry per profile where a method has one.

    Args:
        names: such as ``core:ontology`` or ``none``.
        profiles: of 'core' and 'paper'.

    Raises:
        ConfigError: an unknown or repeated name.
    """
    methods = []
    for name in names:
        words = _method_words(name)
        if name in WITHOUT_PROFILE:
            methods.append(MethodSpec(name, "-", (*words, "profile:=core")))
        else:
            methods += [MethodSpec(name, profile, (*words, f"profile:={profile}")) for profile in profiles]
    if not names or len(set(names)) != len(names):
        raise ConfigError("evaluate", "--methods", f"got {','.join(names)!r}", "a list of different methods")
    return methods


def _method_words(name: str) -> Tuple[str, ...]:
    if name in PLAIN_METHODS:
        return (f"method:={name}",)
    if name.startswith(EMULATED):
        row = name[len(EMULATED) :]
        rows = sorted(load_rows(find_package_folder("core_perception") / "config" / "emulated.yaml"))
        if row not in rows:
            raise ConfigError("evaluate", "--methods", f"got {name!r}", ", ".join(f"{EMULATED}{r}" for r in rows))
        return "method:=core", "reasoner:=emulated", f"emulated_row:={row}"
    if name.startswith("core:") and name[len("core:") :] in CORE_REASONERS:
        return "method:=core", f"reasoner:={name[len('core:') :]}"
    allowed = [f"core:{reasoner}" for reasoner in CORE_REASONERS] + [f"{EMULATED}ROW", *PLAIN_METHODS]
    raise ConfigError("evaluate", "--methods", f"got {name!r}", ", ".join(allowed))


def make_trials(
    methods: Sequence[MethodSpec], tasks: Sequence[TaskSpec], trials: int, seed: int, words: Sequence[str]
) -> List[TrialSpec]:
    """The plan: trial 1 of every task with every method, then trial 2, and so on.

    Args:
        methods: rows.
        tasks: columns.
        trials: trials per method and task.
        seed: base seed S; trial k has seed S * 1000 + k.
        words: launch arguments of every trial.
    """
    given = {word.partition(":=")[0] for word in words}
    extra = tuple(f"{name}:=failed" for name in KEPT_WHEN_FAILED if name not in given)
    specs: List[TrialSpec] = []
    for k in range(1, trials + 1):
        for task in tasks:
            for method in methods:
                own = (f"world:={task.world}", f"task:={task.name}", *method.words)
                number = seed * SEEDS_PER_BASE + k
                every = (*own, f"seed:={number}", *words)
                specs.append(TrialSpec(len(specs), method, task, k, number, every, extra))
    return specs

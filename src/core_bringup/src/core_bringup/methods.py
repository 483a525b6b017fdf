# SPDX-License-Identifier: BSD-3-Clause
"""The methods that are compared, and what each asks of the nodes.

| method       | who states rules              | map and filter |
|--------------|-------------------------------|----------------|
| `core`       | any reasoner                  | as the profile says |
| `oracle`     | the true rules of the task    | the same |
| `no_context` | rules fixed before deployment | the same |
| `geometric`  | nobody                        | what depth shows as an obstacle is unsafe, all else safe |
| `none`       | any reasoner; nobody obeys    | the filter only reports |

Source: [CORE] experimental results, baselines. `none` is ours: the nominal command alone.
"""

from __future__ import annotations

from typing import Dict, List, Mapping, Tuple

METHODS = ("core", "oracle", "no_context", "geometric", "none")
SCRIPTED = "scripted"
_SEEING = ("ontology", "auto", "ollama", "openai", "static", "oracle", "emulated", "replay")
# Allowed with each method; the first is the default.
REASONERS_OF_METHOD: Mapping[str, Tuple[str, ...]] = {
    "core": _SEEING,
    "oracle": ("oracle",),
    "no_context": ("static",),
    "geometric": ("none",),
    "none": (*_SEEING, "none"),
}


def find_reasoner(method: str, reasoner: str, task) -> str:
    """Name of the reasoner that runs: in a task with a wrong answer, `scripted` takes the place of that of `core`."""
    return SCRIPTED if method == "core" and task.wrong_answer else reasoner


def find_predicates(method: str, reasoner: str, task) -> List[str]:
    """Predicates given to the reasoner that runs: the true ones, or the wrong answer; none where it has its own."""
    running = find_reasoner(method, reasoner, task)
    if running == SCRIPTED:
        return list(task.wrong_answer)
    return list(task.oracle_predicates) if running in ("oracle", "emulated") else []


def find_parameters(method: str) -> Dict[str, dict]:
    """Parameters by node name that make up a method, as launch/demo.launch sets them."""
    if method == "geometric":
        return {
            "semantic_map": {"semantics": False, "unknown_is_unsafe": False},
            "cbf_filter": {"require_constraints": False},
        }
    return {"cbf_filter": {"enforce": False}} if method == "none" else {}

# SPDX-License-Identifier: BSD-3-Clause
"""Builds the reasoner that the parameters name."""

from __future__ import annotations

from pathlib import Path

from core_perception.ontology import Ontology
from core_perception.params import ReasonerParams
from core_perception.predicates import parse_predicate
from core_perception.reasoners.base import Reasoner
from core_perception.reasoners.fixed_reasoner import FixedReasoner, load_rules
from core_perception.reasoners.ontology_reasoner import OntologyReasoner


def make_reasoner(params: ReasonerParams, config_dir: Path) -> Reasoner:
    """Return a new reasoner.

    Args:
        params: which one, and its settings.
        config_dir: folder of the files the package ships.

    Raises:
        PerceptionError: a file is missing or wrong.
    """
    if params.reasoner == "oracle":
        return FixedReasoner(
            "oracle", map(parse_predicate, params.predicates), "The true rules of the task, given by parameter."
        )
    if params.reasoner == "static":
        return load_rules(params.rules_file or config_dir / "static_rules.yaml")
    ontology = Ontology.load(params.ontology_file or config_dir / "ontology.yaml")
    return OntologyReasoner(ontology, params.memory, params.link_m, params.frames_of_three)

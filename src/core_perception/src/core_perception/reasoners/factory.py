# SPDX-License-Identifier: BSD-3-Clause
"""Builds the reasoner that the parameters name."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Optional

from core_perception.constraint_memory import ConstraintMemory
from core_perception.endpoint import Endpoint, load_allowed_hosts
from core_perception.exceptions import ParameterError
from core_perception.ontology import Ontology
from core_perception.params import ReasonerParams
from core_perception.predicates import parse_predicate
from core_perception.prompt import PromptTemplate
from core_perception.reasoners.base import Reasoner
from core_perception.reasoners.emulated_reasoner import EmulatedReasoner, load_rows
from core_perception.reasoners.fixed_reasoner import FixedReasoner, NoReasoner, load_rules
from core_perception.reasoners.loading_client import LoadingClient
from core_perception.reasoners.ontology_reasoner import OntologyReasoner
from core_perception.reasoners.recording import RecordingClient, ReplayClient
from core_perception.reasoners.scripted_reasoner import ScriptedReasoner
from core_perception.reasoners.server_choice import choose_server
from core_perception.reasoners.vlm_client import BackOff, VlmClient
from core_perception.reasoners.vlm_reasoner import Sampling, VlmReasoner
from core_perception.reasoners.wire import OllamaWire, OpenAiWire
from core_perception.wordnet import WORDNET_DIR

USUAL_URLS = {"ollama": "http://127.0.0.1:11434", "openai": "http://127.0.0.1:8080"}


@dataclass(frozen=True)
class ReasonerParts:
    """A reasoner and what goes with it.

    Attributes:
        reasoner: answers.
        ontology: canonical names of its classes.
        memory: holds what earlier answers of a reasoner that forgets said; None where each answer replaces the last.
        embedded: the embedded rules that hold besides; None for none.
        description: which reasoner answers and why that one, in one line.
    """

    reasoner: Reasoner
    ontology: Ontology
    memory: Optional[ConstraintMemory]
    embedded: Optional[OntologyReasoner]
    description: str


def make_reasoner(params: ReasonerParams, config_dir: Path, robot_name: str = "") -> ReasonerParts:
    """Return a new reasoner; with ``auto`` a server may be asked for up to two seconds.

    Args:
        params: which one, and its settings.
        config_dir: folder of the files the package ships.
        robot_name: tells several robots that share a server apart.

    Raises:
        PerceptionError: a file is missing or wrong, or an address is not allowed.
    """
    path = params.ontology_file or config_dir / "ontology.yaml"
    ontology = Ontology.load(path, params.wordnet_dir or WORDNET_DIR)
    reason = f"by parameter: {params.reasoner}"
    if params.reasoner == "auto":
        choice = choose_server(_find_endpoint(replace(params, reasoner="ollama")), params.model)
        params = replace(params, reasoner=choice.reasoner, model=choice.model)
        reason = f"auto chose {choice.reasoner}: {choice.reason}"
    reasoner = _make(params, config_dir, ontology, robot_name)
    memory = ConstraintMemory(ontology, params.clear_after_replies) if params.memory else None
    embedded = _make_ontology_reasoner(params, ontology) if params.embedded_rules and reasoner.is_guarded else None
    return ReasonerParts(reasoner, ontology, memory, embedded, reason)


def _make(params: ReasonerParams, config_dir: Path, ontology: Ontology, robot_name: str) -> Reasoner:
    if params.reasoner == "oracle":
        return FixedReasoner(
            "oracle", map(parse_predicate, params.predicates), "The true rules of the task, given by parameter."
        )
    if params.reasoner == "none":
        return NoReasoner()
    if params.reasoner == "scripted":
        return ScriptedReasoner(map(parse_predicate, params.predicates), params.scripted_latency_s)
    if params.reasoner == "static":
        return load_rules(params.rules_file or config_dir / "static_rules.yaml")
    if params.reasoner == "emulated":
        rows = load_rows(config_dir / "emulated.yaml")
        if params.emulated_row not in rows:
            raise ParameterError("emulated_row", params.emulated_row, "one of " + ", ".join(sorted(rows)))
        truth = map(parse_predicate, params.predicates)
        return EmulatedReasoner(truth, rows[params.emulated_row], params.emulated_correlation, params.seed, ontology)
    if params.reasoner == "ontology":
        return _make_ontology_reasoner(params, ontology)
    return _make_vlm(params, config_dir, ontology, robot_name)


def _make_ontology_reasoner(params: ReasonerParams, ontology: Ontology) -> OntologyReasoner:
    return OntologyReasoner(ontology, params.memory, params.link_m, params.frames_of_three)


def _make_vlm(params: ReasonerParams, config_dir: Path, ontology: Ontology, robot_name: str) -> VlmReasoner:
    template = PromptTemplate.load(
        params.prompt_file or config_dir / "prompt.yaml", params.safety_logic, params.chain_of_thought
    )
    is_replay = params.reasoner == "replay"
    client = ReplayClient(Path(params.replay_dir)) if is_replay else make_client(params)
    if params.reasoner == "ollama":
        client = LoadingClient(client)
    if params.record_dir:
        folder = Path(params.record_dir)
        client = RecordingClient(client, folder, params.model, params.reasoner, params.record_images)
    return VlmReasoner(
        params.reasoner,
        client,
        template,
        ontology,
        Sampling(params.confidence, params.confidence_samples, params.seed),
        is_slow=not is_replay,
        # A replay makes the same pauses as the run that was recorded.
        back_off=BackOff(f"{robot_name} {params.seed}"),
    )


def make_client(params: ReasonerParams) -> VlmClient:
    """Return a client of the server that the parameters name; nothing is sent yet.

    Raises:
        PerceptionError: the address is not allowed, or a setting of the server is wrong.
    """
    sampling = {"max_tokens": params.max_tokens, "logprobs": params.confidence == "logprobs"}
    if params.reasoner == "ollama":
        wire = OllamaWire(params.model, params.keep_alive, params.context_tokens, **sampling)
    else:
        wire = OpenAiWire(params.model or "default", params.api_key_env, **sampling)
    return VlmClient(
        wire, _find_endpoint(params), params.deadline_s, params.load_timeout_s, max_image_px=params.image_max_px
    )


def _find_endpoint(params: ReasonerParams) -> Endpoint:
    allowed = load_allowed_hosts(Path(params.allowed_hosts_file)) if params.allowed_hosts_file else ()
    return Endpoint.parse(params.server_url or USUAL_URLS[params.reasoner], allowed, params.allow_remote_images)

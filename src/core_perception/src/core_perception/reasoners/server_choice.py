# SPDX-License-Identifier: BSD-3-Clause
"""Decides between Ollama and the ontology, and says why: ``reasoner:=auto``."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Sequence

from core_perception.endpoint import Endpoint
from core_perception.exceptions import ServerError
from core_perception.http_exchange import HttpExchange, HttpRequest
from core_perception.reasoners.ollama_models import (
    MAX_SURVEY_BYTES,
    OllamaModel,
    full_name,
    read_show,
    read_tags,
    show_request,
    tags_request,
)


@dataclass(frozen=True)
class ServerChoice:
    """What was decided.

    Attributes:
        reasoner: ``ollama`` or ``ontology``.
        model: name of the model with its tag; empty for the ontology.
        reason: in one line, for the operator.
    """

    reasoner: str
    model: str
    reason: str


def choose_server(endpoint: Endpoint, model: str = "", limit_s: float = 2.0) -> ServerChoice:
    """Take Ollama if it answers and has a model that reads images, else the ontology.

    Args:
        endpoint: where Ollama would listen.
        model: the one wanted; empty: the first of Ollama's list that reads images.
        limit_s: for everything [s].

    Returns:
        ServerChoice; never raises for what a server does.
    """
    survey = _Survey(endpoint, time.monotonic() + limit_s)
    try:
        installed = survey.models()
    except ServerError as error:
        return ServerChoice("ontology", "", f"no Ollama answers at {endpoint.url} ({error})")
    wanted = [m for m in installed if not model or full_name(m.name) == full_name(model)]
    if not wanted:
        missing = f"model {model}" if model else "any model"
        return ServerChoice("ontology", "", f"Ollama answers at {endpoint.url} but does not have {missing}")
    refusals = []
    for candidate in wanted:
        refusal = survey.refusal(candidate)
        if not refusal:
            return ServerChoice("ollama", candidate.name, f"Ollama answers at {endpoint.url} with {candidate.name}")
        refusals.append(refusal)
    return ServerChoice("ontology", "", f"Ollama answers at {endpoint.url}, but {_in_short(refusals)}")


class _Survey:
    """Questions to one server within one deadline."""

    def __init__(self, endpoint: Endpoint, deadline_s: float):
        self._endpoint, self._deadline_s = endpoint, deadline_s

    def models(self) -> Sequence[OllamaModel]:
        """The models it has."""
        request = tags_request()
        return read_tags(*self._run(request), request)

    def refusal(self, listed: OllamaModel) -> str:
        """Why a model will not do; empty if it will."""
        sees = listed.sees
        try:
            if sees is None:  # older servers say it one by one
                request = show_request(listed.name)
                sees = read_show(*self._run(request), request, listed.name).sees
        except ServerError as error:
            return f"{listed.name} could not be asked about ({error})"
        if listed.is_remote and not self._endpoint.allow_remote_images:
            return f"{listed.name} runs on another machine"
        if sees is None:
            return f"of {listed.name} it does not say whether it reads images"
        return "" if sees else f"{listed.name} reads no images"

    def _run(self, request: HttpRequest):
        return HttpExchange(self._endpoint, request, MAX_SURVEY_BYTES).run(self._deadline_s - time.monotonic())


def _in_short(refusals: Sequence[str]) -> str:
    return "; ".join(refusals[:3]) + (f"; and {len(refusals) - 3} more" if len(refusals) > 3 else "")

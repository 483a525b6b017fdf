# SPDX-License-Identifier: BSD-3-Clause
"""What Ollama says of the models it has: which of them read images, and which run on another machine."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Mapping, Optional, Tuple

from core_perception.exceptions import ServerError
from core_perception.http_exchange import HttpRequest
from core_perception.reasoners.server_words import read_object

#: Limit of these replies: a description of a model lists its tensors and quotes its licence.
MAX_SURVEY_BYTES = 16 << 20
LONGEST_MODEL_NAME = 256


@dataclass(frozen=True)
class OllamaModel:
    """One entry of Ollama's list.

    Attributes:
        name: with its tag.
        sees: it reads images; None if the server does not say.
        is_remote: Ollama only passes requests on to another machine.
    """

    name: str
    sees: Optional[bool]
    is_remote: bool


def tags_request() -> HttpRequest:
    """Ask Ollama which models it has."""
    return HttpRequest("GET", "/api/tags")


def read_tags(status: int, body: bytes, request: HttpRequest) -> Tuple[OllamaModel, ...]:
    """Read the reply to tags_request(); a name that no model can have is left out.

    Raises:
        ServerError: it is no such list.
    """
    models = read_object(status, body, request, "").get("models")
    if not isinstance(models, list) or not all(isinstance(m, dict) and isinstance(m.get("name"), str) for m in models):
        raise ServerError("bad_reply", "this is not Ollama's list of models")
    return tuple(_model(m["name"], m) for m in models if is_model_name(m["name"]))


def show_request(model: str) -> HttpRequest:
    """Ask Ollama what a model can do."""
    return HttpRequest.post_json("/api/show", {"model": model})


def read_show(status: int, body: bytes, request: HttpRequest, model: str) -> OllamaModel:
    """Read the reply to show_request().

    Raises:
        ServerError: there is no such model.
    """
    return _model(model, read_object(status, body, request, model))


def is_running(status: int, body: bytes, request: HttpRequest, model: str, context_tokens: int) -> bool:
    """Read the reply to GET /api/ps: whether a model is loaded with this context; False where it does not say so."""
    try:
        models = read_object(status, body, request, model).get("models")
    except ServerError:
        return False
    entries = [m for m in models if isinstance(m, dict)] if isinstance(models, list) else []
    return any(
        full_name(str(m.get("name"))) == full_name(model) and m.get("context_length", context_tokens) == context_tokens
        for m in entries
    )


def full_name(model: str) -> str:
    """A name with its tag; Ollama takes ``latest`` where none is given."""
    name = model.lower()
    return name if ":" in name.rpartition("/")[2] else name + ":latest"


def is_model_name(text: str) -> bool:
    """Whether a model can be called so, in a request and in a line for a person."""
    return 0 < len(text) <= LONGEST_MODEL_NAME and text.isprintable() and text.strip() == text


def is_passed_on(model: str) -> bool:
    """Whether the tag alone tells that Ollama runs a model on another machine: ``x:cloud`` or ``x:27b-cloud``."""
    tag = model.lower().rpartition(":")[2] if ":" in model else ""
    return tag == "cloud" or tag.endswith("-cloud")


def _model(name: str, entry: Mapping[str, Any]) -> OllamaModel:
    capabilities = entry.get("capabilities")
    sees = "vision" in capabilities if isinstance(capabilities, list) else None
    return OllamaModel(name, sees, bool(entry.get("remote_host") or entry.get("remote_model")) or is_passed_on(name))

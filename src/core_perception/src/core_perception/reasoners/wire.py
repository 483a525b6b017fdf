# SPDX-License-Identifier: BSD-3-Clause
"""Two wire formats of model servers: Ollama's own and the one of OpenAI, which llama.cpp and vLLM speak.

A wire turns a question into an HTTP request and an HTTP reply into a ModelReply; it opens no connection. Apart from the
question, its seed and its temperature every request is the same: Ollama loads a model anew when its options change.
"""

from __future__ import annotations

import base64
import math
import os
import re
from dataclasses import dataclass, field
from typing import Any, ClassVar, Dict, List, Mapping, Optional, Tuple

from core_perception.exceptions import ParameterError, ServerError
from core_perception.http_exchange import HttpRequest
from core_perception.reasoners.ollama_models import is_model_name, is_running, read_show, show_request
from core_perception.reasoners.server_words import check_finish, logprobs_of, read_object, text_of

DURATION = re.compile(r"-?\d+\Z|(\d+(\.\d+)?(ms|s|m|h))+\Z")
ENVIRONMENT_NAME = re.compile(r"[A-Z_][A-Z0-9_]*\Z")  # what has small letters may be the key itself


@dataclass(frozen=True)
class ModelReply:
    """What a model said.

    Attributes:
        text: the answer.
        thinking: what it thought before, where the server keeps that apart; some servers put the whole answer here.
        token_logprobs: natural logarithm of the probability of each token of the answer, <= 0; None if not given.
        finish: why it ended, in the server's word: "stop", or "load" for a preload.
        latency_s: from the call to the last byte of the reply [s].
    """

    text: str
    thinking: str = ""
    token_logprobs: Optional[Tuple[float, ...]] = None
    finish: str = ""
    latency_s: float = 0.0


@dataclass(frozen=True)
class Question:
    """What a model is asked; its text for a person shows none of it.

    Attributes:
        system: instructions.
        user: the request.
        image: bytes of a JPEG or PNG file; None for none.
        schema: JSON schema the answer must follow; the order of its properties is that of the answer. None for none.
        seed: of the sampler; None leaves it to the server.
        temperature: of the sampler; None for that of the wire.
    """

    system: str = field(repr=False)
    user: str = field(repr=False)
    image: Optional[bytes] = field(default=None, repr=False)
    schema: Optional[Mapping[str, Any]] = field(default=None, repr=False)
    seed: Optional[int] = None
    temperature: Optional[float] = None


@dataclass(frozen=True)
class OllamaWire:
    """Ollama's native protocol.

    Attributes:
        model: name, with its tag if it has one.
        keep_alive: how long the model stays loaded after a request: a Go duration, or seconds; negative is for ever.
        context_tokens: room for prompt, image and answer; the default of the server may be too small.
        max_tokens: the answer is cut there, which makes it an error.
        temperature: of the sampler, >= 0.
        think: let a thinking model think first.
        logprobs: ask for the probabilities of the tokens.
    """

    model: str
    keep_alive: str = "30m"
    context_tokens: int = 8192
    max_tokens: int = 768
    temperature: float = 0.0
    think: bool = False
    logprobs: bool = False
    name: ClassVar[str] = "ollama"

    def __post_init__(self):
        """Check the values.

        Raises:
            ParameterError: one of them is wrong.
        """
        _check_model(self)
        if not DURATION.match(str(self.keep_alive)):
            raise ParameterError("keep_alive", self.keep_alive, "a duration such as 30m, or seconds; -1 is for ever")
        if self.context_tokens <= self.max_tokens:
            raise ParameterError("context_tokens", self.context_tokens, "more than max_tokens")

    def chat(self, question: Question) -> HttpRequest:
        """The request that asks."""
        user: Dict[str, Any] = {"role": "user", "content": question.user}
        if question.image is not None:
            user["images"] = [_base64(question.image)]
        body = self._body([{"role": "system", "content": question.system}, user], question)
        if question.schema is not None:
            body["format"] = question.schema
        if self.logprobs:
            body["logprobs"] = True
        return HttpRequest.post_json("/api/chat", body)

    def read_chat(self, status: int, body: bytes, request: HttpRequest) -> ModelReply:
        """Read the reply to chat().

        Raises:
            ServerError: there is no whole answer.
        """
        reply = read_object(status, body, request, self.model)
        if reply.get("done") is not True:
            raise ServerError("unfinished", "the server broke the answer off (done is not true)")
        check_finish(reply.get("done_reason", "stop"))
        message = reply.get("message")
        if not isinstance(message, dict):
            raise ServerError("bad_reply", "the reply has no message")
        logprobs = logprobs_of(reply.get("logprobs"))
        return ModelReply(text_of(message.get("content")), text_of(message.get("thinking")), logprobs, "stop")

    def preload(self) -> HttpRequest:
        """The request that loads the model with the options of chat()."""
        return HttpRequest.post_json("/api/chat", self._body([], None))

    def read_preload(self, status: int, body: bytes, request: HttpRequest) -> ModelReply:
        """Read the reply to preload().

        Raises:
            ServerError: the model is not loaded; not_local where it would run on another machine.
        """
        reply = read_object(status, body, request, self.model)
        if reply.get("remote_host") or reply.get("remote_model"):
            raise ServerError("not_local", f"{self.model} runs on another machine")
        if reply.get("done") is not True or reply.get("done_reason") not in ("load", None):
            raise ServerError("unfinished", "the server did not load the model")
        return ModelReply("", finish="load")

    def presence(self) -> HttpRequest:
        """The request that tells whether the model is loaded."""
        return HttpRequest("GET", "/api/ps")

    def read_presence(self, status: int, body: bytes, request: HttpRequest) -> bool:
        """Read the reply to presence(); False where the server does not say so, or holds another context."""
        return is_running(status, body, request, self.model, self.context_tokens)

    def whereabouts(self) -> Optional[HttpRequest]:
        """The request that tells whether the model runs on the server itself."""
        return show_request(self.model)

    def check_local(self, status: int, body: bytes, request: HttpRequest) -> None:
        """Read the reply to whereabouts().

        Raises:
            ServerError: not_local, it would pass images on to another machine; or there is no such model.
        """
        if read_show(status, body, request, self.model).is_remote:
            raise ServerError("not_local", f"{self.model} runs on another machine; allow_remote_images is false")

    def _body(self, messages: List[Dict[str, Any]], question: Optional[Question]) -> Dict[str, Any]:
        options: Dict[str, Any] = {"num_ctx": self.context_tokens, "num_predict": self.max_tokens}
        options.update(_sampling(self.temperature, question))
        seconds_or_duration = str(self.keep_alive)
        return {
            "model": self.model,
            "messages": messages,
            "stream": False,  # its default is true
            "think": self.think,  # if absent, a thinking model thinks
            "keep_alive": int(seconds_or_duration)
            if seconds_or_duration.lstrip("-").isdigit()
            else seconds_or_duration,
            "options": options,
        }


@dataclass(frozen=True)
class OpenAiWire:
    """The chat protocol of OpenAI, as llama.cpp's server and vLLM speak it.

    Attributes:
        model: name; llama.cpp's server ignores it.
        api_key_env: name of the environment variable that holds the key; empty for none.
        max_tokens: the answer is cut there, which makes it an error.
        temperature: of the sampler, >= 0.
        logprobs: ask for the probabilities of the tokens.
    """

    model: str
    api_key_env: str = ""
    max_tokens: int = 768
    temperature: float = 0.0
    logprobs: bool = False
    name: ClassVar[str] = "openai"

    def __post_init__(self):
        """Check the values.

        Raises:
            ParameterError: one of them is wrong, or there is no usable key in the environment; never quotes a key.
        """
        _check_model(self)
        self._key()

    def chat(self, question: Question) -> HttpRequest:
        """The request that asks."""
        content: List[Dict[str, Any]] = [{"type": "text", "text": question.user}]
        if question.image is not None:
            kind = "png" if question.image.startswith(b"\x89PNG") else "jpeg"
            url = f"data:image/{kind};base64,{_base64(question.image)}"
            content.insert(0, {"type": "image_url", "image_url": {"url": url}})
        body: Dict[str, Any] = {
            "model": self.model,
            "messages": [{"role": "system", "content": question.system}, {"role": "user", "content": content}],
            "stream": False,
            "max_tokens": self.max_tokens,
            **_sampling(self.temperature, question),
        }
        if question.schema is not None:
            schema = {"name": "safety", "schema": question.schema, "strict": True}
            body["response_format"] = {"type": "json_schema", "json_schema": schema}
        if self.logprobs:
            body["logprobs"] = True
        return HttpRequest.post_json("/v1/chat/completions", body, self._authorization())

    def read_chat(self, status: int, body: bytes, request: HttpRequest) -> ModelReply:
        """Read the reply to chat().

        Raises:
            ServerError: there is no whole answer.
        """
        reply = read_object(status, body, request, self.model)
        choices = reply.get("choices")
        choice = choices[0] if isinstance(choices, list) and choices else None
        message = choice.get("message") if isinstance(choice, dict) else None
        if not isinstance(message, dict):
            raise ServerError("bad_reply", "the reply has no message")
        check_finish(choice.get("finish_reason"))
        thinking = message.get("reasoning_content") or message.get("reasoning")
        logprobs = choice.get("logprobs")
        tokens = logprobs.get("content") if isinstance(logprobs, dict) else None
        return ModelReply(text_of(message.get("content")), text_of(thinking), logprobs_of(tokens), "stop")

    def preload(self) -> HttpRequest:
        """The request for the models served: these servers load theirs when they start and answer 503 until then."""
        return HttpRequest("GET", "/v1/models", self._authorization())

    def read_preload(self, status: int, body: bytes, request: HttpRequest) -> ModelReply:
        """Read the reply to preload().

        Raises:
            ServerError: no model is ready.
        """
        if not read_object(status, body, request, self.model).get("data"):
            raise ServerError("model_missing", "the server offers no model")
        return ModelReply("", finish="load")

    def whereabouts(self) -> Optional[HttpRequest]:
        """None: this protocol does not tell where a model runs."""
        return None

    def _authorization(self) -> Dict[str, str]:
        key = self._key()
        return {"Authorization": f"Bearer {key}"} if key else {}

    def _key(self) -> str:
        if not self.api_key_env:
            return ""
        if not ENVIRONMENT_NAME.match(self.api_key_env):
            raise ParameterError("api_key_env", "something else", "the name of a variable in capitals, not a key")
        key = os.environ.get(self.api_key_env, "")
        if not key or not key.isascii() or not key.isprintable() or " " in key:
            raise ParameterError("api_key_env", self.api_key_env, "a variable that is set to a key of printable ASCII")
        return key


def _check_model(wire) -> None:
    if not is_model_name(wire.model):
        raise ParameterError("model", wire.model, "the name of a model")
    if wire.max_tokens < 1:
        raise ParameterError("max_tokens", wire.max_tokens, ">= 1")
    if not (math.isfinite(wire.temperature) and wire.temperature >= 0.0):
        raise ParameterError("temperature", wire.temperature, ">= 0")


def _sampling(temperature: float, question: Optional[Question]) -> Dict[str, Any]:
    if question is None:
        return {"temperature": temperature}
    sampling = {"temperature": temperature if question.temperature is None else question.temperature}
    return sampling if question.seed is None else {**sampling, "seed": question.seed}


def _base64(image: bytes) -> str:
    return base64.b64encode(image).decode("ascii")

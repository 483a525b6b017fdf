# SPDX-License-Identifier: BSD-3-Clause
"""Asks a model server: one request in flight, a hard deadline, and the cause of every failure in one word."""

from __future__ import annotations

import contextlib
import random
import threading
import time
from dataclasses import replace
from typing import Any, Mapping, Optional

import numpy as np

from core_perception.endpoint import Endpoint
from core_perception.exceptions import EndpointError, ServerError
from core_perception.http_exchange import HttpRequest, OneExchange
from core_perception.picture_file import write_picture
from core_perception.reasoners.ollama_models import MAX_SURVEY_BYTES, is_passed_on
from core_perception.reasoners.wire import ModelReply, Question

#: Every word a ServerError can be counted by.
SERVER_CAUSES = (
    "refused",  # nobody listens
    "unreachable",  # no route, no such name
    "not_local",  # the name, or the model behind it, is not on this machine
    "tls",  # no secure connection, or a certificate that is not accepted
    "timeout",  # no whole reply within the deadline
    "disconnected",  # the server hung up
    "too_large",  # the reply exceeds the cap
    "redirect",  # the server points elsewhere
    "denied",  # 401, 403
    "model_missing",  # the server has no such model
    "overloaded",  # 429, 503; also while llama.cpp's server loads
    "context",  # prompt and image exceed the context of the model
    "image_refused",  # the server cannot read the image, or the model reads none
    "http_4xx",  # any other error of the request
    "http_5xx",  # any other error of the server
    "bad_reply",  # not HTTP, not JSON, or no answer in it
    "length",  # the answer was cut at max_tokens
    "unfinished",  # the answer was broken off
    "busy",  # this client is asking or loading already
    "closed",  # this client was closed
    "not_recorded",  # a replay has no reply to this question
    "record_failed",  # the reply could not be written down
)
#: After these the model is held to be loaded still.
CAUSES_OF_A_LOADED_MODEL = frozenset({"length", "unfinished", "image_refused", "context"})
PROBE_LIMIT_S = 2.0


class VlmClient:
    """A connection to one model; ask() and preload() block, close() ends them from another thread."""

    def __init__(
        self,
        wire,
        endpoint: Endpoint,
        deadline_s: float,
        load_timeout_s: float,
        max_reply_bytes: int = 1 << 20,
        max_image_px: int = 896,
    ):
        """Keep the parts; nothing is sent.

        Args:
            wire: OllamaWire or OpenAiWire.
            endpoint: where the server listens.
            deadline_s: from the call of ask() to the last byte of the reply [s].
            load_timeout_s: the same of preload(); Ollama gives up loading when its client hangs up.
            max_reply_bytes: a longer reply is an error.
            max_image_px: longest edge of an image that is sent; a larger one is scaled down.

        Raises:
            EndpointError: by its name the model runs on another machine, and images must not leave this one.
        """
        if is_passed_on(wire.model) and not endpoint.allow_remote_images:
            raise EndpointError(
                f"{wire.model} runs on another machine; images leave this one only with allow_remote_images: true"
            )
        self._wire, self._endpoint = wire, endpoint
        self._deadline_s, self._load_timeout_s = deadline_s, load_timeout_s
        self._max_reply_bytes, self._max_image_px = max_reply_bytes, max_image_px
        self._turn = threading.Lock()  # held while a request is in flight
        self._exchange = OneExchange(endpoint)
        self._is_loaded = False
        self._is_known_local = endpoint.allow_remote_images

    @property
    def is_loaded(self) -> bool:
        """The model answered or was loaded, and nothing since then says that the server may have dropped it."""
        return self._is_loaded

    def ask(
        self,
        system: str,
        user: str,
        image_rgb: Optional[np.ndarray],
        schema: Optional[Mapping[str, Any]],
        seed: Optional[int] = None,
        temperature: Optional[float] = None,
    ) -> ModelReply:
        """Ask and wait for the answer.

        Args:
            system: instructions.
            user: the request.
            image_rgb: (h, w, 3) uint8; None for none.
            schema: JSON schema the answer must follow; None for none.
            seed: of the sampler; None leaves it to the server.
            temperature: of the sampler; None for that of the wire.

        Raises:
            ServerError: there is no answer; its latency_s is the time until that was known.
            EvidenceError: the image has another shape or type.
        """
        with self._in_turn(self._deadline_s) as deadline_s:
            image = None if image_rgb is None else write_picture(image_rgb, self._max_image_px)[0]
            if image is not None and not self._is_known_local:
                self._find_out_whereabouts(deadline_s)
            request = self._wire.chat(Question(system, user, image, schema, seed, temperature))
            begun_s = deadline_s - self._deadline_s
            status, body = self._run(request, deadline_s)
            reply = self._wire.read_chat(status, body, request)
            self._is_loaded = True
            return replace(reply, latency_s=time.monotonic() - begun_s)

    def probe(self) -> bool:
        """Ask Ollama whether the model is loaded there, within two seconds.

        Raises:
            ServerError: nobody answers; a server that hangs must not be waited for as long as for a model to load.
        """
        with self._in_turn(PROBE_LIMIT_S) as deadline_s:
            request = self._wire.presence()
            status, body = self._run(request, deadline_s)
            return self._wire.read_presence(status, body, request)

    def preload(self) -> ModelReply:
        """Have the server load the model, and wait; call it in the background before the first ask().

        Raises:
            ServerError: it did not.
        """
        with self._in_turn(self._load_timeout_s) as deadline_s:
            request = self._wire.preload()
            status, body = self._run(request, deadline_s)
            reply = self._wire.read_preload(status, body, request)
            self._is_loaded = True
            return replace(reply, latency_s=time.monotonic() - deadline_s + self._load_timeout_s)

    def close(self) -> None:
        """End a request under way at once; every later one fails."""
        self._exchange.close()

    @contextlib.contextmanager
    def _in_turn(self, limit_s: float):
        """Be the one request in flight, and learn from how it ends; gives the deadline, of time.monotonic() [s]."""
        begun_s = time.monotonic()
        if not self._turn.acquire(blocking=False):
            raise ServerError("busy", "a request is in flight")
        try:
            yield begun_s + limit_s
        except ServerError as error:
            error.latency_s = time.monotonic() - begun_s
            if error.cause not in CAUSES_OF_A_LOADED_MODEL:
                self._is_loaded = False
                self._is_known_local = self._endpoint.allow_remote_images  # another server may come up there
            raise
        finally:
            self._turn.release()

    def _run(self, request: HttpRequest, deadline_s: float, max_reply_bytes: Optional[int] = None):
        return self._exchange.run(request, deadline_s, max_reply_bytes or self._max_reply_bytes)

    def _find_out_whereabouts(self, deadline_s: float):
        request = self._wire.whereabouts()
        if request is not None:
            status, body = self._run(request, deadline_s, MAX_SURVEY_BYTES)
            self._wire.check_local(status, body, request)
        self._is_known_local = True


class BackOff:
    """Pauses after failures in a row, so that robots that lost one server do not return to it all at once.

        pause_n = uniform(c_n / 2, c_n),   c_n = min(longest, 2^n first),   n = 1, 2, …

    Source: exponential back-off with "equal jitter".
    """

    def __init__(self, robot_name: str, first_s: float = 0.5, longest_s: float = 10.0):
        """Start without failures.

        Args:
            robot_name: seeds the jitter.
            first_s: shortest pause [s], > 0.
            longest_s: longest pause [s], >= first_s.
        """
        self._random = random.Random(robot_name)
        self._first_s, self._longest_s = first_s, longest_s
        self._ceiling_s = first_s

    def failed(self) -> float:
        """Count a failure and return the pause that follows it [s]."""
        self._ceiling_s = min(self._longest_s, 2.0 * self._ceiling_s)
        return self._random.uniform(max(self._first_s, self._ceiling_s / 2.0), self._ceiling_s)

    def succeeded(self) -> None:
        """Forget the failures."""
        self._ceiling_s = self._first_s

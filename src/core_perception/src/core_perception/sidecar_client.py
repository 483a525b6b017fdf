# SPDX-License-Identifier: BSD-3-Clause
"""Asks a side-car, a server beside the robot that holds a model: JSON over HTTP, one request in flight, hard deadlines.

docs/segmenter_sidecar.md is the contract. Nothing a server sends is believed before it has been checked.
"""

from __future__ import annotations

import base64
import contextlib
import json
import threading
import time
from pathlib import Path
from typing import Any, Dict, Optional

import numpy as np

from core_perception.endpoint import Endpoint, load_allowed_hosts
from core_perception.exceptions import ServerError
from core_perception.http_exchange import HttpRequest, OneExchange
from core_perception.json_server import CONTRACT_VERSION
from core_perception.picture_file import write_picture

MAX_REPLY_BYTES = 1 << 23
JPEG_QUALITY = 92
LONGEST_NUMBER = 25
LONGEST_WORDS = 200


class SidecarClient:
    """A connection to one side-car; call() blocks, close() ends it from another thread."""

    def __init__(self, endpoint: Endpoint, deadline_s: float, max_reply_bytes: int = MAX_REPLY_BYTES):
        """Keep the parts; nothing is sent.

        Args:
            endpoint: where it listens.
            deadline_s: of a request in all, from the call to the last byte of the reply [s].
            max_reply_bytes: a longer reply is an error.
        """
        self.endpoint, self.deadline_s = endpoint, deadline_s
        self._max_reply_bytes = max_reply_bytes
        self._turn = threading.Lock()  # held while a request is in flight
        self._exchange = OneExchange(endpoint)

    def call(self, path: str, value: Any = None, limit_s: Optional[float] = None) -> Dict[str, Any]:
        """Send a value (POST), or nothing (GET), and return the reply, an object of this contract's version.

        Args:
            path: such as ``/v1/segment``.
            value: what json can write; None for a GET.
            limit_s: of this request instead of deadline_s [s].

        Raises:
            ServerError: there is no such reply; the causes are those of vlm_client.SERVER_CAUSES.
        """
        begun_s = time.monotonic()
        request = HttpRequest("GET", path) if value is None else HttpRequest.post_json(path, value)
        if not self._turn.acquire(blocking=False):
            raise ServerError("busy", "a request is in flight")
        try:
            limit_s = self.deadline_s if limit_s is None else limit_s
            status, body = self._exchange.run(request, begun_s + limit_s, self._max_reply_bytes)
            return self._read(status, body)
        except ServerError as error:
            error.latency_s = time.monotonic() - begun_s
            raise
        finally:
            self._turn.release()

    def close(self) -> None:
        """End a request under way at once; every later one fails."""
        self._exchange.close()

    def _read(self, status: int, body: bytes) -> Dict[str, Any]:
        if status != 200:
            raise ServerError(_cause(status), f"{self.endpoint.url} answered {status}: {_words(body)}")
        try:
            value = read_json(body)
        except ValueError as error:
            raise ServerError("bad_reply", f"{self.endpoint.url}: {error}") from None
        if not isinstance(value, dict):
            raise ServerError("bad_reply", f"{self.endpoint.url}: the reply is no JSON object")
        version = value.get("version")
        if type(version) is not int or version != CONTRACT_VERSION:
            raise ServerError("bad_reply", f"{self.endpoint.url}: version: allowed {CONTRACT_VERSION}")
        return value


def find_endpoint(url: str, allowed_hosts_file: str, allow_remote_images: bool) -> Endpoint:
    """Return the address of a side-car, if images may go there; see Endpoint.

    Raises:
        EndpointError: malformed, or not allowed.
    """
    allowed = load_allowed_hosts(Path(allowed_hosts_file)) if allowed_hosts_file else ()
    return Endpoint.parse(url, allowed, allow_remote_images)


def encode_picture(image_rgb: np.ndarray, kind: str, max_image_px: int) -> Dict[str, Any]:
    """Write an image as the contract wants it: format, size and the file in base64.

    Args:
        image_rgb: (h, w, 3) uint8.
        kind: ``jpeg`` of quality 92, or ``png``.
        max_image_px: longest edge; a larger image is scaled down by averaging.

    Raises:
        EvidenceError: the image has another shape or type, or no pixel.
    """
    file, size_px = write_picture(image_rgb, max_image_px, kind, JPEG_QUALITY)
    return {"format": kind, "size": list(size_px), "data": base64.b64encode(file).decode("ascii")}


def read_json(body: bytes) -> Any:
    """Read JSON from a stranger: UTF-8, no NaN or infinity, no endless numbers.

    Raises:
        ValueError: it is none; the message is one line.
    """

    def refuse(_text):
        raise ValueError("not a number of JSON")

    def whole(text):
        if len(text) > LONGEST_NUMBER:
            raise ValueError("a number is too long")
        return int(text)

    def real(text):
        value = float(text)
        if value in (float("inf"), float("-inf")):
            raise ValueError("a number is too large")
        return value

    try:
        return json.loads(body.decode("utf-8"), parse_constant=refuse, parse_int=whole, parse_float=real)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"the reply is no JSON ({type(error).__name__})") from None


def _cause(status: int) -> str:
    known = {401: "denied", 403: "denied", 413: "image_refused", 429: "overloaded", 503: "overloaded"}
    if 300 <= status < 400:
        return "redirect"
    return known.get(status) or ("http_4xx" if 400 <= status < 500 else "http_5xx")


def _words(body: bytes) -> str:
    """What a server says of its failure, cut short and printable."""
    with contextlib.suppress(ValueError, KeyError, TypeError):
        text = read_json(body)["error"]["message"]
        if isinstance(text, str):
            return "".join(c if c.isprintable() else " " for c in text[:LONGEST_WORDS])
    return "no reason given"

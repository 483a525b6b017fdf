# SPDX-License-Identifier: BSD-3-Clause
"""The server's half of the side-car contract: requests checked, one worked on at a time, replies written.

Contract: docs/segmenter_sidecar.md. It needs neither ROS nor OpenCV: it runs in a Python of its own, beside a model.
"""

from __future__ import annotations

import abc
import base64
import binascii
import json
import math
import threading
import time
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, Callable, Dict, Optional, Sequence, Tuple

import numpy as np

from core_perception.exceptions import PredicateError
from core_perception.predicates import canonical_class_name
from core_perception.segmenters.rle import encode_mask

CONTRACT_VERSION = 1
MAX_REQUEST_BYTES = 1 << 25
MAX_EDGE_PX = 8192
MAX_CLASSES = 1000
MAX_DEADLINE_S = 600.0
SOCKET_TIMEOUT_S = 30.0


@dataclass(frozen=True)
class SegmentRequest:
    """One request.

    Attributes:
        file: bytes of the image file.
        image_format: ``jpeg`` or ``png``.
        size_px: its height and width.
        classes: canonical names, the most wanted first.
        min_score: weaker instances are not wanted.
        deadline_s: time to answer in [s].
        stamp: of the image, to be given back.
    """

    file: bytes
    image_format: str
    size_px: Tuple[int, int]
    classes: Tuple[str, ...]
    min_score: float
    deadline_s: float
    stamp: Dict[str, int]


@dataclass(frozen=True)
class Found:
    """One instance: class as it was asked, score in 0..1, mask (h, w) bool of the size of the image."""

    class_name: str
    score: float
    mask: np.ndarray


class SidecarModel(abc.ABC):
    """What a side-car is put before; one call at a time."""

    #: Its name.
    model: str = ""
    #: Its masks mean nothing.
    random_weights: bool = False
    #: Most classes of one request; None for any number.
    max_classes: Optional[int] = None

    @abc.abstractmethod
    def segment(
        self, request: SegmentRequest, is_time_left: Callable[[], bool]
    ) -> Tuple[Sequence[Found], Sequence[str]]:
        """Return what was found, and the classes that were looked for, which may be fewer than were asked.

        Args:
            request: has been checked, but for the content of the image file.
            is_time_left: asked before each class.

        Raises:
            BadRequestError: the image file cannot be read, or has another size than it says.
        """


class BadRequestError(Exception):
    """A request that breaks the contract."""


class SidecarServer:
    """Serves one model until stop()."""

    def __init__(self, model: SidecarModel, host: str = "127.0.0.1", port: int = 0):
        """Listen.

        Args:
            model: answers.
            host: address to listen at; other machines can send images only to one that is not a loopback address.
            port: 0 for any that is free.

        Raises:
            OSError: the address is taken or not of this machine.
        """
        turn = threading.Lock()
        handler = type("Handler", (_Handler,), {"sidecar_model": model, "turn": turn})
        self._server = ThreadingHTTPServer((host, port), handler)
        self._server.daemon_threads = True

    @property
    def port(self) -> int:
        """Where it listens."""
        return self._server.server_address[1]

    def serve(self) -> None:
        """Answer until stop() is called from another thread."""
        self._server.serve_forever(poll_interval=0.1)

    def stop(self) -> None:
        """End serve() and listen no more."""
        self._server.shutdown()
        self._server.server_close()


def read_request(value: Any) -> SegmentRequest:
    """Check a request.

    Raises:
        BadRequestError: a part is missing or wrong; the message names it and what is allowed.
    """
    _check(isinstance(value, dict), "the body: allowed a JSON object")
    _check(type(value.get("version")) is int and value["version"] == CONTRACT_VERSION, "version: allowed 1")
    image, stamp, classes = value.get("image"), value.get("stamp"), value.get("classes")
    keys = isinstance(stamp, dict) and set(stamp) == {"secs", "nsecs"}
    _check(keys and all(type(part) is int and part >= 0 for part in stamp.values()), "stamp: allowed secs and nsecs")
    _check(_is_number(value.get("min_score")) and 0 <= value["min_score"] <= 1, "min_score: allowed 0..1")
    deadline_s = value.get("deadline_s")
    _check(_is_number(deadline_s) and 0 < deadline_s <= MAX_DEADLINE_S, f"deadline_s: allowed up to {MAX_DEADLINE_S}")
    named = (
        isinstance(classes, list) and 0 < len(classes) <= MAX_CLASSES and len(set(map(str, classes))) == len(classes)
    )
    _check(named and all(map(_is_class, classes)), f"classes: allowed up to {MAX_CLASSES} names, each once")
    _check(isinstance(image, dict) and image.get("format") in ("jpeg", "png"), "image: format: allowed jpeg, png")
    size_px, data = image.get("size"), image.get("data")
    is_size = isinstance(size_px, list) and len(size_px) == 2 and all(type(edge) is int for edge in size_px)
    _check(is_size and all(0 < edge <= MAX_EDGE_PX for edge in size_px), f"image: size: allowed 1..{MAX_EDGE_PX}")
    try:
        file = base64.b64decode(data, validate=True)
    except (TypeError, ValueError, binascii.Error):
        raise BadRequestError("image: data: allowed base64") from None
    return SegmentRequest(
        file, image["format"], tuple(size_px), tuple(classes), float(value["min_score"]), float(deadline_s), stamp
    )


class _TimeLeft:
    """Whether one more step ends before a time, if it takes no longer than the longest so far; ask before each step."""

    def __init__(self, end_s: float):
        self._end_s, self._asked_s, self._longest_s = end_s, math.inf, 0.0

    def __call__(self) -> bool:
        now_s = time.monotonic()
        self._longest_s = max(self._longest_s, now_s - self._asked_s)
        self._asked_s = now_s
        return now_s + self._longest_s < self._end_s


class _Handler(BaseHTTPRequestHandler):
    sidecar_model: SidecarModel
    turn: threading.Lock
    timeout = SOCKET_TIMEOUT_S

    def log_message(self, *_):
        """Say nothing of every request."""

    def do_GET(self):  # noqa: D102, N802 - named by the library
        if self.path != "/v1/capabilities":
            self._fail(404, "not_found", "allowed /v1/capabilities and /v1/segment")
            return
        model = self.sidecar_model
        self._send(
            200,
            {
                "model": model.model,
                "tasks": ["segment"],
                "classes": None,
                "max_classes": model.max_classes or MAX_CLASSES,
                "random_weights": model.random_weights,
            },
        )

    def do_POST(self):  # noqa: D102, N802 - named by the library
        begun_s = time.monotonic()
        if self.path != "/v1/segment":
            self._fail(404, "not_found", "allowed /v1/capabilities and /v1/segment")
            return
        # Not asked of a web page: a browser sends it to another origin only after a question that nobody answers here.
        if self.headers.get_content_type() != "application/json":
            self._fail(415, "bad_request", "Content-Type: allowed application/json")
            return
        length = self.headers.get("Content-Length", "")
        if not length.isdigit() or int(length) > MAX_REQUEST_BYTES:
            self._fail(413, "bad_request", f"Content-Length: allowed up to {MAX_REQUEST_BYTES}")
            return
        try:
            request = read_request(json.loads(self.rfile.read(int(length)).decode("utf-8")))
        except (BadRequestError, ValueError, RecursionError) as error:
            words = str(error) if isinstance(error, BadRequestError) else "the body: allowed JSON"
            self._fail(400, "bad_request", words)
            return
        if not self.turn.acquire(blocking=False):
            self._fail(503, "busy", "one request at a time")
            return
        try:
            self._answer(request, begun_s)
        finally:
            self.turn.release()

    def _answer(self, request: SegmentRequest, begun_s: float):
        time_left = _TimeLeft(begun_s + request.deadline_s)
        try:
            found, evaluated = self.sidecar_model.segment(request, time_left)
        except BadRequestError as error:
            self._fail(400, "bad_request", str(error))
            return
        except Exception as error:  # the client must hear of it, and the next request may well succeed
            out_of_memory = "OutOfMemory" in type(error).__name__ or isinstance(error, MemoryError)
            self._fail(500, "out_of_memory" if out_of_memory else "internal", type(error).__name__)
            return
        instances = [
            {
                "class": one.class_name,
                "score": float(one.score),
                "mask": {"size": list(request.size_px), "counts": encode_mask(one.mask)},
            }
            for one in found
        ]
        self._send(
            200,
            {
                "model": self.sidecar_model.model,
                "stamp": request.stamp,
                "size": list(request.size_px),
                "latency_s": time.monotonic() - begun_s,
                "classes_evaluated": list(evaluated),
                "instances": instances,
            },
        )

    def _fail(self, status, code, message):
        self.close_connection = True  # the body may not have been read
        self._send(status, {"error": {"code": code, "message": message}})

    def _send(self, status, value):
        body = json.dumps({"version": CONTRACT_VERSION, **value}).encode()
        try:
            self.send_response(status)
            self.send_header("Content-Type", "application/json")
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)
        except OSError:  # the client hung up, at its deadline for example
            self.close_connection = True


def _is_class(name) -> bool:
    try:
        return isinstance(name, str) and canonical_class_name(name) == name
    except PredicateError:
        return False


def _is_number(value) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def _check(is_right: bool, problem: str) -> None:
    if not is_right:
        raise BadRequestError(problem)

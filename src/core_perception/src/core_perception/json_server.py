# SPDX-License-Identifier: BSD-3-Clause
"""The server's half of the side-car contracts: JSON over HTTP, one request worked on at a time.

docs/segmenter_sidecar.md has what all tasks share. It needs the standard library alone: a side-car runs in a Python of
its own, beside a model.
"""

from __future__ import annotations

import json
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, Callable, Dict

CONTRACT_VERSION = 1
MAX_REQUEST_BYTES = 1 << 25
SOCKET_TIMEOUT_S = 30.0
CAPABILITIES_PATH = "/v1/capabilities"


class BadRequestError(Exception):
    """A request that breaks the contract."""


class JsonServer:
    """Serves one task until stop()."""

    def __init__(
        self,
        path: str,
        capabilities: Dict[str, Any],
        read: Callable[[Any], Any],
        answer: Callable[[Any, float], Dict[str, Any]],
        host: str = "127.0.0.1",
        port: int = 0,
    ):
        """Listen.

        Args:
            path: of the task, such as ``/v1/segment``.
            capabilities: what a GET of /v1/capabilities is told.
            read: checks the JSON value of a request and returns the request; raises BadRequestError.
            answer: request, and when it came on time.monotonic() [s] -> reply; raises BadRequestError too. Never called
                twice at once.
            host: address to listen at; other machines can send images only to one that is not a loopback address.
            port: 0 for any that is free.

        Raises:
            OSError: the address is taken or not of this machine.
        """
        task = {"path_of_task": path, "capabilities": capabilities, "read": staticmethod(read)}
        task.update(answer=staticmethod(answer), turn=threading.Lock())
        self._server = ThreadingHTTPServer((host, port), type("Handler", (_Handler,), task))
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


class _Handler(BaseHTTPRequestHandler):
    path_of_task: str
    capabilities: Dict[str, Any]
    read: Callable
    answer: Callable
    turn: threading.Lock
    timeout = SOCKET_TIMEOUT_S

    def log_message(self, *_):
        """Say nothing of every request."""

    def do_GET(self):  # noqa: D102, N802 - named by the library
        if self.path == CAPABILITIES_PATH:
            self._send(200, self.capabilities)
        else:
            self._fail(404, "not_found", f"allowed {CAPABILITIES_PATH} and {self.path_of_task}")

    def do_POST(self):  # noqa: D102, N802 - named by the library
        begun_s = time.monotonic()
        if self.path != self.path_of_task:
            self._fail(404, "not_found", f"allowed {CAPABILITIES_PATH} and {self.path_of_task}")
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
            request = self.read(json.loads(self.rfile.read(int(length)).decode("utf-8")))
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

    def _answer(self, request, begun_s: float):
        try:
            reply = self.answer(request, begun_s)
        except BadRequestError as error:
            self._fail(400, "bad_request", str(error))
            return
        except Exception as error:  # the client must hear of it, and the next request may well succeed
            out_of_memory = "OutOfMemory" in type(error).__name__ or isinstance(error, MemoryError)
            self._fail(500, "out_of_memory" if out_of_memory else "internal", type(error).__name__)
            return
        self._send(200, {**reply, "latency_s": time.monotonic() - begun_s})

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

# SPDX-License-Identifier: BSD-3-Clause
"""One HTTP request and its reply, with a deadline that holds whatever the server does.

The exchange runs on a thread of its own over a connection of its own; whoever waits for it shuts the socket at the
deadline, so neither a slow name server nor a header or a body that drips can hold the caller. No redirects, no proxies,
no compression, TLS verified, replies capped. No text of an exception holds anything of the request or of the reply.
"""

from __future__ import annotations

import contextlib
import http.client
import json
import socket
import ssl
import threading
import time
from dataclasses import dataclass, field
from typing import Any, Mapping, Optional, Tuple

from core_perception.endpoint import Endpoint
from core_perception.exceptions import ServerError

CHUNK_BYTES = 1 << 16


@dataclass(frozen=True)
class HttpRequest:
    """What is sent; its text for a person shows neither headers nor body.

    Attributes:
        method: ``GET`` or ``POST``.
        path: from ``/`` on.
        headers: name to value; may hold a key.
        body: bytes of the body.
    """

    method: str
    path: str
    headers: Mapping[str, str] = field(default_factory=dict, repr=False)
    body: bytes = field(default=b"", repr=False)

    @classmethod
    def post_json(cls, path: str, value: Any, headers: Optional[Mapping[str, str]] = None) -> HttpRequest:
        """A POST of a value as JSON; keys keep their order."""
        body = json.dumps(value, ensure_ascii=False).encode("utf-8", "replace")
        return cls("POST", path, {"Content-Type": "application/json", **(headers or {})}, body)


class HttpExchange:
    """One request; run() once, abort() from any thread."""

    def __init__(self, endpoint: Endpoint, request: HttpRequest, max_reply_bytes: int):
        """Keep what to send.

        Args:
            endpoint: where to.
            request: what.
            max_reply_bytes: a longer body is an error.
        """
        self._endpoint, self._request, self._max_reply_bytes = endpoint, request, max_reply_bytes
        self._lock = threading.Lock()
        self._ended = threading.Event()
        self._socket: Optional[socket.socket] = None
        self._reply: Optional[Tuple[int, bytes]] = None
        self._error: Optional[Exception] = None
        self._deadline_s = 0.0  # monotonic

    def run(self, limit_s: float) -> Tuple[int, bytes]:
        """Send and return status and body.

        Args:
            limit_s: from now to the last byte of the reply [s].

        Raises:
            ServerError: refused, unreachable, not_local, tls, timeout, disconnected, too_large, bad_reply, or what
                abort() was given.
        """
        self._deadline_s = time.monotonic() + limit_s
        threading.Thread(target=self._work, name="http_exchange", daemon=True).start()
        if not self._ended.wait(max(0.0, limit_s)):
            self.abort(ServerError("timeout", f"no whole reply from {self._endpoint.url} in time"))
        if self._error is not None:
            raise self._error
        return self._reply

    def abort(self, error: ServerError) -> None:
        """End a run() under way with this error, at once; does nothing afterwards."""
        self._end(error=error)

    def _end(self, reply=None, error=None):
        with self._lock:
            if not self._ended.is_set():
                self._reply, self._error = reply, error
                self._ended.set()
            if self._socket is not None:
                with contextlib.suppress(OSError):  # of the plain socket: the one of TLS would wait for a farewell
                    socket.socket.shutdown(self._socket, socket.SHUT_RDWR)

    def _hold(self, a_socket: socket.socket):
        """Have abort() shut this socket from now on."""
        with self._lock:
            if self._socket is not None:
                self._socket.close()
            self._socket = a_socket
            if self._ended.is_set():
                a_socket.close()

    def _left_s(self) -> float:
        return max(1e-3, self._deadline_s - time.monotonic())

    def _work(self):
        reply, error = None, None
        try:
            reply = self._exchange()
        except ServerError as known:
            error = known
        except Exception as raised:  # handed to the thread that waits
            error = self._named(raised)
        self._end(reply, error)
        if self._socket is not None:
            self._socket.close()

    def _exchange(self) -> Tuple[int, bytes]:
        request, endpoint = self._request, self._endpoint
        kind = http.client.HTTPSConnection if endpoint.scheme == "https" else http.client.HTTPConnection
        connection = kind(endpoint.host, endpoint.port)
        connection.sock = self._connect()
        headers = {"Accept-Encoding": "identity", "Connection": "close", **request.headers}
        # A server that refuses a request may answer and hang up before it has read the whole body.
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):
            connection.request(request.method, endpoint.request_path(request.path), request.body or None, headers)
        with contextlib.closing(connection.getresponse()) as response:
            return response.status, self._read_body(response)

    def _connect(self) -> socket.socket:
        found = socket.getaddrinfo(self._endpoint.host, self._endpoint.port, type=socket.SOCK_STREAM)
        allowed = [entry for entry in found if self._endpoint.allows_address(entry[4][0])]
        if not allowed:
            raise ServerError("not_local", f"{self._endpoint.host} resolves to an address that is not on this machine")
        failure: Optional[OSError] = None
        for position, (family, kind, protocol, _, address) in enumerate(allowed):
            try:
                plain = socket.socket(family, kind, protocol)
                self._hold(plain)
                plain.settimeout(self._left_s() / (len(allowed) - position))
                plain.connect(address)
            except OSError as error:
                failure = error
                continue
            plain.settimeout(self._left_s())
            plain.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)  # else the body waits 40 ms behind the head
            return self._secure(plain) if self._endpoint.scheme == "https" else plain
        raise failure

    def _secure(self, plain: socket.socket) -> ssl.SSLSocket:
        context = ssl.create_default_context()
        secured = context.wrap_socket(plain, server_hostname=self._endpoint.host, do_handshake_on_connect=False)
        self._hold(secured)
        secured.do_handshake()
        return secured

    def _read_body(self, response: http.client.HTTPResponse) -> bytes:
        if response.getheader("Content-Encoding", "identity") != "identity":
            raise ServerError("bad_reply", f"{self._endpoint.url} compressed its reply, which was not asked for")
        size = 0
        chunks = []
        while size <= self._max_reply_bytes:
            chunk = response.read(CHUNK_BYTES)
            if not chunk:
                if response.length:
                    raise ServerError("disconnected", f"{self._endpoint.url} hung up in the middle of its reply")
                return b"".join(chunks)
            size += len(chunk)
            chunks.append(chunk)
        raise ServerError("too_large", f"{self._endpoint.url} sent more than {self._max_reply_bytes} bytes")

    def _named(self, error: Exception) -> Exception:
        """The cause of an exception in our words; what is not the server's doing stays as it is."""
        url = self._endpoint.url
        if isinstance(error, ssl.CertificateError):
            return ServerError("tls", f"the certificate of {url} is not accepted: {error.verify_message}")
        if isinstance(error, ssl.SSLError) and not isinstance(error, ssl.SSLEOFError):
            return ServerError("tls", f"no secure connection to {url}: {error.reason}")
        if isinstance(error, ConnectionRefusedError):
            return ServerError("refused", f"no server listens at {url}")
        if isinstance(error, (socket.timeout, TimeoutError)):
            return ServerError("timeout", f"no reply from {url} in time")
        if isinstance(error, (ConnectionError, ssl.SSLEOFError, http.client.IncompleteRead)):
            return ServerError("disconnected", f"{url} hung up before the end of its reply")
        if isinstance(error, OSError):
            return ServerError("unreachable", f"{url}: {error.strerror or type(error).__name__}")
        if isinstance(error, (http.client.HTTPException, ValueError)):
            return ServerError("bad_reply", f"{url} does not speak HTTP ({type(error).__name__})")
        return error


class OneExchange:
    """Runs exchanges with one server, one after the other; close() ends the one under way from another thread."""

    def __init__(self, endpoint: Endpoint):
        """Keep where the server is."""
        self._endpoint = endpoint
        self._lock = threading.Lock()  # of the next two
        self._exchange: Optional[HttpExchange] = None
        self._is_closed = False

    def run(self, request: HttpRequest, deadline_s: float, max_reply_bytes: int) -> Tuple[int, bytes]:
        """Send and return status and body.

        Args:
            request: what to send.
            deadline_s: of the last byte of the reply, of time.monotonic() [s].
            max_reply_bytes: a longer reply is an error.

        Raises:
            ServerError: as HttpExchange.run(), or closed.
        """
        exchange = HttpExchange(self._endpoint, request, max_reply_bytes)
        with self._lock:
            if self._is_closed:
                raise ServerError("closed", "this client was closed")
            self._exchange = exchange
        try:
            return exchange.run(deadline_s - time.monotonic())
        finally:
            with self._lock:
                self._exchange = None

    def close(self) -> None:
        """End an exchange under way at once; every later one fails."""
        with self._lock:
            self._is_closed = True
            exchange = self._exchange
        if exchange is not None:
            exchange.abort(ServerError("closed", "this client was closed"))

#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""A model server without a model: Ollama's protocol, and llama.cpp's /v1, with faults that can be switched at run time.

In a process of its own: ``fake_model_server.py --port 0`` prints the port as its first line. In a test:
``with FakeModelServer() as server: … server.url``. Control, beside the protocol:

    POST /_fault   {"kind": KIND, "count": N or null, "scope": "chat" or "all", "bytes_per_s": 1, "load_s": 1}
    POST /_latency {"seconds": 0.1}            of every answer
    POST /_answer  {"text": "…" or null}       said instead of the default, which depends on the picture
    POST /_unload  {}                          as after keep_alive, or a restart
    GET  /_log                                 requests seen, with how each ended; POST /_reset forgets all of this

KIND: ok hang drip drip_headers 500 garbage huge other_schema nothing close load length unfinished thinking redirect
overloaded midway (hangs up in the middle of the body).
"""

import argparse
import collections
import contextlib
import hashlib
import ipaddress
import json
import select
import socket
import sys
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.request import ProxyHandler, Request, build_opener

import numpy as np

if __package__ in (None, ""):
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from fakes import ollama_protocol as protocol
from fakes.ollama_protocol import RefusalError

FAULTS = frozenset(
    ("ok", "hang", "drip", "drip_headers", "500", "garbage", "huge", "other_schema", "nothing", "close", "load")
    + ("length", "unfinished", "thinking", "redirect", "overloaded", "midway")
)
MAX_QUEUE = 512
HUGE_BYTES = 10_000_000
POLL_S = 0.005
LOG_LENGTH = 20000
VISION = ("completion", "vision")


class HungUpError(Exception):
    """The client hung up."""


class Queue:
    """OLLAMA_NUM_PARALLEL=1: one at a time, first come, first served."""

    def __init__(self):
        self._waiting = collections.deque()
        self._changed = threading.Condition()

    @contextlib.contextmanager
    def turn(self, check):
        me = object()
        with self._changed:
            if len(self._waiting) >= MAX_QUEUE:
                raise RefusalError(503, {"error": "server busy, please try again.  maximum pending requests exceeded"})
            self._waiting.append(me)
        try:
            with self._changed:
                while self._waiting[0] is not me:
                    self._changed.wait(POLL_S)
                    check()
            yield
        finally:
            with self._changed:
                self._waiting.remove(me)
                self._changed.notify_all()


class Models:
    """What is installed and what is loaded."""

    def __init__(self, installed, load_s):
        self.installed = {protocol.full_name(name): dict(entry) for name, entry in installed.items()}
        self.load_s = load_s
        self.loads = 0
        self.loaded = None  # (name, context, monotonic time of expiry)
        self._loading = threading.Lock()

    def find(self, model):
        name = protocol.full_name(model)
        if name not in self.installed:
            raise RefusalError(404, {"error": "model '%s' not found" % model})
        return name

    def current(self):
        if self.loaded is not None and time.monotonic() > self.loaded[2]:
            self.loaded = None
        return self.loaded

    def require(self, chat, check, load_s):
        """Load the model if it is not loaded with this context; a client that hangs up aborts the load."""
        name = self.find(chat.model)
        while not self._loading.acquire(timeout=POLL_S):
            check()
        try:
            current = self.current()
            if current is None or current[:2] != (name, chat.context):
                self.loaded = None
                wait(load_s, check)
                self.loads += 1
            self.loaded = (name, chat.context, time.monotonic() + chat.keep_alive_s)
        finally:
            self._loading.release()

    def entry(self, name):
        model = self.installed[name]
        entry = {"name": name, "model": name, "modified_at": "2026-08-21T18:48:22Z", "size": 17396936941}
        entry["digest"] = hashlib.sha256(name.encode()).hexdigest()
        entry["details"] = {"parent_model": "", "format": "gguf", "family": "gemma3", "families": ["gemma3"]}
        entry["details"].update(parameter_size="27.4B", quantization_level="Q4_K_M")
        if "capabilities" in model:
            entry["capabilities"] = list(model["capabilities"])
        for key in ("remote_host", "remote_model"):
            if key in model:
                entry[key] = model[key]
        return entry


def wait(duration_s, check):
    """Sleep, and raise what check raises when the client hangs up."""
    end_s = time.monotonic() + duration_s
    while True:
        check()
        left_s = end_s - time.monotonic()
        if left_s <= 0:
            return
        time.sleep(min(POLL_S, left_s))


class FakeModelServer(ThreadingHTTPServer):
    """The server; a context manager that serves from a thread."""

    daemon_threads = True
    request_queue_size = 128

    def __init__(self, port=0, models=None, answer=protocol.answer_by_colour, latency_s=0.0, load_s=0.0, api_key=""):
        """Bind to the loopback address.

        Args:
            port: 0 takes a free one.
            models: name to {"capabilities": …, "remote_host": …}; default: one that sees.
            answer: what is said to a protocol.Chat.
            latency_s: of every answer [s].
            load_s: of loading a model [s].
            api_key: /v1 refuses requests without it.
        """
        self.models = Models({"gemma3:27b": {"capabilities": VISION}} if models is None else models, load_s)
        self.default_answer, self.default_latency_s, self.api_key = answer, latency_s, api_key
        self.queue, self.stopping = Queue(), threading.Event()
        self.lock = threading.Lock()
        self.entries = collections.deque(maxlen=LOG_LENGTH)
        self.forget()
        super().__init__(("127.0.0.1", port), Handler)

    def forget(self):
        self.answer, self.latency_s = self.default_answer, self.default_latency_s
        self.fault = {"kind": "ok"}
        self.entries.clear()

    @property
    def port(self):
        return self.server_address[1]

    @property
    def url(self):
        return "http://127.0.0.1:%d" % self.port

    def set_fault(self, kind, **options):
        """Switch a fault on; see the top of the file."""
        if kind not in FAULTS:
            raise ValueError("unknown fault " + repr(kind))
        with self.lock:
            self.fault = {"kind": kind, **options}

    def next_fault(self, path):
        """The fault of this request."""
        is_chat = path in ("/api/chat", "/v1/chat/completions")
        with self.lock:
            fault = dict(self.fault)
            if not is_chat and fault.get("scope", "chat") != "all":
                return {"kind": "ok"}
            if fault.get("count") is not None:
                self.fault["count"] -= 1
                if self.fault["count"] <= 0:
                    self.fault = {"kind": "ok"}
            return fault

    def log(self):
        """Requests seen so far, oldest first."""
        with self.lock:
            return [dict(entry) for entry in self.entries]

    def chats(self):
        """Those that asked for an answer."""
        return [entry for entry in self.log() if entry.get("has_messages")]

    def handle_error(self, request, client_address):
        """A client that hung up is no error of the server."""

    def __enter__(self):
        threading.Thread(target=self.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True).start()
        return self

    def __exit__(self, *_):
        self.stopping.set()
        self.shutdown()
        self.server_close()


class Handler(BaseHTTPRequestHandler):
    """One connection."""

    protocol_version = "HTTP/1.1"
    server_version = "fake_model_server"
    disable_nagle_algorithm = True

    def log_message(self, *_):
        """Keep stderr quiet; GET /_log tells more."""

    def do_GET(self):
        self._serve("GET")

    def do_HEAD(self):
        self._serve("HEAD")

    def do_POST(self):
        self._serve("POST")

    def _serve(self, method):
        body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
        if self.path.startswith("/_"):
            self._control(body)
            return
        self.entry = {
            "method": method,
            "path": self.path,
            "outcome": "open",
            "begun_s": time.monotonic(),
            "client": self.client_address[1],
            "authorized": self.headers.get("Authorization") is not None,
        }
        with self.server.lock:
            self.server.entries.append(self.entry)
        fault = self.server.next_fault(self.path)
        self.entry["fault"] = fault["kind"]
        try:
            if not self._is_host_allowed():
                self._send(403, b"", "text/plain")
            elif not self._break_whole_request(fault):
                self._route(method, body, fault)
            self.entry["outcome"] = "answered"
        except RefusalError as refusal:
            self._send(refusal.status, refusal.body)
            self.entry["outcome"] = "refused %d" % refusal.status
        except (HungUpError, OSError):
            self.entry["outcome"] = "cancelled"
            self.close_connection = True
        self.entry["ended_s"] = time.monotonic()

    def _route(self, method, body, fault):
        route = {
            ("GET", "/"): lambda: self._send(200, b"Ollama is running", "text/plain; charset=utf-8"),
            ("GET", "/api/version"): lambda: self._send_json({"version": protocol.VERSION}),
            ("GET", "/api/tags"): self._tags,
            ("GET", "/api/ps"): self._ps,
            ("POST", "/api/show"): lambda: self._show(body),
            ("POST", "/api/chat"): lambda: self._ollama_chat(body, fault),
            ("GET", "/health"): lambda: self._send_json({"status": "ok"}),
            ("GET", "/v1/models"): self._v1_models,
            ("POST", "/v1/chat/completions"): lambda: self._openai_chat(body, fault),
        }
        wanted = route.get(("GET" if method == "HEAD" else method, self.path))
        if wanted is not None:
            wanted()
        elif any(path == self.path for _, path in route):
            self._send(405, b"405 method not allowed", "text/plain")
        else:
            self._send(404, b"404 page not found", "text/plain")

    def _is_host_allowed(self):
        """Ollama on the loopback address refuses a foreign name in the Host header."""
        host = self.headers.get("Host", "").rpartition(":")[0] or self.headers.get("Host", "")
        try:
            address = ipaddress.ip_address(host.strip("[]"))
            return address.is_loopback or address.is_private
        except ValueError:
            host = host.lower()
        return host in ("", "localhost", socket.gethostname().lower()) or host.endswith(
            (".localhost", ".local", ".internal")
        )

    def _tags(self):
        models = self.server.models
        self._send_json({"models": [models.entry(name) for name in models.installed]})

    def _ps(self):
        current, models = self.server.models.current(), []
        if current is not None:
            entry = self.server.models.entry(current[0])
            entry.pop("modified_at")
            entry.pop("capabilities", None)
            models.append({**entry, "expires_at": protocol.now_text(), "size_vram": 1, "context_length": current[1]})
        self._send_json({"models": models})

    def _show(self, body):
        value = protocol.read_json(body)
        model = value.get("model") or value.get("name")
        if not model:
            raise RefusalError(400, {"error": "model is required"})
        name = self.server.models.find(model)
        installed, entry = self.server.models.installed[name], self.server.models.entry(name)
        reply = {"modelfile": "FROM x", "template": "{{ .Prompt }}", "details": entry["details"], "model_info": {}}
        if "show_capabilities" in installed or "capabilities" in installed:
            reply["capabilities"] = list(installed.get("show_capabilities", installed.get("capabilities")))
        reply.update({key: entry[key] for key in ("remote_host", "remote_model") if key in entry})
        self._send_json(reply)

    def _ollama_chat(self, body, fault):
        chat = protocol.read_ollama_chat(body)
        self._note(chat)
        models = self.server.models
        name = models.find(chat.model)
        remote = {k: v for k, v in models.installed[name].items() if k.startswith("remote_")}
        if not chat.has_messages and chat.keep_alive_s == 0:
            models.loaded = None
            self._send_json(protocol.ollama_reply(chat, "", "", "unload", 0.0))
            return
        thinks = "thinking" in models.installed[name].get("capabilities", VISION)
        if chat.think and not thinks:
            raise RefusalError(400, {"error": '"%s" does not support thinking' % chat.model})
        models.require(chat, self._check, fault.get("load_s", 1.0) if fault["kind"] == "load" else models.load_s)
        if not chat.has_messages:
            self._send_json({**protocol.ollama_reply(chat, "", "", "load", 0.0), **remote})
            return
        text, reason, duration_s = self._generate(chat, fault, nested=True)
        thinking = "Let me look." if thinks and chat.think is not False else ""
        if fault["kind"] == "thinking":
            text, thinking = "", text
        if fault["kind"] == "unfinished":
            text, reason = text[: len(text) // 2], None
        reply = {**protocol.ollama_reply(chat, text, thinking, reason, duration_s), **remote}
        if chat.stream:
            self._send_chunks(protocol.ollama_stream(chat, reply), "application/x-ndjson")
        else:
            self._send_json(reply, fault)

    def _v1_models(self):
        self._check_key()
        names = list(self.server.models.installed)
        models = [{"name": name, "model": name, "capabilities": ["completion", "multimodal"]} for name in names]
        data = [{"id": name, "object": "model", "created": 0, "owned_by": "llamacpp"} for name in names]
        self._send_json({"models": models, "object": "list", "data": data})

    def _openai_chat(self, body, fault):
        self._check_key()
        if fault["kind"] == "load":
            raise RefusalError(503, protocol.openai_error(503, "Loading model", "unavailable_error"))
        chat = protocol.read_openai_chat(body)
        self._note(chat)
        text, reason, duration_s = self._generate(chat, fault, nested=False)
        if reason == "length" and chat.schema is not None:
            message = "The model produced output that does not match the expected peg-native format"
            raise RefusalError(500, protocol.openai_error(500, message, "server_error"))
        thinking = ""
        if fault["kind"] == "thinking":
            text, thinking = "", text
        if fault["kind"] == "unfinished":
            reason = "content_filter"
        reply = protocol.openai_reply(chat, text, thinking, reason, duration_s)
        if chat.stream:
            self._send_chunks(protocol.openai_stream(chat, reply), "text/event-stream")
        else:
            self._send_json(reply, fault)

    def _check_key(self):
        if self.server.api_key and self.headers.get("Authorization") != "Bearer " + self.server.api_key:
            raise RefusalError(401, protocol.openai_error(401, "Invalid API Key", "authentication_error"))

    def _note(self, chat):
        """Log what was asked, without the picture itself."""
        images = [
            {
                "shape": list(image.shape),
                "sha256": hashlib.sha256(image.tobytes()).hexdigest(),
                "mean_bgr": [round(float(v), 2) for v in image.reshape(-1, 3).mean(axis=0)],
            }
            for image in chat.images
        ]
        keep_alive_s = chat.keep_alive_s if np.isfinite(chat.keep_alive_s) else "inf"
        self.entry.update(model=chat.model, system=chat.system, user=chat.user, images=images, options=chat.options)
        self.entry.update(schema=chat.schema, stream=chat.stream, think=chat.think, logprobs=chat.logprobs)
        self.entry.update(has_messages=chat.has_messages, keep_alive_s=keep_alive_s)

    def _generate(self, chat, fault, nested):
        """Answer in turn; text, reason and duration."""
        protocol.check_context(chat, nested)
        with self.server.queue.turn(self._check):
            begun_s = time.monotonic()
            wait(self.server.latency_s, self._check)
            text = self.server.answer(chat)
            if fault["kind"] == "other_schema":
                text = json.dumps({"action": "drive on", "speed": 3, "unsafe_regions": {"ON": ["nothing"]}})
            tokens = protocol.pieces(text)
            limit = max(1, len(tokens) // 2) if fault["kind"] == "length" else chat.max_tokens
            if 0 <= limit < len(tokens):
                return "".join(tokens[:limit]), "length", time.monotonic() - begun_s
            return text, "stop", time.monotonic() - begun_s

    def _check(self):
        """Raise if the client hung up or the server ends."""
        if self.server.stopping.is_set():
            raise HungUpError
        readable, _, _ = select.select([self.connection], [], [], 0)
        if readable and not self.connection.recv(1, socket.MSG_PEEK):
            raise HungUpError

    def _break_whole_request(self, fault):
        """Faults that need no look at the question; True if the reply is over."""
        kind = fault["kind"]
        if kind == "hang":
            wait(3600.0, self._check)
        elif kind == "drip_headers":
            self._drip(b"HTTP/1.1 200 OK\r\nX-Padding: " + b"x" * HUGE_BYTES, fault)
        elif kind == "close":
            self.close_connection = True
        elif kind == "nothing":
            self._send(200, b"")
        elif kind == "garbage":
            self._send(200, bytes(range(256)) * 8)
        elif kind == "huge":
            self._send(200, b'{"message":{"content":"' + b"a" * HUGE_BYTES + b'"},"done":true,"done_reason":"stop"}')
        elif kind == "redirect":
            self._send(302, b"", headers={"Location": self.server.url + "/api/tags"})
        elif kind == "overloaded":
            raise RefusalError(503, {"error": "server busy, please try again.  maximum pending requests exceeded"})
        elif kind == "500":
            error = "an error was encountered while running the model: unexpected EOF"
            is_ollama = self.path.startswith("/api")
            raise RefusalError(
                500, {"error": error} if is_ollama else protocol.openai_error(500, error, "server_error")
            )
        else:
            return False
        return True

    def _send(self, status, body, kind="application/json; charset=utf-8", headers=None):
        self.send_response(status)
        for name, value in {"Content-Type": kind, "Content-Length": str(len(body)), **(headers or {})}.items():
            self.send_header(name, value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)

    def _send_json(self, value, fault=None):
        body, kind = json.dumps(value).encode(), (fault or {}).get("kind")
        if kind not in ("drip", "midway"):
            self._send(200, body)
            return
        self.send_response(200)
        self.send_header("Content-Type", "application/json; charset=utf-8")
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        if kind == "drip":
            self._drip(body, fault)
        else:
            self.wfile.write(body[: len(body) // 2])
            self.close_connection = True

    def _send_chunks(self, chunks, kind):
        self.send_response(200)
        self.send_header("Content-Type", kind)
        self.send_header("Transfer-Encoding", "chunked")
        self.end_headers()
        for chunk in chunks + [b""]:
            self.wfile.write(b"%x\r\n%s\r\n" % (len(chunk), chunk))

    def _drip(self, data, fault):
        """Send byte by byte."""
        for start in range(len(data)):
            self.wfile.write(data[start : start + 1])
            self.wfile.flush()
            wait(1.0 / fault.get("bytes_per_s", 1.0), self._check)

    def _control(self, body):
        server = self.server
        try:
            value = json.loads(body or b"{}")
            if self.path == "/_log":
                self._send_json(server.log())
                return
            if self.path == "/_fault":
                server.set_fault(**value)
            elif self.path == "/_latency":
                server.latency_s = float(value["seconds"])
            elif self.path == "/_answer":
                text = value.get("text")
                server.answer = server.default_answer if text is None else lambda _: text
            elif self.path == "/_unload":
                server.models.loaded = None
            elif self.path == "/_reset":
                server.forget()
            else:
                self._send(404, b"no such control")
                return
            self._send_json({})
        except (ValueError, KeyError, TypeError) as error:
            self._send(400, str(error).encode())


def control(url, path, value=None):
    """Call a control of a server in another process, such as control(url, "/_fault", {"kind": "hang"})."""
    body = None if value is None else json.dumps(value).encode()
    with build_opener(ProxyHandler({})).open(Request(url + path, data=body), timeout=5.0) as reply:
        return json.loads(reply.read())


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--port", type=int, default=0)
    parser.add_argument("--model", action="append", help="NAME or NAME=capability,capability; repeat for more")
    parser.add_argument("--no-models", action="store_true")
    parser.add_argument("--latency-s", type=float, default=0.0)
    parser.add_argument("--load-s", type=float, default=0.0)
    parser.add_argument("--api-key", default="")
    arguments = parser.parse_args()
    named = dict((item.split("=", 1) + [",".join(VISION)])[:2] for item in arguments.model or [])
    models = {name: {"capabilities": tuple(words.split(","))} for name, words in named.items()}
    server = FakeModelServer(
        arguments.port,
        {} if arguments.no_models else models or None,
        latency_s=arguments.latency_s,
        load_s=arguments.load_s,
        api_key=arguments.api_key,
    )
    print(server.port, flush=True)
    with contextlib.suppress(KeyboardInterrupt):
        server.serve_forever(poll_interval=0.05)


if __name__ == "__main__":
    main()

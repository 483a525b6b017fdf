# SPDX-License-Identifier: BSD-3-Clause
"""A segmenter side-car without a model: speaks the contract over real HTTP, with replies that a test can spoil.

It finds rectangles of one colour: class ``<name>`` of ``colors`` wherever a pixel has that colour.
"""

import base64
import contextlib
import json
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import cv2
import numpy as np

from core_perception.segmenters.rle import encode_mask


class FakeSidecar:
    """``with FakeSidecar({"floor": (90, 90, 90)}) as server: … server.url``.

    Attributes:
        requests: bodies of the segment requests, in order.
        capabilities: what it says of itself.
        spoil: changes a reply before it is sent: value -> value or bytes.
        status: of segment replies.
        delay_s: before each segment reply.
        most_evaluated: classes it gets done.
    """

    def __init__(self, colors):
        self.colors = {name: np.array(color) for name, color in colors.items()}
        self.requests = []
        self.capabilities = {"version": 1, "model": "fake", "tasks": ["segment"], "classes": None, "max_classes": None}
        self.spoil = lambda value: value
        self.status, self.delay_s, self.most_evaluated = 200, 0.0, None
        self.in_flight = self.most_in_flight = 0
        self._lock = threading.Lock()

    def __enter__(self):
        sidecar = self

        class Handler(BaseHTTPRequestHandler):
            def log_message(self, *_):
                pass

            def do_GET(self):  # noqa: N802
                self._send(200, sidecar.capabilities if self.path == "/v1/capabilities" else {"error": {}})

            def do_POST(self):  # noqa: N802
                value = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
                with sidecar._flight(), contextlib.suppress(OSError):
                    time.sleep(sidecar.delay_s)
                    reply = sidecar.spoil(sidecar.answer(value))
                    self._send(sidecar.status, reply)

            def _send(self, status, value):
                body = value if isinstance(value, bytes) else json.dumps(value).encode()
                self.send_response(status)
                self.send_header("Content-Length", str(len(body)))
                self.end_headers()
                self.wfile.write(body)

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self._server.daemon_threads = True
        self.url = "http://127.0.0.1:%d" % self._server.server_address[1]
        threading.Thread(target=self._server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True).start()
        return self

    def __exit__(self, *_):
        self._server.shutdown()
        self._server.server_close()

    @contextlib.contextmanager
    def _flight(self):
        with self._lock:
            self.in_flight += 1
            self.most_in_flight = max(self.most_in_flight, self.in_flight)
        try:
            yield
        finally:
            with self._lock:
                self.in_flight -= 1

    def answer(self, request):
        self.requests.append(request)
        data = np.frombuffer(base64.b64decode(request["image"]["data"], validate=True), np.uint8)
        image = cv2.imdecode(data, cv2.IMREAD_COLOR)[:, :, ::-1].astype(int)
        evaluated = request["classes"][: self.most_evaluated]
        instances = []
        for name in evaluated:
            mask = np.abs(image - self.colors.get(name, np.array([-1000] * 3))).max(axis=2) < 12
            if mask.any():
                mask = {"size": list(mask.shape), "counts": encode_mask(mask)}
                instances.append({"class": name, "score": 0.9, "mask": mask})
        return {
            "version": 1,
            "model": "fake",
            "stamp": request["stamp"],
            "size": list(image.shape[:2]),
            "latency_s": 0.01,
            "classes_evaluated": evaluated,
            "instances": instances,
        }

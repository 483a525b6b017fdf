# SPDX-License-Identifier: BSD-3-Clause
"""A depth side-car without a model, over real HTTP: it answers what it is told to, or fails in the way it is told to.

``with FakeDepthSidecar(depth) as server: … server.url``; ``server.fault`` is one of FAULTS, ``requests`` what came.
"""

import base64
import json
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import cv2
import numpy as np

FAULTS = ("", "500", "overloaded", "hang", "close", "garbage", "old_stamp", "short", "other_kind", "no_model", "nan")


class FakeDepthSidecar:
    def __init__(self, depth, kind="relative", confidence=None, dtype="float32", latency_s=0.0):
        self.depth, self.kind, self.confidence, self.dtype = depth, kind, confidence, dtype
        self.latency_s, self.fault, self.requests = latency_s, "", []
        self.in_flight, self.most_in_flight, self._lock = 0, 0, threading.Lock()

    def __enter__(self):
        fake = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self):
                fake.answer(self)

            def log_message(self, *_arguments):
                pass

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self._server.daemon_threads = True
        self.url = f"http://127.0.0.1:{self._server.server_address[1]}"
        threading.Thread(target=self._server.serve_forever, args=(0.01,), daemon=True).start()
        return self

    def __exit__(self, *_error):
        self._server.shutdown()
        self._server.server_close()

    def answer(self, handler):
        body = json.loads(handler.rfile.read(int(handler.headers["Content-Length"])))
        body["path"] = handler.path
        body["picture"] = cv2.imdecode(np.frombuffer(base64.b64decode(body["image"]["data"]), np.uint8), 1)
        with self._lock:
            self.requests.append(body)
            self.in_flight += 1
            self.most_in_flight = max(self.in_flight, self.most_in_flight)
        time.sleep(self.latency_s)
        try:
            self._reply(handler, body)
        finally:
            with self._lock:
                self.in_flight -= 1

    def _reply(self, handler, body):
        fault = self.fault
        if fault == "hang":
            time.sleep(3.0)
        if fault in ("hang", "close"):
            return
        status = {"500": 500, "overloaded": 503}.get(fault, 200)
        reply = {"error": {"message": "out of memory"}} if status != 200 else self._value(body, fault)
        data = b"<html>" if fault == "garbage" else json.dumps(reply).encode()
        handler.send_response(status)
        handler.send_header("Content-Length", str(len(data)))
        handler.end_headers()
        handler.wfile.write(data)

    def _value(self, body, fault):
        depth = np.full_like(self.depth, np.nan) if fault == "nan" else self.depth
        value = {
            "version": 1,
            "stamp": {"secs": 1, "nsecs": 2} if fault == "old_stamp" else body["stamp"],
            "model": "fake",
            "kind": "guess" if fault == "other_kind" else self.kind,
            "size": list(self.depth.shape),
            "dtype": self.dtype,
            "depth": self._encode(depth[1:] if fault == "short" else depth),
        }
        if self.confidence is not None:
            value["confidence"] = self._encode(self.confidence)
        if fault == "no_model":
            del value["model"]
        return value

    def _encode(self, image):
        return base64.b64encode(image.astype("<f4" if self.dtype == "float32" else "<f2").tobytes()).decode()

# SPDX-License-Identifier: BSD-3-Clause
"""Starts, kills and ends the real llama-server that build_server.sh builds, with the model of make_tiny_vlm.py."""

import os
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path

HERE = Path(__file__).resolve().parent
START_LIMIT_S = 30.0
STOP_LIMIT_S = 10.0


def ensure_server() -> Path:
    """Build the server if need be, and return the folder that holds bin/llama-server and python/gguf."""
    built = subprocess.run([str(HERE / "build_server.sh")], stdout=subprocess.PIPE, text=True, check=True)
    return Path(built.stdout.strip())


def write_model(home: Path, out: Path) -> None:
    """Write tiny.gguf and tiny_mmproj.gguf into a folder."""
    environment = dict(os.environ, PYTHONPATH=str(home / "python"))
    command = [sys.executable, str(HERE / "make_tiny_vlm.py"), "--out", str(out)]
    subprocess.run(command, env=environment, check=True)


def free_port() -> int:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return listener.getsockname()[1]


class LlamaServer:
    """One server process on loopback; start() and kill() as often as wanted, always on the same port."""

    def __init__(self, home: Path, models: Path, vision: bool = True, context_tokens: int = 16384):
        self.port = free_port()
        self.url = f"http://127.0.0.1:{self.port}"
        self._log_path = models / f"server_{self.port}.log"
        self._command = [str(home / "bin" / "llama-server"), "--model", str(models / "tiny.gguf")]
        if vision:
            self._command += ["--mmproj", str(models / "tiny_mmproj.gguf")]
        self._command += ["--host", "127.0.0.1", "--port", str(self.port), "--ctx-size", str(context_tokens)]
        self._command += ["--parallel", "1", "--threads", "1", "--cache-ram", "0", "--offline", "--no-ui"]
        self._process = None

    def __enter__(self):
        self.start()
        return self

    def __exit__(self, *_):
        if self._process is not None:
            self._process.terminate()
            try:
                self._process.wait(STOP_LIMIT_S)
            except subprocess.TimeoutExpired:
                self.kill()

    def start(self) -> float:
        """Start the process and return after how many seconds it had its model loaded."""
        begun_s = time.monotonic()
        with self._log_path.open("ab") as log:
            self._process = subprocess.Popen(self._command, stdout=log, stderr=subprocess.STDOUT)
        while not self._is_ready():
            if self._process.poll() is not None or time.monotonic() - begun_s > START_LIMIT_S:
                self.kill()
                raise RuntimeError("llama-server did not start:\n" + self._log_path.read_text(errors="replace")[-2000:])
            time.sleep(0.02)
        return time.monotonic() - begun_s

    def kill(self) -> None:
        """End the process as a crash would."""
        self._process.kill()
        self._process.wait()

    def _is_ready(self) -> bool:
        try:
            with urllib.request.urlopen(self.url + "/health", timeout=1.0) as reply:
                return reply.status == 200
        except (urllib.error.URLError, ConnectionError):
            return False

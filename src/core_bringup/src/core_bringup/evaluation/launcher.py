# SPDX-License-Identifier: BSD-3-Clause
"""Start one roslaunch graph on a master port of its own, read what it prints, and leave nothing of it behind."""

from __future__ import annotations

import contextlib
import ctypes
import os
import queue
import random
import re
import signal
import socket
import subprocess
import threading
import time
import uuid
from pathlib import Path
from typing import IO, Dict, Iterator, List, Optional, Sequence, Tuple

RUN_ID_VARIABLE = "CORE_RUN_ID"
PR_SET_PDEATHSIG = 1  # linux/prctl.h
# Looked up here: between fork and exec a thread of this process may hold the lock that the look-up takes.
_prctl = ctypes.CDLL(None, use_errno=True).prctl
FIRST_PORT, LAST_PORT, PORT_ATTEMPTS = 12000, 32767, 1000
MIN_PORTS = 1000
PORT_RANGE_FILE = Path("/proc/sys/net/ipv4/ip_local_port_range")
# How long each signal may take [s]; roslaunch itself gives its nodes 15 s after SIGINT.
STOP_DEADLINES_S = ((signal.SIGINT, 17.0), (signal.SIGTERM, 4.0), (signal.SIGKILL, 2.0))
ANSI_CODE = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]|\x1b\][^\x07]*\x07|\r")


class RoslaunchProcess:
    """A roslaunch child in a session of its own; use as a context manager.

    Every process of the graph inherits an environment variable with a value no other run has; what is still alive
    after roslaunch has ended is found by it. Should this process die without cleaning up, the kernel sends SIGINT to
    roslaunch.

    Args:
        command: the command without port, for example ("roslaunch", "core_bringup", "demo.launch").
        log_path: file that receives everything the graph prints.

    Attributes:
        master_uri: of the graph, once it is started.
    """

    def __init__(self, command: Sequence[str], log_path: Path):
        """Prepare; nothing is started yet."""
        self._command = list(command)
        self._log_path = Path(log_path)
        self._run_id = uuid.uuid4().hex
        self._lines: queue.Queue[Optional[str]] = queue.Queue()
        self._process: Optional[subprocess.Popen] = None
        self._reader: Optional[threading.Thread] = None
        self._claim: Optional[socket.socket] = None
        self.master_uri = ""

    def __enter__(self) -> RoslaunchProcess:
        """Start roslaunch on a free port."""
        self._log_path.parent.mkdir(parents=True, exist_ok=True)
        port, self._claim = claim_port()
        self.master_uri = f"http://localhost:{port}"
        self._process = subprocess.Popen(
            [self._command[0], "-p", str(port), *self._command[1:]],
            env=self._environment(),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            preexec_fn=_die_with_parent,
        )
        self._reader = threading.Thread(target=self._read, args=(self._process.stdout,), daemon=True)
        self._reader.start()
        return self

    def __exit__(self, *_error) -> None:
        """Stop whatever is still running; a second Ctrl-C does not interrupt this."""
        with _signals_held():
            self.stop()
            self._claim.close()

    @property
    def exit_code(self) -> Optional[int]:
        """Exit code of roslaunch; None while it runs."""
        return self._process.poll()

    def lines(self, idle_s: float = 0.5) -> Iterator[Optional[str]]:
        """What the graph prints, line by line without colour codes; None when nothing came for idle_s.

        Ends when the graph's output is closed, or soon after roslaunch itself has ended.
        """
        ended_at: Optional[float] = None
        while True:
            try:
                line = self._lines.get(timeout=idle_s)
            except queue.Empty:
                line = ""
            if line is None:
                return
            yield line or None
            if self.exit_code is not None:
                ended_at = ended_at or time.monotonic()
                if not line and time.monotonic() - ended_at > 2.0:
                    return

    def stop(self) -> None:
        """SIGINT, SIGTERM, SIGKILL with deadlines to roslaunch, then the same to what it left behind."""
        for number, deadline_s in STOP_DEADLINES_S:
            if self.exit_code is not None:
                break
            self._process.send_signal(number)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(deadline_s)
        for number, deadline_s in STOP_DEADLINES_S[1:]:
            if not self._signal_leftovers(number):
                break
            end = time.monotonic() + deadline_s
            while time.monotonic() < end and find_processes(RUN_ID_VARIABLE, self._run_id):
                time.sleep(0.05)
        self._reader.join(2.0)

    def _signal_leftovers(self, number: int) -> List[int]:
        leftovers = find_processes(RUN_ID_VARIABLE, self._run_id)
        for pid in leftovers:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.kill(pid, number)
        return leftovers

    def _environment(self) -> Dict[str, str]:
        environment = dict(os.environ)
        environment[RUN_ID_VARIABLE] = self._run_id
        environment["ROS_MASTER_URI"] = self.master_uri
        environment["ROS_LOG_DIR"] = str((self._log_path.parent / "ros_log").resolve())
        environment["PYTHONUNBUFFERED"] = "1"
        if "ROS_IP" not in environment:
            environment.setdefault("ROS_HOSTNAME", "localhost")
        for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
            environment.setdefault(name, "1")
        return environment

    def _read(self, stream: IO[bytes]) -> None:
        """Hand on and log what the graph prints; where the log cannot be written, the graph goes on all the same."""
        with self._log_path.open("wb", buffering=0) as log:
            logs = True
            for raw in stream:
                try:
                    logs = logs and log.write(raw) == len(raw)
                except OSError as error:
                    logs = False
                    self._lines.put(f"[FATAL] {self._log_path}: {error.strerror}")
                self._lines.put(ANSI_CODE.sub("", raw.decode("utf-8", "replace")).rstrip("\n"))
        self._lines.put(None)


def claim_port() -> Tuple[int, socket.socket]:
    """A TCP port nobody listens on, and the claim that keeps other calls of this function away from it until closed.

    A roslaunch whose port is taken joins the master that is there, and the nodes of two graphs end each other. So the
    port is none that the system gives to others, and a local socket named after it stands for it, which the kernel
    removes when its process dies. Where the system gives away nearly all ports (``1024 65535`` on tuned servers), it is
    one of them all the same.

    Raises:
        OSError: no port is free.
    """
    end = int(PORT_RANGE_FILE.read_text(encoding="ascii").split()[0]) if PORT_RANGE_FILE.exists() else LAST_PORT + 1
    if end < FIRST_PORT + MIN_PORTS:
        end = LAST_PORT + 1
    for _ in range(PORT_ATTEMPTS):
        port = random.SystemRandom().randrange(FIRST_PORT, end)
        claim = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            claim.bind(f"\0core_master_port_{port}")
            with contextlib.closing(socket.socket(socket.AF_INET, socket.SOCK_STREAM)) as probe:
                probe.bind(("127.0.0.1", port))
            return port, claim
        except OSError:
            claim.close()
    raise OSError(f"no free port in {PORT_ATTEMPTS} attempts")


def find_processes(variable: str, value: str) -> List[int]:
    """Ids of the processes that were started with an environment variable of this value, zombies left out."""
    wanted = f"{variable}={value}".encode()
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit() and int(entry.name) != os.getpid():
            with contextlib.suppress(OSError):
                # The environment of a zombie reads as empty.
                if wanted in (entry / "environ").read_bytes().split(b"\0"):
                    found.append(int(entry.name))
    return sorted(found)


def _die_with_parent() -> None:
    # A shell starts background jobs with SIGINT ignored, and that would be inherited down to every node.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    _prctl(PR_SET_PDEATHSIG, signal.SIGINT)


@contextlib.contextmanager
def _signals_held() -> Iterator[None]:
    """Ignore SIGINT and SIGTERM inside the block; only the main thread may do so, others run the block as it is."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    kept = {number: signal.signal(number, signal.SIG_IGN) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in kept.items():
            signal.signal(number, handler)

# SPDX-License-Identifier: BSD-3-Clause
"""The simulated RGB-D camera: a handle on a child process that draws the world."""

from __future__ import annotations

import os
import pickle
import socket
import subprocess
import sys
from multiprocessing.connection import Connection
from typing import Any, Optional, Sequence

import numpy as np

from core_bringup.backend import RobotState
from core_bringup.camera import CameraModel, Frame
from core_bringup.exceptions import BringupError
from core_bringup.robot import RobotConfig
from core_bringup.world_types import World, WorldObject

RENDERERS = ("tiny", "egl")
_CHILD = "import sys; from core_bringup.pybullet_render_worker import serve; serve(int(sys.argv[1]))"


class PybulletRenderer:
    """Draws frames in a process of its own, because rendering holds the interpreter lock for tens of milliseconds.

    The child is a fresh interpreter (no fork, nothing of the caller's main module) with its own PyBullet client; it
    ends when this object is closed or this process dies. Frames come back in the order of submit.
    """

    def __init__(
        self,
        world: World,
        robot: RobotConfig,
        camera: Optional[CameraModel] = None,
        renderer: str = "tiny",
        timeout_s: float = 60.0,
    ):
        """Start the child and wait until its world stands.

        Args:
            world: World.
            robot: RobotConfig.
            camera: CameraModel; the robot's own when None.
            renderer: 'tiny' (software, everywhere, depth within 1 mm on planes) or 'egl' (OpenGL by a GPU or llvmpipe,
                half the time, but Mesa's 16-bit depth buffer steps by about z^2 / near * 1.5e-5, 15 mm at 7 m).
            timeout_s: longest wait for one answer of the child [s], wall time.

        Raises:
            BringupError: unknown renderer, or the child could not build the world; the message says why.
        """
        if renderer not in RENDERERS:
            raise BringupError(f"renderer: got {renderer!r}, allowed {', '.join(RENDERERS)}")
        self._camera, self._renderer = robot.camera.model if camera is None else camera, renderer
        self._timeout_s, self._due = timeout_s, 0
        ours, theirs = socket.socketpair()
        environment = dict(os.environ, PYTHONPATH=os.pathsep.join(path for path in sys.path if path))
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-c", _CHILD, str(theirs.fileno())],
                env=environment,
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
            )
        self._connection = Connection(ours.detach())
        try:
            self._send((world, robot, self._camera, renderer))
            self._receive()
        except BringupError:
            self.close()
            raise

    def render(self, state: RobotState) -> Frame:
        """Draw what the camera sees at state (RobotState) and wait for it; not while other frames are due."""
        if self._due:
            raise BringupError(f"render: {self._due} submitted frames are not collected; allowed: collect them first")
        self.submit(state)
        return self.collect()

    def submit(self, state: RobotState) -> None:
        """Ask for a frame at state (RobotState) without waiting.

        Raises:
            BringupError: the child has died.
        """
        self._send(("render", (state,)))
        self._due += 1

    def collect(self) -> Frame:
        """Wait for the oldest frame asked for.

        Returns:
            Frame, its arrays read-only.

        Raises:
            BringupError: nothing was asked for, the child has died, or it does not answer in time.
        """
        if not self._due:
            raise BringupError("collect: no frame was submitted")
        self._due -= 1
        shape = (self._camera.height_px, self._camera.width_px)
        pixels = shape[0] * shape[1]
        data = self._receive()
        color = np.frombuffer(data, np.uint8, 3 * pixels).reshape(*shape, 3)
        depth = np.frombuffer(data, np.float32, pixels, 3 * pixels).reshape(shape)
        labels = np.frombuffer(data, np.uint16, pixels, 7 * pixels).reshape(shape)
        return Frame(color, depth, labels)

    def add_object(self, item: WorldObject) -> None:
        """Put a WorldObject into the drawn world, before the frames submitted later."""
        self._call("add_object", item)

    def move_object(self, label_id: int, position_m: Sequence[float], yaw_rad: float) -> None:
        """Move an object of the drawn world: bottom centre position_m (3,), heading yaw_rad."""
        self._call("move_object", label_id, position_m, yaw_rad)

    def remove_object(self, label_id: int) -> None:
        """Take an object out of the drawn world."""
        self._call("remove_object", label_id)

    def close(self) -> None:
        """End the child; calling it twice is allowed."""
        self._connection.close()
        self._process.kill()
        self._process.wait()

    def _call(self, name: str, *arguments: Any) -> None:
        if self._due:
            raise BringupError(f"{name}: {self._due} submitted frames are not collected; allowed: collect them first")
        self._send((name, arguments))
        self._receive()

    def _send(self, message: Any) -> None:
        try:
            self._connection.send(message)
        except (OSError, ValueError) as error:
            raise self._death() from error

    def _receive(self) -> memoryview:
        """The child's next answer as bytes; its own errors are raised here."""
        try:
            if not self._connection.poll(self._timeout_s):
                raise BringupError(f"renderer process {self._process.pid}: no answer within {self._timeout_s} s")
            data = self._connection.recv_bytes()
        except (EOFError, OSError) as error:
            raise self._death() from error
        if data[:1] == b"E":
            raise BringupError(pickle.loads(data[1:]))
        return memoryview(data)[8:]

    def _death(self) -> BringupError:
        if self._connection.closed:
            return BringupError("renderer: it was closed")
        try:
            code = self._process.wait(timeout=5.0)
        except subprocess.TimeoutExpired:
            code = "unknown"
        hint = "; EGL may lack a driver here, tiny needs none" if self._renderer == "egl" else ""
        return BringupError(f"renderer process {self._process.pid} died (exit status {code}){hint}")

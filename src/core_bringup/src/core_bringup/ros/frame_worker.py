# SPDX-License-Identifier: BSD-3-Clause
"""Draws and publishes camera frames beside the real-time loop, so that physics never waits for a picture."""

from __future__ import annotations

import threading
from typing import Callable, Optional, Tuple

from core_bringup.backend import RobotState
from core_bringup.camera import Frame
from core_bringup.exceptions import BringupError


class FrameWorker:
    """A thread that takes the state asked for, draws it and hands the frame on; while busy, requests are skipped.

    Args:
        render: RobotState -> Frame; waits for the renderer's process without holding the interpreter.
        publish: (stamp_ns, Frame) -> None.
    """

    def __init__(self, render: Callable[[RobotState], Frame], publish: Callable[[int, Frame], None]):
        """Start the thread."""
        self._render, self._publish = render, publish
        self._changed = threading.Condition()
        self._request: Optional[Tuple[int, RobotState]] = None
        self._busy, self._epoch, self._ended = False, 0, False
        self._error: Optional[BringupError] = None
        self._thread = threading.Thread(target=self._run, name="frame_worker", daemon=True)
        self._thread.start()

    def submit(self, stamp_ns: int, state: RobotState) -> bool:
        """Ask for a frame; False when the last one is not done yet and this one is skipped.

        Raises:
            BringupError: the renderer's process died during an earlier frame.
        """
        with self._changed:
            if self._error is not None:
                raise self._error
            if self._busy or self._request is not None:
                return False
            self._request = (stamp_ns, state)
            self._changed.notify_all()
            return True

    def reset(self) -> None:
        """Drop the frame under way: its stamp is of before the reset."""
        with self._changed:
            self._request, self._epoch = None, self._epoch + 1

    def close(self) -> None:
        """End the thread after the frame under way."""
        with self._changed:
            self._ended = True
            self._changed.notify_all()
        self._thread.join(timeout=5.0)

    def _run(self) -> None:
        while True:
            with self._changed:
                while self._request is None and not self._ended:
                    self._changed.wait()
                if self._ended:
                    return
                (stamp_ns, state), self._request = self._request, None
                self._busy, epoch = True, self._epoch
            self._draw(stamp_ns, state, epoch)

    def _draw(self, stamp_ns: int, state: RobotState, epoch: int) -> None:
        try:
            frame = self._render(state)
        except BringupError as error:
            with self._changed:
                self._error = error
            return
        with self._changed:
            if epoch == self._epoch and not self._ended:
                self._publish(stamp_ns, frame)
            self._busy = False

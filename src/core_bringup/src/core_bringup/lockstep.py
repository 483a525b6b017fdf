# SPDX-License-Identifier: BSD-3-Clause
"""Book-keeping of a lock-step run: has the chain answered this tick, and if not, who is awaited."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Dict, Optional, Sequence, Tuple

FRAME, TICK = "frame", "tick"


@dataclass(frozen=True)
class Stage:
    """One topic of the chain, the node behind it, and whose stamp it carries: FRAME or TICK."""

    topic: str
    node: str
    keyed_by: str


# In the order of the data: the first that is behind is the one to blame.
CHAIN = (
    Stage("safety/constraints", "safety_reasoner", FRAME),
    Stage("segmentation/label_info", "segmenter", FRAME),
    Stage("safety_grid", "semantic_map", FRAME),
    Stage("cmd_vel_nominal_stamped", "waypoint_controller", TICK),
    Stage("cbf_filter/state", "cbf_filter", TICK),
)


@dataclass(frozen=True)
class Schedule:
    """Stamps of the ticks and which of them carry a camera frame; everything in whole nanoseconds.

    Tick k = 1, 2, ... is at k period_ns; tick 1 has the first frame and then every frame_every-th tick. No tick is at
    zero, because a stamp of zero means "none" in ROS. frame_every = 0: no camera.
    """

    period_ns: int
    frame_every: int

    def stamp_ns(self, tick: int) -> int:
        """Sim time of a tick."""
        return tick * self.period_ns

    def has_frame(self, tick: int) -> bool:
        """Whether a camera frame is due at this tick."""
        return self.frame_every > 0 and (tick - 1) % self.frame_every == 0

    def frame_stamp_ns(self, tick: int) -> int:
        """Stamp of the newest frame at this tick; 0 without a camera."""
        return self.stamp_ns(tick - (tick - 1) % self.frame_every) if self.frame_every > 0 else 0


class LockstepMonitor:
    """Waits for the answer to one tick at a time.

    A tick is answered when the acknowledging stage (the last of the chain) has come with the tick's stamp and the
    newest command equals, bit for bit, the one that stage reports. Stamps are compared for equality, never for order,
    so a message of before a reset cannot be taken for an answer.
    """

    def __init__(self, stall_timeout_s: float, stages: Sequence[Stage] = CHAIN):
        """Wait for nothing yet; stall_timeout_s > 0 counts on the wall clock given to begin."""
        self._stages, self._timeout_s = tuple(stages), stall_timeout_s
        self.reset()

    def reset(self) -> None:
        """Forget every stamp and command."""
        self._newest_ns: Dict[str, int] = {}
        self._expected_ns: Dict[str, int] = {}
        self._tick, self._begun_s = 0, 0.0
        self._acknowledged: Optional[Tuple[float, ...]] = None
        self._command: Optional[Tuple[float, ...]] = None

    def begin(self, tick: int, stamp_ns: int, frame_stamp_ns: int, wall_s: float) -> None:
        """Start to wait for a tick. frame_stamp_ns = 0: no camera, the stages keyed by frames are not expected."""
        self._tick, self._begun_s, self._acknowledged = tick, wall_s, None
        expected = {FRAME: frame_stamp_ns, TICK: stamp_ns}
        self._expected_ns = {s.topic: expected[s.keyed_by] for s in self._stages if expected[s.keyed_by]}

    def note_stage(self, topic: str, stamp_ns: int) -> None:
        """A message of a stage has come."""
        self._newest_ns[topic] = stamp_ns

    def note_acknowledgement(self, stamp_ns: int, command: Sequence[float]) -> None:
        """The last stage has come, with the command (3,) it says it has sent."""
        topic = self._stages[-1].topic
        self.note_stage(topic, stamp_ns)
        if stamp_ns == self._expected_ns.get(topic):
            self._acknowledged = tuple(command)

    def note_command(self, command: Sequence[float]) -> None:
        """A command (3,) has come."""
        self._command = tuple(command)

    @property
    def command(self) -> Optional[Tuple[float, ...]]:
        """Newest command; None before the first."""
        return self._command

    def is_answered(self) -> bool:
        """Whether the tick that was begun has been answered."""
        if self._acknowledged is None or self._command is None:
            return False
        return _bits(self._acknowledged) == _bits(self._command)

    def seconds_left(self, wall_s: float) -> float:
        """Wall time until the wait counts as a stall; <= 0 afterwards."""
        return self._begun_s + self._timeout_s - wall_s

    def awaited(self) -> Stage:
        """First stage whose newest stamp is not the expected one; the last stage when only the command is missing."""
        behind = (s for s in self._stages if s.topic in self._expected_ns
                  and self._newest_ns.get(s.topic) != self._expected_ns[s.topic])  # fmt: skip
        return next(behind, self._stages[-1])

    def stall_report(self, wall_s: float) -> str:
        """One line that names the awaited topic and node, with figures."""
        stage, now_s = self.awaited(), self._expected_ns.get(self._stages[-1].topic, 0) * 1e-9
        head = f"lock-step stalled at tick {self._tick} (sim time {now_s:.3f} s) for {wall_s - self._begun_s:.1f} s"
        expected_ns, newest_ns = self._expected_ns.get(stage.topic), self._newest_ns.get(stage.topic)
        if expected_ns is not None and newest_ns == expected_ns:
            return f"{head}: awaiting cmd_vel by {stage.node}; newest {self._command}, reported {self._acknowledged}"
        newest = "none has come" if newest_ns is None else f"newest {newest_ns * 1e-9:.3f} s"
        return f"{head}: awaiting {stage.topic} by {stage.node}; expected {(expected_ns or 0) * 1e-9:.3f} s, {newest}"


def header_stamp_ns(raw: bytes) -> int:
    """Stamp [ns] of a serialised ROS 1 message that starts with a std_msgs/Header: uint32 seq, secs, nsecs."""
    _seq, secs, nsecs = struct.unpack_from("<III", raw)
    return secs * 1_000_000_000 + nsecs


def _bits(command: Sequence[float]) -> bytes:
    return struct.pack(f"<{len(command)}d", *command)

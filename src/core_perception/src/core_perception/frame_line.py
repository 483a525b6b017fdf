# SPDX-License-Identifier: BSD-3-Clause
"""Lines up frames that wait for a partner, and lets them go in the order of their stamps, none of them lost."""

from __future__ import annotations

from collections import OrderedDict, deque
from dataclasses import dataclass
from typing import Any, Deque, List, Optional, Tuple

PARTNERS_KEPT = 20


@dataclass(frozen=True)
class Waiting:
    """A frame in the line: its stamp [ns], the frame, and when it came [s, any clock that does not go back]."""

    stamp_ns: int
    frame: Any
    came_s: float


class FrameLine:
    """Frames and their partners, matched by stamp; not safe for threads by itself.

    A consumer that sees a stamp go back takes it for a reset, so a frame never overtakes an older one: while one is
    worked on, those behind it wait. A stamp that does go back (the world began anew) empties the line.
    """

    def __init__(self, slop_ns: int, wait_s: float, newest_first: bool, capacity: int = 100):
        """Start empty.

        Args:
            slop_ns: largest difference of the stamps of a frame and its partner [ns].
            wait_s: how long a frame waits for its partner [s].
            newest_first: take the newest frame that has a partner and let the older ones go without; else the oldest.
            capacity: frames kept; beyond it the oldest go without.
        """
        self._slop_ns, self._wait_s, self._newest_first, self._capacity = slop_ns, wait_s, newest_first, capacity
        self._line: Deque[Waiting] = deque()
        self._partners: OrderedDict = OrderedDict()
        self._newest_ns: Optional[int] = None
        self._newest_partner_ns: Optional[int] = None

    def __len__(self):
        return len(self._line)

    def add_frame(self, stamp_ns: int, frame: Any, now_s: float) -> None:
        """Take in a frame; one with the stamp of the last is ignored."""
        if stamp_ns == self._newest_ns:
            return
        if self._newest_ns is not None and stamp_ns < self._newest_ns:
            self._line.clear()
        self._newest_ns = stamp_ns
        self._line.append(Waiting(stamp_ns, frame, now_s))

    def add_partner(self, stamp_ns: int, partner: Any) -> None:
        """Take in what frames wait for."""
        if self._newest_partner_ns is not None and stamp_ns < self._newest_partner_ns:
            self._partners.clear()  # those of another life of the world may bear the same stamps
        self._newest_partner_ns = stamp_ns
        self._partners[stamp_ns] = partner
        while len(self._partners) > PARTNERS_KEPT:
            self._partners.popitem(last=False)

    def take(self, now_s: float, may_wait: bool = True) -> Tuple[List[Waiting], Optional[Waiting], Any]:
        """Take what may go now.

        Args:
            now_s: of the clock of add_frame [s].
            may_wait: False: nobody would work on a frame; all go without a partner.

        Returns:
            Frames that go without a partner, oldest first; then the frame to work on and its partner, or None and None.
        """
        paired = [
            position
            for position, waiting in enumerate(self._line)
            if may_wait and self._partner_of(waiting) is not None
        ]
        if paired:
            chosen = paired[-1] if self._newest_first else paired[0]
            alone = [self._line.popleft() for _ in range(chosen)]
            waiting = self._line.popleft()
            return alone, waiting, self._partners.pop(self._partner_of(waiting))
        alone = []
        while self._line and (
            not may_wait or len(self._line) > self._capacity or now_s - self._line[0].came_s >= self._wait_s
        ):
            alone.append(self._line.popleft())
        return alone, None, None

    def _partner_of(self, waiting: Waiting) -> Optional[int]:
        nearest = min(self._partners, key=lambda stamp_ns: abs(stamp_ns - waiting.stamp_ns), default=None)
        return None if nearest is None or abs(nearest - waiting.stamp_ns) > self._slop_ns else nearest

# SPDX-License-Identifier: BSD-3-Clause
"""Brings together the messages of one frame that come on several topics."""

from __future__ import annotations

from collections import OrderedDict
from typing import Any, Dict, Optional


class StampedJoin:
    """Matches items of several streams by stamp: equal ones, or the nearest within a slop.

    Within a stream a stamp that was had already is ignored; a stamp that goes back (the world was reset) empties that
    stream. What is not newer than a matched item is dropped, as is the oldest beyond the capacity.
    """

    def __init__(self, *streams: str, capacity: int = 50, slop_ns: int = 0):
        """Start empty.

        Args:
            streams: names of the streams, at least one.
            capacity: items kept per stream, >= 1.
            slop_ns: largest difference between the stamps of a match and that of the item that completes it [ns].
        """
        self._items: Dict[str, OrderedDict] = {stream: OrderedDict() for stream in streams}
        self._newest_ns: Dict[str, int] = {}
        self._capacity, self._slop_ns = capacity, slop_ns

    @property
    def missing(self) -> str:
        """What keeps a frame from being whole, in words; empty for nothing."""
        never = [stream for stream in self._items if stream not in self._newest_ns]
        if never:
            return f"no {' and no '.join(never)} came"
        if any(self._items.values()):
            return f"{' and '.join(self._items)} come, but not with one stamp"
        return ""

    def add(self, stream: str, stamp_ns: int, item: Any) -> Optional[Dict[str, Any]]:
        """Take in one item; return the items of all streams near its stamp if it completes them, otherwise None."""
        newest_ns = self._newest_ns.get(stream)
        if stamp_ns == newest_ns:
            return None
        items = self._items[stream]
        if newest_ns is not None and stamp_ns < newest_ns:
            items.clear()
        self._newest_ns[stream] = stamp_ns
        items[stamp_ns] = item
        while len(items) > self._capacity:
            items.popitem(last=False)
        nearest = {
            name: min(other, key=lambda s: abs(s - stamp_ns), default=None) for name, other in self._items.items()
        }
        if any(s is None or abs(s - stamp_ns) > self._slop_ns for s in nearest.values()):
            return None
        matched = {name: self._items[name][s] for name, s in nearest.items()}
        for name, other in self._items.items():
            for old_ns in [s for s in other if s <= nearest[name]]:
                del other[old_ns]
        return matched

# SPDX-License-Identifier: BSD-3-Clause
"""Brings together the messages of one frame that come on several topics."""

from __future__ import annotations

from collections import OrderedDict
from typing import Any, Dict, Optional


class StampedJoin:
    """Matches items of several streams by equal stamp.

    Within a stream a stamp that was had already is ignored; a stamp that goes back (the world was reset) empties that
    stream. What is older than a matched stamp is dropped, as is the oldest beyond the capacity.
    """

    def __init__(self, *streams: str, capacity: int = 50):
        """Start empty.

        Args:
            streams: names of the streams, at least one.
            capacity: items kept per stream, >= 1.
        """
        self._items: Dict[str, OrderedDict] = {stream: OrderedDict() for stream in streams}
        self._newest_ns: Dict[str, int] = {}
        self._capacity = capacity

    def add(self, stream: str, stamp_ns: int, item: Any) -> Optional[Dict[str, Any]]:
        """Take in one item; return the items of all streams at its stamp if it completes them, otherwise None."""
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
        if not all(stamp_ns in other for other in self._items.values()):
            return None
        matched = {name: other[stamp_ns] for name, other in self._items.items()}
        for other in self._items.values():
            for stamp in [s for s in other if s <= stamp_ns]:
                del other[stamp]
        return matched

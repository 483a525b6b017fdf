# SPDX-License-Identifier: BSD-3-Clause
"""A place for one frame between who receives and who works: a newer frame takes the place of one that waits."""

from __future__ import annotations

import threading
from typing import Any, Optional


class NewestFrame:
    """Holds at most one item."""

    def __init__(self):
        """Start empty and open."""
        self._changed = threading.Condition()
        self._item: Optional[Any] = None
        self._is_closed = False

    def put(self, item: Any) -> bool:
        """Leave an item, not None; True where another one waited, which is now gone."""
        with self._changed:
            replaced = self._item is not None
            self._item = item
            self._changed.notify()
        return replaced

    def take(self) -> Optional[Any]:
        """Wait for an item and take it; None once it is closed."""
        with self._changed:
            self._changed.wait_for(lambda: self._item is not None or self._is_closed)
            item, self._item = self._item, None
        return None if self._is_closed else item

    def close(self) -> None:
        """End every take()."""
        with self._changed:
            self._is_closed = True
            self._changed.notify_all()

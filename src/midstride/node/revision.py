"""How often a component has changed."""

from __future__ import annotations

import threading


class Revision:
    """Counts the changes of a component. Both threads count up, so it has a lock; reading needs none."""

    def __init__(self) -> None:
        self.value = 0
        self._lock = threading.Lock()

    def bump(self) -> None:
        with self._lock:
            self.value += 1

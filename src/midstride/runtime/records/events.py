"""A bounded log of the manager's events, which clients can read from any point and follow."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections import deque
from collections.abc import AsyncIterator, Callable, Iterator
from itertools import islice
from typing import Any

from midstride.runtime.records.reports import Event


class Wakers:
    """The readers of a log or a view, each with an event that is set when there may be something new."""

    def __init__(self) -> None:
        self._events: set[asyncio.Event] = set()

    def __len__(self) -> int:
        return len(self._events)

    @contextlib.contextmanager
    def client(self) -> Iterator[asyncio.Event]:
        """One more reader while the context is open."""
        event = asyncio.Event()
        self._events.add(event)
        try:
            yield event
        finally:
            self._events.discard(event)

    def wake(self) -> None:
        for event in self._events:
            event.set()


class EventLog:
    """The latest events of one manager; each listener is called with every one."""

    def __init__(self) -> None:
        self.listeners: list[Callable[[Event], object]] = []
        self._events: deque[Event] = deque(maxlen=10_000)
        self._count = 0
        self.wakers = Wakers()

    def add(self, kind: str, words: str, **details: Any) -> Event:
        """A new event; ``details`` are further fields of :class:`Event`."""
        self._count += 1
        event = Event(n=self._count, at=time.time(), kind=kind, words=words, **details)
        self._events.append(event)
        for listener in self.listeners:
            listener(event)
        self.wakers.wake()
        return event

    @property
    def last(self) -> int:
        """The number of the latest event; 0 before the first."""
        return self._count

    def since(self, n: int = 0) -> list[Event]:
        """The events after number ``n`` that are still kept; all of them if ``n`` is from an earlier manager."""
        new = self._count if n > self._count else self._count - n
        return list(islice(reversed(self._events), new))[::-1]

    async def follow(self, n: int = 0) -> AsyncIterator[Event]:
        """The events after number ``n`` as in ``since``, then each new one. A slow reader loses the oldest."""
        with self.wakers.client() as waker:
            while True:
                waker.clear()
                for event in self.since(n):
                    n = event.n
                    yield event
                await waker.wait()

"""Doing something at the manager while its events are shown as they come."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterator
from typing import Any

from midstride.cli.client import Client, Document, Event
from midstride.errors import MidstrideError

# How long after the answer the events that belong to it may still be under way (s).
LAST_EVENTS = 0.5


class Following:
    """``ask`` in one thread, the event stream in another; iterating yields the events until there is an answer.

    Where ``id`` is given, only those of the command that bears it: its wait, and from its beginning to the next one's.
    """

    def __init__(
        self, client: Client, ask: Callable[[], Document], *, since: int, until: str, id: str | None = None
    ) -> None:
        self._client = client
        self._ask = ask
        self._until = until
        self._queue: queue.Queue[Event | None] = queue.Queue()
        self._answer: Document | None = None
        self._error: MidstrideError | None = None
        self._since = since
        self._id = id
        self._mine = id is None

    def __iter__(self) -> Iterator[Event]:
        """Each event; ends with the answer, or once no more events can come."""
        for target in (self._listen, self._work):
            threading.Thread(target=target, daemon=True).start()
        while (event := self._queue.get()) is not None:
            if self._concerns(event):
                yield event
        try:
            while (event := self._queue.get(timeout=LAST_EVENTS)) is not None:
                if self._concerns(event):
                    yield event
                    if event["kind"] == self._until:
                        return
        except queue.Empty:
            return

    def _concerns(self, event: Event) -> bool:
        """Whether an event belongs here. Each command begins with its own event; the manager runs one at a time."""
        if self._id is None or event["kind"] not in {"command", "waiting"}:
            return self._mine
        own = bool(event.get("id") == self._id)
        if event["kind"] == "command":
            self._mine = own
        return own

    def answer(self) -> Document:
        """What came of it, once the events are over. Raises what the manager raised."""
        if self._error is not None:
            raise self._error
        assert self._answer is not None
        return self._answer

    def _work(self) -> None:
        try:
            self._answer = self._ask()
        except MidstrideError as error:
            self._error = error
        self._queue.put(None)

    def _listen(self) -> None:
        try:
            for event in self._client.events(self._since):
                self._queue.put(event)
        except MidstrideError:  # the asking side tells it
            return


def last_number(client: Client) -> int:
    """The number of the newest event: what follows is new."""
    log: list[dict[str, Any]] = client.get("/log")
    return int(log[-1]["n"]) if log else 0

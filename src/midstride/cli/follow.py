"""A request to the manager, with the events that belong to it as they come."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Generic, TypeVar

from midstride.cli.client import Client
from midstride.errors import MidstrideError

if TYPE_CHECKING:
    from midstride.runtime.records.reports import Event

A = TypeVar("A")

# How long to wait, after the answer, for events still under way (s).
LAST_EVENTS = 0.5


@dataclass
class FollowedRequest(Generic[A]):
    """Runs ``request`` in one thread and the event stream in another; iterate over it for the events.

    ``id`` limits the events to those of one command: while it waits, and from its start to the start of the next.
    """

    client: Client
    request: Callable[[], A]
    since: int
    until: str
    id: str | None = None
    _queue: queue.Queue[Event | None] = field(default_factory=queue.Queue)
    _answer: A | None = None
    _error: MidstrideError | None = None
    _in_command: bool = False

    def __iter__(self) -> Iterator[Event]:
        """Each event, until the answer and the event of kind ``until`` have come or no more events follow."""
        for target in (self._read_events, self._send):
            threading.Thread(target=target, daemon=True).start()
        answered = complete = False
        while not (answered and complete):
            try:
                event = self._queue.get(timeout=LAST_EVENTS if answered else None)
            except queue.Empty:
                return
            if event is None:
                answered = True
            elif self._belongs(event):
                yield event
                complete = complete or event.kind == self.until

    def _belongs(self, event: Event) -> bool:
        """Whether an event is about this command. The manager runs one at a time, and each starts with an event."""
        if self.id is None:
            return True
        if event.kind not in {"command", "waiting"}:
            return self._in_command
        matches = event.id == self.id
        if event.kind == "command":
            self._in_command = matches
        return matches

    def answer(self) -> A:
        """The manager's answer, once the iteration is over. Raises the manager's error."""
        if self._error is not None:
            raise self._error
        assert self._answer is not None
        return self._answer

    def _send(self) -> None:
        try:
            self._answer = self.request()
        except MidstrideError as error:
            self._error = error
        self._queue.put(None)

    def _read_events(self) -> None:
        try:
            for event in self.client.events(self.since):
                self._queue.put(event)
        except MidstrideError:  # the request reports it
            return


def last_event_number(client: Client) -> int:
    """The number of the latest event; later ones are new."""
    log = client.log()
    return log[-1].n if log else 0

"""A request to the manager, with its events as they come, and what becomes of it where its command is interrupted."""

from __future__ import annotations

import queue
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from enum import Enum, auto
from typing import TYPE_CHECKING, Final, Generic, TypeVar

import click

from midstride.cli.client import Client
from midstride.errors import MidstrideError

if TYPE_CHECKING:
    from midstride.runtime.records.reports import Event

A = TypeVar("A")

# How long to wait, after the answer, for events still under way (s).
LAST_EVENTS = 0.5
# How long a manager may take to begin with a request that has been sent, or to say that it waits (s).
BEGIN_TIMEOUT = 2.0
POLL = 0.02
# Events with which the manager ends a command that is no `up` and no `down`.
_ENDING: Final = frozenset({"outcome", "parameters"})


class Sent(Enum):
    """The state of a request whose command is interrupted."""

    WITHDRAWN = auto()  # it was not sent
    NOT_KNOWN = auto()  # it was sent at least in part, and the manager says nothing of it
    WAITING = auto()  # for the command before it
    BEGUN = auto()
    ENDED = auto()


class WithdrawnError(MidstrideError):
    """The request was withdrawn before it was sent."""


class Sending:
    """The sending of the request ``id``: it has begun, or was withdrawn before; one of the two, in whichever thread."""

    def __init__(self, id: str | None = None) -> None:
        self.id = uuid.uuid4().hex if id is None else id
        self._lock = threading.Lock()
        self._begun = self._withdrawn = False

    def begin(self) -> None:
        """The first byte is about to be sent. Raises WithdrawnError."""
        with self._lock:
            if self._withdrawn:
                raise WithdrawnError("the request was withdrawn")
            self._begun = True

    def withdraw(self) -> bool:
        """Keep the request from being sent; False if that has begun."""
        with self._lock:
            self._withdrawn = not self._begun
            return self._withdrawn

    def fate(self, client: Client) -> tuple[Sent, str]:
        """Keep the request from being sent, and find out what becomes of it; for WAITING, also for what it waits."""
        if self.withdraw():
            return Sent.WITHDRAWN, ""
        end = time.monotonic() + BEGIN_TIMEOUT
        try:
            while (found := self._in(client.log())) is None and time.monotonic() <= end:
                time.sleep(POLL)
        except MidstrideError:
            found = None
        return found or (Sent.NOT_KNOWN, "")

    def _in(self, events: Sequence[Event]) -> tuple[Sent, str] | None:
        """Return the state that the events show; None where the request is in none of them."""
        found: tuple[Sent, str] | None = None
        for event in events:
            if event.kind == "command" and found is not None and found[0] is Sent.BEGUN:
                return Sent.ENDED, ""  # the manager runs one at a time
            if event.kind in {"waiting", "command"} and event.id == self.id:
                found = (Sent.WAITING, event.words) if event.kind == "waiting" else (Sent.BEGUN, "")
            elif event.kind in _ENDING and found is not None and found[0] is Sent.BEGUN:
                return Sent.ENDED, ""
        return found

    def interrupted(self, client: Client) -> str:
        """Keep the change from being requested, and say what becomes of it, as far as that is known."""
        fate, waits = self.fate(client)
        return {
            Sent.WITHDRAWN: "Nothing was changed: the manager had not been asked yet.",
            Sent.NOT_KNOWN: "Whether the manager carries out the change is not known: `midstride log` shows it.",
            Sent.WAITING: f"The manager carries out the change later: {waits}. `midstride log` shows how it ends.",
            Sent.BEGUN: "The manager continues with the change; `midstride log` shows how it ends.",
            Sent.ENDED: "The change had ended; `midstride log` shows how.",
        }[fate]


@contextmanager
def explained_when_interrupted(explain: Callable[[], str]) -> Iterator[None]:
    """If the block is interrupted, or the reader of its output has gone, print what ``explain`` says of its work."""
    try:
        yield
    except (KeyboardInterrupt, click.Abort, BrokenPipeError, SystemExit):  # rich exits where the reader has gone
        click.echo(f"\n{explain()}", err=True)
        raise


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
        """Return whether an event is about this command. The manager runs one at a time, and each starts with an
        event.
        """
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

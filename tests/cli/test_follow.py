"""Each command shows its own events, even if another client uses the manager. Needs no manager."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from typing import cast

from msgspec import UNSET

from midstride.cli.client import Client
from midstride.cli.follow import LAST_EVENTS, FollowedRequest
from midstride.runtime.records.reports import Event, Outcome


def numbered(*events: tuple[str, str | None, str]) -> list[Event]:
    """Events as a manager numbers them, from kind, id and text."""
    return [
        Event(n=n, at=0.0, kind=kind, words=words, id=id if kind in {"command", "waiting"} else UNSET)
        for n, (kind, id, words) in enumerate(events, 1)
    ]


class ScriptedClient:
    """A client whose manager sends ``events``, and then the answer to the request."""

    def __init__(self, events: list[Event]) -> None:
        self._events = events
        self._sent = threading.Event()

    def events(self, since: int) -> Iterator[Event]:
        yield from self._events[since:]
        self._sent.set()

    def ask(self) -> Outcome:
        assert self._sent.wait(30)
        return ANSWER


ANSWER = Outcome(outcome="done")
TWO_AT_ONCE = numbered(
    ("command", "first", "replace talker with NewTalker"),
    ("waiting", "second", "`remove listener` waits for `replace talker with NewTalker`"),
    ("step_done", None, "1/1 done"),
    ("outcome", None, "done"),
    ("command", "second", "remove listener"),
    ("step_done", None, "1/1 done, of the second"),
    ("outcome", None, "done, of the second"),
)


def shown(id: str | None) -> list[str]:
    client = ScriptedClient(TWO_AT_ONCE)
    followed = FollowedRequest(cast(Client, client), client.ask, since=0, until="outcome", id=id)
    words = [event.words for event in followed]
    assert followed.answer() == ANSWER
    return words


def test_the_first_client_does_not_see_the_events_of_the_second() -> None:
    assert shown("first") == ["replace talker with NewTalker", "1/1 done", "done"]


def test_a_waiting_client_sees_that_it_waits_and_then_its_own_events() -> None:
    waits, *rest = shown("second")
    assert waits.endswith("waits for `replace talker with NewTalker`")
    assert rest == ["remove listener", "1/1 done, of the second", "done, of the second"]


def test_without_an_id_every_event_is_shown() -> None:
    assert len(shown(None)) == len(TWO_AT_ONCE)


def test_a_command_ends_with_its_answer_and_outcome() -> None:
    """Both are there: the command ends at once, not after the time in which late events may still come."""
    begun = time.monotonic()
    assert shown("second")[-1] == "done, of the second"
    assert time.monotonic() - begun < LAST_EVENTS


def test_events_after_the_answer_are_shown() -> None:
    """The answer may overtake the events that belong to it."""
    client = ScriptedClient(TWO_AT_ONCE)
    answered = threading.Event()

    def late_events(since: int) -> Iterator[Event]:
        assert answered.wait(30)
        yield from TWO_AT_ONCE

    def request() -> Outcome:
        answered.set()
        return ANSWER

    client.events = late_events  # type: ignore[method-assign]
    followed = FollowedRequest(cast(Client, client), request, since=0, until="outcome", id="first")
    assert [event.words for event in followed] == ["replace talker with NewTalker", "1/1 done", "done"]

"""Each command shows its own events, whoever else is at the manager; no manager is needed for that."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import cast

from midstride.cli.client import Client, Document, Event
from midstride.cli.follow import FollowedRequest


def told(*events: tuple[str, str | None, str]) -> list[Event]:
    """Events as a manager numbers them: kind, whose, words."""
    return [
        {"n": n, "at": 0.0, "kind": kind, "words": words, **({"id": id} if kind in {"command", "waiting"} else {})}
        for n, (kind, id, words) in enumerate(events, 1)
    ]


class Scripted:
    """A client whose manager tells ``events``; what is asked of it is answered when they have been told."""

    def __init__(self, events: list[Event]) -> None:
        self._events = events
        self._told = threading.Event()

    def events(self, since: int) -> Iterator[Event]:
        yield from self._events[since:]
        self._told.set()

    def ask(self) -> Document:
        assert self._told.wait(30)
        return ANSWER


ANSWER = {"outcome": "done"}
TWO_AT_ONCE = told(
    ("command", "first", "replace talker by NewTalker"),
    ("waiting", "second", "`remove listener` waits for `replace talker by NewTalker`"),
    ("step_done", None, "1/1 done"),
    ("outcome", None, "done"),
    ("command", "second", "remove listener"),
    ("step_done", None, "1/1 done, of the second"),
    ("outcome", None, "done, of the second"),
)


def shown(id: str | None) -> list[str]:
    client = Scripted(TWO_AT_ONCE)
    followed = FollowedRequest(cast(Client, client), client.ask, since=0, until="outcome", id=id)
    words = [str(event["words"]) for event in followed]
    assert followed.answer() == ANSWER
    return words


def test_who_was_first_does_not_see_what_the_other_one_does() -> None:
    assert shown("first") == ["replace talker by NewTalker", "1/1 done", "done"]


def test_who_waits_sees_that_and_then_what_it_asked_for() -> None:
    waits, *rest = shown("second")
    assert waits.endswith("waits for `replace talker by NewTalker`")
    assert rest == ["remove listener", "1/1 done, of the second", "done, of the second"]


def test_without_a_name_everything_is_shown() -> None:
    assert len(shown(None)) == len(TWO_AT_ONCE)

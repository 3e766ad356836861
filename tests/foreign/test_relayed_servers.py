"""Requests to a program behind a relay: so many at once, in order, and what becomes of those that it never answers."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from midstride.errors import Unanswered
from midstride.foreign.relayed_servers import NEVER, ROOM, RelayedServer


class Request:
    pass


class Listing:
    __srvtype__ = "demo/srv/Listing"
    Request = Request
    Response = str


class Future:
    """As rclpy's, but that its callbacks are called at once."""

    def __init__(self) -> None:
        self.value: Any = None
        self.error: Exception | None = None
        self._callbacks: list[Callable[[Future], object]] = []

    def add_done_callback(self, callback: Callable[[Future], object]) -> None:
        self._callbacks.append(callback)

    def exception(self) -> Exception | None:
        return self.error

    def result(self) -> Any:
        return self.value

    def set_result(self, value: Any) -> None:
        self.value = value
        for callback in self._callbacks:
            callback(self)

    def set_exception(self, error: Exception) -> None:
        self.error = error


class Program:
    """A client of a program, and the clock; ``sent``: each request that the program has, and its response."""

    def __init__(self) -> None:
        self.now = 0.0
        self.sent: list[tuple[Any, Future]] = []
        self.there = False
        host: Any = SimpleNamespace(steady=lambda: int(self.now * 1e9), create_client=lambda *_: self)
        self.server = RelayedServer("map", Listing, "/_midstride/relay/maps/map", 0.5)
        self.server.connect(host)

    def call(self, request: Any) -> Future:
        self.sent.append((request, Future()))
        return self.sent[-1][1]

    unsent = staticmethod(Future)

    def abandon(self, future: Future, error: Exception) -> None:
        future.set_exception(error)

    def matched(self) -> int:
        return int(self.there)

    def asked(self, request: Any) -> Future:
        """A request that the relay is to answer."""
        given: Future = self.server.port.function(request, "")
        return given


def test_as_many_requests_as_its_queue_has_room_for_are_at_the_program_and_the_rest_follows_in_order() -> None:
    program = Program()
    given = [program.asked(number) for number in range(3 * ROOM)]
    assert [request for request, _ in program.sent] == list(range(ROOM))
    answered = 0
    while answered < len(given):
        request, response = program.sent[answered]
        response.set_result(f"for {request}")
        answered += 1
        assert len(program.sent) == min(answered + ROOM, len(given))
    assert [request for request, _ in program.sent] == list(range(3 * ROOM))
    assert [each.value for each in given] == [f"for {number}" for number in range(3 * ROOM)]


def test_requests_that_the_program_never_answers_hold_up_no_others_for_ever() -> None:
    program = Program()
    lost = [program.asked(number) for number in range(ROOM)]
    last = program.asked("last")
    program.now = 0.9 * NEVER
    program.server.send_waiting()
    assert len(program.sent) == ROOM
    program.now = 1.1 * NEVER
    program.server.send_waiting()
    assert program.sent[-1][0] == "last"
    program.sent[-1][1].set_result("answered")
    assert last.value == "answered"
    program.sent[0][1].set_result("late")  # which is passed on as well
    assert lost[0].value == "late" and lost[1].value is None


def test_what_a_program_that_has_exited_was_asked_ends() -> None:
    program = Program()
    given = [program.asked(number) for number in range(ROOM + 1)]
    program.server.give_up()
    assert all(isinstance(each.error, Unanswered) for each in given)
    program.sent[0][1].set_result("on its way when it exited")
    assert given[0].value is None
    with pytest.raises(Unanswered, match="the program that answers for server map has exited"):
        program.asked("another")


def test_the_program_is_there_once_its_server_has_been_discovered() -> None:
    program = Program()
    found = [program.server.matched]
    program.there = True
    found.append(program.server.matched)
    assert found == [False, True]
    assert program.server.port.within == 0.5

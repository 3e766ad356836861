"""Bounds of servers of components with the API: what is recorded of requests, and when a bound is broken."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from typing import Any

from midstride import Component
from midstride.backends.simulator.virtual_loop import run
from midstride.node.author.server_ports import ServerLink
from midstride.node.data.functionality_runner import FunctionalityRunner
from midstride.wire.state import MeasuredResponses
from tests.node.test_service_ports import ServiceHost, Trigger, nothing

S = 1_000_000_000
NAME = "/count"


class ClockHost(ServiceHost):
    """A host whose ``/clock`` a test sets, too (s)."""

    def __init__(self) -> None:
        super().__init__()
        self.simulated_time = False
        self.ros = 0.0

    def now(self) -> int:
        return round((self.ros if self.simulated_time else self.time) * S)


class Served:
    """A server with a bound of 0.1 s, in the mode ``normal``, which serves, or ``off``."""

    def __init__(self, within: float | None = 0.1, *, answers: bool = True) -> None:
        self.host = ClockHost()
        self.admission = self.host.admission
        self.admission.is_open = answers
        comp = Component("Server")
        self.port = comp.create_server("count", Trigger, lambda request, response: None, within=within)
        work = comp.create_functionality("work", outputs=[self.port])
        work.set_normal_mode(nothing, outputs=[self.port])
        work.set_degraded_mode(nothing, name="off")
        self.runner = FunctionalityRunner(work, self.host.host, lambda runner: None)
        self.port.owner, self.port.call = self.runner, self.runner.answer
        self.port.links = (ServerLink(self.port, NAME, self.host.host),)
        self.port.links[0].set_gate(True)
        self.enter(0)

    def enter(self, index: int) -> None:
        self.runner.enter_mode(index, "a test")

    def comes(self, request: str, waited: float = 0.0) -> None:
        self.admission.admit(request, lambda: None, service=NAME, waited=waited)

    def answers(self, request: str) -> None:
        self.admission.finished(request)

    def seen(self, at: float) -> MeasuredResponses | None:
        """What is reported at this time (s)."""
        self.host.time = at
        self.port.look(self.host.host)
        return self.port.states()[NAME].responses

    def broken(self, at: float) -> str | None:
        found = self.seen(at)
        return None if found is None else found.broken


def in_a_loop(check: Callable[[], None]) -> None:
    async def checked() -> None:
        check()

    coroutine: Coroutine[Any, Any, None] = checked()
    run(coroutine)


def test_a_request_that_is_not_answered_breaks_the_bound() -> None:
    def check() -> None:
        served = Served()
        served.seen(1)
        served.comes("a")
        found = served.seen(6)
        assert found is not None and (found.silent, found.broken) == (5.0, None)
        found = served.seen(6.1)
        assert found is not None
        assert found.words == "has not answered a request for 5.1 s, 0.1 s are promised"
        served.answers("a")
        found = served.seen(6.2)
        assert found is not None and (found.answered, found.late, found.broken) == (1, 1, None)

    in_a_loop(check)


def test_late_responses_in_succession_break_the_bound() -> None:
    def check() -> None:
        served = Served()
        served.seen(0)
        for number in range(30):
            served.host.time = number * 0.5
            served.comes(str(number))
            served.host.time += 0.3
            served.answers(str(number))
            found = served.seen(served.host.time)
        assert found is not None and (found.answered, found.late) == (30, 30)
        assert found.broken == "has answered late" and found.longest is not None and round(found.longest, 3) == 0.3
        served.comes("in time")
        served.answers("in time")
        assert served.broken(16) is None

    in_a_loop(check)


def test_a_data_thread_that_is_not_free_takes_no_requests() -> None:
    def check() -> None:
        served = Served()
        served.seen(0)
        served.host.busy = True
        served.seen(1)
        assert served.broken(6) is None
        assert served.broken(6.1) == "has not waited for requests"
        served.host.free()
        assert served.broken(6.2) is None

    in_a_loop(check)


def test_what_the_middleware_has_kept_a_request_for_counts() -> None:
    def check() -> None:
        served = Served()
        served.seen(10)
        served.comes("a", waited=0.7)
        served.answers("a")
        found = served.seen(10)
        assert found is not None and found.longest is not None and round(found.longest, 3) == 0.7

    in_a_loop(check)


def test_a_request_that_was_held_counts_from_when_it_is_handled() -> None:
    """The hand-over has kept it, and not this instance."""

    def check() -> None:
        served = Served(answers=False)
        served.comes("a")
        assert served.broken(4) is None
        served.admission.open([])
        served.host.time = 4.05
        served.answers("a")
        served.seen(4.05)
        served.comes("b")
        served.host.time = 4.1
        served.answers("b")
        found = served.seen(4.1)
        assert found is not None and (found.late, found.longest) == (0, 0.05)

    in_a_loop(check)


def test_in_simulated_time_nothing_is_late_while_the_clock_stands_still() -> None:
    def check() -> None:
        served = Served()
        served.host.simulated_time = True
        served.seen(0)
        served.comes("a", waited=3)  # which may have been while it stood still
        assert served.broken(100) is None
        served.host.ros = 5.1
        assert served.broken(200) == "has not answered a request"
        served.answers("a")
        served.comes("b")
        served.host.ros = 50
        found = served.seen(200.05)  # it runs fast: a bound is one of real time
        assert found is not None and round(found.silent, 3) == 0.05
        served.answers("b")

    in_a_loop(check)


def test_in_simulated_time_a_data_thread_may_wait_for_the_clock() -> None:
    """As in a function that sleeps by it, while it stands still."""

    def check() -> None:
        served = Served()
        served.host.simulated_time = True
        served.seen(0)
        served.host.ros = 50
        served.seen(50)
        served.host.busy = True
        served.seen(51)
        assert served.broken(100) is None
        served.host.ros = 55.1
        assert served.broken(200) == "has not waited for requests"
        served.host.free()
        assert served.broken(201) is None

    in_a_loop(check)


def test_nothing_is_reported_without_a_bound_or_in_a_mode_that_does_not_serve() -> None:
    def check() -> None:
        assert Served(within=None).seen(1) is None
        served = Served()
        served.enter(1)
        assert served.seen(1) is None

    in_a_loop(check)


def test_an_instance_that_does_not_answer_is_not_judged() -> None:
    def check() -> None:
        served = Served()
        served.seen(0)
        served.comes("a")
        assert served.broken(6) is not None
        served.admission.close()
        assert served.broken(7) is None
        served.port.links[0].destroy()
        assert not served.admission.timed

    in_a_loop(check)

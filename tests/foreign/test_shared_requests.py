"""Requests that a component with Midstride's API and a node with the library share: one of the two claims each."""

from __future__ import annotations

import asyncio
import contextlib
import random
import subprocess
from collections.abc import Callable, Coroutine, Iterator
from contextlib import contextmanager
from functools import partial
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import Any, cast

import pytest
from hypothesis import given
from hypothesis import strategies as st

from midstride.errors import BackendError
from midstride.foreign.page import KnownGoal
from midstride.foreign.page_layout import KNOWN, GoalState
from midstride.foreign.sharing_components import place, share_requests
from midstride.node.control import service_answering
from midstride.node.control.service_answering import SHARE_INTERVAL, Answering
from midstride.node.request_admission import HOLD, LEFT_OVER, PassableRequest, RequestAdmission
from midstride.node.shared_requests import RequestsSlot
from midstride.wire.commands import JoinRequestsCommand
from midstride.wire.replies import PagePlace
from tests.foreign.lab import Lab, until, variables
from tests.foreign.test_response_watch import server

REQUESTS = 20_000
# So many that the page knows of each, also if both note it: a process may get no time while the other claims all.
ALL_KNOWN = KNOWN // 2 - 1


class Page:
    """What the two know of each other: the slow twin of the page. ``answering``, ``before``: `own`, `other`."""

    def __init__(self, answering: str) -> None:
        self.answering, self.before = answering, ""
        self.taken: set[str] = set()
        self.held: dict[str, set[str]] = {"own": set(), "other": set()}
        self.unanswered, self.noted = 0, False

    def give(self, side: str) -> None:
        if self.answering != side:
            self.answering, self.before = side, self.answering

    # What the component asks of it.

    def answers(self) -> bool:
        return self.answering == "own"

    def answered_before(self) -> bool:
        return self.before == "own"

    def claim(self, request: str) -> bool:
        if request in self.taken:
            return False
        self.taken.add(request)
        self.unanswered += 1
        return True

    def note_claimed(self, request: str) -> None:
        self.taken.add(request)

    def note_held(self, request: str) -> None:
        self.held["own"].add(request)

    def has_noted(self) -> None:
        self.noted = True

    def claimed(self, request: str) -> bool:
        return request in self.taken

    def held_by_other(self, request: str) -> bool:
        return request not in self.taken and request in self.held["other"]

    def answered(self) -> None:
        self.unanswered -= 1


class Library:
    """The other node: it claims what it takes while it answers, and holds the rest."""

    def __init__(self, page: Page) -> None:
        self.page, self.held, self.handled = page, list[str](), list[str]()

    def receives(self, request: str) -> None:
        if self.page.answering == "other":
            self._claim(request)
        else:
            self.page.held["other"].add(request)
            self.held.append(request)

    def look(self) -> None:
        if self.page.answering == "other":
            held, self.held = self.held, []
            for request in held:
                self._claim(request)

    def _claim(self, request: str) -> None:
        if request not in self.page.taken:
            self.page.taken.add(request)
            self.handled.append(request)


class Component:
    def __init__(self, *, is_open: bool) -> None:
        self.time, self.handled = 0.0, list[str]()
        self.admission = RequestAdmission(lambda: int(self.time * 1e9), is_open=is_open)

    def receives(self, request: str, passable: PassableRequest | None = None) -> None:
        def handle() -> None:
            self.handled.append(request)
            self.admission.finished(request)

        if self.admission.admit(request, handle, passable):
            handle()


EVENTS = st.lists(
    st.one_of(st.tuples(st.sampled_from(["own", "other"]), st.integers(0, 9)), st.sampled_from(["look", "give"]))
)


@given(EVENTS, st.booleans())
def test_each_request_is_handled_once_in_whatever_order_the_two_receive_it(events: list[object], own: bool) -> None:
    """Either of the two answers at first, and the component joins before the other one is to answer."""
    component, page = Component(is_open=own), Page("own" if own else "other")
    library, received = Library(page), {"own": set[str](), "other": set[str]()}
    component.receives("1 99") if own else None  # handled before it joins; the other one holds it
    component.admission.share(page)
    if own:
        library.receives("1 99")
    sides: dict[str, Callable[[str], object]] = {"own": component.receives, "other": library.receives}
    rest = [(side, number) for number in range(10) for side in sides]
    for event in [*events, "give", "look", *rest, "look"]:
        match event:
            case "look":
                component.admission.look()
                library.look()
            case "give":
                page.give("other" if page.answering == "own" else "own")
            case (str(side), int(number)) if (request := f"1 {number}") not in received[side]:
                received[side].add(request)
                sides[side](request)
    expected = {f"1 {number}" for number in range(10)} | ({"1 99"} if own else set())
    assert sorted([*component.handled, *library.handled]) == sorted(expected)
    assert page.unanswered == 0
    assert component.admission.is_open == (page.answering == "own")


def test_what_its_successor_has_not_received_is_handled_here_after_a_while() -> None:
    component, page = Component(is_open=True), Page("own")
    component.admission.share(page)
    page.give("other")
    component.receives("1 1")
    component.receives("1 2")
    page.held["other"].add("1 2")  # which has it, and is busy
    component.time = LEFT_OVER - 0.01
    component.admission.look()
    assert component.handled == []
    component.time = LEFT_OVER + 0.01
    component.admission.look()
    assert component.handled == ["1 1"]
    page.taken.add("1 2")
    component.time = LEFT_OVER + 0.02
    component.admission.look()
    assert component.handled == ["1 1"]
    assert not component.admission.passable()


def test_one_that_waits_handles_nothing_that_the_other_one_has_not_received() -> None:
    """It has never answered: what the one that answers has not taken yet is that one's."""
    component, page = Component(is_open=False), Page("other")
    component.admission.share(page)
    component.receives("1 1")
    component.time = HOLD - 0.1
    component.admission.look()
    assert component.handled == []
    page.give("own")
    component.admission.look()
    assert component.handled == ["1 1"]


def test_one_that_ends_begins_no_request_but_those_that_only_it_has() -> None:
    component, page = Component(is_open=True), Page("own")
    component.admission.share(page)
    page.give("other")
    component.admission.look()
    component.admission.pause()
    answered = PassableRequest("/count", bytes, lambda data: None)
    component.receives("1 1", answered)
    component.admission.look()
    assert component.handled == []
    assert list(component.admission.passable()) == ["1 1"]  # it is waited for
    component.time = LEFT_OVER + 0.01
    component.admission.look()
    assert component.handled == ["1 1"]


def test_what_is_still_handled_when_it_joins_is_waited_for() -> None:
    component, page = Component(is_open=True), Page("own")
    for request in ("1 1", "1 2", "goal 1"):
        assert component.admission.admit(request, lambda: None)
    component.admission.finished("1 1")
    component.admission.share(page)
    assert (page.taken, page.unanswered, page.noted) == ({"1 1", "1 2"}, 1, True)
    component.admission.finished("1 2")
    component.admission.finished("goal 1")
    assert page.unanswered == 0


def test_it_leaves_the_page_only_in_a_moment_in_which_it_is_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Another node may come at any time, and is to find it there."""
    events, tasks, none = list[str](), list[asyncio.Task[None]](), cast(Any, None)

    class Slot(Page):
        def __init__(self, where: PagePlace) -> None:
            super().__init__("own")
            self.place = where

        def serve(self, services: set[str]) -> None: ...

        @property
        def is_alone(self) -> bool:
            events.append("is alone")
            return True

        def leave(self) -> None:
            events.append("leaves")

    async def sleep(seconds: float) -> None:
        events.append("sleeps")

    def start(work: Coroutine[Any, Any, None]) -> None:
        tasks.append(asyncio.get_running_loop().create_task(work))

    async def main() -> None:
        answering = Answering(Component(is_open=True).admission, none, lambda: None, start, sleep, str)
        await answering.join(JoinRequestsCommand(place=PagePlace(page="page", library="library", index=0)))
        await asyncio.gather(*tasks)

    monkeypatch.setattr(service_answering, "RequestsSlot", Slot)
    asyncio.run(main())
    assert events[-2:] == ["is alone", "leaves"]
    assert events.count("sleeps") >= round(HOLD / SHARE_INTERVAL) - 1


def joined(lab: Lab, of: int | None = None) -> RequestsSlot:
    slot = RequestsSlot(place(lab.page, share_requests(lab.page, "component", of)))
    slot.has_noted()
    return slot


@pytest.mark.parametrize("seed", range(5))
def test_of_two_that_claim_at_once_one_does(lab: Lab, seed: int) -> None:
    """A server that takes as fast as it can, in another process, and a component that claims just the same requests."""
    chance, page = random.Random(seed), lab.page
    index = page.allocate("server")
    page.have_requests(index)
    own = joined(lab, index)
    claimed = sum(own.claim(f"0 {number}") for number in range(1, 100, 7))
    given = variables(page.path, lab.programs, lab.library, lab.log, index)
    command = [str(lab.programs / "server"), "/count", str(ALL_KNOWN)]
    process = subprocess.Popen(command, env=given, stdout=subprocess.DEVNULL)
    until(lambda: "/count" in page.servers(index), "the server does not join")
    port = page.servers(index)["/count"]
    number, role = 0, page._requests[page.layout.nodes[index].requests - 1]
    while number < ALL_KNOWN:
        taken = int(role.knows) - claimed  # by the server
        number = min(max(number + 1, taken + chance.randrange(-1, 4)), ALL_KNOWN)
        claimed += own.claim(f"0 {number}")
    assert process.wait(30) == 0
    assert int(port.passed) + claimed == ALL_KNOWN
    own.leave()
    assert own.answers() and own.is_alone, "it has left"


def test_of_two_nodes_with_the_library_one_claims_while_a_component_shares_the_role(lab: Lab) -> None:
    """It has no such service, so both claim at once, each request."""
    page, own = lab.page, joined(lab)
    processes = []
    indices = [page.allocate(name) for name in ("old", "new")]
    for index in indices:
        page.have_requests(index, own.place.index)
    for index in indices:
        given = variables(page.path, lab.programs, lab.library, lab.log, index)
        command = [str(lab.programs / "server"), "/count", str(REQUESTS)]
        processes.append(subprocess.Popen(command, env=given, stdout=subprocess.DEVNULL))
    assert [process.wait(60) for process in processes] == [0, 0]
    assert sum(int(page.servers(index)["/count"].passed) for index in indices) == REQUESTS
    own.leave()


def asked(connection: Connection, where: PagePlace) -> None:
    """The component in another process: a process does not see its own locks. It does what it is asked."""
    own = RequestsSlot(where)
    while True:
        name, *arguments = connection.recv()
        found = getattr(own, name)
        connection.send(found(*arguments) if callable(found) else found)


@contextmanager
def elsewhere(where: PagePlace) -> Iterator[Callable[..., Any]]:
    here, there = get_context("spawn").Pipe()
    process = get_context("spawn").Process(target=asked, args=(there, where))
    process.start()
    there.close()  # else nothing would tell that it has ended

    def ask(*what: Any) -> Any:
        here.send(what)
        return here.recv()

    try:
        yield ask
    finally:
        process.kill()
        process.join()


def test_a_component_and_a_node_change_places(lab: Lab) -> None:
    """The node begins when the component has answered what it had claimed; then the component is to answer again.

    It goes on where that has died.
    """
    page = lab.page
    index = share_requests(page, "component")
    with elsewhere(place(page, index)) as ask:
        ask("serve", {"/count"})
        ask("has_noted")
        assert ask("answers") and ask("is_alone")
        assert ask("claim", "7 1") and not ask("claim", "7 1")
        new = page.allocate("server")
        page.have_requests(new, index)
        assert page.answering(new) == index
        assert not ask("is_alone")
        page.give_requests(new, 5.0)
        assert not ask("answers") and ask("answered_before")
        assert page.layout.nodes[index].unanswered == 1
        ask("answered")
        assert page.layout.nodes[index].unanswered == 0
        ask("answer", 5.0)
        assert ask("answers") and page.answering(new) == index
        page.give_requests(new, 5.0)
        assert not ask("answers")
        page.layout.nodes[new].pid = 2**22 + 1  # no process has its lock: it has died
        assert ask("answers") and ask("is_alone")
        page.free(index)
        assert ask("answers"), "its part was taken back"
    assert share_requests(page, "component") == index, "its part is free"


@pytest.mark.parametrize("joined", ["never", "just before"])
@pytest.mark.parametrize("way", ["its part is taken back", "the other one is to answer"])
def test_what_was_held_when_a_component_died_that_had_noted_nothing_is_not_answered(
    lab: Lab, way: str, joined: str
) -> None:
    """The component may have answered each of them. A request that arrives later is answered."""
    page = lab.page
    index = share_requests(page, "component")
    with server(lab, index) as served:
        with contextlib.nullcontext() if joined == "never" else elsewhere(place(page, index)) as ask:
            assert ask is None or ask("answers")
            for _ in range(3):
                served.does("take")
            node, port = served.port.node - 1, served.port
            until(lambda: port.gated == 3, "the requests are not held")
        assert page.is_dead(index) == (joined != "never")
        if way == "its part is taken back":
            page.free(index)
        else:
            page.give_requests(node, 0.0)
        page.ring(node)
        until(lambda: port.gated == 0, "the requests are still held")
        assert port.passed == 0
        served.does("take")
        assert port.passed == 1


def test_what_had_arrived_and_was_not_taken_when_such_a_component_died_is_not_answered(lab: Lab) -> None:
    """The component may have answered it, too; what counts is when it came, as the middleware says."""
    page = lab.page
    index = share_requests(page, "component")
    with server(lab, index, FAKE_RECEIVED_MS="20000") as served:
        port = served.port
        page.give_requests(port.node - 1, 0.0)
        served.does("take")
        assert (port.passed, port.gated) == (0, 0)


def test_a_component_that_has_noted_what_it_had_handled_leaves_the_rest_to_the_other_one(lab: Lab) -> None:
    page = lab.page
    index = share_requests(page, "component")
    with server(lab, index) as served:
        with elsewhere(place(page, index)) as ask:
            ask("serve", {"/count"})
            ask("note_claimed", "0 1")
            ask("has_noted")
            for _ in range(3):
                served.does("take")
            port = served.port
            until(lambda: port.gated == 2, "two requests are not held")
        page.give_requests(port.node - 1, 0.0)
        for _ in range(2):
            served.does("take")
        assert port.passed == 2


def ended_node(lab: Lab) -> int:
    """The index of a node with requests whose part of the page has been taken back."""
    index = lab.page.allocate("server")
    lab.page.have_requests(index)
    lab.page.free(index)
    return index


def test_with_a_node_that_has_ended_nothing_is_shared(lab: Lab) -> None:
    with pytest.raises(BackendError, match="it has ended"):
        share_requests(lab.page, "component", ended_node(lab))


def test_a_node_that_has_just_ended_is_not_to_answer(lab: Lab) -> None:
    """Its part of the page is taken back while the manager waits for others."""
    page, index = lab.page, ended_node(lab)
    with pytest.raises(BackendError, match="the node has ended"):
        page.give_requests(index, 0.0)
    page.forget_goal(index, KnownGoal("/count", GoalState.ENDED, bytes(16), 0, 0))
    assert page.answering(index) is None


def test_what_is_noted_is_known_by_whose_it_is(lab: Lab) -> None:
    page = lab.page
    index = page.allocate("server")
    page.have_requests(index)
    own = joined(lab, index)
    own.note_held("7 1")
    assert not own.claimed("7 1") and not own.held_by_other("7 1")
    own.note_claimed("7 2")
    assert own.claimed("7 2") and not own.claim("7 2")
    for number in range(5000):  # more than there are places
        own.note_claimed(f"8 {number}")
    assert not own.claimed("7 2")
    assert all(map(own.claimed, map(partial("8 {}".format), range(2000, 5000))))
    own.leave()

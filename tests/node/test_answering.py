"""Which instance of a role answers: the admission of its requests, and the commands that open and close it."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Awaitable, Callable, Coroutine
from functools import partial
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from midstride.backends.simulator.virtual_loop import run
from midstride.errors import BackendError, CallTimeout, CommandRefused, Unreachable
from midstride.node.control.component_end import REQUESTS_SECONDS, ComponentEnd
from midstride.node.control.service_answering import PASS_INTERVAL, SERVE_TIMEOUT, YIELD_ATTEMPTS, Answering
from midstride.node.request_admission import (
    HELD,
    HOLD,
    PASS_AFTER,
    REMEMBER,
    REMEMBERED,
    PassableRequest,
    RequestAdmission,
)
from midstride.wire.commands import (
    AnswerCommand,
    Command,
    MissingRequestsCommand,
    ServeCommand,
    YieldCommand,
)
from midstride.wire.frames import Reply, encode_value
from midstride.wire.replies import Answers, FetchedState


class Server:
    """An admission, with the requests that were handled."""

    def __init__(self, *, is_open: bool) -> None:
        self.time = 0.0
        self.handled: list[str] = []
        self.admission = RequestAdmission(lambda: int(self.time * 1e9), is_open=is_open)

    def receives(self, *requests: str) -> None:
        for request in requests:
            if self.admission.admit(request, lambda request=request: self.handled.append(request)):  # type: ignore[misc]
                self.handled.append(request)


@given(st.lists(st.one_of(st.tuples(st.sampled_from("ab"), st.integers(0, 9)), st.just("change"))))
def test_each_request_is_handled_exactly_once_however_the_two_receive_it(events: list[Any]) -> None:
    """Each of two servers receives each request, each in its own order; in between, the other one starts to answer."""
    servers = {"a": Server(is_open=True), "b": Server(is_open=False)}
    open_, closed = "ab"
    received = {"a": set[int](), "b": set[int]()}
    rest = [(name, number) for number in range(10) for name in "ab"]
    for event in [*events, *rest]:
        if event == "change":
            open_, closed = closed, open_
            servers[open_].admission.open(servers[closed].admission.close())
        elif event[1] not in received[event[0]]:
            received[event[0]].add(event[1])
            servers[event[0]].receives(str(event[1]))
    assert Counter(servers["a"].handled + servers["b"].handled) == {str(number): 1 for number in range(10)}


def test_what_came_while_the_predecessor_closed_is_handled_in_order() -> None:
    new = Server(is_open=False)
    new.receives("1", "2", "3")
    assert new.handled == []
    new.admission.open(["2"])
    assert new.handled == ["1", "3"]
    new.receives("4", "2", "1")
    assert new.handled == ["1", "3", "4"]


def test_what_a_predecessor_may_have_handled_before_it_exited_is_not_handled_again() -> None:
    new = Server(is_open=False)
    new.receives("1")
    new.admission.open(None)
    new.receives("2")
    assert new.handled == ["2"]


def test_how_lately_a_request_was_handled_to_the_end_is_known() -> None:
    server = Server(is_open=True)
    assert not server.admission.answered_within(1.0)
    server.receives("1")
    assert not server.admission.answered_within(1.0)
    server.time = 5.0
    server.admission.finished("1")
    server.time = 5.9
    assert server.admission.answered_within(1.0) and not server.admission.answered_within(0.9)


def test_a_request_is_held_for_a_bounded_time_and_in_bounded_number() -> None:
    new = Server(is_open=False)
    new.receives("old")
    new.time = HOLD + 1
    new.receives(*map(str, range(HELD + 1)))
    new.admission.open([])
    assert new.handled == list(map(str, range(1, HELD + 1)))


def test_what_a_server_receives_late_since_its_thread_was_held_up_is_not_handled_again() -> None:
    """A successor constructs its node, or the predecessor was stopped, for 50 s: what waits for it arrives then."""
    old, new = Server(is_open=True), Server(is_open=False)
    old.receives("1")
    old.time = new.time = 50.0
    old.receives("2")
    new.receives("1", "2")
    new.admission.open(old.admission.close())
    assert (old.handled, new.handled) == (["1", "2"], [])
    new.receives("3")
    new.time += 50.0
    new.receives("4")
    assert new.admission.missing(["3", "4"]) == []


def test_handled_requests_are_remembered_longer_than_they_are_held_and_not_for_ever() -> None:
    old = Server(is_open=True)
    old.receives("1")
    old.time = HOLD + 1
    old.receives("2")
    assert old.admission.close() == ["1", "2"]
    old.time = REMEMBER + 1
    old.receives("3")
    assert old.admission.close() == ["2"]
    old.admission.open(f"other {number}" for number in range(2 * REMEMBERED))
    old.receives("last")
    assert len(old.admission.close()) == REMEMBERED
    assert old.handled == ["1", "2", "3", "last"]


# -- the commands --------------------------------------------------------------------------------------


class Peer:
    """The instance that answers, with its own admission; ``faults`` are raised by its next calls."""

    def __init__(self, *faults: Exception) -> None:
        self.server = Server(is_open=True)
        self.faults = list(faults)
        self.calls: list[Command[Any]] = []

    async def call(self, address: str, command: Command[Any], timeout: float) -> Reply:
        assert address == "its address" and isinstance(command, YieldCommand)
        self.calls.append(command)
        if self.faults:
            raise self.faults.pop(0)
        result = await answering(self.server, self).stop(command)
        return Reply(id="1", revision=1, result=encode_value(result))


def answering(server: Server, peer: Peer) -> Answering:
    """Its part in a process that passes no request on."""
    return Answering(server.admission, peer.call, lambda: None, Coroutine.close, asyncio.sleep, lambda: "")


def answer(server: Server, peer: Peer, address: str | None = "its address") -> Answers:
    command = AnswerCommand(peer="talker", address=address)
    return asyncio.run(answering(server, peer).answer(command))


@pytest.mark.parametrize("lost", [0, YIELD_ATTEMPTS - 1])
def test_the_successor_takes_over_with_what_was_handled(lost: int) -> None:
    new, peer = Server(is_open=False), Peer(*[CallTimeout("its reply is lost")] * lost)
    peer.server.receives("1")
    new.receives("1", "2")
    answer(new, peer)
    peer.server.receives("2", "3")
    new.receives("3")
    assert (peer.server.handled, new.handled) == (["1"], ["2", "3"])
    answer(new, peer)
    assert len(peer.calls) == lost + 1, "it answers already"


def test_a_predecessor_that_has_exited_is_not_waited_for() -> None:
    new, peer = Server(is_open=False), Peer(Unreachable("it has exited"))
    new.receives("1")
    answer(new, peer)
    new.receives("2")
    assert new.handled == ["2"]


@pytest.mark.parametrize("address", [None, "its address"])
def test_what_was_held_while_state_was_to_move_is_handled_if_the_new_side_has_exited(address: str | None) -> None:
    """It cannot have begun to answer; once it has asked the old one to stop, it may have."""
    old, exited = Server(is_open=True), Peer(Unreachable("it has exited"))
    old.admission.pause()
    old.receives("1")
    answer(old, exited, address)
    assert old.handled == ["1"]
    old.admission.pause()
    old.admission.close()
    old.receives("2")
    answer(old, Peer(Unreachable("it has exited")), address)
    assert old.handled == ["1"]


def test_a_predecessor_that_may_still_answer_keeps_the_successor_closed() -> None:
    new, peer = Server(is_open=False), Peer(*[CallTimeout("it is busy")] * YIELD_ATTEMPTS)
    with pytest.raises(CommandRefused, match=r"talker did not respond within 1\.5 s"):
        answer(new, peer)
    assert not new.admission.is_open
    answer(new, peer, address=None)
    assert new.admission.is_open


# -- requests that reach the predecessor alone ---------------------------------------------------------


class Instance:
    """One of two instances that can reach each other, on the loop's clock; ``handled`` by name of the request.

    ``responses``: what clients have received from it, for requests that it passed on.
    """

    def __init__(self, name: str, instances: dict[str, Instance], *, is_open: bool) -> None:
        self.name = name
        self.handled: list[str] = []
        self.responses: dict[str, bytes] = {}
        self.faults: list[BackendError] = []  # of its next calls
        self.raises = False
        self._instances = instances
        self._tasks: set[asyncio.Task[None]] = set()
        instances[name] = self
        clock = asyncio.get_running_loop().time
        self.admission = RequestAdmission(lambda: int(clock() * 1e9), is_open=is_open)
        self.admission.passed_handlers["/talker/count"] = self.handles_passed
        self.answering = Answering(
            self.admission, self.call, lambda: None, self._start, asyncio.sleep, lambda: self.name
        )

    def receives(self, request: str) -> None:
        handle = partial(self.handles, request)
        respond = partial(self.responses.__setitem__, request)
        if self.admission.admit(request, handle, PassableRequest("/talker/count", request.encode, respond)):
            handle()

    def handles(self, request: str) -> None:
        self.handled.append(request)
        self.admission.finished(request)

    def handles_passed(self, request: str, data: bytes, respond: Callable[[bytes | None], object]) -> None:
        assert data == request.encode()
        self.handles(request)
        respond(None if self.raises else f"{request} by {self.name}".encode())

    async def call(self, address: str, command: Command[Any], timeout: float) -> Reply:
        if self.faults:
            raise self.faults.pop(0)
        peer = self._instances[address].answering
        handlers: dict[type[Command[Any]], Callable[[Any], Awaitable[Any]]] = {
            YieldCommand: peer.stop,
            MissingRequestsCommand: peer.missing,
            ServeCommand: peer.serve,
        }
        return Reply(id="1", revision=1, result=encode_value(await handlers[type(command)](command)))

    async def takes_over(self, old: Instance) -> None:
        await self.answering.answer(AnswerCommand(peer=old.name, address=old.name))

    def _start(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.ensure_future(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)


PASSED = PASS_AFTER + 2 * PASS_INTERVAL + 0.01


@given(
    st.lists(st.one_of(st.tuples(st.integers(0, 9), st.booleans()), st.just("wait"), st.just("change")), max_size=30)
)
def test_each_request_is_handled_once_although_the_one_that_does_not_answer_may_not_receive_it(
    events: list[Any],
) -> None:
    """Each request reaches the instance that has answered so far; the other one receives it, or never does."""

    async def main() -> tuple[Counter[str], set[str]]:
        instances: dict[str, Instance] = {}
        old, new = Instance("a", instances, is_open=True), Instance("b", instances, is_open=False)
        sent: set[str] = set()
        for event in events:
            if event == "change":
                await new.takes_over(old)
                old, new = new, old
            elif event == "wait":
                await asyncio.sleep(PASSED)
            elif str(event[0]) not in sent:
                sent.add(str(event[0]))
                # The client may know only the one that has answered until the last change.
                for instance in {new, old} if event[1] else {new if old.admission.yields else old}:
                    instance.receives(str(event[0]))
        await asyncio.sleep(PASSED)
        return Counter(old.handled + new.handled), sent

    handled, sent = run(main())
    assert handled == dict.fromkeys(sent, 1)


# Longer than a request is held by an instance that another one has replaced.
LONG = HOLD + 1.0


class Transfer:
    """Moves state between two instances: the one that answers, ``old``, and the other one, step by step."""

    def __init__(self) -> None:
        instances: dict[str, Instance] = {}
        self.old = Instance("a", instances, is_open=True)
        self.new = Instance("b", instances, is_open=False)
        self.sent: list[str] = []
        self.step = "apart"

    def send(self) -> None:
        """A request to both."""
        self.sent.append(str(len(self.sent)))
        for instance in (self.old, self.new):
            instance.receives(self.sent[-1])

    def pause(self) -> None:
        """The state of the old one is exported."""
        assert self.old.answering.pause()
        self.step, self._yields = "paused", self.new.admission.yields

    def move(self) -> None:
        """The new one has imported the state, and the old one has confirmed that."""
        requests = self.old.admission.handled
        self.old.answering.state_moved(self.new.name)
        found = FetchedState(state=b"", handled={}, since=0, requests=requests)
        self.new.answering.take_over(found, self.old.name, self._yields)
        self.step = "moved"

    async def ask(self) -> None:
        """The manager has the new one ask, since the old one has not confirmed."""
        await self.new.takes_over(self.old)
        self.step = "moved"

    async def take_back(self) -> None:
        """The old one resumes."""
        await self.old.answering.take_back(self.new.name, self.new.name)
        self.step = "apart"

    async def end(self) -> None:
        """It has moved, and nothing is passed on any more: the next one is the other way."""
        await asyncio.sleep(PASSED)
        self.old, self.new, self.step = self.new, self.old, "apart"

    @property
    def times_handled(self) -> Counter[str]:
        return Counter(self.old.handled + self.new.handled)


@given(
    st.lists(st.sampled_from(["send", "wait", "wait long", "pause", "move", "ask", "take back", "end"]), max_size=30)
)
def test_each_request_is_handled_once_while_state_moves_however_long_that_takes_or_if_it_does_not(
    events: list[str],
) -> None:
    async def main() -> tuple[Counter[str], list[str]]:
        transfer = Transfer()
        for event in events:
            match event, transfer.step:
                case "send", _:
                    transfer.send()
                case "wait", _:
                    await asyncio.sleep(PASSED / 4)
                case "wait long", _:
                    await asyncio.sleep(LONG)
                case "pause", "apart":
                    transfer.pause()
                case "move", "paused":
                    transfer.move()
                case "ask", "paused":
                    await transfer.ask()
                case "take back", "paused" | "moved":
                    await transfer.take_back()
                case "end", "moved":
                    await transfer.end()
        if transfer.step == "paused":
            await transfer.take_back()
        await asyncio.sleep(PASSED)
        return transfer.times_handled, transfer.sent

    handled, sent = run(main())
    assert handled == dict.fromkeys(sent, 1)


@pytest.mark.parametrize("confirmed", [True, False])
def test_what_the_new_side_has_answered_is_not_answered_again_when_the_old_one_resumes_much_later(
    confirmed: bool,
) -> None:
    """Also where the old one has only been asked to stop, and does not know that the state has moved."""

    async def main() -> Transfer:
        transfer = Transfer()
        transfer.pause()
        transfer.send()
        if confirmed:
            transfer.move()
        else:
            await transfer.ask()
        for _ in range(int(2 * REMEMBER)):
            await asyncio.sleep(1.0)
            transfer.send()
        await transfer.take_back()
        transfer.send()
        return transfer

    transfer = run(main())
    assert transfer.times_handled == dict.fromkeys(transfer.sent, 1)
    assert transfer.old.handled == [transfer.sent[-1]]


def test_what_was_held_for_longer_than_a_successor_holds_it_is_passed_on() -> None:
    async def main() -> Transfer:
        transfer = Transfer()
        transfer.pause()
        transfer.send()
        await asyncio.sleep(LONG)
        transfer.send()
        transfer.move()
        transfer.send()
        await asyncio.sleep(PASSED)
        return transfer

    transfer = run(main())
    assert (transfer.old.handled, transfer.new.handled) == ([], ["1", "2", "0"])
    assert transfer.old.responses == {"0": b"0 by b"}


def test_what_only_the_predecessor_receives_is_handled_by_the_successor_and_answered() -> None:
    async def main() -> tuple[Instance, Instance]:
        instances: dict[str, Instance] = {}
        old, new = Instance("a", instances, is_open=True), Instance("b", instances, is_open=False)
        await new.takes_over(old)
        old.receives("1")
        for instance in (old, new):
            instance.receives("2")
        assert old.answering.undecided() == ["1", "2"]
        old.faults = [CallTimeout("its reply is lost")]  # it asks again
        await asyncio.sleep(PASSED)
        assert not old.answering.undecided() and not old.admission.busy
        new.receives("1")  # which has been on its way for very long
        return old, new

    old, new = run(main())
    assert (old.handled, new.handled) == ([], ["2", "1"])
    assert old.responses == {"1": b"1 by b"}


def test_a_predecessor_passes_on_although_its_successor_begins_late() -> None:
    """Until it begins, it refuses to say what it has received: its predecessor has stopped, and the reply is late."""

    async def main() -> tuple[Instance, Instance]:
        instances: dict[str, Instance] = {}
        old, new = Instance("a", instances, is_open=True), Instance("b", instances, is_open=False)
        await old.answering.stop(YieldCommand(address="b"))
        old.receives("1")
        await asyncio.sleep(PASSED)
        assert old.answering.undecided() == ["1"] and not new.handled
        await new.takes_over(old)
        await asyncio.sleep(PASSED)
        assert not old.answering.undecided()
        return old, new

    old, new = run(main())
    assert (old.handled, new.handled, old.responses) == ([], ["1"], {"1": b"1 by b"})


@pytest.mark.parametrize("raises", [True, False])
def test_a_request_that_was_passed_on_and_gets_no_response_does_not_keep_the_predecessor(raises: bool) -> None:
    async def main() -> tuple[Instance, Instance]:
        instances: dict[str, Instance] = {}
        old, new = Instance("a", instances, is_open=True), Instance("b", instances, is_open=False)
        await new.takes_over(old)
        new.raises = raises
        if not raises:
            del new.admission.passed_handlers["/talker/count"]
        old.receives("1")
        await asyncio.sleep(PASSED + SERVE_TIMEOUT)
        assert not old.admission.busy
        return old, new

    old, new = run(main())
    assert old.responses == {} and new.handled == (["1"] if raises else [])


def test_an_instance_that_answers_again_passes_nothing_on() -> None:
    async def main() -> tuple[list[str], list[str]]:
        instances: dict[str, Instance] = {}
        old, new = Instance("a", instances, is_open=True), Instance("b", instances, is_open=False)
        await new.takes_over(old)
        old.receives("1")
        await old.takes_over(new)
        assert old.answering.undecided() == []
        await asyncio.sleep(PASSED)
        return old.handled, new.handled

    assert run(main()) == (["1"], [])


def test_requests_of_which_the_successor_says_nothing_are_waited_for_and_named() -> None:
    async def main() -> None:
        clock, said = asyncio.get_running_loop().time, list[str]()

        def steady() -> int:
            return int(clock() * 1e9)

        callbacks = SimpleNamespace(stop=None, stop_timeout=1.0)
        end: Any = object.__new__(ComponentEnd)
        end.parts = SimpleNamespace(callbacks=callbacks)
        end.host = SimpleNamespace(
            admission=RequestAdmission(steady, is_open=False),
            instance="old",
            logger=SimpleNamespace(error=said.append),
            sleep=asyncio.sleep,
            steady=steady,
        )
        answering = SimpleNamespace(has_successor=True, may_pass_on=True, undecided=lambda: ["request 1"])
        end.handovers = SimpleNamespace(answering=answering)
        assert end.seconds() > REQUESTS_SECONDS
        await end._finish_requests(steady() + int(REQUESTS_SECONDS * 1e9))
        words = "after 10 s, its successor has not said which of the requests held here it has received"
        assert said == [f"old ends, but {words}"] and clock() >= REQUESTS_SECONDS
        answering.undecided = list
        assert end.seconds() < REQUESTS_SECONDS

    run(main())

"""The manager's connections: revisions, requests repeated and undone, and the news of components that go and come."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any

import pytest

from midstride.backends.simulator.virtual_clock import SimulatedClock
from midstride.backends.simulator.virtual_loop import run
from midstride.errors import CallTimeout, CommandRefused, ProtocolError, RevisionChanged, Superseded, Unreachable
from midstride.runtime.instance_life import ANSWER_TIMEOUT, SILENCE, ConnectionEvent, ConnectionState
from midstride.runtime.process.component_client import (
    REOPEN_INTERVAL,
    UNDO_ATTEMPTS,
    ComponentClient,
    ComponentEvent,
    Disconnected,
)
from midstride.wire.command_server import CommandServer
from midstride.wire.commands import AttachCommand, GateCommand, GridCommand, ObserveCommand
from midstride.wire.frames import (
    OLDEST,
    PROTOCOL,
    Greeting,
    Registration,
    Reply,
    Request,
    StateChanged,
    decode_command,
    encode_value,
)
from midstride.wire.pipe import PipeEnd, PipeNetwork
from midstride.wire.replies import Attached, Done, Grid
from midstride.wire.state import ComponentState
from tests.runtime.scripted import TALKER, TOKEN, registration

GATE = GateCommand(port="out", topic="/chatter", gate="open")
ATTACH = AttachCommand(port="out", topic="/chatter")
GRID = GridCommand(port="out")


class Component:
    """A component named talker that keeps to the rules of the envelope, on a real command server."""

    def __init__(self, uuid: str = "first", protocol: int = PROTOCOL) -> None:
        self.uuid = uuid
        self.revision = 5
        self.requests: list[Request] = []
        self.carried_out: list[str] = []  # the names of the changes, each once
        self.lost_replies = 0
        self.lost_requests = 0
        self.tokens: set[str] = set()
        self._replies: dict[str, Reply] = {}
        self.server = CommandServer(
            Greeting(protocol=protocol, instance="talker", uuid=uuid, pid=7, start_token=TOKEN), self.handle
        )

    def state(self) -> ComponentState:
        return ComponentState(
            instance="talker",
            uuid=self.uuid,
            pid=7,
            revision=self.revision,
            functionalities={},
            ports={},
            parameters={},
            stopping=0.0,
        )

    def move(self) -> None:
        """Something has changed by itself: another revision, reported."""
        self.revision += 1
        self.server.report(StateChanged(state=self.state()))

    async def handle(self, request: Request, token: str) -> Reply:
        self.requests.append(request)
        self.tokens.add(token)
        if self.lost_requests:
            self.lost_requests -= 1
            await asyncio.Event().wait()
        command = decode_command(request)
        if command.kind != "changing":
            result = self.state() if isinstance(command, ObserveCommand) else Grid(trigger="none", now=1)
            reply = Reply(id=request.id, revision=self.revision, result=encode_value(result))
        elif request.id in self._replies:
            reply = self._replies[request.id]
        elif request.revision != self.revision:
            words = f"the component is at {self.revision}"
            reply = self._replies[request.id] = Reply(id=request.id, revision=self.revision, refused=words)
        else:
            self.revision += 1
            self.carried_out.append(command.name)
            done = Attached(matched=2) if isinstance(command, AttachCommand) else Done()
            reply = Reply(id=request.id, revision=self.revision, result=encode_value(done))
            self._replies[request.id] = reply
        if self.lost_replies:
            self.lost_replies -= 1
            await asyncio.Event().wait()
        return reply

    def names(self) -> list[str]:
        return [decode_command(request).name for request in self.requests]


class CountedNetwork(PipeNetwork):
    """Remembers the connections; ``peer`` is the process at the other end of each (None: the component itself)."""

    def __init__(self) -> None:
        super().__init__()
        self.opened: list[PipeEnd] = []
        self.peer: int | None = None
        self.overloaded = False  # the component listens, and accepts no connection

    async def connect(self, address: str) -> PipeEnd:
        if self.overloaded:
            raise CallTimeout(f"{address} accepts no connection: its process is stopped or overloaded")
        end = await super().connect(address)
        end.peer = self.peer
        self.opened.append(end)
        return end


class Control:
    """A client, the components that it talks to, and what it has heard."""

    def __init__(self) -> None:
        self.clock = SimulatedClock()
        self.clock.follow(asyncio.get_running_loop())
        self.network = CountedNetwork()
        self.events: list[ComponentEvent] = []
        self.client = ComponentClient(self.network, self.clock, TOKEN, listeners=[self.events.append])
        self.component = Component()

    async def start(self, component: Component | None = None) -> None:
        self.component = component or self.component
        await self.component.server.open(self.network)

    async def stop(self) -> None:
        await self.component.server.close(0.0)
        await settled()


async def settled() -> None:
    """Until everything that has been sent has arrived."""
    await asyncio.sleep(0.001)


def play(body: Callable[[Control], Coroutine[Any, Any, None]], listening: bool = True) -> None:
    """Run ``body`` in virtual time; the component listens from the beginning, or not yet."""

    async def main() -> None:
        control = Control()
        if listening:
            await control.start()
        await body(control)
        control.client.close()

    run(main())


# -- revisions -----------------------------------------------------------------------------------------


def test_a_change_names_the_revision_that_the_last_one_led_to() -> None:
    async def body(c: Control) -> None:
        assert await c.client.change("talker", ATTACH) == Attached(matched=2)
        await c.client.change("talker", GATE)
        assert c.component.names() == ["observe", "attach", "gate"], "it is observed once"
        assert [request.revision for request in c.component.requests] == [None, 5, 6]
        assert len({request.id for request in c.component.requests}) == 3
        assert c.component.tokens == {TOKEN}

    play(body)


def test_reading_needs_no_revision_and_changes_none() -> None:
    async def body(c: Control) -> None:
        assert await c.client.read("talker", GRID) == Grid(trigger="none", now=1)
        assert c.component.names() == ["grid"] and c.component.requests[0].revision is None
        await c.client.change("talker", GATE)
        c.component.revision += 1
        assert (await c.client.peek("talker")).revision == 7
        await c.client.read("talker", GRID)
        with pytest.raises(CommandRefused, match="talker refused `gate`: the component is at 7"):
            await c.client.change("talker", GATE)

    play(body)


def test_after_a_refusal_the_next_change_observes_first() -> None:
    async def body(c: Control) -> None:
        await c.client.observe("talker")
        c.component.revision += 1  # it has degraded by itself, and has not been heard of yet
        with pytest.raises(RevisionChanged):
            await c.client.change("talker", GATE)
        await c.client.change("talker", GATE)
        assert c.component.names() == ["observe", "gate", "observe", "gate"]

    play(body)


def test_a_reported_state_that_is_accepted_is_the_one_expected() -> None:
    async def body(c: Control) -> None:
        await c.client.observe("talker")
        c.component.move()
        await settled()
        assert c.client.life.latest("talker") is not None
        c.client.accept("talker")
        await c.client.change("talker", GATE)
        assert c.component.names() == ["observe", "gate"]

    play(body)


# -- lost messages -------------------------------------------------------------------------------------


def test_a_request_is_repeated_once_under_its_id_and_carried_out_once() -> None:
    async def body(c: Control) -> None:
        await c.client.observe("talker")
        c.component.lost_replies = 1
        assert await c.client.change("talker", ATTACH) == Attached(matched=2)
        assert c.clock.steady() == pytest.approx(ATTACH.timeout + ANSWER_TIMEOUT)
        _, first, second = c.component.requests
        assert first == second and c.component.carried_out == ["attach"]
        c.component.lost_requests = 1
        await c.client.change("talker", GATE)
        assert c.component.carried_out == ["attach", "gate"]

    play(body)


def test_a_component_that_does_not_answer_twice_may_have_changed() -> None:
    async def body(c: Control) -> None:
        await c.client.observe("talker")
        c.component.lost_replies = 2
        with pytest.raises(CallTimeout, match="talker did not answer `gate` within 5 s and, asked again, 3 s more"):
            await c.client.change("talker", GATE)
        assert c.clock.steady() == pytest.approx(GATE.timeout + 2 * ANSWER_TIMEOUT)
        await c.client.change("talker", GATE)  # at the revision that it is at by now
        assert c.component.names() == ["observe", "gate", "gate", "observe", "gate"]

    play(body)


@pytest.mark.parametrize("how", ["not listening", "ends meanwhile"])
def test_a_component_that_is_gone_is_named(how: str) -> None:
    async def body(c: Control) -> None:
        if how == "ends meanwhile":
            c.component.lost_replies = 1
            asyncio.get_running_loop().call_later(1.0, asyncio.ensure_future, c.stop())
        with pytest.raises(Unreachable, match="talker cannot be reached for `grid`"):
            await c.client.read("talker", GRID)
        assert c.clock.steady() <= 1.1

    play(body, listening=how == "ends meanwhile")


# -- undoing -------------------------------------------------------------------------------------------


def test_nothing_is_changed_or_undone_once_another_manager_has_taken_over() -> None:
    async def body(c: Control) -> None:
        await c.client.change("talker", GATE)
        c.client.superseded = lambda: True
        with pytest.raises(Superseded, match="another manager of this system has taken over"):
            await c.client.change("talker", ATTACH)
        await c.client.undo("talker", GATE)
        await c.client.peek("talker")
        assert c.component.names() == ["observe", "gate", "observe"]

    play(body)


def test_undoing_does_not_depend_on_the_revision() -> None:
    async def body(c: Control) -> None:
        await c.client.observe("talker")
        c.component.revision += 3
        await c.client.undo("talker", GATE)
        assert c.component.carried_out == ["gate"]

    play(body)


def test_undoing_waits_for_a_change_that_was_still_under_way() -> None:
    """Its state is read before that change ends, which moves the revision on."""

    async def body(c: Control) -> None:
        observe = c.component.state

        def state() -> ComponentState:
            found = observe()
            if len(c.component.requests) == 1:
                c.component.revision += 1
            return found

        c.component.state = state  # type: ignore[method-assign]
        await c.client.undo("talker", GATE)
        assert c.component.names() == ["observe", "gate", "observe", "gate"]
        assert c.component.carried_out == ["gate"]

    play(body)


def test_an_undo_that_is_owed_is_sent_once_the_component_can_be_reached_again() -> None:
    async def body(c: Control) -> None:
        c.client.owe("talker", GATE)
        c.client.owe("listener", GATE)
        await c.client.send_owed()
        assert c.component.names() == []
        await c.client.connect("talker")
        c.component.move()
        await settled()
        await c.client.send_owed()
        await c.client.send_owed()
        assert c.component.carried_out == ["gate"]
        c.client.owe("talker", GATE)
        c.client.disconnect("talker")
        await c.client.connect("talker")
        c.component.move()
        await settled()
        await c.client.send_owed()
        assert c.component.carried_out == ["gate"], "it was owed to a process that is gone"

    play(body)


def move_whenever_observed(component: Component) -> None:
    """Have the component change right after each look at it, so that no change is at its revision."""
    observe = component.state

    def state() -> ComponentState:
        found = observe()
        component.revision += 1
        return found

    component.state = state  # type: ignore[method-assign]


def test_an_undo_that_is_owed_and_cannot_be_carried_out_stays_owed() -> None:
    async def body(c: Control) -> None:
        await c.client.connect("talker")
        c.component.move()
        await settled()
        move_whenever_observed(c.component)
        c.client.owe("talker", GATE)
        await c.client.send_owed()
        assert c.component.carried_out == []
        del c.component.state
        await c.client.send_owed()
        await c.client.send_owed()
        assert c.component.carried_out == ["gate"]

    play(body)


def test_undoing_gives_up_silently() -> None:
    async def body(c: Control) -> None:
        move_whenever_observed(c.component)
        await c.client.undo("talker", GATE)
        assert c.component.names() == ["observe", "gate"] * UNDO_ATTEMPTS and c.component.carried_out == []
        await c.stop()
        await c.client.undo("talker", GATE)

    play(body)


# -- what is reported ----------------------------------------------------------------------------------


def test_states_are_kept_as_they_come() -> None:
    async def body(c: Control) -> None:
        assert c.client.life.latest("talker") is None
        greeting = await c.client.connect("talker")
        assert (greeting.instance, greeting.uuid) == ("talker", "first")
        c.component.move()
        c.component.move()
        await settled()
        latest = c.client.life.latest("talker")
        assert latest is not None and latest.state == c.component.state() and c.events[-1] == latest.state

    play(body)


def test_a_component_that_reports_nothing_for_some_time_is_silent() -> None:
    async def body(c: Control) -> None:
        await c.client.connect("talker")
        c.component.move()
        await settled()
        state = c.client.life.responsive("talker")
        assert state == c.component.state()
        latest = c.client.life.latest("talker")
        assert latest is not None
        await asyncio.sleep(latest.at + SILENCE - c.clock.steady())
        assert c.client.life.responsive("talker") == state
        await asyncio.sleep(0.001)
        assert c.client.life.responsive("talker") is None
        assert c.client.life.latest("talker") == latest, "it is known what it said last"
        c.component.move()
        await settled()
        assert c.client.life.responsive("talker") == c.component.state()

    play(body)


def test_the_end_of_a_component_is_reported_once() -> None:
    async def body(c: Control) -> None:
        await c.client.observe("talker")
        c.component.move()
        await settled()
        assert not c.client.life.is_gone("talker")
        await c.stop()
        assert c.client.life.is_gone("talker")
        assert c.events == [c.component.state(), Disconnected("talker")]
        assert c.client.life.latest("talker") is None and c.client.life.responsive("talker") is None

    play(body)


def test_a_connection_that_a_protocol_error_has_closed_is_reopened_at_once() -> None:
    async def body(c: Control) -> None:
        await c.client.observe("talker")
        for attempt in range(3):
            began = c.clock.steady()
            c.network.opened[-1].arrive(b"not a frame")
            await settled()
            assert len(c.network.opened) == 2 + attempt
            await asyncio.sleep(REOPEN_INTERVAL)  # the next attempt is not made before
            c.component.move()
            await settled()
            assert c.client.life.responsive("talker") == c.component.state(), (
                "it reports again, and no command was sent"
            )
            assert c.clock.steady() - began < REOPEN_INTERVAL + 0.1
        assert not c.client.life.is_gone("talker") and not any(isinstance(event, Disconnected) for event in c.events)

    play(body)


def test_a_component_that_sends_nothing_but_errors_is_not_connected_all_the_time() -> None:
    async def body(c: Control) -> None:
        await c.client.observe("talker")
        until, broken = c.clock.steady() + 10 * REOPEN_INTERVAL, 0
        while c.clock.steady() < until:
            if len(c.network.opened) > broken:  # connected again
                broken = len(c.network.opened)
                await settled()
                c.network.opened[-1].arrive(b"not a frame")
            await settled()
        assert 8 <= len(c.network.opened) <= 12

    play(body)


def test_the_end_of_a_forwarded_connection_is_not_that_of_the_component() -> None:
    async def body(c: Control) -> None:
        c.network.peer = 4711  # the process of `ssh`; the component's is 7
        await c.client.observe("talker")
        listening = c.network.listeners.pop("talker")
        c.network.opened[-1].other.close()
        await asyncio.sleep(5.5)
        assert c.events == [Disconnected("talker", exited=False)], "it is reported once"
        assert not c.client.life.is_gone("talker") and c.client.life.responsive("talker") is None
        c.network.listeners["talker"] = listening
        await asyncio.sleep(REOPEN_INTERVAL)
        c.component.move()
        await settled()
        assert c.client.life.responsive("talker") == c.component.state()

    play(body)


def test_a_component_that_accepts_no_connection_has_not_exited() -> None:
    async def body(c: Control) -> None:
        await c.client.observe("talker")
        c.network.overloaded = True
        c.network.opened[-1].other.close()
        await asyncio.sleep(5.5)
        assert c.events == [Disconnected("talker", exited=False)] and not c.client.life.is_gone("talker")
        with pytest.raises(CallTimeout, match=r"talker cannot be reached for `grid`: .* accepts no connection"):
            await c.client.read("talker", GRID)
        c.network.overloaded = False
        await asyncio.sleep(REOPEN_INTERVAL)
        c.component.move()
        await settled()
        assert c.client.life.responsive("talker") == c.component.state()

    play(body)


@pytest.mark.parametrize("successor", [Component("second"), Component("second", protocol=OLDEST - 1)])
def test_another_component_that_took_the_name_shows_that_the_first_has_exited(successor: Component) -> None:
    async def body(c: Control) -> None:
        c.network.peer = 4711
        await c.client.observe("talker")
        await c.component.server.close(0.0)
        await c.start(successor)
        await settled()
        assert c.client.life.is_gone("talker") and c.events == [Disconnected("talker", exited=True)]

    play(body)


def test_the_end_of_that_other_component_brings_the_first_one_not_back() -> None:
    async def body(c: Control) -> None:
        c.network.peer = 4711
        await c.client.observe("talker")
        await c.component.server.close(0.0)
        c.network.peer = None
        await c.start(Component("second"))
        await settled()
        await c.stop()
        await asyncio.sleep(2 * REOPEN_INTERVAL)
        assert c.client.life["talker"].connection is ConnectionState.GONE
        assert [each.event for each in c.client.life["talker"].history][-2:] == [
            ConnectionEvent.BROKEN,
            ConnectionEvent.REFUSED,
        ]

    play(body)


def test_nothing_is_reopened_after_the_manager_disconnects() -> None:
    async def body(c: Control) -> None:
        c.network.peer = 4711
        await c.client.observe("talker")
        await c.stop()
        c.client.disconnect("talker")
        await c.start(Component("second"))
        opened = len(c.network.opened)
        await asyncio.sleep(5 * REOPEN_INTERVAL)
        assert len(c.network.opened) == opened

    play(body)


def test_what_the_manager_disconnects_is_no_news() -> None:
    async def body(c: Control) -> None:
        await c.client.observe("talker")
        c.client.disconnect("talker")
        c.client.disconnect("talker")
        await c.stop()
        assert c.events == [] and not c.client.life.is_gone("talker")

    play(body)


# -- coming up -----------------------------------------------------------------------------------------


def test_a_component_is_connected_as_soon_as_it_listens_and_registered_as_soon_as_it_is_set_up() -> None:
    async def body(c: Control) -> None:
        connecting, registering = (
            asyncio.ensure_future(work) for work in (c.client.connect("talker"), c.client.registered("talker"))
        )
        await asyncio.sleep(3)
        assert not connecting.done()
        await c.start()
        await asyncio.sleep(0.1)
        assert connecting.done() and not registering.done()
        said = registration(TALKER)
        c.component.server.register(said)
        await settled()
        assert registering.done() and await registering == (await connecting, said)
        assert await c.client.registered("talker") == await registering, "whenever it is asked for"

    play(body, listening=False)


def test_one_that_ends_before_it_is_set_up_is_not_waited_for_but_the_next(caplog: pytest.LogCaptureFixture) -> None:
    async def body(c: Control) -> None:
        registering = asyncio.ensure_future(c.client.registered("talker"))
        await settled()
        await c.stop()
        await c.start(Component("second"))
        c.component.server.register(registration(TALKER))
        greeting, said = await registering
        assert greeting.uuid == "second" and isinstance(said, Registration)

    play(body)
    assert caplog.text == ""


def test_a_component_that_comes_back_under_its_name_is_another_one() -> None:
    async def body(c: Control) -> None:
        await c.client.change("talker", GATE)
        c.component.move()
        await settled()
        await c.stop()
        again = Component("second")
        await c.start(again)
        assert c.client.life.latest("talker") is None
        await c.client.change("talker", GATE)
        assert again.names() == ["observe", "gate"], "its revisions are its own"
        assert not c.client.life.is_gone("talker")
        assert (await c.client.peek("talker")).uuid == "second"

    play(body)


def test_a_component_of_another_version_of_the_protocol_is_refused_with_what_to_do() -> None:
    async def body(c: Control) -> None:
        await c.start(Component(protocol=OLDEST - 1))
        words = f"talker speaks version {OLDEST - 1} of the control protocol.*restart it"
        for attempt in (c.client.connect("talker"), c.client.registered("talker"), c.client.observe("talker")):
            with pytest.raises(ProtocolError, match=words):
                await attempt
        assert c.component.requests == []

    play(body, listening=False)

"""The manager's control connections: every command with token, id and expected revision, and every state reported.

There is one connection to each component, opened when it is first needed and kept open; where it closes and the
component has not exited, it is reopened. Components push their state after every change and twice a second, so the
latest one is known without polling.
"""

from __future__ import annotations

import asyncio
import uuid
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final, TypeVar

from midstride.errors import (
    BackendError,
    CallTimeout,
    CommandRefused,
    ProtocolError,
    RevisionChanged,
    Superseded,
    Unreachable,
)
from midstride.runtime.instance_life import ANSWER_TIMEOUT, STOPPED, ConnectionEvent, LifeTable
from midstride.runtime.manager_clock import Clock
from midstride.wire.channel import Channel, ComponentReport, result_of
from midstride.wire.commands import Command, ObserveCommand
from midstride.wire.frames import PROTOCOL, WITH_PLACE, Greeting, Registration, Reply
from midstride.wire.state import ComponentState, Endpoint
from midstride.wire.transport import Transport

R = TypeVar("R")

# How often an undo is tried if the component's revision changes meanwhile.
UNDO_ATTEMPTS: Final = 2
# The interval between attempts to connect to a component that is starting (s).
CONNECT_INTERVAL: Final = 0.005
CONNECT_INTERVAL_LONGEST: Final = 0.1
# The shortest interval between attempts to reopen a connection that has closed (s).
REOPEN_INTERVAL: Final = 1.0


@dataclass(frozen=True, slots=True)
class Disconnected:
    """A component's control connection has closed and cannot be reopened.

    ``exited``: its process has exited or is about to. Else it may still run: it does not answer, or what has ended is a
    program that forwarded the connection.
    """

    instance: str
    exited: bool = True


# A component has reported its state, or it has disconnected.
ComponentEvent = ComponentState | Disconnected


@dataclass
class ComponentClient:
    """Sends commands to components, each change with the revision that the component is expected to be at.

    A component refuses a change at any other revision. It recognizes its manager by ``token``. Each listener is called
    with every reported state and every disconnection. Once another manager has taken over, as ``superseded`` says,
    nothing is changed or undone any more. What becomes of the connections, and what components report, is recorded in
    ``life``. Not thread-safe: use it on one event loop.
    """

    transport: Transport
    clock: Clock
    token: str
    superseded: Callable[[], bool] = lambda: False
    listeners: list[Callable[[ComponentEvent], object]] = field(default_factory=list)
    life: LifeTable = field(init=False)
    _revisions: dict[str, int] = field(default_factory=dict)
    _channels: dict[str, Channel] = field(default_factory=dict)
    _connecting: dict[str, asyncio.Lock] = field(default_factory=dict)
    _reopening: dict[str, asyncio.Task[None]] = field(default_factory=dict)
    _reopened_at: dict[str, float] = field(default_factory=dict)
    _registrations: dict[str, asyncio.Future[Registration]] = field(default_factory=dict)
    _owed: dict[str, list[Command[Any]]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.life = LifeTable(self.clock)

    def address(self, instance: str, seen_from: str | None = None) -> str:
        """The address at which the component listens, as its peer of a hand-over is to use it (``seen_from``)."""
        return self.transport.address(instance, seen_from)

    async def share_locks(self, instance: str, other: str) -> bool:
        """Return whether the locks of both components exclude each other, which they do not on two hosts.

        Raises BackendError where one cannot be reached.
        """
        greetings = [(await self._channel(each)).greeting for each in (instance, other)]
        if any(each.protocol < WITH_PLACE for each in greetings):  # it does not say; nor does it know of leases
            return True
        places = [each.place for each in greetings]
        return places[0] != "" and places[0] == places[1]

    async def connect(self, instance: str) -> Greeting:
        """Connect as soon as the component listens; returns its greeting. It waits without limit: cancel it.

        Raises ProtocolError for a component of another version of Midstride.
        """
        pause = CONNECT_INTERVAL
        while True:
            try:
                return (await self._channel(instance)).greeting
            except (Unreachable, CallTimeout):
                await self.clock.sleep(pause)
                pause = min(1.2 * pause, CONNECT_INTERVAL_LONGEST)

    async def registered(self, instance: str) -> tuple[Greeting, Registration]:
        """The component's greeting and registration, as soon as it has registered. Waits and raises as ``connect``."""
        while True:
            greeting = await self.connect(instance)
            try:
                return greeting, await asyncio.shield(self._registrations[instance])
            except Unreachable:
                continue  # it exited before it registered; another process may start under the same name

    def protocol(self, instance: str) -> int:
        """The version of the control protocol that is spoken with the component; ours while it is not connected."""
        channel = self._channels.get(instance)
        return PROTOCOL if channel is None else channel.greeting.protocol

    def endpoints(self, instance: str) -> list[Endpoint]:
        """The endpoints that the component's node had besides its ports when it registered; none before that."""
        registration = self._registrations.get(instance)
        if registration is None or not registration.done() or registration.exception() is not None:
            return []
        return registration.result().endpoints

    async def _channel(self, instance: str) -> Channel:
        """Raises Unreachable, CallTimeout or ProtocolError."""
        async with self._connecting.setdefault(instance, asyncio.Lock()):
            known = self._channels.get(instance)
            if known is not None and not known.closed.is_set():
                return known
            self._registrations[instance] = asyncio.get_running_loop().create_future()
            channel = await Channel.open(
                self.transport,
                self.address(instance),
                self.token,
                timeout=ANSWER_TIMEOUT,
                report=lambda frame: self._on_report(instance, frame),
                ended=lambda: self._on_closed(instance, channel),
            )
            self.life.record(instance, ConnectionEvent.OPENED)
            self._channels[instance] = channel
            return channel

    def _on_report(self, instance: str, frame: ComponentReport) -> None:
        if isinstance(frame, Registration):
            registration = self._registrations[instance]
            if not registration.done():
                registration.set_result(frame)
            return
        self.life.reported(frame.state)
        self._tell_listeners(frame.state)

    def _tell_listeners(self, event: ComponentEvent) -> None:
        for listener in self.listeners:
            listener(event)

    def _on_closed(self, instance: str, channel: Channel) -> None:
        if self._channels.get(instance) is channel:
            self._drop(instance, ConnectionEvent.BROKEN)
            reopening = self._reopening.get(instance)
            if reopening is None or reopening.done():
                loop = asyncio.get_running_loop()
                self._reopening[instance] = loop.create_task(self._reopen(instance, channel))

    async def _reopen(self, instance: str, closed: Channel) -> None:
        """Connect again, until that succeeds or shows that the component has exited."""
        exited = reported = False
        while not exited:
            earliest = self._reopened_at.get(instance, -REOPEN_INTERVAL) + REOPEN_INTERVAL
            await self.clock.sleep(max(0.0, earliest - self.clock.steady()))
            self._reopened_at[instance] = self.clock.steady()
            try:
                if (await self._channel(instance)).greeting.uuid == closed.greeting.uuid:
                    return
                exited = True
            except CallTimeout:
                pass
            except Unreachable:
                exited = closed.direct
            except ProtocolError:
                exited = True  # its name is another component's by now
            if exited:
                self.life.record(instance, ConnectionEvent.REFUSED)
            if exited or not reported:
                reported = True
                self._tell_listeners(Disconnected(instance, exited))

    def disconnect(self, instance: str) -> None:
        """Close the connection: the component was released or has exited. The listeners are not called."""
        if reopening := self._reopening.pop(instance, None):
            reopening.cancel()
        self._reopened_at.pop(instance, None)
        self._owed.pop(instance, None)
        channel = self._channels.get(instance)
        self._drop(instance, ConnectionEvent.DISCONNECTED)
        if channel is not None:
            channel.close()

    def _drop(self, instance: str, event: ConnectionEvent) -> None:
        self.forget_revision(instance)
        self.life.record(instance, event)
        self._channels.pop(instance, None)
        registration = self._registrations.pop(instance, None)
        if registration is not None and not registration.done():
            registration.set_exception(Unreachable(f"{instance} ended before it was set up"))
            registration.exception()  # retrieved, so that the loop does not log it if nothing awaits it

    def close(self) -> None:
        """Close every connection; the components keep running."""
        for instance in {*self._channels, *self._reopening}:
            self.disconnect(instance)

    async def read(self, instance: str, command: Command[R]) -> R:
        """Send a command that changes nothing.

        Raises CommandRefused, CallTimeout or Unreachable, each naming the component and the command.
        """
        return await self._send(instance, command, None)

    async def change(self, instance: str, command: Command[R]) -> R:
        """Send a command that changes the component. Raises as ``read``, RevisionChanged and Superseded."""
        if self.superseded():
            raise Superseded("another manager of this system has taken over")
        if instance not in self._revisions:
            await self.observe(instance)
        return await self._send(instance, command, self._revisions.get(instance))

    async def observe(self, instance: str) -> ComponentState:
        """The component's state. Later changes expect its revision."""
        state = await self.peek(instance)
        self._revisions[instance] = state.revision
        return state

    async def peek(self, instance: str, look: float = 0.0) -> ComponentState:
        """The component's state: the expected revision does not change.

        ``look``: for how long the agent of a node without Midstride's API may look for what is not known yet (s).
        """
        return await self.read(instance, ObserveCommand(timeout=look))

    def accept(self, instance: str) -> None:
        """The last reported state has been taken into the model. Later changes expect its revision."""
        latest = self.life.latest(instance)
        assert latest is not None
        self._revisions[instance] = latest.state.revision

    async def undo(self, instance: str, command: Command[Any]) -> bool:
        """Send a change that undoes another one, at whatever revision the component is; whether it is carried out.

        A command that timed out may still be in progress at the component. It completes first and changes the revision,
        so a refused undo is sent again. A silent component is not waited for. Nothing is sent once another manager has
        taken over.
        """
        if self.life.is_silent(instance) or self.superseded():
            return False
        for _ in range(UNDO_ATTEMPTS):
            self.forget_revision(instance)
            try:
                await self.change(instance, command)
            except CommandRefused:
                continue
            except (BackendError, Superseded):
                return False
            return True
        return False

    def owe(self, instance: str, command: Command[Any]) -> None:
        """Keep the undo ``command``, which could not be carried out, for when the component can be reached again."""
        self._owed.setdefault(instance, []).append(command)

    async def send_owed(self) -> None:
        """Send the undos that are owed to components that can be reached again. One that is not carried out stays."""
        for instance in [name for name in self._owed if self.life.responsive(name) is not None]:
            for command in self._owed.pop(instance):
                if not await self.undo(instance, command) and not self.life.is_gone(instance):
                    self.owe(instance, command)

    def forget_revision(self, instance: str) -> None:
        """The component's revision is unknown from now on: the next change observes it first."""
        self._revisions.pop(instance, None)

    async def _send(self, instance: str, command: Command[R], revision: int | None) -> R:
        try:
            reply = await self._request(instance, command, revision)
        except CallTimeout as error:
            self.forget_revision(instance)  # the command may or may not have been carried out
            if instance not in self._channels:
                raise CallTimeout(f"{instance} cannot be reached for `{command.name}`: {error}") from None
            how = f"within {command.timeout + ANSWER_TIMEOUT:.3g} s and, asked again, {ANSWER_TIMEOUT:g} s more"
            if (latest := self.life.latest(instance)) is not None and self.life.is_silent(instance):
                how = f"and has reported nothing for {self.clock.steady() - latest.at:.1f} s"
            raise CallTimeout(f"{instance} did not answer `{command.name}` {how}") from None
        except Unreachable as error:
            self.forget_revision(instance)
            raise Unreachable(f"{instance} cannot be reached for `{command.name}`: {error}") from None
        if revision is not None:
            self._revisions[instance] = reply.revision
        try:
            return result_of(reply, command)
        except CommandRefused as error:
            self.forget_revision(instance)  # its state is not the expected one
            kind = CommandRefused if revision in (None, reply.revision) else RevisionChanged
            raise kind(f"{instance} refused `{command.name}`: {error}") from None

    async def _request(self, instance: str, command: Command[R], revision: int | None) -> Reply:
        """Send a request, and once more under the same id if no reply comes: it is carried out only once."""
        id, timeout = uuid.uuid4().hex, command.timeout + ANSWER_TIMEOUT
        try:
            return await self._unless_stopped(instance, command, revision, timeout, id)
        except CallTimeout:
            if self.life.is_silent(instance):
                raise
            return await self._unless_stopped(instance, command, revision, ANSWER_TIMEOUT, id)

    async def _unless_stopped(
        self, instance: str, command: Command[R], revision: int | None, timeout: float, id: str
    ) -> Reply:
        """One request. Raises CallTimeout once the component has neither answered nor reported for too long."""
        channel = await self._channel(instance)
        sent = self.clock.steady()
        exchange = channel.begin(command, revision=revision, id=id)
        try:
            while not exchange.done():
                given_up = sent + timeout
                if (latest := self.life.latest(instance)) is not None:  # None: it has not registered yet
                    given_up = min(given_up, max(latest.at + STOPPED, sent + ANSWER_TIMEOUT))
                left = given_up - self.clock.steady()
                if left <= 0:
                    raise CallTimeout(f"{instance} has neither answered nor reported in time")
                await asyncio.wait({exchange}, timeout=left)
            return exchange.result()
        finally:
            exchange.cancel()

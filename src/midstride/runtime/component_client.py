"""The manager's control connections: every command with token, id and expected revision, and every state reported.

One connection to each component, opened when it is first needed and kept. Its end is the news that the component is
gone. The component pushes its state after every change and twice a second, so the latest one is here without asking.
"""

from __future__ import annotations

import asyncio
import uuid
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, TypeVar

from midstride.errors import BackendError, CallTimeout, CommandRefused, Unreachable
from midstride.runtime.clock import Clock
from midstride.wire.channel import Channel, Report, result_of
from midstride.wire.commands import Command, ObserveCommand
from midstride.wire.frames import Greeting, Registration, Reply
from midstride.wire.state import ComponentState
from midstride.wire.transport import Transport

R = TypeVar("R")

# How long a component may take to answer what needs no user code (s), on top of a command's own time-out.
ANSWER_TIMEOUT: Final = 3.0
# How often a change is undone again where an earlier command ended only meanwhile.
UNDO_ATTEMPTS: Final = 2
# A component that has reported nothing for so long (s) is silent: it reports twice a second.
SILENCE: Final = 2.0
# How often a control address is tried while its component is coming up (s).
CONNECT_INTERVAL: Final = 0.005
CONNECT_INTERVAL_LONGEST: Final = 0.1


@dataclass(frozen=True, slots=True)
class Reported:
    """A component has reported its state."""

    state: ComponentState


@dataclass(frozen=True, slots=True)
class Disconnected:
    """A component's control connection has ended: its process has, or is about to."""

    instance: str


ComponentEvent = Reported | Disconnected


@dataclass(frozen=True, slots=True)
class LatestState:
    """The last state a component reported, and when it came (steady s)."""

    state: ComponentState
    at: float


class ComponentClient:
    """Knows the revision each component is at, so that a change is refused where the component has moved on.

    ``on_event`` is called for each state and each disconnection. To be used on one event loop.
    """

    def __init__(
        self,
        transport: Transport,
        clock: Clock,
        token: str,
        on_event: Callable[[ComponentEvent], None] = lambda _: None,
    ) -> None:
        self._transport = transport
        self._clock = clock
        self._token = token
        self._on_event = on_event
        self._prefix = uuid.uuid4().hex[:12]
        self._count = 0
        self._revisions: dict[str, int] = {}
        self._channels: dict[str, Channel] = {}
        self._connecting: dict[str, asyncio.Lock] = {}
        self._latest: dict[str, LatestState] = {}
        self._lost: set[str] = set()
        self._registrations: dict[str, asyncio.Future[Registration]] = {}

    # -- connections -------------------------------------------------------------------------------

    def address(self, instance: str) -> str:
        """Where the component listens: what its peer of a hand-over is given."""
        return self._transport.address(instance)

    async def connect(self, instance: str) -> Greeting:
        """Connect as soon as the component listens; what it greets with. To be cancelled when time is up.

        Raises ProtocolError for a component of another version of Midstride.
        """
        pause = CONNECT_INTERVAL
        while True:
            try:
                return (await self._channel(instance)).greeting
            except (Unreachable, CallTimeout):
                await self._clock.sleep(pause)
                pause = min(1.2 * pause, CONNECT_INTERVAL_LONGEST)

    async def registered(self, instance: str) -> tuple[Greeting, Registration]:
        """What the component is, as soon as it is set up and has said so. As ``connect``."""
        while True:
            greeting = await self.connect(instance)
            try:
                return greeting, await asyncio.shield(self._registrations[instance])
            except Unreachable:
                continue  # it ended before it was set up; another one may come

    async def _channel(self, instance: str) -> Channel:
        """Raises Unreachable, CallTimeout or ProtocolError."""
        async with self._connecting.setdefault(instance, asyncio.Lock()):
            channel = self._channels.get(instance)
            if channel is not None and not channel.closed.is_set():
                return channel
            made: list[Channel] = []

            def report(frame: Report) -> None:
                self._reported(instance, made[0], frame)

            def ended() -> None:
                self._ended(instance, made[0])

            self._registrations[instance] = asyncio.get_running_loop().create_future()
            channel = await Channel.open(
                self._transport,
                self._transport.address(instance),
                self._token,
                timeout=ANSWER_TIMEOUT,
                report=report,
                ended=ended,
            )
            made.append(channel)
            self._lost.discard(instance)
            self._channels[instance] = channel
            return channel

    def _reported(self, instance: str, channel: Channel, frame: Report) -> None:
        if isinstance(frame, Registration):
            registration = self._registrations[instance]
            if not registration.done():
                registration.set_result(frame)
            return
        self._latest[instance] = LatestState(frame.state, self._clock.steady())
        self._on_event(Reported(frame.state))

    def _ended(self, instance: str, channel: Channel) -> None:
        if self._channels.get(instance) is channel:
            self._drop(instance)
            self._lost.add(instance)
            self._on_event(Disconnected(instance))

    def greeting(self, instance: str) -> Greeting | None:
        """What the component greeted with, while it is connected."""
        channel = self._channels.get(instance)
        return None if channel is None else channel.greeting

    def latest(self, instance: str) -> LatestState | None:
        """The state that the component last reported, while it is connected."""
        return self._latest.get(instance)

    def is_lost(self, instance: str) -> bool:
        """Whether the component has ended its last connection, and has not come back."""
        return instance in self._lost

    def responsive(self, instance: str) -> ComponentState | None:
        """The state that the component last reported; None where it is gone or has been silent for ``SILENCE``."""
        latest = self._latest.get(instance)
        if latest is None or self._clock.steady() - latest.at > SILENCE:
            return None
        return latest.state

    def disconnect(self, instance: str) -> None:
        """The component is not this manager's any more, or its process is gone."""
        channel = self._channels.get(instance)
        self._drop(instance)
        if channel is not None:
            channel.close()

    def _drop(self, instance: str) -> None:
        self.forget(instance)
        self._latest.pop(instance, None)
        self._channels.pop(instance, None)
        registration = self._registrations.pop(instance, None)
        if registration is not None and not registration.done():
            registration.set_exception(Unreachable(f"{instance} ended before it was set up"))
            registration.exception()  # seen, so that the loop does not complain where it is not awaited

    def close(self) -> None:
        """Close every connection; the components go on."""
        for instance in list(self._channels):
            self.disconnect(instance)

    # -- commands ----------------------------------------------------------------------------------

    async def read(self, instance: str, command: Command[R]) -> R:
        """Send a command that changes nothing.

        Raises CommandRefused, CallTimeout or Unreachable, each naming the component and the command.
        """
        return await self._send(instance, command, None)

    async def change(self, instance: str, command: Command[R]) -> R:
        """Send a command that changes the component. Raises as ``read``."""
        if instance not in self._revisions:
            await self.observe(instance)
        return await self._send(instance, command, self._revisions.get(instance))

    async def observe(self, instance: str) -> ComponentState:
        """The component's state; its revision is the one expected from now on."""
        state = await self.read(instance, ObserveCommand(timeout=0.0))
        self._revisions[instance] = state.revision
        return state

    async def peek(self, instance: str) -> ComponentState:
        """The component's state, for showing: the revision expected of it stays as it is."""
        return await self.read(instance, ObserveCommand(timeout=0.0))

    def accept(self, instance: str) -> None:
        """The state that it last reported is in the model now: its revision is the one expected from now on."""
        self._revisions[instance] = self._latest[instance].state.revision

    async def undo(self, instance: str, command: Command[Any]) -> None:
        """Have a component put something back, whatever revision it is at; a refusal is final, a failure ignored.

        A command that was given up may still be under way there. It is carried out first, and the component has moved
        on: then it is asked again.
        """
        for _ in range(UNDO_ATTEMPTS):
            self.forget(instance)
            try:
                await self.change(instance, command)
            except CommandRefused:
                continue
            except BackendError:
                pass
            return

    def forget(self, instance: str) -> None:
        """The component's revision is not known any more: the next change observes it first."""
        self._revisions.pop(instance, None)

    async def _send(self, instance: str, command: Command[R], revision: int | None) -> R:
        self._count += 1
        try:
            reply = await self._request(instance, command, f"{self._prefix}-{self._count}", revision)
        except CallTimeout:
            self.forget(instance)  # it may or may not have carried the command out
            waited = command.timeout + 2 * ANSWER_TIMEOUT
            raise CallTimeout(f"{instance} did not answer `{command.name}` within {waited:g} s, asked twice") from None
        except Unreachable as error:
            self.forget(instance)
            raise Unreachable(f"{instance} cannot be reached for `{command.name}`: {error}") from None
        if revision is not None:
            self._revisions[instance] = reply.revision
        try:
            return result_of(reply, command)
        except CommandRefused as error:
            self.forget(instance)  # it is not what was expected: the next change observes it first
            raise CommandRefused(f"{instance} refused `{command.name}`: {error}") from None

    async def _request(self, instance: str, command: Command[R], id: str, revision: int | None) -> Reply:
        """A lost request or reply costs one repetition: the component knows the request by its id."""
        timeout = command.timeout + ANSWER_TIMEOUT
        try:
            channel = await self._channel(instance)
            return await channel.request(command, revision=revision, timeout=timeout, id=id)
        except CallTimeout:
            channel = await self._channel(instance)
            return await channel.request(command, revision=revision, timeout=ANSWER_TIMEOUT, id=id)

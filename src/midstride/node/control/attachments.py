"""Attaching and detaching ports at run time, and the gates of attachments. Control thread.

The middleware loses messages of an endpoint that is not matched yet, and those of one that is destroyed right after
publishing. So an output is created behind a closed gate, which opens once its endpoint is matched and ready;
before an endpoint is destroyed, its gate is closed and its readers have acknowledged.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final

from midstride.errors import CommandRefused
from midstride.node.author.client_ports import ClientLink, ClientPort
from midstride.node.author.declaration import DeclaredParts
from midstride.node.author.message_times import MessageTimes
from midstride.node.author.ports import Input, InputLink, Output, OutputLink
from midstride.node.author.server_ports import ServerLink, ServerPort
from midstride.node.author.write_lease import WriteLease
from midstride.node.component_host import Host
from midstride.node.control.rate_watch import RateWatch
from midstride.node.data.mode_switch import DataExecutor, within
from midstride.wire import commands, replies

# A best-effort message right after the match is often lost, one a moment later is not (s).
READY_AFTER: Final = 0.05
# How often an endpoint is asked how many peers it has (s).
TICK: Final = 0.005


def not_matched(matched: int, command: commands.AttachCommand | commands.AwaitReadersCommand) -> CommandRefused:
    """The refusal of a command that has found only ``matched`` of the endpoints that it must find."""
    return CommandRefused(
        f"only {matched} of {command.peers} endpoints on {command.topic} were found within {command.timeout:.3g} s; "
        "the others are missing, have another type or incompatible QoS, or discovery does not reach them"
    )


@dataclass
class Attachments:
    """The attachments of a component's ports. Raises CommandRefused for names that do not exist."""

    parts: DeclaredParts
    host: Host
    data: DataExecutor

    def __post_init__(self) -> None:
        self.lease = WriteLease(self.host.steady)

    @property
    def relays(self) -> bool:
        """Return whether messages of another program pass through an output."""
        return any(output.relayed for output in self.parts.outputs.values())

    def port(self, name: str) -> Input | Output:
        found = self.parts.ports.get(name)
        if found is None:
            listed = ", ".join(self.parts.ports) or "none"
            raise CommandRefused(f"there is no port {name}; the ports are: {listed}")
        return found

    def output(self, name: str) -> Output:
        found = self.port(name)
        if not isinstance(found, Output):
            raise CommandRefused(f"{name} is an input, not an output")
        return found

    def input(self, name: str) -> Input:
        found = self.port(name)
        if not isinstance(found, Input):
            raise CommandRefused(f"{name} is an output, not an input")
        return found

    def link(self, port: str, topic: str) -> OutputLink:
        """The attachment of an output to ``topic``. Raises CommandRefused where there is none."""
        found = self.output(port).link(topic)
        if found is None:
            raise CommandRefused(f"output {port} is not attached to {topic}")
        return found

    async def attach(self, command: commands.AttachCommand) -> replies.Attached:
        topic, timeout = command.topic, command.timeout
        port = self.port(command.port)
        if port.link(topic) is not None:
            raise CommandRefused(f"{port.name} is already attached to {topic}")
        if isinstance(port, Input):
            port.condition = port.condition or command.condition
            if command.rate is not None:
                port.rate = command.rate
                port.tolerates = command.tolerates or port.tolerates
        link = await self.data.run(lambda: self._create(port, topic), timeout)
        try:
            matched = await self._match(link, command.peers, timeout)
            if matched < command.peers:
                raise not_matched(max(matched, 0), command)
            ready_in = READY_AFTER if command.peers else 0.0
            if ready_in and (command.await_ready or isinstance(link, OutputLink)):
                await self.host.sleep(ready_in)
                ready_in = 0.0
            if isinstance(link, OutputLink) and command.gate == "open":
                await self.data.run(partial(self._open, link), timeout)
        except CommandRefused:
            # Undone as soon as user code returns, however long that takes: a refused command must change nothing.
            await within(self.host, self.host.on_data(link.destroy), timeout)
            raise
        return replies.Attached(matched=matched, ready_in=ready_in)

    async def detach(self, command: commands.DetachCommand) -> replies.Detached:
        link, timeout = self._attached(command.port, command.topic), command.timeout
        if isinstance(link, InputLink):
            await self.data.run(link.destroy, timeout)
            return replies.Detached(acknowledged=None, last=None)
        was_open = link.gate == "open"

        def close() -> None:
            if link.open or link.cut is not None:  # else what has closed it may open it, if the detachment fails
                link.set_gate(False)

        await self.data.run(close, timeout)
        acknowledged = await link.endpoint.acknowledged(timeout)
        try:
            await self.data.run(link.destroy, timeout)
        except CommandRefused:
            if was_open:
                self.host.on_data(lambda: link.set_gate(True))
            raise
        return replies.Detached(acknowledged=acknowledged, last=link.count)

    async def gate(self, command: commands.GateCommand) -> replies.Done:
        link = self.link(command.port, command.topic)
        if link.cut is not None:
            raise CommandRefused(f"{link} is part of a cut under way; cancel the cut first")

        def switch() -> None:
            link.set_gate(command.gate == "open")
            if command.latch:
                link.write_kept()

        await self.data.run(switch, command.timeout)
        return replies.Done()

    async def await_write(self, command: commands.AwaitWriteCommand) -> replies.GatedWrites:
        link = self.link(command.port, command.topic)
        deadline = self.host.steady() + int(command.timeout * 1e9)
        while not link.gated and link.output.wrong_type is None and self.host.steady() < deadline:
            if link.output.owner.failed:
                break  # it will not write
            await self.host.sleep(TICK)
        owner, deadline = link.output.owner, self.host.steady() + int(command.patience * 1e9)
        wanted = 1 if owner.driven == "none" else command.calls
        while owner.calls < wanted and not owner.failed and self.host.steady() < deadline:
            await self.host.sleep(TICK)
        if link.output.wrong_type is not None:
            with contextlib.suppress(CommandRefused):
                await self.data.run(lambda: None, command.timeout)  # until the call that wrote it has degraded
        return replies.GatedWrites(gated=link.gated, wrong_type=link.output.wrong_type, failed=owner.failed)

    async def await_rate(self, command: commands.AwaitRateCommand) -> replies.RateVerdict:
        link = self.link(command.port, command.topic)
        owner, until = link.output.owner, command.until
        begun, deadline = link.count + link.gated, self.host.steady() + int(command.timeout * 1e9)
        # The system's clock may be set meanwhile, which would seem to be a pause.
        now = self.host.now if self.host.simulated_time else self.host.steady
        watch = RateWatch(command.rate, command.window, now())
        while True:
            watch.see(link.count + link.gated - begun, now())
            reached = watch.kept if until == "met" else watch.broken or owner.failed
            if reached or owner.failed or self.host.steady() >= deadline:
                rate, pause = round(watch.rate, 3), round(watch.pause, 3)
                return replies.RateVerdict(reached=reached, rate=rate, pause=pause, failed=owner.failed)
            await self.host.sleep(TICK)

    async def await_match(self, command: commands.AwaitMatchCommand) -> replies.Attached:
        link, wanted = self._attached(command.port, command.topic), set(command.publisher_ids)
        if not wanted or (missing := _undiscovered(link, wanted)) is None:
            return replies.Attached(matched=max(0, await self._match(link, command.peers, command.timeout)))
        deadline = self.host.steady() + int(command.timeout * 1e9)
        while missing or link.endpoint.matched() < len(wanted):
            if self.host.steady() >= deadline:
                break
            await self.host.sleep(TICK)
            missing = _undiscovered(link, wanted)
        return replies.Attached(matched=max(0, link.endpoint.matched()), missing=sorted(missing or ()))

    async def await_readers(self, command: commands.AwaitReadersCommand) -> replies.Attached:
        link = self.link(command.port, command.topic)
        matched = await self._match(link, command.peers, command.timeout, handed_over=True)
        if matched < command.peers:
            raise not_matched(max(matched, 0), command)
        matched = await self._match(link, command.everyone, command.patience, command.reader_ids, handed_over=True)
        if command.peers or command.everyone:
            await self.host.sleep(READY_AFTER)
        return replies.Attached(matched=matched)

    async def count_writes(self, command: commands.CountWritesCommand) -> replies.CountedWrites:
        output = self.output(command.port)
        link = output.link(command.topic)
        return replies.CountedWrites(written=output.unattached if link is None else link.count + link.gated)

    async def close_all(self, timeout: float) -> None:
        """Destroy every endpoint once all readers have acknowledged, or after ``timeout`` (s)."""
        links = [link for output in self.parts.outputs.values() for link in output.links]
        await asyncio.gather(*(link.endpoint.acknowledged(timeout) for link in links))
        await self.data.run(self._destroy_all, timeout)

    def _attached(self, port: str, topic: str) -> OutputLink | InputLink:
        """The attachment of a port to ``topic``. Raises CommandRefused where there is none."""
        link = self.port(port).link(topic)
        if link is None:
            raise CommandRefused(f"{port} is not attached to {topic}")
        return link

    async def _match(
        self,
        link: OutputLink | InputLink,
        wanted: int,
        patience: float,
        reader_ids: Sequence[str] = (),
        handed_over: bool = False,
    ) -> int:
        """The number of compatible endpoints matched, once that is ``wanted`` or after ``patience`` (s).

        The number alone may be right while one of the readers that are waited for is missing and another has come.
        """
        deadline = self.host.steady() + int(patience * 1e9)
        while True:
            matched, missing = link.endpoint.matched(), _missing(link, reader_ids)
            # An output whose code has failed will not be handed over to.
            failed = handed_over and isinstance(link, OutputLink) and link.output.owner.failed
            if failed or (matched >= wanted and not missing) or self.host.steady() >= deadline:
                return matched - missing
            await self.host.sleep(TICK)

    # -- data thread -------------------------------------------------------------------------------

    def _create(self, port: Output | Input, topic: str) -> OutputLink | InputLink:
        if isinstance(port, ServerPort):
            served = ServerLink(port, topic, self.host)
            port.show(served)
            port.links = (*port.links, served)
            return served
        if isinstance(port, ClientPort):
            called = ClientLink(port, topic, self.host)
            port.links = (*port.links, called)
            port.begin(self.host)
            return called
        times = MessageTimes(self.host.now)
        if isinstance(port, Input):
            inlet = InputLink(port, topic, times)
            receive = port.receiver(inlet, self.host)
            inlet.endpoint = self.host.create_subscription(topic, port.type, port.assumption.qos, receive)
            port.links = (*port.links, inlet)
            return inlet
        link = OutputLink(port, topic, self.host.create_publisher(topic, port.type, port.qos), times, self.lease)
        once = port.owner.driven == "none" or (port.relayed and port.rate is None)
        for message in port.kept if port.latched or once else ():
            link.write_gated(message)  # what writes once may have written while unattached
        port.wrong_type = None
        port.links = (*port.links, link)
        link.follow_lease()  # once more: a lease that has begun meanwhile has not found it
        return link

    def _open(self, link: OutputLink) -> None:
        link.set_gate(True)
        if link.output.latched:
            link.write_kept()

    def _destroy_all(self) -> None:
        for port in self.parts.ports.values():
            for link in port.links:
                link.destroy()


def _missing(link: OutputLink | InputLink, reader_ids: Sequence[str]) -> int:
    """The number of readers that the process has not discovered yet."""
    return len(set(reader_ids) - link.endpoint.reader_ids()) if isinstance(link, OutputLink) and reader_ids else 0


def _undiscovered(link: OutputLink | InputLink, publisher_ids: set[str]) -> set[str] | None:
    """The publishers that the process of an input has not discovered yet; None where that is not told."""
    if not isinstance(link, InputLink) or (known := link.endpoint.publisher_ids()) is None:
        return None
    return publisher_ids - known

"""Keeps the lease of the component's outputs: without a renewal by the manager, they fall silent. Control thread.

The manager renews it with a moment that this component has stated, on its steady clock. So a renewal that is late, or
that the link delivers once it is back, makes the lease no longer than it would have been (docs/protocols/lease.md).
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from typing import Final

from midstride.errors import CommandRefused
from midstride.node.author.ports import OutputLink
from midstride.node.author.server_ports import ServerPort
from midstride.node.component_host import Host
from midstride.node.control.attachments import Attachments
from midstride.node.data.mode_switch import DataExecutor
from midstride.wire import commands, replies

# How long the data thread may take to drop what is not delivered, or to repeat what late joiners are to have (s).
PATIENCE: Final = 1.0


@dataclass
class Leasing:
    """``changed`` is called when the lease is over, and when it is renewed after that."""

    attachments: Attachments
    host: Host
    data: DataExecutor
    changed: Callable[[], None]
    _watching: asyncio.Task[None] | None = field(default=None, init=False)
    _seen: int = field(default=0, init=False)  # the latest moment that a command has named

    async def keep(self, command: commands.KeepLeaseCommand) -> replies.LeaseKept:
        """Make the lease last for so long from the moment that the command names; without seconds, end it."""
        if any(isinstance(output, ServerPort) for output in self.attachments.parts.outputs.values()):
            raise CommandRefused("a component with servers keeps no lease: they would answer besides")
        lease, was_over = self.attachments.lease, self.attachments.lease.is_over
        if command.seen is not None and command.seen >= self._seen:  # else the link has delivered it late
            self._seen = command.seen
            lease.until = None if command.seconds is None else command.seen + round(command.seconds * 1e9)
        for link in self._links():
            link.follow_lease()
        if was_over and not lease.is_over:
            await self._resume()
        if lease.until is not None and (self._watching is None or self._watching.done()):
            self._watching = asyncio.get_running_loop().create_task(self._watch())
        return replies.LeaseKept(now=self.host.steady())

    def _links(self) -> Iterator[OutputLink]:
        for output in self.attachments.parts.outputs.values():
            yield from output.links

    async def _watch(self) -> None:
        """Wait until the lease is over, which the next renewal begins anew."""
        lease = self.attachments.lease
        while lease.until is not None and not lease.is_over:
            await self.host.sleep((lease.until - self.host.steady()) / 1e9)
        if lease.until is None:
            return
        self.host.logger.warning(
            f"{self.host.instance} publishes nothing until its manager answers again: its lease is over, and its "
            "fallback on another host may take over"
        )
        for link in list(self._links()):
            if await link.endpoint.acknowledged(0.0) is not True and link.output.qos.effective().is_reliable:
                with contextlib.suppress(CommandRefused):
                    await self.data.run(partial(self._drop_undelivered, link), PATIENCE)
        self.changed()

    def _drop_undelivered(self, link: OutputLink) -> None:
        """On the data thread: else the middleware delivers it once the link is back, when the fallback writes."""
        if link in link.output.links and self.attachments.lease.is_over:
            link.replace_endpoint(self.host.create_publisher(link.topic, link.output.type, link.output.qos))

    async def _resume(self) -> None:
        def repeat() -> None:
            for link in self._links():
                for message in link.output.kept if link.output.latched and link.lets_pass else ():
                    link.publish(message)
                    link.count += 1

        self.host.logger.warning(f"{self.host.instance} publishes again: its lease is renewed")
        with contextlib.suppress(CommandRefused):
            await self.data.run(repeat, PATIENCE)
        self.changed()

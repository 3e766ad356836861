"""State that moves although nothing is handed over: between instances without outputs (docs/protocols/state.md).

Such a replacement is muted when it is upgraded: the old component still makes every call. Before the first step that
takes anything from the old one, its state moves at a cut without outputs, and from then on the new one makes the calls.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable, Container
from dataclasses import dataclass, field
from typing import Final

from midstride.errors import CallTimeout, CommandRefused, Unreachable
from midstride.model.action import Action, Degrade, Detach, Remove, Upgrade
from midstride.runtime.process.component_client import ComponentClient
from midstride.wire.commands import MuteCommand, PrepareStateCommand

# How long a replacement is waited for that has not received a message on a topic on which the old one has (s), and how
# often it is looked at.
FIRST_MESSAGES: Final = 0.5
LOOK_INTERVAL: Final = 0.01


@dataclass(slots=True)
class StateMoves:
    """The moves of one change; ``predecessors`` come from :func:`midstride.plan.state_continuity.without_outputs`.

    ``move(old, new)`` moves the state of live components; ``keeps_own(old, new, because)`` is called where it cannot.
    """

    client: ComponentClient
    move: Callable[[str, str], Awaitable[None]]
    keeps_own: Callable[[str, str, str], None]
    predecessors: dict[str, str] = field(default_factory=dict)
    _muted: set[str] = field(default_factory=set)
    _asked: set[str] = field(default_factory=set)

    async def before(self, action: Action, live: Container[str]) -> None:
        """Do what must precede ``action``; ``live`` are the instances of the configuration. Raises MidstrideError."""
        for new, old in list(self.predecessors.items()):
            if new not in live or old not in live:
                continue
            if isinstance(action, Upgrade) and new in action.instances():
                await self._mute(old, new)
            elif isinstance(action, (Degrade, Detach, Remove)) and old in action.instances():
                if isinstance(action, Remove):  # without functionalities, no step has upgraded the new one
                    await self._mute(old, new)
                if new not in self._muted:
                    continue
                self._muted.discard(new)
                if self.client.life.is_gone_or_fenced(old):
                    self.keeps_own(old, new, f"{old} exited or hangs, so it could not export its state")
                else:
                    await self._first_messages(old, new)
                    await self.move(old, new)
                    del self.predecessors[new]
                    self.predecessors[old] = new  # a roll-back moves it back
                    self._muted.add(old)
                    self._asked.add(old)

    async def _mute(self, old: str, new: str) -> None:
        """Have ``new`` wait for the state of ``old``, if that exports any."""
        if new in self._asked or self.client.life.is_gone_or_fenced(old):
            return
        self._asked.add(new)
        try:
            prepare = PrepareStateCommand(peer=old, address=self.client.address(old, new))
            offer = await self.client.change(new, prepare)
        except CommandRefused as error:
            self.keeps_own(old, new, str(error))
            return
        if offer.has_state:
            await self.client.change(new, MuteCommand())
            self._muted.add(new)

    async def _first_messages(self, old: str, new: str) -> None:
        """Wait until ``new`` has received a message on each topic on which ``old`` has, or for a while.

        A subscription that has found a publisher may not have been found by it. Only a message shows that it has, and
        ``new`` would lack what is published before.
        """
        clock = self.client.clock
        deadline = clock.steady() + FIRST_MESSAGES
        with contextlib.suppress(CallTimeout, Unreachable):  # the move finds that as well
            received = (await self.client.peek(old)).ports
            while clock.steady() < deadline:
                there = (await self.client.peek(new)).ports
                links = [
                    (link, there.get(port, {}).get(topic))
                    for port in received
                    for topic, link in received[port].items()
                ]
                if all(other is None or other.count or not link.count for link, other in links):
                    return
                await asyncio.sleep(LOOK_INTERVAL)

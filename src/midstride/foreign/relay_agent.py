"""The agent of a relay, which also says and does what concerns its program's node: its lifecycle, its parameters and
its servers."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass
from typing import Final

from msgspec import structs

from midstride.foreign.relayed_actions import RelayedActionServer
from midstride.foreign.relayed_lifecycle import LOOK, RelayedLifecycle
from midstride.foreign.relayed_parameters import PARAMETERS_LOOK, RelayedParameters
from midstride.foreign.relayed_servers import RelayedServer
from midstride.foreign.relayed_state import RelayedState
from midstride.node.control.component_agent import Agent
from midstride.wire import commands
from midstride.wire.commands import Command
from midstride.wire.frames import Reply, Request
from midstride.wire.state import ComponentState

# How often it is looked whether requests that wait in the relay can be passed on (s), besides when one is answered.
REQUESTS_LOOK: Final = 1.0


@dataclass
class RelayAgent(Agent):
    """``lifecycle``: what is known of that of its program's node; ``parameters``: those of the node, once it is known.

    ``program_state``: the state of the node, likewise. Each is None where nodes have none that can be asked for.
    ``servers``: those whose requests, or goals, its program answers.
    """

    lifecycle: RelayedLifecycle | None = None
    parameters: RelayedParameters | None = None
    servers: Sequence[RelayedServer | RelayedActionServer] = ()
    program_state: RelayedState | None = None

    async def main(self) -> None:
        """Run from set-up to the end."""
        watches = [self._in_background(self._watch_parameters(), "its watch over the parameters has")]
        if self.lifecycle is not None:
            watches.append(self._in_background(self._watch(self.lifecycle.look, LOOK), "its watch has"))
        watches.append(self._in_background(self._watch_state(), "its watch over the state has"))
        if self.servers:
            watches.append(self._in_background(self._watch_servers(), "its watch over requests has"))
        try:
            await super().main()
        finally:
            for watch in watches:
                watch.cancel()

    async def _watch(self, look: Callable[[], Awaitable[bool]], interval: float) -> None:
        await self._ready.wait()
        while True:
            if await look():
                self.report_state()
            await asyncio.sleep(interval)

    async def _watch_servers(self) -> None:
        """Pass on what waits behind requests that the program does not answer."""
        await self._ready.wait()
        while True:
            await self.host.sleep(REQUESTS_LOOK)
            await self.host.on_data(lambda: [server.send_waiting() for server in self.servers])

    def program_exited(self) -> None:
        """End in order, on any thread: the program will not answer what it has been asked."""
        if (loop := self._loop) is not None and not loop.is_closed():
            loop.call_soon_threadsafe(self._give_up)
        self.stop()

    def _give_up(self) -> None:
        self.host.on_data(lambda: [server.give_up() for server in self.servers])

    async def _watch_state(self) -> None:
        await self._ready.wait()  # then the node is known
        while (state := self.program_state) is not None:
            if state.look():
                self.report_state()
            await asyncio.sleep(LOOK)

    async def _watch_parameters(self) -> None:
        await self._ready.wait()  # then the node is known
        if self.parameters is not None:
            await self._watch(self.parameters.look, PARAMETERS_LOOK)

    def state(self) -> ComponentState:
        """Read without waiting for the data thread."""
        state, lifecycle = super().state(), self.lifecycle
        if lifecycle is not None:
            state = structs.replace(state, managed=[*lifecycle.managed], differences=[*lifecycle.faults])
        if self.parameters is None:
            return structs.replace(state, parameters={}, declared={}, unread_parameters=True)
        return self.parameters.shown_in(state)

    async def _carry_out(self, request: Request, command: Command[object], token: str) -> Reply:
        if isinstance(command, commands.ObserveCommand):
            if self.lifecycle is not None and self.lifecycle.managed:
                await self.lifecycle.look()  # the manager may have ended
            if self.parameters is not None:
                await self.parameters.refresh()
        return await super()._carry_out(request, command, token)

"""The commands that decide which instance of a role answers requests to the node's services.

The successor asks its predecessor, directly, to stop; with its reply it opens its own gate. So they do not need the
manager once it has sent the command, and there is no moment at which both answer.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Any, Final

from midstride.errors import CallTimeout, CommandRefused, Unreachable
from midstride.node.service_gate import ServiceGate
from midstride.wire import commands
from midstride.wire.channel import result_of
from midstride.wire.commands import Command
from midstride.wire.frames import Reply

# How long one attempt to have the predecessor stop may take (s), and how many there are.
YIELD_TIMEOUT: Final = 0.5
YIELD_ATTEMPTS: Final = 3


@dataclass
class Answering:
    """``call`` sends a command to a peer at an address; ``changed`` is called when a peer has closed the gate."""

    gate: ServiceGate
    call: Callable[[str, Command[Any], float], Awaitable[Reply]]
    changed: Callable[[], None]

    async def answer(self, command: commands.AnswerCommand) -> commands.Done:
        if not self.gate.is_open:
            self.gate.open(None if command.address is None else await self._yielded(command.peer, command.address))
        return commands.Done()

    async def _yielded(self, peer: str, address: str) -> list[str] | None:
        """What the predecessor has handled; None if it has exited. Raises CommandRefused if it may still answer."""
        stop = commands.YieldCommand()
        for _ in range(YIELD_ATTEMPTS):
            try:
                return result_of(await self.call(address, stop, YIELD_TIMEOUT), stop).handled
            except Unreachable:
                return None
            except CallTimeout:
                continue
        waited = YIELD_ATTEMPTS * YIELD_TIMEOUT
        raise CommandRefused(f"{peer} did not respond within {waited:g} s, so it may still answer requests")

    async def stop(self, command: commands.YieldCommand) -> commands.Yielded:
        """From the successor. Asked again, it gives the same reply: the first may be lost."""
        handled = self.gate.close()
        self.changed()
        return commands.Yielded(handled=handled)

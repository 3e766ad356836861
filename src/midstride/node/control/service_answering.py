"""The commands that decide which instance of a role answers requests to the node's services.

The successor asks its predecessor, directly, to stop, and with its reply begins to answer. So they do not need the
manager once it has sent the command, and there is no moment at which both answer. Where state moves, the predecessor
stops before it exports, and what it has handled comes with the state (:mod:`midstride.node.handover.state_transfer`).
"""

from __future__ import annotations

import contextlib
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Any, Final

from midstride.errors import CallTimeout, CommandRefused, Unreachable
from midstride.node.request_admission import RequestAdmission
from midstride.wire import commands, replies
from midstride.wire.channel import result_of
from midstride.wire.commands import Command
from midstride.wire.frames import Reply

# How long one attempt to have the predecessor stop may take (s), and how many there are.
YIELD_TIMEOUT: Final = 0.5
YIELD_ATTEMPTS: Final = 3


@dataclass
class Answering:
    """``call`` sends a command to a peer at an address; ``changed`` is called when a peer has had it stop."""

    admission: RequestAdmission
    call: Callable[[str, Command[Any], float], Awaitable[Reply]]
    changed: Callable[[], None]

    async def answer(self, command: commands.AnswerCommand) -> replies.Done:
        if not self.admission.is_open:
            self.admission.open(None if command.address is None else await self._yielded(command.peer, command.address))
        return replies.Done()

    def pause(self) -> bool:
        """Answer no request for now: the state is about to be exported. Whether this one answered until now."""
        was_open = self.admission.pause()
        if was_open:
            self.changed()
        return was_open

    def take_over(self, handled: list[str] | None, yields: int) -> None:
        """Answer from now on, since the state of the predecessor has arrived, unless it has asked for that again.

        ``handled`` as for :meth:`RequestAdmission.open`; ``yields``: those of the admission when the transfer began.
        """
        if self.admission.yields == yields and not self.admission.is_open:
            self.admission.open(handled)
            self.changed()

    async def take_back(self, peer: str, address: str, *, may_answer: bool) -> None:
        """The state has not moved after all: answer again. ``may_answer``: ``peer`` may have begun to."""
        if not may_answer:
            self.admission.open(())
        else:
            with contextlib.suppress(CommandRefused):  # it answers until the manager has ended it
                await self.answer(commands.AnswerCommand(peer=peer, address=address))
        self.changed()

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

    async def stop(self, command: commands.YieldCommand) -> replies.Yielded:
        """From the successor. Asked again, it gives the same reply: the first may be lost."""
        handled = self.admission.close()
        self.changed()
        return replies.Yielded(handled=handled)

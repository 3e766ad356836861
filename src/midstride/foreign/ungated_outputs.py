"""The way to hold back the outputs of a node without Midstride's API, a value chosen once, when its agent is made."""

from __future__ import annotations

import time
from typing import Any

from midstride.errors import CommandRefused
from midstride.foreign.node import ForeignNode
from midstride.wire import commands, replies


class UngatedOutputs:
    """Nothing does (`gate none`). Each method carries out the command of its name, and raises CommandRefused."""

    def __init__(self, node: ForeignNode) -> None:
        self._node = node

    async def attach(self, command: commands.AttachCommand) -> replies.Attached:
        if command.gate == "closed":
            raise CommandRefused(
                f"{self._node.record.instance} has no gate (`gate none`), so {command.topic} cannot be handed over to "
                "it; use `--strategy paper`, or `gate preload`"
            )
        self._node.set_links({command.port: "open"})
        return replies.Attached(matched=0)

    async def detach(self, command: commands.DetachCommand) -> replies.Detached:
        self._node.set_links({command.port: None})
        return replies.Detached(acknowledged=None, last=None)

    async def await_match(self, command: commands.AwaitMatchCommand) -> replies.Attached:
        """With how many is not known, and delays nothing."""
        return replies.Attached(matched=command.peers)

    async def await_readers(self, command: commands.AwaitReadersCommand) -> replies.Attached:
        """Return at once: the number of readers is not known, and delays nothing."""
        return replies.Attached(matched=max(command.peers, command.everyone))

    async def await_idle(self, command: commands.AwaitIdleCommand) -> replies.Idle:
        return replies.Idle(busy=None)

    async def grid(self, command: commands.GridCommand) -> replies.Grid:
        """The trigger of an output; by a rate that is stated, any moment is a slot."""
        rate = None if command.port is None else self._node.component.stated_rate(command.port, self._node.record.modes)
        now = time.time_ns()
        if not rate:
            return replies.Grid(trigger="none", now=now)
        return replies.Grid(trigger="rate", now=now, epoch=now, period=1 / rate)

    async def cancel_cut(self, command: commands.CancelCutCommand) -> replies.Done:
        return replies.Done()

    async def finish(self) -> None:
        """Before the process is ended."""

    async def refuse(self, command: Any) -> Any:
        kind = f"`gate {self._node.component.gate}`"
        raise CommandRefused(
            f"{self._node.record.instance} has no gate in its process ({kind}), so it cannot be held back"
        )

    gate = fence = await_write = await_rate = count_writes = share_slot = cut_out = cut_in = await_cut = refuse

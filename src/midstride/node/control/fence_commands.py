"""Fencing: a component whose user code does not return is kept from publishing. Control thread.

The stated exception to docs/protocols/modes.md: "never inside a call". All other commands that
change an attachment wait for the data thread.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

from midstride.errors import CommandRefused
from midstride.node.author.ports import Output, OutputLink
from midstride.node.component_host import Host
from midstride.node.control.attachments import Attachments
from midstride.node.data.functionality_runner import FunctionalityRunner
from midstride.node.data.mode_switch import DataExecutor
from midstride.wire import commands, replies

# How often it is looked whether a message is still being published, and whether an async call has ended (s).
TICK: Final = 0.002
# The functions that may already have decided to publish.
_WRITING: Final = frozenset(
    function.__code__ for function in (Output.write, OutputLink.write_gated, OutputLink.write_kept)
)


@dataclass
class Fencing:
    """``changed`` is called when a fence has been put up or lifted. ``data_thread`` identifies that thread."""

    attachments: Attachments
    host: Host
    data: DataExecutor
    runners: Sequence[FunctionalityRunner]
    changed: Callable[[], None]
    data_thread: int = 0

    async def await_idle(self, command: commands.AwaitIdleCommand) -> replies.Idle:
        """An async call counts as busy, too; one that a mode has begun on entry if it is to leave that mode."""

        def keeps(runner: FunctionalityRunner) -> bool:
            return runner.awaits or (runner.asynchronous and runner.name in command.leaving)

        deadline = self.host.steady() + int(command.timeout * 1e9)
        try:
            await self.data.run(lambda: None, command.timeout)
        except CommandRefused as error:
            return replies.Idle(busy=str(error))
        while any(map(keeps, self.runners)):
            if self.host.steady() >= deadline:
                words = f"user code did not return within {command.timeout:.3g} s{self.data.busy()}"
                return replies.Idle(busy=words)
            await self.host.sleep(TICK)
        return replies.Idle(busy=None)

    async def fence(self, command: commands.FenceCommand) -> replies.FencedOutputs:
        links = [self.attachments.link(port, topic) for port, topic in command.attachments]
        for link in links:
            link.fence(not command.lift)
        if not command.lift:
            deadline = self.host.steady() + int(command.timeout * 1e9)
            while self._writing():
                if self.host.steady() >= deadline:
                    for link in links:
                        link.fence(False)
                    raise CommandRefused("a message is being published, and that does not end")
                await self.host.sleep(TICK)
        self.changed()
        return replies.FencedOutputs(last={str(link): link.count for link in links})

    def _writing(self) -> bool:
        """Return whether the data thread is in the middle of a write, which may have found the gate open.

        Looking at its stack costs a write nothing, unlike a lock.
        """
        frame = sys._current_frames().get(self.data_thread)
        while frame is not None:
            if frame.f_code in _WRITING:
                return True
            frame = frame.f_back
        return False

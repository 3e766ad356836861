"""State that moves between two nodes with a preloaded library, neither of which publishes or takes a request meanwhile.

Such a node cannot be held at a slot: the state is exported once the old one has laid the baton down, and imported
before the new one gets it (docs/protocols/foreign-state.md).
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from midstride.errors import CommandRefused
from midstride.foreign.foreign_state import ForeignState, moved
from midstride.foreign.gates import Gates
from midstride.foreign.node import ForeignNode
from midstride.node.handover.baton import BatonState, BatonStep
from midstride.wire import commands, replies

# How long a call of a node that is publishing may take to return (s).
PUBLISHING: Final = 0.3
# How long the state waits for requests that the old node has taken (s): what these change later is not in it. The same
# as for components.
REQUESTS: Final = 0.2
# How long the helper thread of a node may take to look, once it is asked to (s).
LOOK: Final = 0.3
# How much longer than all of that the nodes wait (s): if the manager ends meanwhile, the old one continues after that.
MARGIN: Final = 0.5
# How long the new node may take to write its first message (s), or so many periods.
FIRST: Final = 1.0
FIRST_PERIODS: Final = 9


def longest_wait(transfer: commands.StateTransfer) -> float:
    """For how long the old node leaves the baton, and both leave requests, at most (s)."""
    return PUBLISHING + REQUESTS + LOOK + transfer.timeout + MARGIN


@dataclass(frozen=True, slots=True)
class MovingSides:
    """Both sides of a transfer: the new node and its gates, the index of the old one; and the state of each.

    ``baton``: what decides for ``ports``, of the new node, each with the port of the old one that has its topic; 0
    where there are none. ``quiet``: neither publishes.
    """

    node: ForeignNode
    gates: Gates
    other: int
    old: ForeignState
    new: ForeignState
    baton: int
    ports: Mapping[str, str]
    quiet: bool

    async def move(self, transfer: commands.StateTransfer) -> replies.MovedState:
        """Raises CommandRefused, with the reason, where the old node keeps running."""
        page, gates, ports = self.gates.page, self.gates, list(self.ports)
        before = {port: int(gates.entry(port).passed) for port in ports}
        paused = time.monotonic()
        gates.pause(longest_wait(transfer))
        try:
            generation = await self._laid_down()
            last = self._last_of_old()
            await self.node.comes_true(lambda: not page.layout.nodes[self.other].unanswered, REQUESTS)
            size = await moved(self.old, self.new, transfer.timeout, self._forget_kept)
            self._take(generation)
        except BaseException:
            if self.baton:
                page.step(self.baton, BatonStep.WITHDRAW, self.other)
            gates.resume(self.other)
            raise
        gates.answer(self.old.node.component.stop_times.drain)
        gates.resume(self.other)
        held = time.monotonic() - paused
        rates = [rate for port in ports if (rate := gates.rate(port))]
        if rates and not self.quiet:
            longest = max(FIRST, FIRST_PERIODS / min(rates))
            await self.node.comes_true(lambda: self._written(before) or page.is_dead(gates.index), longest)
            if not self._written(before):
                raise CommandRefused(f"{self.node.record.instance} had imported the state, and has published nothing")
        silent = [
            (gates.entry(port).last - at) / 1e9 for port, at in last.items() if gates.entry(port).passed > before[port]
        ]
        longest_silence = max(silent, default=None)
        return replies.MovedState(
            bytes=size, silent=None if longest_silence is None else max(0.0, longest_silence), held=held
        )

    async def _laid_down(self) -> int:
        """Have the old node offer the baton and leave it; its generation. Raises CommandRefused."""
        if not self.baton:
            return 0
        page, gates = self.gates.page, self.gates
        page.step(self.baton, BatonStep.NAME_SUCCESSOR, self.other, gates.index, at_once=True)

        def offered() -> bool:
            return page.word(self.baton).state is BatonState.OFFERED

        if not await self.node.comes_true(offered, PUBLISHING):
            raise CommandRefused(f"{self.old.node.record.instance} is publishing, and that does not end")
        return page.word(self.baton).generation

    def _last_of_old(self) -> dict[str, int]:
        """By port, when the old node has published last (monotonic ns), where it has."""
        theirs = self.old.node.gates
        assert theirs is not None
        return {port: at for port, other in self.ports.items() if (at := int(theirs.entry(other).last))}

    async def _forget_kept(self) -> None:
        """Drop what the new node wrote with its own state and has kept: it is never published."""
        page, gates = self.gates.page, self.gates
        looked = page.beat(gates.index)
        gates.wait_for_manager(self.ports, keeping=False)
        await self.node.comes_true(lambda: page.beat(gates.index) != looked, LOOK)
        gates.wait_for_manager(self.ports, keeping=True)

    def _take(self, generation: int) -> None:
        """Take the baton. Raises CommandRefused where the old node has published since it laid the baton down."""
        if not self.baton:
            return
        page, gates, ports = self.gates.page, self.gates, list(self.ports)
        self.node.set_links(dict.fromkeys(ports, "open"))
        word = page.step(self.baton, BatonStep.TAKE, gates.index)
        gates.page.ring(gates.index)
        if word.generation != generation or page.word(self.baton).holder != gates.index + 1:
            self.node.set_links(dict.fromkeys(ports, "closed"))
            raise CommandRefused(f"{self.old.node.record.instance} has published again before its state had moved")

    def _written(self, before: Mapping[str, int]) -> bool:
        return any(self.gates.entry(port).passed > before[port] for port in self.ports)

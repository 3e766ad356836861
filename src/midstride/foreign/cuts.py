"""The hand-over of a node without Midstride's API: by a baton, which each side asks for and lays down itself.

docs/protocols/baton.md has the protocol; ``baton.h`` has its steps.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Final

from midstride.errors import CommandRefused
from midstride.foreign.gates import share_baton
from midstride.foreign.node import ForeignNode
from midstride.foreign.page import OPEN, OUTPUT
from midstride.node.handover.baton import BatonStep
from midstride.wire import commands, replies

# How long a call that is publishing may take to return (s).
PUBLISHING: Final = 0.3


@dataclass
class _Cut:
    """One cut, of the old side or the new one. ``before``: by port, how many messages had passed."""

    swaps: list[commands.CutSwap]
    baton: int
    before: dict[str, int]
    other: int | None = None  # the index of the old side; None on that side
    own: dict[str, int] = field(default_factory=dict)  # by port, its baton before


class ForeignCuts:
    """The cuts of one node. Each method carries out one command. Raises CommandRefused, as they do."""

    def __init__(self, node: ForeignNode) -> None:
        self._node = node
        self._cuts: dict[str, _Cut] = {}
        self._seats: dict[str, int] = {}  # by cut: the part in the page of a peer that uses Midstride's API

    async def grid(self, command: commands.GridCommand) -> replies.Grid:
        """How an output is triggered; by a rate that is stated, any moment is a slot."""
        rate = None if command.port is None else self._node.component.stated_rate(command.port, self._node.record.modes)
        now, readers = time.time_ns(), None
        if command.port is not None and command.topic is not None and self._node.gates is not None:
            readers = await self._node.matched(command.port, 0, 0.0)
        if not rate:
            return replies.Grid(trigger="none", now=now, readers=readers)
        return replies.Grid(trigger="rate", now=now, epoch=now, period=1 / rate, readers=readers)

    async def cut_out(self, command: commands.CutOutCommand) -> replies.Done:
        """The old side: from now on, one baton decides for the outputs of the cut."""
        gates, ports = self._node.require_gates(), [swap.port for swap in command.swaps]
        if not ports or command.state is not None:
            raise CommandRefused(f"{self._node.record.instance} does not use Midstride's API: it has no state to move")
        own = {port: gates.baton(port) for port in self._node.component.outputs}
        baton = gates.share(ports)
        self._cuts[command.cut] = _Cut(command.swaps, baton, {}, own=own)
        return replies.Done()

    async def seat(self, command: commands.SeatCommand) -> replies.Seat:
        """Either side: the other one uses Midstride's API, and gets a part in the page for the cut."""
        page, cut = self._node.require_gates().page, self._cuts.get(command.cut)
        if not command.old and cut is None:
            raise CommandRefused(f"there is no cut {command.cut}")
        index = self._seats[command.cut] = page.allocate(command.peer)
        page.set_ports(index, [(port.topic, OUTPUT) for port in command.ports])
        baton = page.new_baton(index) if cut is None else cut.baton
        entries = list(zip(page.layout.nodes[index].ports, (port.rate for port in command.ports), strict=False))
        share_baton(page, entries, baton)
        for entry, _ in entries:
            entry.gate = OPEN
        return replies.Seat(
            page=str(page.path.absolute()),
            library=str(page.library_path),
            baton=baton,
            index=index,
            other=self._node.require_gates().index,
            timed=not any(port.rate for port in command.ports),
        )

    async def cut_in(self, command: commands.CutInCommand) -> replies.Done:
        """The new side: be named as the successor of the old one."""
        gates, ports = self._node.require_gates(), [swap.port for swap in command.swaps]
        old = self._seats.get(command.cut, gates.page.index_of(command.peer))
        if old is None:
            raise CommandRefused(f"{command.peer} has no gate of the kind that {self._node.record.instance} has")
        topics = {swap.topic for swap in command.swaps}
        holders = {
            int(entry.baton) for entry in gates.page.layout.nodes[old].ports if entry.topic.decode() in topics
        } - {0}
        if len(holders) != 1:
            raise CommandRefused(f"{command.peer} is not ready to hand over")
        baton = holders.pop()
        own = {port: gates.baton(port) for port in self._node.component.outputs}
        before = {port: int(gates.entry(port).passed) for port in ports}
        gates.share(ports, baton)
        cut = self._cuts[command.cut] = _Cut(command.swaps, baton, before, old, own)
        self._node.change_record(links={**self._node.record.links, **dict.fromkeys(ports, "open")})
        for port in ports:
            self._node.adjust(port)
        gates.page.step(baton, BatonStep.NAME_SUCCESSOR, old, gates.index, at_once=gates.timed(ports))
        gates.page.ring(gates.index)
        word = gates.page.word(baton)
        if gates.index + 1 not in (word.successor, word.holder):
            await self._withdraw(cut)
            del self._cuts[command.cut]
            raise CommandRefused(f"{command.peer} does not hold the baton of its outputs")
        return replies.Done()

    async def await_cut(self, command: commands.AwaitCutCommand) -> replies.CutResult:
        """Both sides: until the new one has written, or that is withdrawn, or the old one is fenced."""
        cut, gates = self._cuts.get(command.cut), self._node.require_gates()
        if cut is None:
            raise CommandRefused(f"there is no cut {command.cut}")
        new = cut.other is not None
        old = cut.other + 1 if cut.other is not None else gates.index + 1
        ports = [swap.port for swap in cut.swaps]

        def taken() -> bool:
            return gates.page.word(cut.baton).holder != old

        def over() -> bool:
            word = gates.page.word(cut.baton)
            return word.holder == old and not word.successor

        def done() -> bool:
            return taken() and (not new or any(gates.entry(port).passed > cut.before[port] for port in ports))

        await self._node.comes_true(lambda: done() or over(), command.timeout)
        if not done():
            return replies.CutResult(outcome="waiting")
        writes = {f"{swap.port} {swap.topic}": self._last_write(swap.port, cut) for swap in cut.swaps}
        if new:
            return replies.CutResult(outcome="done", first=writes)
        return replies.CutResult(outcome="done", last=writes)

    def _last_write(self, port: str, cut: _Cut) -> replies.LastWrite | None:
        entry = self._node.require_gates().entry(port)
        if entry.passed <= cut.before.get(port, -1):
            return None
        return replies.LastWrite(number=entry.passed, source=time.time_ns() - time.monotonic_ns() + entry.last)

    async def cancel_cut(self, command: commands.CancelCutCommand) -> replies.Done:
        """Either side: the old one keeps the baton, or gets it back."""
        cut = self._cuts.pop(command.cut, None)
        if cut is not None and cut.other is not None:
            await self._withdraw(cut)
        elif cut is not None:
            gates = self._node.require_gates()
            gates.step(cut.baton, BatonStep.WITHDRAW)
            self._restore(cut)
        return replies.Done()

    async def _withdraw(self, cut: _Cut) -> None:
        """The new side: close its gates, and give the baton back to the old side."""
        gates = self._node.require_gates()
        assert cut.other is not None
        ports = [swap.port for swap in cut.swaps]
        self._node.change_record(links={**self._node.record.links, **dict.fromkeys(ports, "closed")})
        for port in ports:
            self._node.adjust(port)
        gates.page.step(cut.baton, BatonStep.WITHDRAW, cut.other)
        if gates.page.word(cut.baton).holder == gates.index + 1:
            gates.step(cut.baton, BatonStep.FENCE)
            if not await self._node.comes_true(lambda: not self._node.writers(cut.baton), PUBLISHING):
                raise CommandRefused(f"{self._node.record.instance} is publishing, and that does not end")
            gates.page.step(cut.baton, BatonStep.GIVE, cut.other)
        self._restore(cut)

    def _restore(self, cut: _Cut) -> None:
        for port, baton in cut.own.items():
            self._node.require_gates().entry(port).baton = baton

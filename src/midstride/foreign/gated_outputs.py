"""The outputs of a node with a preloaded library: gates in a page of shared memory, and a baton at a hand-over.

docs/protocols/baton.md has the protocol; ``baton.h`` has its steps.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

from msgspec import structs

from midstride.errors import CommandRefused
from midstride.foreign.ending_goals import EndingGoals
from midstride.foreign.foreign_state import StatePeers
from midstride.foreign.gated_state import LOOK, PUBLISHING, MovingSides, longest_wait
from midstride.foreign.gates import Gates, share_baton
from midstride.foreign.node import TICK, ForeignNode
from midstride.foreign.page_layout import OPEN, OUTPUT
from midstride.foreign.receipts import ReceiptNotes
from midstride.foreign.ungated_outputs import UngatedOutputs
from midstride.node.control.attachments import READY_AFTER, not_matched
from midstride.node.control.rate_watch import RateWatch
from midstride.node.handover.baton import BatonStep
from midstride.wire import commands, replies

# An output with a rate hangs if it has been silent for so many periods, and at least so long (s).
HANGS_PERIODS: Final = 10
HANGS: Final = 1.0
# How long a node may take until it shows the clients of the one that answers, or its readers (s).
PEERS_KNOWN: Final = 2.0
# How long a node that has answered stays: a client that is held up learns that it has left before it reads (s).
LINGER: Final = 0.5


@dataclass
class _Cut:
    """One cut, of the old side or the new one. ``before``: by port, how many messages had passed.

    Where state moves, ``state`` says how; without swaps, ``baton`` is 0.
    """

    swaps: list[commands.CutSwap]
    baton: int
    before: dict[str, int]
    other: int | None = None  # the index of the old side; None on that side
    own: dict[str, tuple[int, int]] = field(default_factory=dict)  # by port, its baton and its flags before
    quiet: bool = False  # the new side takes over without a message too
    state: commands.StateTransfer | None = None
    falls: list[int] | None = None  # where each input is answered by one of the two, until these change


class GatedOutputs(UngatedOutputs):
    """The outputs of ``node``, each behind one of ``gates``."""

    def __init__(self, node: ForeignNode, gates: Gates, states: StatePeers) -> None:
        super().__init__(node)
        self._gates = gates
        self._states = states
        self._cuts: dict[str, _Cut] = {}
        self._receipts = ReceiptNotes(gates, node.record.simulated_time, asyncio.sleep)
        self._shared_slots: dict[str, int] = {}  # by cut: the part in the page of a peer that uses Midstride's API

    async def attach(self, command: commands.AttachCommand) -> replies.Attached:
        port, matched = command.port, 0
        if command.peers:
            matched = await self._matched(port, command.peers, command.timeout)
            if matched < command.peers:
                raise not_matched(matched, command)
            await asyncio.sleep(READY_AFTER)
        self._node.set_links({port: command.gate})
        if not self._node.component.has_output(port):
            self._gates.set_gate(port, True)
        return replies.Attached(matched=matched)

    async def detach(self, command: commands.DetachCommand) -> replies.Detached:
        port, gates = command.port, self._gates
        await super().detach(command)
        gates.set_gate(port, False)
        if self._node.component.has_output(port) and (baton := gates.baton(port)):
            await self._node.comes_true(lambda: not gates.has_it(port) or not self._writers(baton), PUBLISHING)
            word = gates.page.word(baton)
            if word.predecessor == gates.index + 1:  # it has been handed over, for good
                gates.page.step(baton, BatonStep.SETTLE, word.holder - 1)
        return replies.Detached(acknowledged=None, last=gates.entry(port).passed)

    async def gate(self, command: commands.GateCommand) -> replies.Done:
        self._node.set_links({command.port: command.gate})
        return replies.Done()

    async def fence(self, command: commands.FenceCommand) -> replies.FencedOutputs:
        gates = self._gates
        attachments = [each for each in command.attachments if each[0] in gates.component.ports()]
        batons = {baton for port, _ in attachments if (baton := gates.baton(port))}
        for baton in batons:
            gates.step(baton, BatonStep.LIFT if command.lift else BatonStep.FENCE)
        for port, _ in attachments:
            if not gates.baton(port):
                gates.set_gate(port, command.lift)
        if not command.lift:
            free = await self._node.comes_true(lambda: not any(map(self._writers, batons)), command.timeout)
            if not free:
                for baton in batons:
                    gates.step(baton, BatonStep.LIFT)
                raise CommandRefused("a message is being published, and that does not end")
        last = {f"{port} {topic}": int(gates.entry(port).passed) for port, topic in attachments}
        return replies.FencedOutputs(last=last)

    async def _matched(self, port: str, wanted: int, patience: float) -> int:
        """With how many endpoints a port is matched, once that is ``wanted`` or after ``patience`` (s)."""
        page, index, entry = self._gates.page, self._gates.index, self._gates.entry(port)
        looked = page.beat(index)
        page.ring(index)
        await self._node.comes_true(lambda: page.beat(index) != looked, LOOK)
        await self._node.comes_true(lambda: entry.matched >= wanted, patience)
        return int(entry.matched)

    def _writers(self, baton: int) -> int:
        """The number of calls of the holder of ``baton`` that are publishing."""
        return self._gates.page.word(baton).writers

    async def record(self, command: commands.RecordCommand) -> replies.RecordingSwitched:
        return await self._receipts.switch(command)

    async def records(self, command: commands.RecordsCommand) -> replies.Records:
        return await self._receipts.read(command)

    # -- waiting ---------------------------------------------------------------------------------------

    async def await_match(self, command: commands.AwaitMatchCommand) -> replies.Attached:
        return replies.Attached(matched=await self._matched(command.port, command.peers, command.timeout))

    async def await_readers(self, command: commands.AwaitReadersCommand) -> replies.Attached:
        matched = await self._matched(command.port, command.peers, command.timeout)
        if matched < command.peers:
            raise not_matched(matched, command)
        matched = await self._matched(command.port, command.everyone, command.patience)
        if command.peers or command.everyone:
            await asyncio.sleep(READY_AFTER)
        return replies.Attached(matched=matched)

    async def count_writes(self, command: commands.CountWritesCommand) -> replies.CountedWrites:
        return replies.CountedWrites(written=self._gates.total(command.port))

    async def await_write(self, command: commands.AwaitWriteCommand) -> replies.GatedWrites:
        """With a rate, what was written before does not count: it may hang by now."""
        entry, rated = self._gates.entry(command.port), self._gates.rate(command.port)
        begun = int(entry.gated) if rated else 0
        await self._node.comes_true(lambda: entry.gated > begun, command.timeout)
        if rated and entry.gated > begun:
            await self._node.comes_true(lambda: entry.gated - begun >= command.calls, command.patience)
        return replies.GatedWrites(gated=entry.gated - begun, wrong_type=None)

    async def await_rate(self, command: commands.AwaitRateCommand) -> replies.RateVerdict:
        gates, deadline = self._gates, time.monotonic() + command.timeout
        if command.known_clock and self._node.record.simulated_time:
            return replies.RateVerdict(reached=command.until == "met", rate=command.rate, pause=0.0)
        begun = gates.total(command.port)
        watch = RateWatch(command.rate, command.window, time.monotonic_ns())
        while True:
            watch.see(gates.total(command.port) - begun, time.monotonic_ns())
            reached = watch.kept if command.until == "met" else watch.broken
            if reached or time.monotonic() >= deadline:
                return replies.RateVerdict(reached=reached, rate=round(watch.rate, 3), pause=round(watch.pause, 3))
            await asyncio.sleep(TICK)

    async def await_idle(self, command: commands.AwaitIdleCommand) -> replies.Idle:
        """Report a node that hangs: an output with a rate has been silent for long, whether its gate is open or not.

        In simulated time, nothing is judged while `/clock` stands still, or it is not known how it moves.
        """
        return replies.Idle(busy=self._hangs())

    def _hangs(self) -> str | None:
        """The sign by which an output with a rate shows that the node hangs; None where none does."""
        for port in self._gates.component.outputs:
            if port not in self._node.record.links:
                continue
            rate = self._node.component.stated_rate(port, self._node.record.modes)
            age = self._gates.age(port)
            due = None if age is None else self._node.due(age)
            if rate and due is not None and due > max(HANGS, HANGS_PERIODS / rate):
                return f"it has written nothing on {self._node.record.topics[port]} for {age:.1f} s"
        return None

    # -- requests to its services, and topics that are no ports -----------------------------------------

    async def answer(self, command: commands.AnswerCommand) -> replies.Answers:
        """Write from now on also on topics that are no ports, and answer requests.

        Requests are what arrives, and what has been held that the old one has not taken.
        """
        page, index, gates = self._gates.page, self._gates.index, self._gates
        if not gates.writes_unstated:
            writer = page.word(gates.unstated).holder - 1
            await self._peers_known(writer, command.address, lambda: gates.has_readers_of(writer))
            # A call that is publishing, and does not end, is of a stopped process: this one takes over after it.
            await self._node.comes_true(gates.take_unstated, PUBLISHING)
        if (other := page.answering(index)) is None:
            return replies.Answers()
        if command.address is not None and (first := gates.to_be_joined(other)) is not None:
            return replies.Answers(first=first)
        await self._peers_known(other, command.address, lambda: gates.has_clients_of(other))
        gates.answer(command.drain)
        await self._node.comes_true(lambda: gates.begun, command.drain)
        return replies.Answers(outlasting=0 if page.is_dead(other) else int(page.layout.nodes[other].unanswered))

    async def _peers_known(self, other: int, address: str | None, known: Callable[[], bool]) -> None:
        """Wait until this node is matched with the peers of the node ``other`` at ``address``, where that lives."""
        page, index = self._gates.page, self._gates.index
        if address is None or page.is_dead(other):
            return
        looked = page.beat(index), page.beat(other)
        page.ring(index)
        page.ring(other)
        await self._node.comes_true(lambda: page.beat(index) != looked[0] and page.beat(other) != looked[1], LOOK)
        if not known():
            await self._node.comes_true(known, PEERS_KNOWN)
            await asyncio.sleep(READY_AFTER)

    async def finish(self) -> None:
        """Before a node is ended whose successor answers: its goals end, and what it has taken is answered."""
        if not self._gates.succeeded:
            return
        found = await EndingGoals(self._node, self._gates, self._hangs).end()
        drain = self._node.component.stop_times.drain
        await self._node.comes_true(lambda: self._gates.answered_all(LINGER), drain + LINGER)
        if left := int(self._gates.page.layout.nodes[self._gates.index].unanswered):
            what = "1 request that it had taken was" if left == 1 else f"{left} requests that it had taken were"
            found.append(f"{what} not answered within the {drain:g} s of `drain`")
        self._node.unfinished = "; ".join(found) or None

    # -- hand-over -------------------------------------------------------------------------------------

    async def grid(self, command: commands.GridCommand) -> replies.Grid:
        grid = await super().grid(command)
        if command.port is None or command.topic is None:
            return grid
        return structs.replace(grid, readers=await self._matched(command.port, 0, 0.0))

    async def cut_out(self, command: commands.CutOutCommand) -> replies.Done:
        """The old side: from now on, one baton decides for the outputs of the cut."""
        gates, ports, state = self._gates, [swap.port for swap in command.swaps], command.state
        own = _decided(gates)
        baton = gates.share(ports) if ports else 0
        if ports and state is not None:
            gates.hold_back(ports, baton, longest_wait(state))
        self._cuts[command.cut] = _Cut(command.swaps, baton, {}, own=own, state=state)
        return replies.Done()

    async def share_slot(self, command: commands.ShareSlotCommand) -> replies.SharedSlotPlace:
        """Either side: the other one uses Midstride's API, and gets a part in the page for the cut."""
        page, cut = self._gates.page, self._cuts.get(command.cut)
        if not command.old and cut is None:
            raise CommandRefused(f"there is no cut {command.cut}")
        index = self._shared_slots[command.cut] = page.allocate(command.peer)
        page.set_ports(index, [(port.topic, OUTPUT) for port in command.ports])
        baton = page.new_baton(index) if cut is None else cut.baton
        entries = list(zip(page.ports(index), (port.rate for port in command.ports), strict=True))
        share_baton(page, entries, baton)
        for entry, _ in entries:
            entry.gate = OPEN
        return replies.SharedSlotPlace(
            page=str(page.path.absolute()),
            library=str(page.library_path),
            baton=baton,
            index=index,
            other=self._gates.index,
            timed=not any(port.rate for port in command.ports),
        )

    async def cut_in(self, command: commands.CutInCommand) -> replies.Done:
        """The new side: be named as the successor of the old one."""
        gates, ports = self._gates, [swap.port for swap in command.swaps]
        old = self._shared_slots.get(command.cut, gates.page.index_of(command.peer))
        if old is None:
            raise CommandRefused(f"{command.peer} has no gate of the kind that {self._node.record.instance} has")
        if command.state is not None:
            return await self._import_in(command, command.state, old)
        baton = self._baton_of(command, old)
        own = _decided(gates)
        before = {port: int(gates.entry(port).passed) for port in ports}
        falls = gates.falls(old, ports)
        by_input = not command.quiet and gates.answers_as(old, ports)
        if by_input:
            gates.share_answers(ports, baton, old)
        else:
            gates.share(ports, baton)
        cut = self._cuts[command.cut] = _Cut(
            command.swaps, baton, before, old, own, command.quiet, falls=falls if by_input else None
        )
        at_once = command.quiet or by_input or not any(map(gates.rate, ports))
        self._node.set_links(dict.fromkeys(ports, "open"))
        gates.page.step(baton, BatonStep.NAME_SUCCESSOR, old, gates.index, at_once=at_once)
        gates.page.ring(gates.index)
        word = gates.page.word(baton)
        if gates.index + 1 not in (word.successor, word.holder):
            await self._withdraw(cut)
            del self._cuts[command.cut]
            raise CommandRefused(f"{command.peer} does not hold the baton of its outputs")
        return replies.Done()

    async def _import_in(
        self, command: commands.CutInCommand, transfer: commands.StateTransfer, other: int
    ) -> replies.Done:
        """The new side: take over from the node ``other`` (index) with its state, in the background."""
        gates, states, swaps = self._gates, self._states, command.swaps
        old, new = states.nodes.get(command.peer), states.nodes.get(self._node.record.instance)
        if old is None or new is None or old.node.gates is None:
            raise CommandRefused(f"{command.peer} has no state of the kind that {self._node.record.instance} imports")
        ports = [swap.port for swap in swaps]
        baton = self._baton_of(command, other) if swaps else 0
        own = _decided(gates)
        if swaps:
            gates.share(ports, baton)
            gates.wait_for_manager(ports, keeping=True)
            old.node.gates.hold_back([], baton, longest_wait(transfer))
        before = {port: int(gates.entry(port).passed) for port in ports}
        self._cuts[command.cut] = _Cut(swaps, baton, before, other, own, command.quiet, transfer)
        await self._peers_known(other, command.address, lambda: gates.has_clients_of(other))
        theirs = {topic: port for port, topic in old.node.record.topics.items() if old.node.component.has_output(port)}
        of_old = {swap.port: theirs[swap.topic] for swap in swaps}
        sides = MovingSides(self._node, gates, other, old, new, baton, of_old, command.quiet)
        moving = states.transfers[command.cut] = asyncio.get_running_loop().create_task(sides.move(transfer))
        moving.add_done_callback(lambda done: done.cancelled() or done.exception())  # retrieved
        return replies.Done()

    def _baton_of(self, command: commands.CutInCommand, old: int) -> int:
        """The baton of the outputs of the node ``old`` (index) that are handed over. Raises CommandRefused."""
        gates = self._gates
        topics = {swap.topic for swap in command.swaps}
        holders = {int(entry.baton) for entry in gates.page.ports(old) if entry.topic.decode() in topics} - {0}
        if len(holders) != 1:
            raise CommandRefused(f"{command.peer} is not ready to hand over")
        return holders.pop()

    async def await_cut(self, command: commands.AwaitCutCommand) -> replies.CutResult:
        """Both sides: until the new one has written, or that is withdrawn, or the old one is fenced."""
        cut, gates = self._cuts.get(command.cut), self._gates
        if cut is None:
            raise CommandRefused(f"there is no cut {command.cut}")
        if cut.state is not None:
            return await self._await_state(cut, command)
        new = cut.other is not None
        old = cut.other + 1 if cut.other is not None else gates.index + 1
        ports = [swap.port for swap in cut.swaps]

        def moved() -> bool:
            return gates.page.word(cut.baton).holder != old

        def over() -> bool:
            word = gates.page.word(cut.baton)
            return word.holder == old and not word.successor

        def done() -> bool:
            quiet = cut.quiet and gates.index + 1 == gates.page.word(cut.baton).holder
            return moved() and (not new or quiet or any(gates.entry(port).passed > cut.before[port] for port in ports))

        if new and cut.quiet:
            await self._node.comes_true(lambda: done() or over() or self._takes(cut), command.timeout)
        await self._node.comes_true(lambda: done() or over(), command.timeout)
        if not done():
            return replies.CutResult(outcome="waiting")
        writes = {f"{swap.port} {swap.topic}": self._last_write(swap.port, cut) for swap in cut.swaps}
        if new:
            # Outputs that have fallen out of step meanwhile may have answered a message twice, or not at all.
            if cut.falls is None or cut.other is None:
                return replies.CutResult(outcome="done", first=writes)
            in_step = gates.answers_as(cut.other, ports) and gates.falls(cut.other, ports) == cut.falls
            return replies.CutResult(outcome="done", first=writes, by_input=in_step, out_of_step=not in_step)
        return replies.CutResult(outcome="done", last=writes)

    async def _await_state(self, cut: _Cut, command: commands.AwaitCutCommand) -> replies.CutResult:
        """Both sides, where state moves: until the new one has taken over with it, or has failed to."""
        moving = self._states.transfers.get(command.cut)
        if moving is not None:
            await asyncio.wait({moving}, timeout=command.timeout)
        if moving is None or not moving.done() or moving.cancelled():
            return replies.CutResult(outcome="waiting", because="the state has not moved in time")
        if (error := moving.exception()) is not None:
            return replies.CutResult(outcome="waiting", because=str(error))
        writes = {f"{swap.port} {swap.topic}": self._last_write(swap.port, cut) for swap in cut.swaps}
        if cut.other is not None:
            return replies.CutResult(outcome="done", first=writes, moved=moving.result())
        return replies.CutResult(outcome="done", last=writes)

    def _takes(self, cut: _Cut) -> bool:
        """Take the baton without a message, if it is offered; whether this side has it."""
        self._gates.step(cut.baton, BatonStep.TAKE)
        return self._gates.page.word(cut.baton).holder == self._gates.index + 1

    def _last_write(self, port: str, cut: _Cut) -> replies.LastWrite | None:
        entry = self._gates.entry(port)
        if entry.passed <= cut.before.get(port, -1):
            return None
        return replies.LastWrite(number=entry.passed, source=time.time_ns() - time.monotonic_ns() + entry.last)

    async def cancel_cut(self, command: commands.CancelCutCommand) -> replies.Done:
        """Either side: the old one keeps the baton, or gets it back."""
        cut = self._cuts.pop(command.cut, None)
        if cut is None:
            return replies.Done()
        if cut.state is not None:
            await self._end_transfer(command.cut, cut)
        if cut.other is not None:
            await self._withdraw(cut)
        elif cut.baton:
            self._gates.step(cut.baton, BatonStep.WITHDRAW)
            kept = [self._gates.entry(swap.port) for swap in cut.swaps]
            # What it has kept in the cut is published before the flags of the cut, by which it is kept, are taken away.
            await self._node.comes_true(lambda: not any(entry.kept for entry in kept), LOOK)
            self._restore(cut)
        return replies.Done()

    async def _end_transfer(self, id: str, cut: _Cut) -> None:
        """Either side: no state moves any more. The old one answers requests again."""
        if (moving := self._states.transfers.pop(id, None)) is not None:
            moving.cancel()
            await asyncio.wait({moving})
        if cut.other is None and not self._gates.answers:
            self._gates.answer(self._node.component.stop_times.drain)

    async def _withdraw(self, cut: _Cut) -> None:
        """The new side: close its gates, and give the baton back to the old side."""
        gates = self._gates
        assert cut.other is not None
        if not cut.baton:
            return
        self._node.set_links({swap.port: "closed" for swap in cut.swaps})
        gates.page.step(cut.baton, BatonStep.WITHDRAW, cut.other)
        if gates.page.word(cut.baton).holder == gates.index + 1:
            gates.step(cut.baton, BatonStep.FENCE)
            if not await self._node.comes_true(lambda: not self._writers(cut.baton), PUBLISHING):
                raise CommandRefused(f"{self._node.record.instance} is publishing, and that does not end")
            gates.page.step(cut.baton, BatonStep.GIVE, cut.other)
        self._restore(cut)

    def _restore(self, cut: _Cut) -> None:
        gates = self._gates
        for port, (baton, flags) in cut.own.items():
            entry = gates.entry(port)
            entry.baton, entry.flags = baton, flags
        gates.page.ring(gates.index)


def _decided(gates: Gates) -> dict[str, tuple[int, int]]:
    """By output, what decides for it: its baton and its flags."""
    return {port: (gates.baton(port), int(gates.entry(port).flags)) for port in gates.component.outputs}

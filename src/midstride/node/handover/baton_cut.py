"""The side of a component in a hand-over with a node without Midstride's API: the baton decides what passes its gates.

docs/protocols/baton.md. There is no agreed slot. The policy runs on the data
thread, write by write; the task runs on the control thread, and needs no manager.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from midstride.errors import CommandRefused
from midstride.node.author.ports import GatePolicy, OutputLink
from midstride.node.component_host import Host
from midstride.node.handover.baton import BatonState, BatonStep, TakenSeat
from midstride.wire.replies import CutOutcome, CutResult, LastWrite
from midstride.wire.state import GateState

# How often the task looks at the baton (s), and how often once it is over.
TICK: Final = 0.002
SLOW_TICK: Final = 0.05
# Without a manager, which gives up earlier, the offer of the baton is withdrawn so long after it should be taken (s).
OFFER: Final = 5.0


@dataclass(eq=False)
class BatonCut(GatePolicy):
    """``links`` publish while this component has the baton. ``written``: by link, its first or last number, and when.

    ``latches``: those without a rate, whose last message is repeated when a new side takes over.
    """

    links: Sequence[OutputLink]
    latches: Sequence[OutputLink]
    seat: TakenSeat
    host: Host
    new: bool
    written: dict[OutputLink, LastWrite] = field(default_factory=dict, init=False)

    def arm(self) -> None:
        for link in self.links:
            link.enter(self)

    def passes(self, link: OutputLink) -> bool:
        word = self.seat.word()
        return word.holder == self.seat.me or (word.successor == self.seat.me and word.state is BatonState.LAID)

    admits = passes

    def publish(self, link: OutputLink, message: Any) -> bool:
        if not self.seat.begin(self.links.index(link)):
            return False
        try:
            link.publish(message)
        finally:
            self.seat.end()
        link.count += 1
        if link not in self.written or not self.new:
            self.written[link] = LastWrite(number=link.count, source=self.host.now())
        return True

    def shows(self, link: OutputLink) -> GateState:
        return "open" if self.seat.word().holder == self.seat.me else "closed"

    def latch(self) -> None:
        """Publish what was written once, behind the gate."""
        for link in self.latches:
            if link.cut is self and link not in self.written and link.last_gated is not None:
                self.publish(link, link.last_gated)

    def conclude(self) -> None:
        """This side has the baton for good, or as long as it lives: nothing needs to be decided any more."""
        if self.new:
            self.latch()
        for link in self.links:
            if link.cut is self:
                link.set_gate(True)

    def close(self) -> None:
        for link in self.links:
            if link in link.output.links:
                link.set_gate(False)

    @property
    def armed(self) -> bool:
        return any(link.cut is self for link in self.links)


@dataclass(eq=False)
class BatonTask:
    """One side of such a hand-over; the counterpart of the tasks of :mod:`midstride.node.handover.cut_protocol`."""

    host: Host
    changed: Callable[[], None]
    cut: BatonCut
    patience: float
    outcome: CutOutcome | None = field(default=None, init=False)
    finished: asyncio.Event = field(default_factory=asyncio.Event, init=False)

    async def run(self) -> None:
        seat, begun = self.cut.seat, self.host.steady()
        if self.cut.new:
            seat.step(BatonStep.NAME_SUCCESSOR, seat.other, seat.me, at_once=seat.timed)
            await self.host.on_data(self.cut.latch)
        while self.outcome is None:
            overdue = (self.host.steady() - begun) / 1e9 > self.patience + OFFER
            await (self._new_side(overdue) if self.cut.new else self._old_side(overdue))
            await self.host.sleep(TICK)
        await self._linger()

    async def _new_side(self, overdue: bool) -> None:
        seat = self.cut.seat
        if self.cut.written:
            await self._end("done", self.cut.conclude)
            return
        word = seat.word()
        withdrawn = word.holder == seat.other and not word.successor  # or taken from that side by force
        if withdrawn or overdue or any(link.output.owner.failed for link in self.cut.links):
            await self.cancel()

    async def _old_side(self, overdue: bool) -> None:
        seat = self.cut.seat
        if overdue:
            seat.step(BatonStep.FENCE, seat.me)  # from then on, no successor can be named
        word = seat.word()
        if word.holder != seat.me:
            await self._end("done", lambda: None)
        elif word.state is BatonState.FENCED:
            await self._end("resumed", self.cut.conclude)

    async def _end(self, outcome: CutOutcome, gates: Callable[[], None]) -> None:
        if self.outcome is None:
            self.outcome = outcome
            await self.host.on_data(gates)
        self.finished.set()
        self.changed()

    async def _linger(self) -> None:
        """Keep the seat until the hand-over is settled: until then, the old side may get the baton back."""
        seat = self.cut.seat
        while seat.taken and self.outcome != "cancelled":
            word = seat.word()
            if word.holder == seat.me:
                if self.outcome == "done" and not self.cut.new:  # the new side has died
                    await self._reopen()
                elif not word.predecessor:
                    seat.rise()
                    return
            elif not self.cut.armed:
                if word.predecessor == seat.me:
                    seat.step(BatonStep.SETTLE, word.holder)
                seat.rise()
                return
            await self.host.sleep(SLOW_TICK)

    @property
    def new(self) -> bool:
        return self.cut.new

    @property
    def over(self) -> bool:
        return self.finished.is_set()

    async def settle(self) -> None:
        """Return once it has an outcome; cancel it unless the new side has the baton, and has written."""
        if self.outcome is None and not (self.new and self.cut.written):
            with contextlib.suppress(CommandRefused):
                await self.cancel()
        await self.finished.wait()

    async def cancel(self) -> None:
        """The old side has the baton again, or still. Raises CommandRefused where the new side has not returned it."""
        seat = self.cut.seat
        if self.cut.new:
            await self._cancelled(self.cut.close)
            if seat.taken:
                seat.step(BatonStep.WITHDRAW, seat.other)
                if seat.word().holder == seat.me:  # its gates are closed, so it publishes nothing
                    seat.step(BatonStep.GIVE, seat.other)
                seat.rise()
        elif not seat.taken:
            await self._cancelled(lambda: None)
        elif seat.step(BatonStep.FENCE, seat.me).holder == seat.me:
            await self._reopen()
        else:
            raise CommandRefused("the new side has the baton, and has not given it back")

    async def _cancelled(self, gates: Callable[[], None]) -> None:
        self.outcome = "cancelled"
        await self.host.on_data(gates)
        self.finished.set()
        self.changed()

    async def _reopen(self) -> None:
        self.cut.seat.step(BatonStep.FENCE, self.cut.seat.me)
        await self._cancelled(self.cut.conclude)
        self.cut.seat.rise()

    def result(self) -> CutResult:
        writes = {str(link): self.cut.written.get(link) for link in self.cut.links}
        return CutResult(
            outcome=self.outcome or "waiting",
            first=writes if self.cut.new else {},
            last={} if self.cut.new else writes,
        )

"""The control thread's part in a cut: waiting for T, the report of the first write, and resuming.

Each side of a cut is one task, which ends with the outcome that `await_cut` returns. It does not need the manager, so
the topic does not depend on the manager's being alive. Which side writes after T is decided by the arbiter of the cut;
a report only lets the old side know early.
"""

from __future__ import annotations

import abc
import asyncio
import math
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from typing import ClassVar, Final

from midstride.errors import BackendError, CommandRefused
from midstride.node.component_host import Host
from midstride.node.handover.cut import GRACE, IncomingSide, OutgoingSide
from midstride.node.handover.cut_life import PHASES, STATES, CutEvent, CutPhase, CutProgress, CutState
from midstride.node.handover.lease import LeaseKeeper
from midstride.node.handover.state_transfer import StateExport, StateImport
from midstride.wire.replies import CutOutcome, CutResult

# How often a side checks whether it can go on (s): shorter than a period at 200 Hz.
TICK: Final = 0.002
# How long one attempt to report to the peer may take (s), and how many there are: a dead peer cannot write.
REPORT_TIMEOUT: Final = 0.25
REPORT_ATTEMPTS: Final = 20
# A side whose clock has gone back by more than this gives the cut up (s): T may be far ahead again.
JUMP: Final = 1.0
# A new side may be late by so much, however fast the ROS clock runs (s).
SHORTEST_SILENCE: Final = 0.1
# How often an old side that has done its part looks whether the new one can still write (s).
SLOW_TICK: Final = 0.05
# How often a side that waits for T looks at the clock, and at what has happened meanwhile (s).
LONGEST_WAIT: Final = 0.01


@dataclass(eq=False)
class _CutTask(abc.ABC):
    """One side of a cut: a phase, an outcome, and cancellation."""

    new: ClassVar[bool]
    host: Host
    changed: Callable[[], None]
    side: OutgoingSide | IncomingSide
    phase: CutPhase = field(default=CutPhase.APPROACHING, init=False)
    status: CutState = field(default=CutState.WAITING, init=False)
    finished: asyncio.Event = field(default_factory=asyncio.Event, init=False)
    _latest: int = field(default=0, init=False)  # what the clock of the cut has shown

    @property
    def outcome(self) -> CutOutcome:
        return self.status.value

    def _going(self) -> bool:
        """Return whether the cut has no outcome yet; a cancellation may come at any await."""
        return self.status is CutState.WAITING

    def _failed(self) -> bool:
        """Return whether this side will not write at T."""
        return False

    @property
    @abc.abstractmethod
    def over(self) -> bool:
        """Return whether nothing of this cut, nor its arbiter, decides any more what this side writes."""

    @abc.abstractmethod
    async def cancel(self) -> None: ...

    @abc.abstractmethod
    async def resolve(self) -> None:
        """Return once it has an outcome; cancel it unless the new side has taken over."""

    def _jumped_back(self, by: float = JUMP) -> bool:
        """Return whether the clock of the cut has been set back since this was first asked: a simulation has started
        again.
        """
        now = self.side.now()
        self._latest = max(self._latest, now)
        return self._latest - now > by * 1e9

    async def _until(self, at: int) -> None:
        """Wait until ``at`` on the clock of the cut, which may not run like the steady one; less long if it fails."""
        while self._going() and not self._failed() and (left := (at - self.side.now()) / 1e9) > 0:
            if self._jumped_back():
                return
            await self.host.sleep(min(max(left, 0.0001), LONGEST_WAIT))

    def _advances(self, progress: CutProgress) -> None:
        self.phase = PHASES.after(self.phase, progress, str(self))

    def _happens(self, event: CutEvent) -> None:
        self.status = STATES.after(self.status, event, str(self))

    def __str__(self) -> str:
        return f"the {'new' if self.new else 'old'} side of a cut"

    async def _end(self, event: CutEvent, gates: Callable[[], None]) -> None:
        """Set the outcome first, since the peer may ask at any moment; then the gates; then wake those that wait."""
        self._happens(event)
        await self.host.on_data(gates)
        self.finished.set()
        self.changed()


@dataclass(eq=False)
class CutOutTask(_CutTask):
    """The old side: writes up to T, and resumes where `taken` does not arrive in time."""

    new = False
    side: OutgoingSide
    resume_after: float
    export: StateExport | None = None
    _taken: bool = field(default=False, init=False)
    # The manager wants this side to write again, and the new one could still.
    _wanted: bool = field(default=False, init=False)
    _watching: bool = field(default=False, init=False)
    # When T had come (steady, ns).
    _due_at: int = field(default=0, init=False)

    async def run(self) -> None:
        await self._pass()
        self._advances(CutProgress.FINISHED)
        await self.watch_successor()

    async def _pass(self) -> None:
        """Do this side's part, until there is an outcome."""
        await self._until(self.side.at)
        self._advances(CutProgress.DUE)
        self._due_at = self.host.steady()
        while self._going():
            if self.side.arbiter.passed_on:
                self._note_taken()
            if self._failed():
                await self._end(CutEvent.TAKEN_OVER, self.side.finish)
                return
            if self._jumped_back() and self._may_resume():
                await self._end(CutEvent.RECLAIMED, self.side.reopen)
                return
            passed = self.side.over or await self.host.on_data(self.side.passed)
            if not self._going():
                return
            if passed and self.export is not None:
                await self.export.passed(self)
                if not self._going():
                    return
            if passed and self._taken:
                await self._end(CutEvent.TAKEN_OVER, self.side.confirmed)
            elif not self._taken and self._given_up() and self._may_resume():
                await self._end(CutEvent.RECLAIMED, self.side.reopen)
            else:
                await (self.host.sleep(TICK) if self.export is None else self.export.pause())

    def _failed(self) -> bool:
        """Return whether the new side has written, and the clock was set back before this side noticed T."""
        return self._taken and self.side.now() < self.side.at and self._jumped_back(0.0)

    def _given_up(self) -> bool:
        if self.export is not None and self.export.given_up(self.resume_after):
            return True
        return self._is_overdue()

    def _is_overdue(self) -> bool:
        """Return whether the new side should have written ``resume_after`` ago; where messages drive it, since one
        arrived.

        A new side on a time grid that ``/clock`` drives writes nothing while that stands still.
        """
        since = self.side.newer_at if self.side.driven_by_messages else self._due_at
        if since is not None and self.export is not None:
            since = max(since, self.export.heard_at)
        if since is None:
            return False
        silent = (self.host.steady() - since) / 1e9
        if self.side.clock == "ros" and self.host.simulated_time:
            on_clock = (self.side.now() - self.side.at) / 1e9
            return on_clock > self.resume_after and silent > min(SHORTEST_SILENCE, self.resume_after)
        return silent > self.resume_after

    async def _end(self, event: CutEvent, gates: Callable[[], None]) -> None:
        export = self.export
        if export is None:
            await super()._end(event, gates)
            return
        export.end(self, resumed=event is not CutEvent.TAKEN_OVER)

        def gates_then_calls() -> None:
            gates()
            export.release_if_over()

        await super()._end(event, gates_then_calls)

    async def taken(self, failed: bool, place: str = "") -> bool:
        """The new side has written, and has the right to in ``place``; or it has failed.

        Returns whether this one writes again.
        """
        if self.status in (CutState.RESUMED, CutState.CANCELLED):
            return True
        if failed:
            self.side.arbiter.free()
            await self.cancel()
            return True
        self.side.arbiter.share(place)
        self._note_taken()
        return False

    def _note_taken(self) -> None:
        if not self._taken:
            self._taken, self.side.taken_at = True, self.host.steady()

    def _may_resume(self) -> bool:
        """Return whether this side may write again; else the new one has taken over, even if its report is lost.

        Where that is undecided, it is asked again.
        """
        if self._taken:
            return False
        has = self.side.arbiter.reclaim()
        if not has and not self.side.arbiter.undecided:
            self._note_taken()
        return has

    async def _reclaim(self) -> bool:
        """Return whether this side has the right, as soon as that is decided."""
        while not (has := self.side.arbiter.reclaim()) and self.side.arbiter.undecided:
            await self.host.sleep(TICK)
        return has

    async def cancel(self) -> None:
        """Raises CommandRefused where the new side has taken over, and has not given up."""
        if not await self._reclaim():
            self._note_taken()
            self._wanted = True
            raise CommandRefused("the new side has taken over, and can still write")
        await self._end(CutEvent.CANCELLED, self.side.reopen)

    async def watch_successor(self) -> None:
        """Write again as soon as the new side can no longer: it has given up, or its process has ended.

        That needs no command, which may not arrive. It ends with the attachments, or once another cut has them. Where
        the two sides are not known to have one arbiter, only a command makes this side write again.
        """
        if self._watching:
            return
        self._watching = True
        while not self.over:
            await self.host.sleep(SLOW_TICK)
            await self._reclaim_freed()
        await self.finished.wait()
        self.side.arbiter.leave()

    @property
    def over(self) -> bool:
        if self.status is CutState.DONE:
            return not (self.side.closed or (self._wanted and not self.side.links))
        return not self._going()

    async def _reclaim_freed(self) -> None:
        if not self.over and self._taken and self.side.arbiter.reclaim_freed():
            await self._end(CutEvent.RECLAIMED, self.side.reopen)

    async def resolve(self) -> None:
        if self._going() and await self._reclaim() and self._going():
            await self._end(CutEvent.CANCELLED, self.side.reopen)
        await self.finished.wait()
        await self._reclaim_freed()

    def result(self) -> CutResult:
        if (export := self.export) is None:
            return CutResult(outcome=self.outcome, last=self.side.last())
        return CutResult(outcome=self.outcome, because=export.because, moved=export.moved, last=self.side.last())


@dataclass(eq=False)
class CutInTask(_CutTask):
    """The new side: writes from T on, and reports its first write to its peer, unless the arbiter shows it.

    Without a moment, it gives up after ``patience`` seconds.
    """

    new = True
    side: IncomingSide
    # Reports the first write, or a failure, to the old side within so many seconds; returns whether that has resumed.
    report: Callable[[float, bool], Awaitable[bool]] | None
    state: StateImport | None = None
    patience: float = math.inf
    keeper: LeaseKeeper | None = None  # of its lease, where it has one
    _reports: int = field(default=0, init=False)  # how often it has reported to its peer
    _begun_at: int = field(default=0, init=False)  # steady, ns

    async def run(self) -> None:
        self._begun_at = self.host.steady()
        self.side.arbiter.request()
        # A time grid needs no latch, unless nothing may be written.
        latched = not self.side.quiet and all(link.output.owner.rate is not None for link in self.side.links)
        grace = GRACE if self.side.driven_by_messages or self.side.quiet else 0.0
        await self._until(self.side.at)
        if self.state is not None and self._going():
            await self.state.decided()
        self._advances(CutProgress.DUE)
        waited_from = self.host.steady()
        while self.side.links and self._going() and not self._is_decided():
            # A message in transit at T may still make the new side write; nothing else will.
            waited = (self.host.steady() - waited_from) / 1e9
            if not latched and waited > grace:
                await self.host.on_data(self.side.latch)
                latched = not self.side.quiet or self.side.taken  # where it is not offered yet, it is asked for again
            else:
                await self.host.sleep(TICK)
        if (self._failed() or self.side.refused) and await self._abandon(report=not self.side.refused):
            return
        self._advances(CutProgress.DECIDED)
        if self._going() and await self._resumed(failed=False):
            await self._end(CutEvent.CANCELLED, self._close)
        if self._going():
            self._advances(CutProgress.CONFIRMED)
            self._happens(CutEvent.TAKEN_OVER)
            self.finished.set()
            self.changed()
            if self.side.grace:
                await self.host.sleep(self.side.grace)  # messages from before T may still be in transit to here
            await self.host.on_data(self._conclude)
            self.changed()  # the gates of outputs that have written nothing are open now, too
            self._advances(CutProgress.FINISHED)
            while not self.side.arbiter.settled:
                await self.host.sleep(SLOW_TICK)
            self.side.arbiter.leave()

    def _conclude(self) -> None:
        self.side.conclude()
        if self.state is not None:
            self.state.end(self, done=True)

    def _close(self) -> None:
        self.side.close()
        if self.state is not None:
            self.state.end(self, done=False)

    @property
    def is_detached(self) -> bool:
        """Return whether this side had attachments, and has none left."""
        return bool(self.side.links) and not any(link in link.output.links for link in self.side.links)

    def _is_decided(self) -> bool:
        return bool(self.side.written) or self.side.taken or self.side.refused or self._failed()

    def _failed(self) -> bool:
        """Return whether the author's code raised, the clock jumped back or no state came, before the first write."""
        if self.state is not None and self.state.failed:
            return True
        failed = self._jumped_back() or any(link.output.owner.failed for link in self.side.links)
        overdue = (self.host.steady() - self._begun_at) / 1e9 > self.patience
        return (failed or overdue) and not self.side.written and not self.side.taken

    @property
    def over(self) -> bool:
        if not self.side.links:
            return self.finished.is_set()
        return self.status is CutState.CANCELLED or self.is_detached

    async def _resumed(self, failed: bool) -> bool:
        """Report to the old side until it answers; whether it has resumed. One that cannot be reached has not.

        Where the arbiter does not tell so, a first write is reported until the answer does.
        """
        if self.report is None:
            return False
        while self._reports < REPORT_ATTEMPTS or not (failed or self.side.arbiter.settled):
            if not failed and not self._going():
                return False
            self._reports += 1
            try:
                return await self.report(REPORT_TIMEOUT, failed)
            except BackendError:
                await self.host.sleep(REPORT_TIMEOUT / 5)
        return False

    async def cancel(self) -> None:
        if self.state is not None:
            await self.state.cancel()
        await self._end(CutEvent.CANCELLED, self._close)

    async def resolve(self) -> None:
        if self._going() and self.phase in (CutPhase.APPROACHING, CutPhase.CROSSING):
            await self._abandon(report=False)
        await self.finished.wait()

    async def _abandon(self, report: bool) -> bool:
        """Cancel this side unless it has written; whether it is cancelled. A hung call delays nothing."""
        if self.side.arbiter.renounce() or await self.host.on_data(self.side.abandon):
            self._happens(CutEvent.CANCELLED)
            if report:
                await self._resumed(failed=True)
            await self.cancel()
        return self.status is CutState.CANCELLED

    def result(self) -> CutResult:
        because = None if self.state is None else self.state.problem
        return CutResult(outcome=self.outcome, because=because, first=self.side.first())

"""The hand-over on live components: both publishers exist at once, and switch at an agreed moment, the *cut*.

The new publisher is behind a closed gate until both sides know the cut, a future slot of the old publisher's time grid
(docs/protocols/cut.md). The old side is sent the cut first, and resumes publishing unless the new side reports
its first message: if the manager exits at any point, the topic is silent for at most ``RESUME_PERIODS`` periods
(:mod:`.agreed_cut`).
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Final

from immutables import Map

from midstride.errors import CallTimeout, CommandRefused, MidstrideError, StepFailed, Unreachable
from midstride.model.action import Swap
from midstride.model.component import PortRef
from midstride.model.configuration import Configuration
from midstride.runtime.backend_protocol import Backend
from midstride.runtime.cancellation import all_of
from midstride.runtime.handover.agreed_cut import (
    Cut,
    agree_cuts,
    early_publishers,
    publishers_found,
    require_found,
    require_same_clock,
    written_once,
)
from midstride.runtime.handover.arbiter_choice import choose_arbiter, require_answering
from midstride.runtime.handover.cut_turns import CutTurn, only_turn
from midstride.runtime.handover.fences import Fences
from midstride.runtime.handover.new_publishers import ATTACH_TIMEOUT, DETACH_TIMEOUT, NewPublishers
from midstride.runtime.handover.state_transfers import StateTransfers
from midstride.runtime.process.answering_instance import have_answer
from midstride.runtime.process.component_client import ComponentClient
from midstride.runtime.records.events import EventLog
from midstride.runtime.watch.simulated_time import stretch_of
from midstride.wire import commands
from midstride.wire.clock_offset import ClockOffset
from midstride.wire.replies import CutClock, CutResult

# How far ahead the cut is (s): many round trips, so that both sides know it in time. If the machine is too busy for one
# of these, the next one is tried.
LEADS: Final = (0.1, 0.3, 1.0)
# None is tried that is shorter than so many of the exchanges just before it: a cut that one side learns of too late
# makes the messages after its moment late.
EXCHANGES: Final = 2.0
# The same for an old side that was too slow for these, at most: as far as it may still take to become free.
LONGEST_LEAD: Final = 10.0
# An old side that is not free for so long after a cut could not be agreed was too busy for it (s).
AT_ONCE: Final = 0.2
# One that refuses a cut after this part of the time ahead of it was busy until then.
SLOW: Final = 0.9
# How often, and how long each time (s), the two sides try to connect to each other.
MEET_ATTEMPTS: Final = 10
MEET_TIMEOUT: Final = 0.5
# How often, and at which interval (s), an old side that cannot be reached is looked for before it counts as running.
EXIT_ATTEMPTS: Final = 10
EXIT_INTERVAL: Final = 0.01


class OldSideFailed(StepFailed):
    """The old side may not have done its part."""


@contextlib.contextmanager
def _old_side_needed() -> Iterator[None]:
    try:
        yield
    except (CommandRefused, CallTimeout) as error:
        raise OldSideFailed(str(error)) from error


def _raised(result: CutResult | BaseException) -> CutResult:
    """The result; raises it if it is an exception."""
    if isinstance(result, BaseException):
        raise result
    return result


@dataclass(slots=True)
class LiveHandover:
    """One hand-over on the components of ``configuration``.

    ``fences`` is for old sides that hang. ``states`` moves their state; there may be state to move without any swap.
    ``before_cut(old, new)`` is called when both are ready for it. It is cut when it is its ``turn``: others may be
    prepared at the same time.
    """

    client: ComponentClient
    events: EventLog
    configuration: Configuration
    swaps: Sequence[Swap]
    backend: Backend
    states: StateTransfers
    fences: Fences
    before_cut: Callable[[str, str], Awaitable[None]] | None = None
    timing: Mapping[str, float] = field(default_factory=Map)  # of the specification
    turn: CutTurn = field(default_factory=only_turn)
    rates: bool = True  # whether the new publishers must keep their rates before the cut
    # Of the new outputs that have published at an agreed moment: the number of the first message.
    first_numbers: dict[PortRef, int] = field(default_factory=dict, init=False)
    _new: NewPublishers = field(init=False)
    # Those of services and ROS actions: no messages are cut, but requests answered by the new side from then on.
    _services: list[Swap] = field(init=False)
    _cuts: list[Cut] = field(default_factory=list)
    _too_slow: bool = False  # the old side was not free until the last moment that was tried
    _published: bool = False  # the new side has published after the cut
    _deadline: float = 0.0  # until when an old side that hangs may become free (steady s)

    def __post_init__(self) -> None:
        is_topic = self.configuration.is_topic
        self._services = [swap for swap in self.swaps if not is_topic(swap.connector)]
        self.swaps = [swap for swap in self.swaps if is_topic(swap.connector)]
        self._new = NewPublishers(self.client, self.events, self.configuration, self.backend, self.timing, self.rates)

    async def run(self) -> dict[PortRef, int | None]:
        """The number of each old output's last message. Raises StepFailed with the reason.

        Then the old publishers publish as before, and the new ones have no endpoint on the topics. What fails after the
        cut is only noted.
        """
        last: dict[PortRef, int | None] = {}
        try:
            await self._attach_servers()
            if self.swaps or not self._services or self._moves_state:
                last = await self._exchange()
            else:
                await self._have_answer()
        except MidstrideError as error:
            await self._undo()
            raise StepFailed(str(error)) from error
        except (Exception, asyncio.CancelledError):
            await self._undo()
            raise
        await self._change_answering()
        for swap in (*self.swaps, *self._services):
            if self.client.life.is_gone_or_fenced(swap.old.instance):
                continue
            try:
                detach = commands.DetachCommand(port=swap.old.port, topic=self._topic(swap), timeout=DETACH_TIMEOUT)
                await self.client.change(swap.old.instance, detach)
            except MidstrideError as error:
                words = f"{swap.old} could not be taken off {swap.connector} after the hand-over: {error}"
                self.events.add("note", words)
        return last

    async def _exchange(self) -> dict[PortRef, int | None]:
        """Hand over at an agreed moment; or take over from old sides that have exited, or that are fenced.

        One that hangs has until ``fences.wait`` seconds from now to become free, not counting the time in which it is
        not asked since it is the turn of others; then it is tried once more, with more time ahead.
        """
        self._deadline = self.fences.now() + self.fences.wait
        olds = sorted({old for old, _ in self._pairs})
        attempt: Callable[[], Awaitable[dict[PortRef, int | None]]] = partial(self._agree, LEADS)
        while True:
            try:
                return await attempt()
            except MidstrideError as error:
                failure = error
            asked = self.fences.now()
            hung: dict[str, str] = {}
            if isinstance(failure, OldSideFailed) and not await self._have_exited():
                if self._published:
                    self._deadline = asked  # nothing is gained by waiting: it may only disturb the new one
                found = await asyncio.gather(*(self.fences.unresponsive(old, self._deadline) for old in olds))
                hung = {old: words for old, words in zip(olds, found, strict=True) if words is not None}
            if await self._have_exited():
                return await self._take_over()
            slow = self._too_slow or self.fences.now() - asked > AT_ONCE
            if not isinstance(failure, OldSideFailed) or not (hung or slow):
                raise failure
            if hung or self.fences.now() >= self._deadline:
                return await self._take_over(hung or {old: f"{old} is too slow: {failure}" for old in olds})
            if self._published:
                attempt = self._await_cuts
            else:
                await self._undo_exchange()
                self._cuts = []
                attempt = partial(self._agree, (max(LEADS[-1], min(LONGEST_LEAD, self._deadline - self.fences.now())),))

    @property
    def _moves_state(self) -> bool:
        return any(old in self.states.keeping for old, _ in self.states.pairs)

    async def _have_exited(self) -> bool:
        return all([await self._has_exited(old) for old, _ in self._pairs])

    async def _attach_servers(self) -> None:
        """Attach the new servers: their gates are open once they answer. Raises StepFailed if they cannot take over."""
        for swap in self._services:
            require_answering(self.configuration, swap)
            attach = commands.AttachCommand(
                port=swap.new.port,
                topic=self._topic(swap),
                peers=0,
                timeout=ATTACH_TIMEOUT,
                await_ready=False,
            )
            await self.client.change(swap.new.instance, attach)

    async def _have_answer(self) -> None:
        """Have the new sides of the services answer, where no topic is handed over. Raises MidstrideError."""
        await self.states.prepare()
        if self.states.agreed:
            await self._exchange()
        for old, new in sorted({(swap.old.instance, swap.new.instance) for swap in self._services}):
            if self.before_cut is not None and not self.states.agreed:
                await self.before_cut(old, new)
            await self._have_answer_for(old, new)

    async def _have_answer_for(self, old: str, new: str) -> None:
        """Have ``new`` answer requests instead of ``old``, and note what that has left. Raises MidstrideError."""
        runs, drain = not self.client.life.is_gone(old), self.configuration.component(old).stop_times.drain
        if (left := await have_answer(self.client, new, old if runs else None, drain)) is not None:
            self.events.add("note", left)

    async def _change_answering(self) -> None:
        """Have each replacement answer the requests to its role's node."""
        instances = self.configuration.instances
        for old, new in self._pairs:
            if old != new and instances[old].role == instances[new].role:
                try:
                    await self._have_answer_for(old, new)
                except MidstrideError as error:
                    self.events.add("note", f"{new} does not answer requests to {instances[new].role} yet: {error}")

    async def _agree(self, leads: Sequence[float]) -> dict[PortRef, int | None]:
        """Hand over at an agreed moment; the number of each old output's last message.

        Raises OldSideFailed where the old side may be to blame.
        """
        pairs = self._pairs
        for old, new in pairs:
            if choose_arbiter(self.configuration.component, old, new).by_moment:
                with _old_side_needed():
                    await require_same_clock(self.client, old, new)
        connectors = sorted({swap.connector for swap in self.swaps})
        found = await all_of(
            publishers_found(self.client, self.configuration, name, self._early_publishers(name)) for name in connectors
        )
        with _old_side_needed():
            readers = await all_of(self._new.readers(swap) for swap in self.swaps)
        await self._new.attach_beside(self.swaps, readers)
        await all_of(
            require_found(self.client, self.backend, self.configuration, self.swaps, connector, before)
            for connector, before in zip(connectors, found, strict=True)
        )
        await self._await_turn(self.swaps, lambda: any(self.client.life.is_gone(old) for old, _ in pairs))
        begun = self.fences.now()
        for old, new in pairs:
            with _old_side_needed():
                await self._meet(new, old)
        shortest = EXCHANGES * (self.fences.now() - begun)
        offsets = await self._clock_offsets()
        await self.states.prepare()
        await self._before_cut()
        for lead in [lead for lead in leads if lead >= shortest] or leads[-1:]:
            with _old_side_needed():
                states = self.states.agreed
                self._cuts = await agree_cuts(self.client, self.configuration, self.swaps, lead, states, offsets)
                for cut in self._cuts:
                    cut.quiet = bool(cut.swaps) and self._new.quiet.issuperset(cut.swaps)
                if await self._announce(last_try=lead == leads[-1]):
                    break
        return await self._await_cuts()

    async def _await_turn(self, swaps: Iterable[Swap], old_is_silent: Callable[[], bool]) -> None:
        """Wait for the probations of the new publishers, and then until it is their turn. Raises GivenUp."""
        await self.turn.prepare(self._new.await_probation(swaps))
        ready = self.fences.now()
        await self.turn.begin(old_is_silent)
        self._deadline += self.fences.now() - ready

    def _early_publishers(self, connector: str) -> int:
        new = (swap.new for swap in self.swaps if swap.connector == connector)
        return early_publishers(self.configuration, new)

    async def _before_cut(self) -> None:
        for old, new in self._pairs:
            if self.before_cut is not None:
                await self.before_cut(old, new)

    async def _take_over(self, hung: Mapping[str, str] = Map()) -> dict[PortRef, int | None]:
        """Have the new publishers publish at once, because the old ones have exited, or are fenced since they hang.

        Of one that has exited, going back would leave the topics without a publisher. One that is ``hung``, and why, is
        fenced when the new ones are ready to publish, and before they do.
        """
        last: dict[PortRef, int | None] = {}
        if hung and self._cuts:  # the new ones are ready, and may publish already
            last = await self._fence(hung)
        for cut in self._cuts:
            if cut.lease and self.client.life.is_gone(cut.old):
                await self._confirm(cut)
        published = [cut for cut in self._cuts if await self._publishes(cut)]
        waiting = [swap for swap in self.swaps if not any(swap in cut.swaps for cut in published)]
        await self._cancel(cut for cut in self._cuts if cut not in published)
        await self._new.attach([swap for swap in waiting if not self._new.attached(swap)])
        self._new.rates &= "probation" in self.timing  # the topics are silent
        await self._await_turn(waiting, lambda: True)
        if hung and not last:
            await self._before_cut()
            last = await self._fence(hung)
        for swap in waiting:
            grid = await self.client.read(swap.new.instance, commands.GridCommand(port=swap.new.port))
            latch = written_once(self.configuration, swap.new, grid.trigger)
            opening = commands.GateCommand(port=swap.new.port, topic=self._topic(swap), gate="open", latch=latch)
            await self.client.change(swap.new.instance, opening)
        for old, new in self._pairs:
            how = "was fenced" if old in hung else "exited during the hand-over"
            self.events.add("note", f"{old} {how}, and {new} took over at once")
            if not any((cut.old, cut.new) == (old, new) for cut in published):
                self.states.note_exit(old, new, hangs=old in hung)
        return last

    async def _fence(self, hung: Mapping[str, str]) -> dict[PortRef, int | None]:
        """Fence the old sides that hang. Raises StepFailed. Those that do not were asked to agree with them in vain."""
        last: dict[PortRef, int | None] = {}
        for old in sorted({old for old, _ in self._pairs}):
            because = hung.get(old, f"{old} hands over together with {', '.join(sorted(hung))}")
            links = [(swap.old, self._topic(swap)) for swap in self.swaps if swap.old.instance == old]
            last |= await self.fences.fence(old, because, links)
        return last

    async def _publishes(self, cut: Cut) -> bool:
        """Return whether the new side of ``cut`` has published, or will at the agreed moment."""
        try:
            incoming = await self.client.read(cut.new, self._await_cut(cut))
            if incoming.outcome == "done":
                self.states.ended(cut, incoming)
            return incoming.outcome == "done"
        except CommandRefused:
            return False  # it was not sent the cut

    async def _has_exited(self, instance: str) -> bool:
        """Return whether the process of ``instance`` has exited.

        A connection that has just closed may not be known to be yet.
        """
        for _ in range(EXIT_ATTEMPTS):
            if self.client.life.is_gone(instance):
                return True
            if self.client.life.responsive(instance) is None and self.client.life.latest(instance) is not None:
                return False  # it is connected, and silent
            try:
                await self.client.peek(instance)
            except Unreachable:
                await asyncio.sleep(EXIT_INTERVAL)
                continue
            except MidstrideError:
                pass
            return False
        return self.client.life.is_gone(instance)

    @property
    def _pairs(self) -> list[tuple[str, str]]:
        """Old and new components: those of the swaps, and those between which only state moves."""
        return sorted({(swap.old.instance, swap.new.instance) for swap in self.swaps} | {*self.states.pairs})

    def _topic(self, swap: Swap) -> str:
        return self.configuration.topic(swap.connector)

    async def _meet(self, new: str, old: str) -> None:
        """Have the new side connect to the old one.

        Several short attempts, because the topic is silent if the old side has exited: each attempt checks that first.
        """
        for _ in range(MEET_ATTEMPTS):
            await self.client.peek(old)
            try:
                meet = commands.MeetCommand(peer=old, address=self.client.address(old, new), timeout=MEET_TIMEOUT)
                await self.client.change(new, meet)
                return
            except CommandRefused as error:
                refused = error
        raise refused

    async def _clock_offsets(self) -> dict[tuple[str, str, CutClock], ClockOffset]:
        """For the pairs on two hosts, how far the clocks of the new one's are ahead. Raises BackendError.

        The ROS clock is left out where ``/clock`` drives it: that is one for all hosts.
        """
        found: dict[tuple[str, str, CutClock], ClockOffset] = {}
        measured: dict[str, ClockOffset] = {}
        for old, new in self._pairs:
            hosts = [self.configuration.instances[name].host for name in (old, new)]
            if hosts[0] == hosts[1]:
                continue
            for host in hosts:
                measured[host] = measured.get(host) or await self.backend.clock_offset(host)
            offset = measured[hosts[0]].between(measured[hosts[1]])
            found[old, new, "message"] = offset
            with _old_side_needed():
                if not (await self.client.peek(old)).simulated_time:
                    found[old, new, "ros"] = offset
        return found

    async def _announce(self, last_try: bool) -> bool:
        """Send each cut to both sides. False if one side received it too late; then all cuts have been cancelled."""
        self._too_slow = False
        try:
            for cut in self._cuts:  # the old side first: it resumes if the new side never learns of the cut
                sent = self.fences.now()
                try:
                    slot, address = await cut.shared_slot(self.client, cut.old), self.client.address(cut.old, cut.new)
                    await self.client.change(cut.old, cut.outgoing(address, slot))
                except CommandRefused:
                    self._too_slow = self.fences.now() - sent >= SLOW * cut.lead
                    raise
            for cut in self._cuts:
                slot = await cut.shared_slot(self.client, cut.new)
                await self.client.change(cut.new, cut.incoming(self.client.address(cut.old, cut.new), slot))
        except CommandRefused:
            if last_try:
                raise
            await self._cancel(self._cuts)
            return False
        return True

    async def _await_cuts(self) -> dict[PortRef, int | None]:
        last: dict[PortRef, int | None] = {}
        for cut in self._cuts:
            new, old = await asyncio.gather(
                self.client.read(cut.new, self._await_cut(cut)), self._ended_at_old(cut), return_exceptions=True
            )
            incoming = _raised(new)
            self._published = any(incoming.first.values())
            with _old_side_needed():
                outgoing = _raised(old)
            because = incoming.because or outgoing.because
            reason = "" if because is None else f": {because}"
            if incoming.outcome != "done" and not any(incoming.first.values()):
                reason = reason or await self._new.waits_for(cut.new)
                what = "publish after the cut" if cut.swaps else "take over"
                # A component that is busy with exporting its state does not hang. A node without Midstride's API that
                # has not done its part may: it is asked.
                is_blameless = because is not None and (cut.arbiter.by_moment or outgoing.outcome == "done")
                failed = StepFailed if is_blameless else OldSideFailed
                raise failed(f"{cut.new} did not {what}; {cut.old} continues{reason}")
            # A new side that has published, and is still reporting it, has taken over if the old one knows.
            if incoming.outcome not in ("done", "waiting") or outgoing.outcome != "done":
                raise OldSideFailed(f"{cut.old} resumed before it learned that {cut.new} had published{reason}")
            self.states.ended(cut, incoming, outgoing)
            if incoming.by_input:
                words = f"{cut.new} took over from {cut.old} between two messages: each was answered by one of them"
                self.events.add("note", words)
            elif incoming.out_of_step:
                words = (
                    f"{cut.new} took over from {cut.old} between two messages, and one of them ceased to publish one"
                )
                words += " message for each that it takes: one may have been answered by both, or by neither"
                self.events.add("note", words)
            if because is not None and cut.arbiter.exchange:
                self.events.add("note", f"{cut.old} was deactivated before {cut.new} was activated: {because}")
            for swap in cut.swaps:
                write = outgoing.last.get(f"{swap.old.port} {self._topic(swap)}")
                last[swap.old] = None if write is None else write.number
                first = incoming.first.get(f"{swap.new.port} {self._topic(swap)}")
                if first is not None:  # of several topics, the latest: what is known to be lost is never too much
                    self.first_numbers[swap.new] = max(first.number, self.first_numbers.get(swap.new, 0))
        return last

    async def _ended_at_old(self, cut: Cut) -> CutResult:
        """The end of the cut at the old side. Raises MidstrideError.

        If that has exited, its lease is no longer needed: the new one may not be able to know.
        """
        try:
            return await self.client.read(cut.old, self._await_cut(cut))
        except MidstrideError:
            if cut.lease and await self._has_exited(cut.old):
                await self._confirm(cut)
            raise

    async def _confirm(self, cut: Cut) -> None:
        """Have the new side keep the right to write: the process of the old one has ended."""
        with contextlib.suppress(MidstrideError):
            await self.client.read(cut.new, commands.ConfirmCutCommand(cut=cut.id))

    def _await_cut(self, cut: Cut) -> commands.AwaitCutCommand:
        timeout = max(each.timeout(stretch_of(self.client, each.old)) for each in self._cuts)
        return commands.AwaitCutCommand(cut=cut.id, timeout=timeout)

    async def _cancel(self, cuts: Iterable[Cut]) -> None:
        for cut in cuts:
            freed = False
            for side in (cut.new, cut.old):
                if side in self.client.life.fenced:
                    continue  # it may hang for ever, and publishes nothing
                cancel = commands.CancelCutCommand(cut=cut.id, freed=freed)
                undone = await self.client.undo(side, cancel)
                if side == cut.new:
                    freed = bool(cut.lease) and (undone or self.client.life.is_gone(side))
                elif not undone:  # else it would be part of this cut for ever
                    self.client.owe(side, cancel)

    async def _undo_exchange(self) -> None:
        """Reopen the gates of the old publishers and detach the new ones, as far as they can be reached."""
        await self.fences.lift({old for old, _ in self._pairs})
        await self._cancel(self._cuts)
        await self._new.detach()

    async def _undo(self) -> None:
        """Undo the exchange, and detach the new servers."""
        await self._undo_exchange()
        for swap in self._services:
            detach = commands.DetachCommand(port=swap.new.port, topic=self._topic(swap), timeout=DETACH_TIMEOUT)
            await self.client.undo(swap.new.instance, detach)

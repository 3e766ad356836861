"""The commands of a hand-over: the time grid, the two sides of a cut, and the connection between the peers."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable, Coroutine, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Final, TypeAlias, TypeVar

from midstride.errors import BackendError, CallTimeout, CommandRefused, Unreachable
from midstride.node.author.ports import OutputLink
from midstride.node.component_host import Host
from midstride.node.control.attachments import Attachments
from midstride.node.control.service_answering import Answering
from midstride.node.control.state_hooks import StateHooks
from midstride.node.data.functionality_runner import FunctionalityRunner
from midstride.node.data.mode_switch import DataExecutor, within
from midstride.node.handover.arbiter import LockArbiter
from midstride.node.handover.baton import SharedSlot
from midstride.node.handover.cut import (
    CutSide,
    IncomingCut,
    IncomingSide,
    OutgoingCut,
    OutgoingSide,
    comparable,
    reading,
)
from midstride.node.handover.cut_life import CutState
from midstride.node.handover.cut_protocol import CutInTask, CutOutTask
from midstride.node.handover.lease import LeaseKeeper, NewLease, OldLease, OldPeer
from midstride.node.handover.state_transfer import StateExport, StateImport, mute, unmute
from midstride.wire import commands, replies
from midstride.wire.channel import Channel, result_of
from midstride.wire.commands import Command
from midstride.wire.frames import Reply
from midstride.wire.other_hosts import OtherHostAddress
from midstride.wire.state import GateState
from midstride.wire.transport import CutLock

R = TypeVar("R")
Side: TypeAlias = CutOutTask | CutInTask

# How long one attempt to reach a peer may take (s).
MEET_ATTEMPT: Final = 0.5
# Without a manager, which gives up earlier, the offer of a baton is withdrawn so long after it should be taken (s).
OFFER: Final = 5.0
# How many finished cuts can still be queried, or cancelled.
REMEMBERED: Final = 50


@dataclass
class HandoverCommands:
    """``changed`` is called when a cut is over; ``token`` gives the token with which peers are called."""

    attachments: Attachments
    host: Host
    data: DataExecutor
    changed: Callable[[], None]
    token: Callable[[], str]
    hooks: StateHooks
    runners: Sequence[FunctionalityRunner]
    # Both sides of a cut may be here: one output of a component can hand over to another.
    _sides: dict[str, list[Side]] = field(default_factory=dict)
    _exports: dict[str, StateExport] = field(default_factory=dict)
    _imports: dict[str, StateImport] = field(default_factory=dict)
    _tasks: set[asyncio.Task[None]] = field(default_factory=set)
    _passing: set[asyncio.Task[None]] = field(default_factory=set)  # requests on to the successor
    _channels: dict[str, Channel] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.answering = Answering(
            self.host.admission,
            self.call,
            self.changed,
            partial(self._start, among=self._passing),
            self.host.sleep,
            self._own_address,
            self.host.instance,
        )

    def _own_address(self) -> str:
        transport = self.host.transport
        return "" if transport is None else transport.address(self.host.instance)

    def close_cuts(self) -> None:
        """The component ends: stop all cuts."""
        for task in self._tasks:
            task.cancel()

    def close(self) -> None:
        """Pass no requests on any more, and close the connections to peers."""
        for task in self._passing:
            task.cancel()
        self.disconnect()

    def disconnect(self) -> None:
        """Close the connections to peers: they belong to the system that the component leaves."""
        for channel in self._channels.values():
            channel.close()
        self._channels.clear()

    async def grid(self, command: commands.GridCommand) -> replies.Grid:
        if command.port is None:
            return replies.Grid(trigger="none", clock="message", now=reading(self.host, "message"))
        output = self.attachments.output(command.port)
        owner, topic = output.owner, command.topic
        rate = owner.rate
        clock: replies.CutClock = "ros" if rate is not None or comparable(self.host, "ros", "message") else "message"
        simulated = clock == "ros" and self.host.simulated_time
        endpoint = None if topic is None else self.attachments.link(command.port, topic).endpoint
        epoch, period = (None, None) if rate is None else (rate.slot, rate.period)
        if output.relayed and clock == "ros" and (found := output.observed_grid()) is not None:
            epoch, period = found
        return replies.Grid(
            trigger=owner.driven,
            clock=clock,
            speed=self.host.clock_history.speed(self.host.steady()) if simulated else 1.0,
            epoch=epoch,
            period=period,
            now=reading(self.host, clock),
            readers=None if endpoint is None else endpoint.matched(),
            reader_ids=[] if endpoint is None else sorted(endpoint.reader_ids()),
        )

    async def meet(self, command: commands.MeetCommand) -> replies.Done:
        """Connect to the peer and ping it; the connection is kept for the report of the first write."""
        await self._ask(command, commands.PingCommand())
        return replies.Done()

    async def _ask(self, command: commands.MeetCommand | commands.PrepareStateCommand, question: Command[R]) -> R:
        """Ask the peer of ``command``, in several short attempts. Raises CommandRefused."""
        deadline = self.host.steady() + int(command.timeout * 1e9)
        while True:
            try:
                return result_of(await self.call(command.address, question, MEET_ATTEMPT), question)
            except CommandRefused as error:
                raise CommandRefused(f"{command.peer} refused `{question.name}`: {error}") from None
            except BackendError as error:
                if self.host.steady() >= deadline:
                    raise CommandRefused(
                        f"{command.peer} did not answer within {command.timeout:.3g} s: {error}"
                    ) from None
                await self.host.sleep(0.02)

    async def cut_out(self, command: commands.CutOutCommand) -> replies.Done:
        links = self._links_of(command, CutOutTask, gate="open")
        if command.shared_slot is not None:
            outgoing = OutgoingSide(links, self.host, SharedSlot(command.shared_slot))
            patience = command.resume_after + OFFER
            return await self._join(command, outgoing, CutOutTask(self.host, self.changed, outgoing, patience))
        export = None if command.state is None else self._export(command.state, command.own_address)
        in_order = export is not None and _in_order(links)
        arbiter = OldLease(self.host.steady, command.lease) if command.lease else LockArbiter(self._lock(command))
        side = OutgoingCut(links, self.host, arbiter, command.at, in_order=in_order, clock=command.clock)
        if command.state is not None and command.state.order_only:
            side.until = command.at + int(command.state.timeout * 1e9)

        def arm() -> None:
            side.arm()
            if export is not None:
                export.arm(links, side)

        await self._arm(side, arm)
        self._begin(command.cut, CutOutTask(self.host, self.changed, side, command.resume_after, export))
        return replies.Done()

    async def cut_in(self, command: commands.CutInCommand) -> replies.Done:
        links = self._links_of(command, CutInTask, gate="closed")
        if failed := [str(link) for link in links if link.output.owner.failed]:
            raise CommandRefused(f"{', '.join(failed)} cannot take over: its functionality has failed")
        if command.shared_slot is not None:
            latches = [link for link, swap in zip(links, command.swaps, strict=True) if swap.latch]
            incoming = IncomingSide(
                links, self.host, SharedSlot(command.shared_slot), latches=latches, quiet=command.quiet
            )
            patience = command.resume_after + OFFER
            task = CutInTask(self.host, self.changed, incoming, None, patience=patience)
            return await self._join(command, incoming, task)
        # One that writes once has nothing else to write, however the old side is driven.
        latches = [
            link
            for link, swap in zip(links, command.swaps, strict=True)
            if swap.latch or link.output.owner.driven == "none"
        ]
        met = self._channels.get(command.address)
        channel = partial(self._channel, command.address)
        old = OldPeer(command.peer, channel, "" if met is None else met.greeting.uuid)
        keeper, place = None, ""
        arbiter: LockArbiter | NewLease
        if command.leased:
            arbiter = old.lease = NewLease(self.host.steady)
            keeper = LeaseKeeper(command.cut, arbiter, self.host, old.ask)
            await keeper.begin(command.peer)
        else:
            lock = self._lock(command)
            arbiter, place = LockArbiter(lock), lock.place
        side = IncomingCut(
            links,
            self.host,
            arbiter,
            command.at,
            latches=latches,
            quiet=command.quiet,
            clock=command.clock,
            shift=command.shift,
        )
        state = None if command.state is None else self._import(command.state, command.peer, command.address)

        def arm() -> None:
            side.arm(command.epoch)
            if state is not None:
                state.arm(links, side)

        await self._arm(side, arm)

        async def report(timeout: float, failed: bool) -> bool:
            taken = commands.CutTakenCommand(cut=command.cut, failed=failed, lock="" if failed else place)
            return await old.report(taken, timeout)

        task = CutInTask(self.host, self.changed, side, report, state, keeper=keeper)
        self._begin(command.cut, task)
        if keeper is not None:
            self._start(keeper.run())
        if state is not None and state.complete:
            self._start(state.run())
        return replies.Done()

    async def _join(
        self, command: commands.CutOutCommand | commands.CutInCommand, side: CutSide, task: Side
    ) -> replies.Done:
        """A side of a cut whose other side has a gate: no moment is agreed."""
        try:
            await self.data.run(side.arm, command.timeout)
        except CommandRefused:
            side.arbiter.leave()
            raise
        self._begin(command.cut, task)
        return replies.Done()

    async def cancel_cut(self, command: commands.CancelCutCommand) -> replies.Done:
        # A new side first: the old one cannot write while that does.
        for side in sorted(self._sides.get(command.cut, []), key=lambda side: not side.new):
            if command.freed and isinstance(side, CutOutTask):
                side.side.arbiter.free()
            try:
                await side.cancel()
                self._tell_old(side)
            except CommandRefused:
                if isinstance(side, CutOutTask):
                    self._start(side.watch_successor())
                raise
        return replies.Done()

    def _tell_old(self, side: Side) -> None:
        """The old side on another host is to hear that this new one writes nothing any more."""
        if isinstance(side, CutInTask) and side.keeper is not None:
            self._start(side.keeper.tell())

    async def confirm_cut(self, command: commands.ConfirmCutCommand) -> replies.Done:
        for side in self._sides.get(command.cut, []):
            if isinstance(side, CutInTask) and side.keeper is not None:
                side.keeper.lease.old_has_ended()
        return replies.Done()

    async def claim(self, command: commands.CutClaimCommand) -> replies.Claimed:
        """From the new side. Where the cut is unknown, this side has not stopped writing."""
        for side in self._sides.get(command.cut, []):
            if isinstance(side, CutOutTask) and isinstance(side.side.arbiter, OldLease):
                return side.side.arbiter.claim()
        return replies.Claimed(how="refused")

    async def resolve_cuts(self, command: commands.ResolveCutsCommand) -> replies.Done:
        sides = [side for sides in self._sides.values() for side in sides if side.new == command.new]
        await within(self.host, asyncio.gather(*(side.resolve() for side in sides)), command.timeout)
        return replies.Done()

    async def await_cut(self, command: commands.AwaitCutCommand) -> replies.CutResult:
        sides = self._sides.get(command.cut, [])
        if not sides:
            raise CommandRefused(f"there is no cut {command.cut}")
        over = asyncio.gather(*(side.finished.wait() for side in sides))
        await within(self.host, over, command.timeout)
        results = [side.result() for side in sides]
        # Where both sides are here, the cut is done once both are.
        outcome: replies.CutOutcome = next((each.outcome for each in results if each.outcome != "done"), "done")
        last = {name: write for result in results for name, write in result.last.items()}
        first = {name: write for result in results for name, write in result.first.items()}
        because = next((result.because for result in results if result.because is not None), None)
        moved = next((result.moved for result in results if result.moved is not None), None)
        return replies.CutResult(outcome=outcome, because=because, moved=moved, last=last, first=first)

    async def taken(self, command: commands.CutTakenCommand) -> replies.Confirmed:
        """From the new side. Where the cut is unknown, this side has not stopped writing."""
        old = [side for side in self._sides.get(command.cut, []) if isinstance(side, CutOutTask)]
        resumed = [await side.taken(command.failed, command.lock) for side in old]
        return replies.Confirmed(resumed=any(resumed) if old else True)

    # -- state ---------------------------------------------------------------------------------------

    async def mute(self, command: commands.MuteCommand) -> replies.Done:
        await self.data.run(lambda: mute(self.runners), command.timeout)
        return replies.Done()

    async def answer(self, command: commands.AnswerCommand) -> replies.Answers:
        """The instance of its role that answers is the one that works, too."""
        done = await self.answering.answer(command)
        # Whatever keeps its thread: nothing asks again once it answers.
        await self.data.run(lambda: unmute(self.runners), command.timeout, late=True)
        return done

    async def prepare_state(self, command: commands.PrepareStateCommand) -> replies.StateOffer:
        if command.bulk:
            export = commands.ExportStateCommand(timeout=command.timeout)
            state = result_of(await self.call(command.address, export, command.timeout), export).state
            if state is not None:
                await self.hooks.import_(state, command.timeout)
            return replies.StateOffer(exports="changes")
        offered = await self._ask(command, commands.OfferStateCommand(changes=self.hooks.imports_changes))
        if offered.has_state:
            await self.hooks.check_import()
        return offered

    async def offer_state(self, command: commands.OfferStateCommand) -> replies.StateOffer:
        exports = self.hooks.exports(command.changes)
        if exports == "nothing" and self.attachments.relays:
            return replies.StateOffer(exports="order")
        return replies.StateOffer(exports=exports)

    async def fetch_state(self, command: commands.FetchStateCommand) -> replies.FetchedState:
        return await self._exporting(command.transfer).fetch()

    async def importing(self, command: commands.ImportingCommand) -> replies.Confirmed:
        return self._exporting(command.transfer).importing(command.done)

    def _exporting(self, transfer: str) -> StateExport:
        if (export := self._exports.get(transfer)) is None:
            raise CommandRefused(f"there is no transfer {transfer}")
        return export

    def _export(self, transfer: commands.StateTransfer, own_address: str) -> StateExport:
        if transfer.id not in self._exports:
            export = StateExport(
                transfer, self.hooks, self.answering, self.host, self.runners, self._start, own_address
            )
            self._exports = {transfer.id: export}
        return self._exports[transfer.id]

    def _import(self, transfer: commands.StateTransfer, peer: str, address: str) -> StateImport:
        if transfer.id not in self._imports:

            def request(command: Command[Any], timeout: float) -> Awaitable[Reply]:
                return self.call(address, command, timeout)

            state = StateImport(transfer, self.hooks, self.answering, self.host, self.runners, peer, address, request)
            self._imports = {transfer.id: state}
        return self._imports[transfer.id]

    def _lock(self, command: commands.CutOutCommand | commands.CutInCommand) -> CutLock:
        if self.host.transport is None:
            raise CommandRefused("this component runs without a control socket, so it hands nothing over")
        return self.host.transport.cut_lock(command.cut)

    def give_back(self) -> None:
        """New sides without any attachment left have nothing to write; the right of one that has handed over since is
        its successor's.
        """
        sides = [side for sides in self._sides.values() for side in sides]
        for index, side in enumerate(sides):
            if isinstance(side, CutInTask) and side.is_detached and not _handed_over(side, sides[index + 1 :]):
                side.side.arbiter.give_back()
                self._tell_old(side)

    def _links_of(
        self, command: commands.CutOutCommand | commands.CutInCommand, kind: type, gate: GateState
    ) -> list[OutputLink]:
        """The attachments that take part in a cut. Raises CommandRefused where one cannot."""
        if any(isinstance(side, kind) for side in self._sides.get(command.cut, [])):
            raise CommandRefused(f"cut {command.cut} has been agreed already")
        links = []
        for swap in command.swaps:
            link = self.attachments.link(swap.port, swap.topic)
            if link.cut is not None:
                raise CommandRefused(f"{link} is part of another cut under way")
            if link.gate != gate:
                raise CommandRefused(f"the gate of {link} is {link.gate}, and must be {gate} before this side of a cut")
            links.append(link)
        if not links and command.state is None:
            raise CommandRefused("a cut needs at least one swap, or state to move")
        return links

    async def _arm(self, side: OutgoingCut | IncomingCut, arm: Callable[[], None]) -> None:
        """Prepare the data thread for the cut, before its moment or not at all."""
        left = (side.at - side.now()) / 1e9

        def in_time() -> None:
            if side.now() >= side.at:
                raise CommandRefused("the agreed moment of the cut has passed already")
            arm()

        if left <= 0:
            raise CommandRefused(f"the agreed moment of the cut passed {-left:.3f} s ago")
        await self.data.run(in_time, left)

    def _begin(self, cut: str, side: Side) -> None:
        self._sides.setdefault(cut, []).append(side)
        over = [cut for cut, sides in self._sides.items() if all(earlier.over for earlier in sides)]
        for old in over[:-REMEMBERED]:
            del self._sides[old]
        self._start(side.run())

    def _start(self, work: Coroutine[Any, Any, None], among: set[asyncio.Task[None]] | None = None) -> None:
        tasks = self._tasks if among is None else among
        task = asyncio.get_running_loop().create_task(work)
        tasks.add(task)
        task.add_done_callback(partial(self._ended, tasks))

    def _ended(self, tasks: set[asyncio.Task[None]], task: asyncio.Task[None]) -> None:
        tasks.discard(task)
        if not task.cancelled() and (error := task.exception()) is not None:
            what = "passing requests on" if tasks is self._passing else "a side of a cut"
            self.host.logger.error(f"{what} failed: {type(error).__name__}: {error}")

    async def call(self, address: str, command: Command[Any], timeout: float) -> Reply:
        """A peer's reply. Raises CallTimeout or Unreachable."""
        channel = await self._channel(address, timeout)
        with _as_far_as_known(address):
            return await channel.request(command, timeout=timeout)

    async def _channel(self, address: str, timeout: float) -> Channel:
        """A connection to a peer, which is kept. Raises CallTimeout or Unreachable."""
        channel = self._channels.get(address)
        if channel is None or channel.closed.is_set():
            if self.host.transport is None:
                raise Unreachable("this component runs without a control socket, so it has no peers")
            made = await Channel.open(self.host.transport, address, self.token(), timeout=timeout)
            self._channels = {peer: other for peer, other in self._channels.items() if not other.closed.is_set()}
            channel = self._channels.setdefault(address, made)
            if channel is not made:  # another cut has connected to the same peer meanwhile
                made.close()
        return channel


@contextlib.contextmanager
def _as_far_as_known(address: str) -> Iterator[None]:
    """Have an open connection to another host that ends say nothing about the peer: the way there may have ended."""
    try:
        yield
    except Unreachable as error:
        if OtherHostAddress.read(address) is None:
            raise
        raise CallTimeout(str(error)) from None


def _handed_over(new: CutInTask, later: Sequence[Side]) -> bool:
    """Return whether an output of ``new`` has been taken over from it in a later cut."""
    return any(
        isinstance(side, CutOutTask)
        and side.status is CutState.DONE
        and any(link in new.side.links for link in side.side.links)
        for side in later
    )


def _in_order(links: Sequence[OutputLink]) -> bool:
    """Return whether one publisher drives these outputs by its messages: a newer one then follows all older."""
    inputs = {port for link in links for port in link.output.owner.driving}
    attachments = [link for port in inputs for link in port.links]
    return len(attachments) == 1 and attachments[0].endpoint.matched() == 1

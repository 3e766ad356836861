"""The state of a component at a cut: exported after the old one's last write, imported before the new one's first.

docs/protocols/state.md. From T on, both components hold back calls of the author's functions: the old one
those that belong to the new side, until it knows that they are not its own after all; the new one those that belong to
it, until the state has arrived. A functionality without an output in a cut, which only receives, goes on at the old
side until the export; the new one holds all its messages back, and drops those that the old one has received. The new
side asks for the state, and reports that it is importing it, so the old side can tell a slow import from a dead peer.
Requests to the node's services follow the state: the old side answers none from the export on, and the new one those
that it is not known to have answered, once it has imported. None of this needs the manager.

The methods ``arm``, ``admit`` and ``release`` run on the data thread, the others on the control thread.
"""

from __future__ import annotations

import abc
import asyncio
from collections.abc import Awaitable, Callable, Coroutine, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from midstride.errors import BackendError, CallTimeout, CommandRefused, Unreachable
from midstride.node.author.ports import Input, OutputLink, OutputOwner
from midstride.node.component_host import Host
from midstride.node.control.service_answering import Answering
from midstride.node.control.state_hooks import StateHooks
from midstride.node.data.functionality_runner import Admission, Call, FunctionalityRunner
from midstride.node.data.mode_switch import within
from midstride.node.data.trigger import InfoSet
from midstride.node.handover.arbiter import Arbiter
from midstride.node.handover.cut import IncomingCut, OutgoingCut, call_belongs_after, reading
from midstride.wire import commands, replies
from midstride.wire.channel import result_of
from midstride.wire.commands import Command
from midstride.wire.frames import Reply
from midstride.wire.replies import CutClock

# How often a side checks whether a cut has passed, and async calls have ended (s).
TICK: Final = 0.002
# How long before T the new side asks for the state (s): a request that waited for long would be repeated.
FETCH_LEAD: Final = 0.05
# How often a side that waits for a moment of the ROS clock looks at it (s).
LONGEST_WAIT: Final = 0.01
# How often a peer that cannot be reached is tried, and how soon again (s).
FETCH_ATTEMPTS: Final = 5
FETCH_INTERVAL: Final = 0.01
# How often the new side reports that it is still importing (s): often enough for the shortest time before a resumption.
REPORT_INTERVAL: Final = 0.03
REPORT_TIMEOUT: Final = 0.25
# How long the export waits for a request to a service that is being handled (s): what that changes later is not in the
# state.
REQUEST_PATIENCE: Final = 0.2
# How long the export waits for the messages of a publisher that the new side may have had before it held any back (s);
# and how often a publisher must write for its next message to be expected in that time (s).
CATCH_UP: Final = 0.5
EXPECTED: Final = 0.25
# How long a state may take on its way (s per byte), besides the time in which the new side must report.
TRANSIT_PER_BYTE: Final = 2e-8


def mute(runners: Iterable[FunctionalityRunner]) -> None:
    """On the data thread: make no call for a slot or a message. Another instance makes them."""
    for runner in runners:
        runner.admission = _drop


def unmute(runners: Iterable[FunctionalityRunner]) -> None:
    for runner in runners:
        if runner.admission is _drop:
            runner.admission = None


def _drop(runner: FunctionalityRunner, call: Call) -> Admission:
    return "drop"


@dataclass(eq=False)
class _Transfer(abc.ABC):
    """The common part of both sides.

    ``_armed``: how many cuts the pair has agreed so far; ``_ended``: those that are over.

    Where no output is cut (``_moments`` is empty), a side that does not take part in the work makes no calls.
    """

    transfer: commands.StateTransfer
    hooks: StateHooks
    answering: Answering
    host: Host
    runners: Sequence[FunctionalityRunner]
    _moments: dict[OutputOwner, tuple[int, CutClock]] = field(default_factory=dict, init=False)
    _shift: int = field(default=0, init=False)  # of the cuts, the same for all
    _armed: int = field(default=0, init=False)
    _ended: set[object] = field(default_factory=set, init=False)

    @property
    def complete(self) -> bool:
        """Return whether all cuts of the pair have been agreed."""
        return self._armed == self.transfer.cuts

    @property
    def over(self) -> bool:
        return len(self._ended) == self._armed

    def arm(self, links: Iterable[OutputLink], side: OutgoingCut | IncomingCut) -> None:
        self._armed += 1
        self._shift = side.shift
        self._moments.update({link.output.owner: (side.at, side.clock) for link in links})
        for runner in self.runners:
            runner.admission = self.admit

    @abc.abstractmethod
    def admit(self, runner: FunctionalityRunner, call: Call) -> Admission:
        """Return whether a call is made, held back, or dropped."""

    def release(self, make: bool) -> None:
        """Hold nothing back any more; ``make`` the calls that were, or drop them."""
        for runner in self.runners:
            if runner.admission == self.admit:
                runner.admission = None
                if make:
                    runner.make_held()
                else:
                    runner.drop_held()

    def _origin(self, runner: FunctionalityRunner, call: Call) -> tuple[str, int] | None:
        """The publisher of a message and its time, where known, of a functionality that has no output in a cut."""
        if runner in self._moments or call.info is None or isinstance(call.info, InfoSet):
            return None
        facts = self.host.read_info(call.info)
        return None if facts.publisher is None or facts.source is None else (facts.publisher, facts.source)

    def _belongs_after(self, runner: FunctionalityRunner, call: Call, slot: int) -> bool:
        at, clock = self._moments.get(runner, (self.transfer.at, self.transfer.clock))
        return call_belongs_after(runner, call.slots, call.info, at, self.host, slot, clock, self._shift)

    def _now(self) -> int:
        """The clock of the last cut."""
        return reading(self.host, self.transfer.clock)

    async def _quiet(self) -> None:
        """Wait until no async call is under way, but for loops that a mode has begun on entry."""
        while any(runner.awaits for runner in self.runners):
            await self.host.sleep(TICK)


@dataclass(eq=False)
class StateExport(_Transfer):
    """The old side. Where it resumes, it makes the calls that it held back: one for all slots, one for each message.

    ``start`` runs a coroutine in the background. ``own_address``: where the new side reaches this one, if not where it
    listens.
    """

    start: Callable[[Coroutine[Any, Any, None]], None]
    own_address: str = ""
    because: str | None = field(default=None, init=False)
    # Whether it answered requests before the export.
    _answered: bool = field(default=False, init=False)
    _passed: set[object] = field(default_factory=set, init=False)
    _all_passed: bool = field(default=False, init=False)
    # Whether all has been received that the new side may not have held back.
    _caught_up: bool = field(default=False, init=False)
    _state: bytes | None = field(default=None, init=False)
    # When the last cut was due; and when the state was exported, or the new side last reported (steady, ns).
    _due_at: int | None = field(default=None, init=False)
    _heard_at: int | None = field(default=None, init=False)
    # By publisher, the newest message that was received before ``_since``, when the first cut was agreed, or that a
    # functionality without an output in a cut has received since.
    _handled: dict[str, int] = field(default_factory=dict, init=False)
    _since: int = field(default=0, init=False)
    _imported: bool = field(default=False, init=False)
    _resumed: bool = field(default=False, init=False)
    # How many bytes were exported; when requests were held from, and until when (steady, ns).
    _bytes: int | None = field(default=None, init=False)
    _held_from: int = field(default=0, init=False)
    _held_until: int = field(default=0, init=False)
    _held: asyncio.Event = field(default_factory=asyncio.Event, init=False)
    _decided: asyncio.Event = field(default_factory=asyncio.Event, init=False)

    def __post_init__(self) -> None:
        self._loop = asyncio.get_running_loop()

    def arm(self, links: Iterable[OutputLink], side: OutgoingCut | IncomingCut) -> None:
        super().arm(links, side)
        if not self._since:
            self._since = self.host.message_now()
            for port in {port for runner in self.runners for port in runner.inputs}:
                self._handled |= {publisher: times[-1][1] for publisher, times in self._received(port).items()}

    def _received(self, port: Input) -> dict[str, list[tuple[int, int]]]:
        """By publisher, when the last messages were received (steady, ns), and when published, in order."""
        times: dict[str, list[tuple[int, int]]] = {}
        for received, info in port.last_receipts():
            facts = self.host.read_info(info)
            if facts.publisher is not None and facts.source is not None:
                times.setdefault(facts.publisher, []).append((received, facts.source))
        return times

    def admit(self, runner: FunctionalityRunner, call: Call) -> Admission:
        if not self._caught_up:
            if (origin := self._origin(runner, call)) is not None:
                publisher, source = origin
                self._handled[publisher] = max(source, self._handled.get(publisher, 0))
                return "make"
            if not self._belongs_after(runner, call, slot=0):
                return "make"
        if not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._held.set)
        return "hold"

    async def pause(self) -> None:
        """Wait until a call is held back, which may show that a cut has passed, or for a short time."""
        await within(self.host, self._held.wait(), TICK)
        self._held.clear()

    async def passed(self, cut: object) -> None:
        """A cut has passed. After the last one the state is exported, once."""
        self._passed.add(cut)
        if self._all_passed or len(self._passed) < self.transfer.cuts:
            return
        self._all_passed = True
        await within(self.host, self._catch_up(self.host.message_now()), CATCH_UP)
        self._caught_up = True
        try:
            if await within(self.host, self._quiet(), self.transfer.timeout) is None:
                raise CommandRefused(f"user code did not return within {self.transfer.timeout:.3g} s")
            self._held_from = self.host.steady()
            self._answered = self.answering.pause()
            await within(self.host, self._requests_answered(), REQUEST_PATIENCE)
            self._state = await self.hooks.export(self.transfer.timeout, self.transfer.changes)
        except CommandRefused as error:
            self.because = self.because or str(error)
        self._bytes = None if self._state is None else len(self._state)
        self._heard_at = self.host.steady() + int(len(self._state or b"") * TRANSIT_PER_BYTE * 1e9)
        self._decided.set()

    async def _catch_up(self, passed: int) -> None:
        """Wait until a newer message shows that all have been received that were published until ``passed``.

        The new side holds messages back from when it has learned of the cut, and has dropped those before. Where an
        output waits for the state, only a publisher is waited for that seems to be late.
        """
        ports = {port for runner in self.runners if runner not in self._moments for port in runner.inputs}
        while any(self._is_awaited(times, passed) for port in ports for times in self._received(port).values()):
            await self.host.sleep(TICK)

    def _is_awaited(self, times: Sequence[tuple[int, int]], passed: int) -> bool:
        """Return whether a message after ``passed`` is waited for, of a publisher whose last ones came at ``times``."""
        (_, oldest), (received, newest) = times[0], times[-1]
        interval = (newest - oldest) / max(len(times) - 1, 1)
        if newest > passed or not 0 < interval <= EXPECTED * 1e9:
            return False
        return not self._moments or self.host.steady() - received > 2 * interval

    async def _requests_answered(self) -> None:
        while self.answering.admission.busy:
            await self.host.sleep(TICK)

    @property
    def heard_at(self) -> int:
        """The time of the new side's last sign that it works (steady, ns). None is expected before the export."""
        return self.host.steady() if self._heard_at is None else self._heard_at

    def given_up(self, patience: float) -> bool:
        """Return whether the old side resumes because of the transfer: another cut has, or it takes too long."""
        now = self.host.steady()
        if self._due_at is None and self._now() >= self.transfer.at:
            self._due_at = now
        if self._resumed or self._imported or self._due_at is None:
            return self._resumed
        if now - self._due_at <= (self.transfer.timeout + patience) * 1e9:
            return False
        self.because = self.because or _too_long(self.transfer)
        return True

    async def fetch(self) -> replies.FetchedState:
        """Raises CommandRefused where the state could not be exported, or the old side has resumed."""
        await self._decided.wait()
        if self.because is not None:
            raise CommandRefused(self.because)
        admission = self.answering.admission
        return replies.FetchedState(
            state=self._state,
            handled=self._handled,
            since=self._since,
            requests=admission.handled if self._answered else None,
            goals=admission.give_goals() if self._answered else [],
        )

    def importing(self, done: bool) -> replies.Confirmed:
        if not self._resumed:
            self._heard_at = max(self.host.steady(), self.heard_at)
            if done and not self._imported:
                self._imported, self._held_until = True, self.host.steady()
                if self._answered:
                    self.answering.state_moved(self.transfer.address)
        return replies.Confirmed(resumed=self._resumed)

    @property
    def moved(self) -> replies.MovedState | None:
        """The state that the new side has; None where it has none of this one."""
        if self._bytes is None or not self._imported or self._resumed:
            return None
        return replies.MovedState(bytes=self._bytes, silent=None, held=(self._held_until - self._held_from) / 1e9)

    def end(self, cut: object, resumed: bool) -> None:
        """A cut has ended. Once all have, calls are no longer held back."""
        self._ended.add(cut)
        self._resumed = self._resumed or resumed
        if self._resumed:
            self.because = self.because or "the old component has resumed"
            if self._answered:
                self._answered = False
                self.start(self.answering.take_back(self.transfer.new, self.transfer.address, self.own_address))
        self._decided.set()
        if self.over:
            self._state = None

    def release_if_over(self) -> None:
        if self.over:
            self.release(make=self._resumed)
            if not self._moments and not self._resumed:
                mute(self.runners)


@dataclass(eq=False)
class StateImport(_Transfer):
    """The new side. ``request`` sends a command to ``peer``, which is at ``address``.

    ``problem``: why the state has not been imported.
    """

    peer: str
    address: str
    request: Callable[[Command[Any], float], Awaitable[Reply]]
    problem: str | None = field(default=None, init=False)
    # Whether it cannot take over; without its peer, or where the state is not required, it continues with its own.
    failed: bool = field(default=False, init=False)
    _imported: bool = field(default=False, init=False)
    _open: bool = field(default=False, init=False)
    # Where no output is cut: the first call takes the right that a first write does otherwise.
    _arbiter: Arbiter | None = field(default=None, init=False)
    # As the old side reports them.
    _handled: dict[str, int] = field(default_factory=dict, init=False)
    _since: int = field(default=0, init=False)
    _decided: asyncio.Event = field(default_factory=asyncio.Event, init=False)

    def __post_init__(self) -> None:
        self._yields = self.answering.admission.yields

    def arm(self, links: Iterable[OutputLink], side: OutgoingCut | IncomingCut) -> None:
        super().arm(links, side)
        self._arbiter = None if side.links else side.arbiter

    def admit(self, runner: FunctionalityRunner, call: Call) -> Admission:
        origin = self._origin(runner, call)
        if origin is None:
            included = not self._belongs_after(runner, call, slot=1)
            if included and not self._imported:
                return "make" if self._moments else "drop"
        else:
            publisher, source = origin
            included = self._imported and source <= self._handled.get(publisher, self._since)
        if included and self.transfer.order_only:
            return "make"  # behind the gate, where the last one is kept
        if not self._open:
            return "drop" if included and origin is None else "hold"
        return "drop" if included else "make"

    async def run(self) -> None:
        """Fetch and import the state; then make the calls that were held back."""
        try:
            fetched = await self._fetch()
            if fetched is not None and fetched.state is not None:
                self._handled, self._since = fetched.handled, fetched.since
                await self._import(fetched)
        except CommandRefused as error:
            await self._decide(str(error), self.transfer.required)
        except Unreachable:
            self.answering.take_over(None, self.address, self._yields)
            await self._decide(f"{self.peer} exited before it had exported its state", False)
        else:
            await self._decide(None, False)

    async def decided(self) -> None:
        """At T: wait until the state has been imported, or cannot be in time."""
        if not self.complete:
            await self._decide("the manager has not sent every cut", True)
        else:
            await self._until(0.0)  # the last cut of the pair may be later
            if await within(self.host, self._decided.wait(), self.transfer.timeout) is None:
                await self._decide(_too_long(self.transfer), self.transfer.required)

    def end(self, cut: object, done: bool) -> None:
        """On the data thread: a cut has ended. Once all have, calls from before T are no longer dropped."""
        self._ended.add(cut)
        if self.over:
            self.release(make=False)
            if not self._moments and not done:
                mute(self.runners)

    async def cancel(self) -> None:
        await self._decide("the cut was cancelled", True)

    async def _decide(self, problem: str | None, failed: bool) -> None:
        """The first outcome counts."""
        if self._decided.is_set():
            return
        if not failed and self._arbiter is not None and not self._arbiter.admits():
            problem, failed = "the old component has resumed", True
        self.problem, self.failed = problem, failed
        self._decided.set()
        if not failed:
            await self.host.on_data(self._begin)

    def _begin(self) -> None:
        self._open = True
        for runner in self.runners:
            runner.make_held()

    async def _fetch(self) -> replies.FetchedState | None:
        """Raises CommandRefused, or Unreachable where the old side has exited."""
        await self._until(FETCH_LEAD)
        fetch = commands.FetchStateCommand(transfer=self.transfer.id)
        attempts = 0
        while not self._decided.is_set():
            try:
                return result_of(await self.request(fetch, FETCH_LEAD + self.transfer.timeout), fetch)
            except CallTimeout:
                continue  # on a clock that follows /clock, T may be far ahead
            except Unreachable:
                attempts += 1
                if attempts == FETCH_ATTEMPTS:
                    raise
                await self.host.sleep(FETCH_INTERVAL)
        return None

    async def _until(self, lead: float) -> None:
        """Wait until so long (s) before the last cut, on its clock."""
        while not self._decided.is_set() and (left := (self.transfer.at - self._now()) / 1e9 - lead) > 0:
            await self.host.sleep(min(max(left, 0.0001), LONGEST_WAIT))

    async def _import(self, fetched: replies.FetchedState) -> None:
        """Raises CommandRefused where the import fails, or the old side has resumed."""
        work = asyncio.ensure_future(self._import_quietly(fetched.state or b""))
        while (finished := await within(self.host, work, REPORT_INTERVAL)) is None:
            await self._report(done=False)
        finished.result()
        # An old side that does not reply may still answer requests: then the manager has it asked once more.
        if await self._report(done=True) and fetched.requests is not None:
            self.answering.take_over(fetched, self.address, self._yields)

    async def _import_quietly(self, state: bytes) -> None:
        await self._quiet()
        self._imported = True
        await self.hooks.import_(state, self.transfer.timeout, self.transfer.changes)

    async def _report(self, done: bool) -> bool:
        """Tell the old side of the end; return whether it knows, or has exited.

        Raises CommandRefused where it has resumed.
        """
        importing = commands.ImportingCommand(transfer=self.transfer.id, done=done)
        try:
            reply = await self.request(importing, REPORT_TIMEOUT)
        except BackendError as error:
            return isinstance(error, Unreachable)  # it has exited, or is stopped: it writes nothing
        if not reply.ok or result_of(reply, importing).resumed:
            raise CommandRefused("the old component has resumed")
        return True


def _too_long(transfer: commands.StateTransfer) -> str:
    return f"the state took longer than {transfer.timeout:.3g} s"

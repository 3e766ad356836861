"""A cut, explored: every order of the steps of both sides, of the manager and of the network, with deaths.

The two sides are the shipped ones, `CutOutTask` and `CutInTask` with their gates, over either arbiter: with a lock
they have agreed on a moment; with a baton each message decides, by the steps of the shipped library. Here are only the
threads that they run on: a step is what one of them does until it waits. A thread may wait for as long as it likes, so
every stall and every lost or late message is among these orders. Coroutines have no copy, so a world is made again from
its steps.
"""

from __future__ import annotations

import ctypes
from collections.abc import Awaitable, Callable, Coroutine, Generator, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias, cast

import pytest

from midstride.errors import CallTimeout, CommandRefused, Unreachable
from midstride.foreign.page_layout import PortFlag
from midstride.node.component_host import Host
from midstride.node.handover import cut_protocol
from midstride.node.handover.arbiter import Arbiter, LockArbiter
from midstride.node.handover.baton import BatonState, BatonStep, BatonWord, SharedSlot
from midstride.node.handover.cut import GRACE, IncomingCut, IncomingSide, OutgoingCut, OutgoingSide
from midstride.node.handover.cut_life import CutEvent
from midstride.node.handover.cut_protocol import CutInTask, CutOutTask
from midstride.wire.pipe import PipeLock
from tests.native import baton_steps
from tests.node.test_cut import PERIOD, Clocks, Grid, Owner, T, link_of, write
from tests.planting import plant

SLOT = round(PERIOD * 1e9)
# What the clock shows: before T, at T, long after T, and when the old side has waited long enough in any case.
MOMENTS = (T - SLOT // 10, T, T + 10**10, T + 10**10)
# The outputs of both sides have a rate, and the baton is offered after each message. Nodes are as in its word.
FLAGS = int(PortFlag.RATED | PortFlag.OFFERS)
NODES = {"o": 1, "n": 2}
PASS, ASK = 0, 3
# An actor, what it does, and to which of several things.
Step: TypeAlias = tuple[str, str, int]


@dataclass
class Waits:
    """What a coroutine awaits: until ``done``, or where that is so already, as long as the explorer likes."""

    what: str
    done: bool = True
    value: Any = None

    def __await__(self) -> Generator[Waits, None, Any]:
        yield self
        if isinstance(self.value, Exception):
            raise self.value
        return self.value


class Finished:
    """As an `asyncio.Event`, without a loop."""

    def __init__(self) -> None:
        self.set_ = False

    def set(self) -> None:
        self.set_ = True

    async def wait(self) -> None:
        while not self.set_:
            await Waits("finished")


class Work:
    """A coroutine of a control thread. ``waits``: what for; None once it has returned."""

    def __init__(self, coroutine: Coroutine[Any, Any, Any]) -> None:
        self.coroutine, self.name = coroutine, cast(Any, coroutine).__qualname__
        self.waits: Waits | None = None
        self.result: Any = None
        self.advance()

    def advance(self) -> None:
        try:
            self.waits = self.coroutine.send(None)
        except StopIteration as stop:
            self.waits, self.result = None, stop.value
        except CommandRefused:
            self.waits, self.result = None, True

    def position(self) -> object:
        """Where it is, together with the phase of its side."""
        if self.waits is None:
            return None
        # The value, too: a report that is lost leads elsewhere than one that is answered.
        return self.name, self.waits.what, self.waits.done, str(self.waits.value)


@dataclass(eq=False)
class Process:
    """One side: its control thread has ``works``, its data thread ``queue`` and calls for ``slots``."""

    world: World
    slots: list[int]
    alive: bool = True
    works: list[Work] = field(default_factory=list)
    queue: list[tuple[Callable[[], Any], Waits]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.owner = Owner(rate=Grid(slot=T - 2 * SLOT))
        self.link, self.published = link_of(self.owner)
        host = cast(Any, Clocks())
        host.now = host.steady = lambda: MOMENTS[self.world.moment]
        host.sleep, host.on_data = lambda seconds: Waits("a time"), self.on_data
        self.host = cast(Host, host)

    def on_data(self, function: Callable[[], Any]) -> Waits:
        self.queue.append((function, waits := Waits(function.__name__, done=False)))
        return waits

    def start(self, coroutine: Coroutine[Any, Any, Any]) -> Work:
        self.works.append(work := Work(coroutine))
        return work

    def steps(self, name: str) -> Iterator[Step]:
        if self.alive:
            waiting = [index for index, work in enumerate(self.works) if work.waits is not None and work.waits.done]
            yield from ((name, "control", index) for index in waiting)
            if self.queue:
                yield name, "data", 0
            if self.slots and self.slots[0] <= MOMENTS[self.world.moment]:
                yield name, "call", 0

    def do(self, what: str, index: int) -> None:
        match what:
            case "control":
                self.works[index].advance()
            case "data":
                function, waits = self.queue.pop(0)
                waits.value, waits.done = function(), True
            case "call":
                slot = self.slots.pop(0)
                assert self.owner.rate is not None
                self.owner.slots, self.owner.rate.slot = (slot, slot), slot
                write(self.link, str(slot))
            case "die":
                self.alive = False
                self.world.rights.free(self)

    def writes(self) -> bool:
        """Whether it can publish what belongs to T or later."""
        return self.alive and (self.link.open or (self.link.cut is not None and self.world.rights.may_write(self)))

    def state(self) -> object:
        jobs = tuple(waits.what for _, waits in self.queue)
        works = tuple(work.position() for work in self.works)
        gate = self.link.open, self.link.cut is None, self.link.set_by is None, bool(self.link.output.links)
        return self.alive, len(self.slots), works, jobs, gate, self.world.rights.state(self)


class Locks:
    """The one lock of both sides."""

    def __init__(self, sides: dict[str, Process]) -> None:
        self.holders: dict[str, PipeLock] = {}
        self.locks = {process: PipeLock(self.holders, "cut") for process in sides.values()}

    def arbiter(self, process: Process) -> Arbiter:
        return LockArbiter(self.locks[process])

    def free(self, process: Process) -> None:
        """The kernel does it."""
        self.locks[process].give_back()

    def may_write(self, process: Process) -> bool:
        return self.locks[process] in self.holders.values()

    def place(self, process: Process) -> str:
        return self.locks[process].place

    def state(self, process: Process) -> object:
        return self.locks[process]._shared, self.may_write(process)


class Baton:
    """The word of a baton, of which the old side is the holder, and the steps of the library."""

    def __init__(self, sides: dict[str, Process], library: Any) -> None:
        self.sides = {NODES[name]: process for name, process in sides.items()}
        self.nodes = {process: node for node, process in self.sides.items()}
        self.library, self.word = library, [int(library.midstride_step(0, BatonStep.GIVE, NODES["o"], 0, False))]
        self.slots = {process: ModelSlot(self, node) for process, node in self.nodes.items()}

    def entered(self, node: int) -> int | None:
        """What the word becomes if this node begins to publish; None where it may not."""
        holder = self.sides[BatonWord.of(self.word[0]).holder]
        following = ctypes.c_uint64(0)
        for dead in (-1, int(not holder.alive)):
            verdict = self.library.midstride_enter(self.word[0], node, FLAGS, True, False, dead, following)
            if verdict != ASK:
                return following.value if verdict == PASS else None
        raise AssertionError("it asks although it knows")

    def arbiter(self, process: Process) -> Arbiter:
        return self.slots[process]

    def free(self, process: Process) -> None:
        """That it is dead is asked for."""

    def may_write(self, process: Process) -> bool:
        """It has the baton, or gets it at its next message although the other side may publish without one."""
        node, word = self.nodes[process], BatonWord.of(self.word[0])
        if not self.slots[process].joined:
            return False
        alone = not self.sides[word.holder].alive or any(side.alive and side.link.open for side in self.nodes)
        return (word.holder == node and word.state is not BatonState.FENCED) or (
            alone and self.entered(node) is not None
        )

    def place(self, process: Process) -> str:
        raise AssertionError("nothing is reported")

    def state(self, process: Process) -> object:
        return self.word[0] & 0xFFFFFFFFFFFF, self.slots[process].joined  # without the generation


class ModelSlot(SharedSlot):
    """The shared slot of one side, without shared memory: it is itself the library, but for the steps."""

    def __init__(self, baton: Baton, node: int) -> None:
        self._library, self._slot, self._word = cast(Any, self), 1, baton.word
        self.me, self.other, self.timed = node, 3 - node, False
        self._baton, self._entered, self._again = baton, 0, False

    @property
    def joined(self) -> bool:
        return self._slot is not None

    def midstride_begin(self, slot: int, output: int) -> bool:
        word, entered = self.word(), self._baton.entered(self.me)
        if entered is not None:
            self._again = (word.state, word.holder) == (BatonState.OFFERED, self.me) and bool(word.successor)
            self._word[0] = self._entered = entered
        return entered is not None

    def midstride_end(self, slot: int) -> None:
        left = self._baton.library.midstride_leave(self._word[0], self._entered, FLAGS, self._again)
        self._word[0] = int(left)

    def midstride_take_step(self, word: list[int], step: BatonStep, node: int, successor: int, at_once: bool) -> None:
        word[0] = int(self._baton.library.midstride_step(word[0], step, node, successor, at_once))

    def midstride_leave_slot(self, slot: int) -> None: ...


@dataclass
class Report:
    """A request of the new side: on its way to the old one, or ``handled`` by it."""

    failed: bool
    waits: Waits
    handled: Work | None = None


class World:
    """``manager``: its commands; it may end before each. `c` cancels and `s` resolves a side, `o` or `n`, `k` kills it,
    `d` takes it off its topic.

    ``mortal``: the sides that may die. ``fails``: the code of the new side may raise. With a ``library``, a baton
    decides.
    """

    def __init__(self, manager: str = "", mortal: str = "", fails: bool = False, library: Any = None) -> None:
        self.moment = 0
        self.manager, self.mortal, self.fails = manager, mortal, fails
        self.command: Work | None = None
        # Whether the old side was heard long after T, beside the new one: with one lock it can know.
        self.outdated, self.one_lock = False, library is None
        self.reports: list[Report] = []
        self.processes = {"o": Process(self, [T - SLOT, T]), "n": Process(self, [T])}
        old, new = self.processes.values()
        old.link.open = True
        self.rights = Locks(self.processes) if library is None else Baton(self.processes, library)
        outgoing: OutgoingSide
        incoming: IncomingSide
        if library is None:
            outgoing = OutgoingCut([old.link], old.host, self.rights.arbiter(old), T)
            incoming = cut = IncomingCut([new.link], new.host, self.rights.arbiter(new), T)
            cut.arm(T)
            self.incoming = CutInTask(new.host, lambda: None, incoming, self.report)
        else:
            outgoing = OutgoingSide([old.link], old.host, self.rights.arbiter(old))
            incoming = IncomingSide([new.link], new.host, self.rights.arbiter(new))
            incoming.arm()
            self.incoming = CutInTask(new.host, lambda: None, incoming, None, patience=1.0)
        outgoing.arm()
        self.outgoing = CutOutTask(old.host, lambda: None, outgoing, resume_after=1.0)
        self.outgoing.finished, self.incoming.finished = cast(Any, Finished()), cast(Any, Finished())
        old.start(self.outgoing.run())
        new.start(self.incoming.run())

    def report(self, timeout: float, failed: bool) -> Awaitable[bool]:
        if not self.processes["o"].alive:
            return Waits("report", value=Unreachable("it has exited"))
        self.reports.append(report := Report(failed, Waits("report", done=False)))
        return report.waits

    def steps(self) -> list[Step]:
        found = [step for name, process in self.processes.items() for step in process.steps(name)]
        for index, report in enumerate(self.reports):
            found.append(("report", "lose", index))
            if report.handled is None and self.processes["o"].alive:
                found.append(("report", "deliver", index))
            elif report.handled is not None and report.handled.waits is None:
                found.append(("report", "reply", index))
        if self.moment + 1 < len(MOMENTS):
            found.append(("time", "", 0))
        if self.manager and (self.command is None or self.command.waits is None):
            found += [("manager", "do", 0), ("manager", "end", 0)]
        found += [(name, "die", 0) for name in self.mortal if self.processes[name].alive]
        if self.fails and not self.processes["n"].owner.failed:
            found.append(("fail", "", 0))
        return found

    def do(self, step: Step) -> None:
        match step:
            case "time", _, _:
                self.moment += 1
                if self.moment + 1 == len(MOMENTS):
                    self.outgoing.resume_after = -1.0
                    if self.incoming.report is None:
                        self.incoming.patience = -1.0
            case "fail", _, _:
                self.processes["n"].owner.failed = True
            case "report", "deliver", index:
                report = self.reports[index]
                place = "" if report.failed else self.rights.place(self.processes["n"])
                report.handled = self.processes["o"].start(self.outgoing.taken(report.failed, place))
            case "report", how, index:
                report = self.reports.pop(index)
                lost = how == "lose" or report.handled is None
                report.waits.value = CallTimeout("lost") if lost else report.handled and report.handled.result
                report.waits.done = True
            case "manager", "do", _:
                what, name, self.manager = self.manager[0], self.manager[1], self.manager[2:]
                if what == "k":
                    self.processes[name].do("die", 0)
                elif self.processes[name].alive:
                    task = self.outgoing if name == "o" else self.incoming
                    doing = {"c": self.cancel, "d": self.detach, "s": type(task).resolve}[what]
                    self.command = self.processes[name].start(doing(cast(Any, task)))
            case "manager", _, _:
                self.manager = ""
            case "o", "call", _:
                old, late = self.processes["o"], MOMENTS[self.moment] - T > GRACE * 1e9
                beside, heard = late and self.one_lock and self.processes["n"].writes(), len(old.published)
                old.do("call", 0)
                self.outdated = self.outdated or (beside and len(old.published) > heard)
            case name, what, index:
                self.processes[name].do(what, index)

    async def cancel(self, task: CutOutTask | CutInTask) -> None:
        """As `HandoverCommands.cancel_cut`."""
        try:
            await task.cancel()
        except CommandRefused:
            assert isinstance(task, CutOutTask)
            self.processes["o"].start(task.watch_successor())

    async def detach(self, task: CutOutTask | CutInTask) -> None:
        """As `CommandHandlers._detach`."""
        process = self.processes["n" if task.new else "o"]
        await process.on_data(process.link.destroy)
        if isinstance(task, CutInTask) and task.is_detached:
            task.side.arbiter.give_back()

    def state(self) -> object:
        out, into = self.outgoing, self.incoming
        return (
            self.moment,
            *(process.state() for process in self.processes.values()),
            tuple((report.failed, report.handled and report.handled.waits is None) for report in self.reports),
            (out.phase, out.outcome, out._taken, out._wanted, out._watching, out._due_at, out.side.over),
            (into.phase, into.outcome, into._reports, into.side.refused, bool(into.side.written)),
            (self.manager, self.command is None or self.command.waits is None, self.processes["n"].owner.failed),
            self.outdated,
        )


@dataclass
class Seen:
    """``writes``: the sides that can write after T. ``settled``: nothing more happens without a command."""

    writes: str
    alive: str
    attached: str
    outcomes: tuple[str | None, str | None]
    confirmed: bool  # the old side knows that the new one has taken over
    outdated: bool = False  # the old side was heard long after T, beside the new one
    settled: bool = True


def explore(**given: Any) -> list[Seen]:
    """What every world that can be reached shows."""
    found: dict[object, Seen] = {}
    waiting: list[tuple[list[Step], object]] = [([], None)]
    while waiting:
        path, before = waiting.pop()
        world = World(**given)
        for step in path:
            world.do(step)
        while True:  # on along the first step; the others later
            state = world.state()
            if before is not None and state != before:
                found[before].settled = False
            if state in found:
                break
            sides = world.processes.items()
            found[state] = Seen(
                "".join(name for name, process in sides if process.writes()),
                "".join(name for name, process in sides if process.alive),
                "".join(name for name, process in sides if process.link.output.links),
                (world.outgoing.outcome, world.incoming.outcome),
                world.outgoing._taken,
                world.outdated,
            )
            if not (steps := world.steps()):
                break
            waiting += [([*path, step], state) for step in steps[1:]]
            path, before = [*path, steps[0]], state
            world.do(steps[0])
    return list(found.values())


@pytest.fixture(autouse=True)
def one_report(monkeypatch: pytest.MonkeyPatch) -> None:
    """Which may be lost, as all of them may."""
    monkeypatch.setattr(cut_protocol, "REPORT_ATTEMPTS", 1)


FULL, LONG = pytest.mark.full, pytest.mark.long


def side_can_write(seen: Seen, side: str) -> bool:
    return side in seen.alive and side in seen.attached


def assert_one_writer(states: int, **given: Any) -> list[Seen]:
    """Explore: never do both sides write, and one does wherever one can; all worlds, of which there are ``states``.

    Nor is the old one heard long after the new one has begun. Another number means that the protocol has changed, or
    that the exploration has missed some.
    """
    found = explore(**given)
    assert len(found) == states
    for seen in found:
        assert len(seen.writes) < 2 and not seen.outdated, seen
        if seen.settled and (side_can_write(seen, "o") or side_can_write(seen, "n")):
            # The new side has given up for an old one that has died.
            given_up = seen.outcomes[1] == "cancelled" or seen.outcomes[0] in ("resumed", "cancelled")
            assert seen.writes or (given_up and not side_can_write(seen, "o")), seen
    return found


@pytest.mark.parametrize(
    ("manager", "mortal", "fails", "states"),
    [
        ("", "", False, 2279),
        pytest.param("", "o", False, 4940, marks=FULL),
        pytest.param("", "n", False, 5536, marks=FULL),
        pytest.param("", "", True, 10444, marks=FULL),
        pytest.param("co", "", False, 9707, marks=FULL),
        pytest.param("cn", "", False, 16111, marks=LONG),  # and nothing reaches the old side
        pytest.param("kn", "", False, 7815, marks=FULL),
        pytest.param("dn", "", False, 13364, marks=FULL),
        pytest.param("dokn", "", False, 19630, marks=LONG),
        pytest.param("cndn", "", False, 33649, marks=LONG),
        pytest.param("cokn", "", False, 23608, marks=LONG),
        pytest.param("cnco", "", False, 35822, marks=LONG),
        pytest.param("snso", "", False, 21128, marks=LONG),
        pytest.param("cn", "n", True, 136516, marks=LONG),
        pytest.param("", "on", True, 47146, marks=LONG),
    ],
)
def test_two_sides_can_never_both_write_and_one_does(manager: str, mortal: str, fails: bool, states: int) -> None:
    found = assert_one_writer(states, manager=manager, mortal=mortal, fails=fails)
    assert mortal or {seen.writes for seen in found if seen.settled} >= {"o"}


def test_a_new_side_that_fails_has_its_outcome_before_it_reports_that() -> None:
    """The old side, which writes again from then on, or the manager may ask for it at any moment."""
    world = World(fails=True)
    world.do(("fail", "", 0))
    while not world.reports:
        world.do(("n", "control", 0))
    assert world.incoming.outcome == "cancelled"


@pytest.mark.parametrize("attempts", [1, 4])
def test_a_report_that_is_lost_is_repeated_so_often(attempts: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cut_protocol, "REPORT_ATTEMPTS", attempts)
    world, lost = World(fails=True), 0
    world.do(("fail", "", 0))
    taken = [("n", "control"), ("n", "data"), ("report", "lose")]
    while next_ := [step for step in world.steps() if step[:2] in taken]:
        lost += next_[0][0] == "report"
        world.do(next_[0])
    assert lost == attempts


def test_the_patience_of_a_new_side_begins_when_it_begins() -> None:
    world = World()
    process = world.processes["n"]
    task = CutInTask(process.host, lambda: None, cast(Any, world.incoming.side), world.report, patience=1.0)
    process.start(task.run())
    process.do("control", 1)
    assert task.outcome == "waiting"


@pytest.mark.parametrize(("back", "outcome"), [(0.9, "waiting"), (1.1, "cancelled")])
def test_only_a_clock_that_is_set_back_far_ends_a_cut(back: float, outcome: str) -> None:
    """A synchronization corrects it by less; a simulation that has started again sets it back by more than a second."""
    world, now = World(), T - SLOT
    host = cast(Any, world.processes["n"].host)
    for moment in (now, now - round(back * 1e9)):
        host.now = lambda moment=moment: moment
        world.do(("n", "control", 0))
    assert world.incoming.outcome == outcome


@pytest.mark.parametrize(
    ("manager", "mortal", "fails", "states"),
    [
        ("", "", False, 296),
        ("", "on", False, 1424),
        pytest.param("", "", True, 616, marks=FULL),
        pytest.param("co", "", False, 1560, marks=FULL),
        pytest.param("cn", "", False, 2392, marks=FULL),
        pytest.param("cnco", "", False, 5412, marks=FULL),
        pytest.param("snso", "", False, 2746, marks=FULL),
        pytest.param("do", "n", False, 3872, marks=FULL),
        pytest.param("dn", "o", False, 3899, marks=FULL),
    ],
)
def test_with_a_baton_two_sides_can_never_both_write_and_one_does(
    gate_library: Path, manager: str, mortal: str, fails: bool, states: int
) -> None:
    library = baton_steps(gate_library)
    found = assert_one_writer(states, manager=manager, mortal=mortal, fails=fails, library=library)
    assert {seen.outcomes[0] for seen in found} >= {"waiting", "done", "resumed"}


async def cancelled_without_the_lock(self: Any) -> None:
    await self._end(CutEvent.CANCELLED, self.side.reopen)


@pytest.mark.parametrize(
    ("task", "name", "mistake", "manager"),
    [
        (CutOutTask, "_may_resume", lambda self: not self._taken, ""),
        pytest.param(IncomingCut, "admits", IncomingCut.passes, "", marks=FULL, id="admits"),
        pytest.param(CutOutTask, "cancel", cancelled_without_the_lock, "co", marks=LONG, id="cancel"),
    ],
)
def test_the_exploration_finds_a_side_that_does_not_lock(
    task: type, name: str, mistake: Any, manager: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    plant(monkeypatch, task, name, mistake)
    assert any(len(seen.writes) == 2 for seen in explore(manager=manager))


def test_the_exploration_finds_an_old_side_that_is_heard_beside_the_new_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """It was stopped before T, and goes on with the call that it was in, long after the new side has written."""
    plant(monkeypatch, LockArbiter, "is_overtaken", lambda self: False)
    assert any(seen.outdated for seen in explore())


@pytest.mark.full
def test_the_exploration_finds_a_topic_without_a_writer(monkeypatch: pytest.MonkeyPatch) -> None:
    """The new side fails, and its report is lost."""
    plant(monkeypatch, CutOutTask, "_given_up", lambda self: False)
    assert any(seen.settled and not seen.writes for seen in explore(fails=True))


def test_the_exploration_finds_an_old_side_that_does_not_fence_the_baton(
    gate_library: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plant(monkeypatch, SharedSlot, "reclaim", lambda self: True)
    assert any(len(seen.writes) == 2 for seen in explore(library=baton_steps(gate_library)))


@pytest.mark.full
def test_the_exploration_finds_a_new_side_that_keeps_the_baton_of_a_cancelled_cut(
    gate_library: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plant(monkeypatch, SharedSlot, "give_back", lambda self: self.leave())
    found = explore(manager="cn", library=baton_steps(gate_library))
    assert any(seen.settled and not seen.writes for seen in found)

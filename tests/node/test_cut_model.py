"""The agreed cut, explored: every order of the steps of both sides, of the manager and of the network, with deaths.

The two sides are the shipped ones, `CutOutTask` and `CutInTask` with their gates. Here are only the threads that they
run on: a step is what one of them does until it waits. A thread may wait for as long as it likes, so every stall and
every lost or late message is among these orders. Coroutines have no copy, so a world is made again from its steps.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Coroutine, Generator, Iterator
from dataclasses import dataclass, field
from typing import Any, TypeAlias, cast

import pytest

from midstride.errors import CallTimeout, CommandRefused, Unreachable
from midstride.node.component_host import Host
from midstride.node.handover import cut_protocol
from midstride.node.handover.arbiter import ClaimArbiter
from midstride.node.handover.cut import IncomingCut, OutgoingCut
from midstride.node.handover.cut_life import CutEvent
from midstride.node.handover.cut_protocol import CutInTask, CutOutTask
from midstride.wire.pipe import PipeClaim
from tests.node.test_cut import PERIOD, Clocks, Grid, Owner, T, link_of, write
from tests.planting import plant

SLOT = round(PERIOD * 1e9)
# What the clock shows: before T, at T, long after T, and when the old side has waited long enough in any case.
MOMENTS = (T - SLOT // 10, T, T + 10**10, T + 10**10)
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
        self.claim = self.world.claim()
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
                self.claim.give_back()

    def writes(self) -> bool:
        """Whether it can publish what belongs to T or later."""
        claimed = self.link.cut is not None and self.claim in self.world.holders()
        return self.alive and (self.link.open or claimed)

    def state(self) -> object:
        jobs = tuple(waits.what for _, waits in self.queue)
        works = tuple(work.position() for work in self.works)
        gate = self.link.open, self.link.cut is None, self.link.set_by is None, bool(self.link.output.links)
        return self.alive, len(self.slots), works, jobs, gate, self.claim._shared


@dataclass
class Report:
    """A request of the new side: on its way to the old one, or ``handled`` by it."""

    failed: bool
    waits: Waits
    handled: Work | None = None


class World:
    """``manager``: its commands; it may end before each. `c` cancels and `s` resolves a side, `o` or `n`, `k` kills it,
    `d` takes it off its topic.

    ``mortal``: the sides that may die. ``fails``: the code of the new side may raise. ``hosts``: one, with one claim
    for both sides, or two.
    """

    def __init__(self, manager: str = "", mortal: str = "", fails: bool = False, hosts: int = 1) -> None:
        self.moment = 0
        self.claims: list[dict[str, PipeClaim]] = [{} for _ in range(hosts)]
        self.claimed = 0
        self.manager, self.mortal, self.fails = manager, mortal, fails
        self.command: Work | None = None
        self.reports: list[Report] = []
        self.processes = {"o": Process(self, [T - SLOT, T]), "n": Process(self, [T])}
        old, new = self.processes.values()
        old.link.open = True
        outgoing = OutgoingCut([old.link], old.host, ClaimArbiter(old.claim), T)
        incoming = IncomingCut([new.link], new.host, ClaimArbiter(new.claim), T)
        outgoing.arm()
        incoming.arm(T)
        self.outgoing = CutOutTask(old.host, lambda: None, outgoing, resume_after=1.0)
        self.incoming = CutInTask(new.host, lambda: None, incoming, self.report)
        self.outgoing.finished, self.incoming.finished = cast(Any, Finished()), cast(Any, Finished())
        old.start(self.outgoing.run())
        new.start(self.incoming.run())

    def claim(self) -> PipeClaim:
        host = self.claimed % len(self.claims)
        self.claimed += 1
        return PipeClaim(self.claims[host], "cut", f"host {host}")

    def holders(self) -> list[PipeClaim]:
        return [holder for claims in self.claims for holder in claims.values()]

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
            case "fail", _, _:
                self.processes["n"].owner.failed = True
            case "report", "deliver", index:
                report = self.reports[index]
                place = "" if report.failed else self.processes["n"].claim.place
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
            process.claim.give_back()

    def state(self) -> object:
        out, into, holders = self.outgoing, self.incoming, self.holders()
        return (
            self.moment,
            *(process.state() for process in self.processes.values()),
            tuple((report.failed, report.handled and report.handled.waits is None) for report in self.reports),
            (out.phase, out.outcome, out._taken, out._wanted, out._watching, out._due_at, out.side.over),
            (into.phase, into.outcome, into._reports, into.side.refused, bool(into.side.written)),
            tuple(process.claim in holders for process in self.processes.values()),
            (self.manager, self.command is None or self.command.waits is None, self.processes["n"].owner.failed),
        )


@dataclass
class Seen:
    """``writes``: the sides that can write after T. ``settled``: nothing more happens without a command."""

    writes: str
    alive: str
    attached: str
    outcomes: tuple[str | None, str | None]
    confirmed: bool  # the old side knows that the new one has taken over
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


def old_side_can_write(seen: Seen) -> bool:
    return "o" in seen.alive and "o" in seen.attached


def new_side_has_given_up_for_one_that_died(seen: Seen) -> bool:
    return seen.outcomes[1] == "cancelled" or seen.outcomes[0] in ("resumed", "cancelled")


@pytest.mark.parametrize(
    ("manager", "mortal", "fails", "states"),
    [
        ("", "", False, 2279),
        pytest.param("", "o", False, 4940, marks=FULL),
        pytest.param("", "n", False, 5536, marks=FULL),
        pytest.param("", "", True, 10444, marks=FULL),
        pytest.param("co", "", False, 9707, marks=FULL),
        pytest.param("cn", "", False, 16111, marks=FULL),  # and nothing reaches the old side
        pytest.param("kn", "", False, 7815, marks=FULL),
        pytest.param("dn", "", False, 13364, marks=FULL),
        pytest.param("dokn", "", False, 19630, marks=LONG),
        pytest.param("cndn", "", False, 33649, marks=LONG),
        pytest.param("cokn", "", False, 23608, marks=LONG),
        pytest.param("cnco", "", False, 35822, marks=LONG),
        pytest.param("snso", "", False, 21084, marks=LONG),
        pytest.param("cn", "n", True, None, marks=LONG),
        pytest.param("", "on", True, None, marks=LONG),
    ],
)
def test_two_sides_can_never_both_write_and_one_does(
    manager: str, mortal: str, fails: bool, states: int | None
) -> None:
    """Another number of ``states`` means that the protocol has changed, or that the exploration has missed some."""
    found = explore(manager=manager, mortal=mortal, fails=fails)
    assert len(found) == states or (states is None and len(found) > 1000)
    for seen in found:
        assert len(seen.writes) < 2, seen
        if seen.settled and (old_side_can_write(seen) or ("n" in seen.alive and "n" in seen.attached)):
            gone = not old_side_can_write(seen) and new_side_has_given_up_for_one_that_died(seen)
            assert seen.writes or gone, seen
    assert mortal or {seen.writes for seen in found if seen.settled} >= {"o"}


def test_a_new_side_that_fails_has_its_outcome_before_it_reports_that() -> None:
    """The old side, which writes again from then on, or the manager may ask for it at any moment."""
    world = World(fails=True)
    world.do(("fail", "", 0))
    while not world.reports:
        world.do(("n", "control", 0))
    assert world.incoming.outcome == "cancelled"


@pytest.mark.parametrize(("back", "outcome"), [(0.9, "waiting"), (1.1, "cancelled")])
def test_only_a_clock_that_is_set_back_far_ends_a_cut(back: float, outcome: str) -> None:
    """A synchronization corrects it by less; a simulation that has started again sets it back by more than a second."""
    world, now = World(), T - SLOT
    host = cast(Any, world.processes["n"].host)
    for moment in (now, now - round(back * 1e9)):
        host.now = lambda moment=moment: moment
        world.do(("n", "control", 0))
    assert world.incoming.outcome == outcome


@pytest.mark.parametrize(("manager", "states"), [("", 2256), pytest.param("kn", 6768, marks=FULL)])
def test_between_two_hosts_an_old_side_that_knows_writes_on_command_only(manager: str, states: int) -> None:
    """They share no claim, so it cannot know that the new side has ended."""
    found = explore(manager=manager, hosts=2)
    assert len(found) == states
    assert all(seen.writes != "on" for seen in found if seen.confirmed and seen.outcomes[0] == "done")
    assert not any("o" in seen.writes for seen in found if seen.outcomes[0] == "done")
    assert any(seen.confirmed and not seen.writes for seen in found if seen.settled) == bool(manager)


@pytest.mark.parametrize(
    ("task", "name", "mistake", "manager"),
    [
        (CutOutTask, "_may_resume", lambda self: not self._taken, ""),
        pytest.param(IncomingCut, "admits", IncomingCut.passes, "", marks=FULL, id="admits"),
        pytest.param(
            CutOutTask,
            "cancel",
            lambda self: self._end(CutEvent.CANCELLED, self.side.reopen),
            "co",
            marks=FULL,
            id="cancel",
        ),
    ],
)
def test_the_exploration_finds_a_side_that_does_not_claim(
    task: type, name: str, mistake: Any, manager: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    plant(monkeypatch, task, name, mistake)
    assert any(len(seen.writes) == 2 for seen in explore(manager=manager))


@pytest.mark.full
def test_the_exploration_finds_a_topic_without_a_writer(monkeypatch: pytest.MonkeyPatch) -> None:
    """The new side fails, and its report is lost."""
    plant(monkeypatch, CutOutTask, "_given_up", lambda self: False)
    assert any(seen.settled and not seen.writes for seen in explore(fails=True))

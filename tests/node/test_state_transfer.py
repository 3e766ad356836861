"""The state at a cut: which calls are made, held back or dropped meanwhile, and for how long each side waits."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from types import SimpleNamespace
from typing import Any, cast

import pytest

from midstride.backends.simulator.virtual_loop import run
from midstride.node.author.ports import OutputLink
from midstride.node.component_host import MessageInfo
from midstride.node.data.functionality_runner import Admission, Call, FunctionalityRunner
from midstride.node.handover.state_transfer import (
    CATCH_UP,
    LONGEST_WAIT,
    REPORT_INTERVAL,
    TICK,
    StateExport,
    StateImport,
)
from midstride.node.request_admission import RequestAdmission
from midstride.wire.commands import Command, FetchStateCommand, StateTransfer
from midstride.wire.frames import Reply, encode_value
from midstride.wire.replies import Confirmed, FetchedState
from tests.node.test_cut import Owner, link_of
from tests.node.virtual import SECOND, Rights, VirtualHost, seconds
from tests.planting import plant


class Runner(Owner):
    """A functionality as a transfer sees it."""

    asynchronous = False
    awaits = FunctionalityRunner.awaits
    admission: Any = None
    inputs: Any = ()

    def __init__(self) -> None:
        super().__init__()
        self.held: list[str] = []

    def make_held(self) -> None:
        self.held.append("made")

    def drop_held(self) -> None:
        self.held.append("dropped")


class Hooks:
    """The author's functions: when they were called."""

    def __init__(self) -> None:
        self.imported_at: float | None = None

    async def import_(self, state: bytes, timeout: float, changes: bool) -> None:
        self.imported_at = seconds()

    async def export(self, timeout: float, changes: bool) -> bytes:
        return b"state"


def cut_of(rights: Rights, *links: OutputLink, at: float = 0.0) -> Any:
    return SimpleNamespace(at=round(at * SECOND), clock="ros", shift=0, arbiter=rights, links=links)


def transfer(at: float = 0.0, **more: Any) -> StateTransfer:
    return StateTransfer(id="1", at=round(at * SECOND), **{"cuts": 1, "timeout": 0.5, **more})


def answering() -> Any:
    return SimpleNamespace(admission=RequestAdmission(lambda: 0), take_over=lambda *_: None, pause=lambda: False)


def importing(
    runner: Runner,
    moves: StateTransfer,
    hooks: Hooks | None = None,
    request: Callable[[Command[Any], float], Awaitable[Reply]] | None = None,
) -> StateImport:
    async def never(command: Command[Any], timeout: float) -> Reply:
        await asyncio.Event().wait()
        raise AssertionError

    return StateImport(
        moves,
        cast(Any, hooks or Hooks()),
        answering(),
        VirtualHost().host,
        cast(Any, [runner]),
        "old",
        "its address",
        request or never,
    )


def exporting(runner: Runner, moves: StateTransfer) -> StateExport:
    runners: Any = [runner]
    return StateExport(moves, cast(Any, Hooks()), answering(), VirtualHost().host, runners, lambda work: None)


def call(info: Any = None) -> Call:
    return Call(lambda: None, (), None, info)


def in_virtual_time(main: Callable[[], Awaitable[None]]) -> None:
    async def opened() -> None:
        await main()

    run(opened())


def replying(reports: list[tuple[float, bool]]) -> Callable[[Command[Any], float], Awaitable[Reply]]:
    """The old side: its state is there at once; ``reports``: when the new one reported, and whether as done."""

    async def request(command: Command[Any], timeout: float) -> Reply:
        if isinstance(command, FetchStateCommand):
            return Reply(id="1", revision=0, result=encode_value(FetchedState(state=b"state", handled={}, since=0)))
        reports.append((seconds(), cast(Any, command).done))
        return Reply(id="1", revision=0, result=encode_value(Confirmed(resumed=False)))

    return request


def test_a_state_is_imported_once_no_async_call_is_under_way_and_the_old_side_hears_of_it_meanwhile() -> None:
    async def main() -> None:
        runner, hooks, reports = Runner(), Hooks(), list[tuple[float, bool]]()
        runner.asynchronous = True
        work = importing(runner, transfer(timeout=5.0), hooks, replying(reports))
        work.arm([], cut_of(Rights()))
        running = asyncio.ensure_future(work.run())
        await asyncio.sleep(0.3)
        assert hooks.imported_at is None
        assert len(reports) == pytest.approx(0.3 / REPORT_INTERVAL, abs=1) and not any(done for _, done in reports)
        runner.asynchronous = False
        await running
        assert hooks.imported_at == pytest.approx(0.3, abs=2 * TICK)
        assert reports[-1][1] and runner.held == ["made"] and work.problem is None

    in_virtual_time(main)


def test_a_loop_that_a_mode_has_begun_on_entry_is_not_waited_for() -> None:
    async def main() -> None:
        runner, hooks = Runner(), Hooks()
        runner.asynchronous, runner.driven = True, "none"
        work = importing(runner, transfer(), hooks, replying([]))
        work.arm([], cut_of(Rights()))
        await work.run()
        assert hooks.imported_at == pytest.approx(0.0, abs=TICK)

    in_virtual_time(main)


@pytest.mark.parametrize("required", [True, False])
def test_the_time_in_which_the_state_may_come_begins_with_the_last_cut_of_the_pair(required: bool) -> None:
    async def main() -> None:
        runner = Runner()
        work = importing(runner, transfer(at=3.0, required=required))
        work.arm([], cut_of(Rights()))
        await work.decided()
        assert seconds() == pytest.approx(3.5, abs=0.02)
        assert work.problem == "the state took longer than 0.5 s" and work.failed is required

    in_virtual_time(main)


def test_while_the_last_cut_is_far_ahead_the_clock_is_looked_at_now_and_then(monkeypatch: pytest.MonkeyPatch) -> None:
    slept: list[float] = []
    sleep = VirtualHost.sleep

    async def counted(self: VirtualHost, seconds: float) -> None:
        slept.append(seconds)
        await sleep(self, seconds)

    plant(monkeypatch, VirtualHost, "sleep", counted)

    async def main() -> None:
        work = importing(Runner(), transfer(at=3.0))
        work.arm([], cut_of(Rights()))
        await work.decided()
        assert 3.0 / LONGEST_WAIT <= len(slept) < 1.1 * 3.0 / LONGEST_WAIT

    in_virtual_time(main)


def test_without_every_cut_of_the_pair_the_new_side_cannot_take_over() -> None:
    async def main() -> None:
        work = importing(Runner(), transfer(at=3.0, cuts=2))
        work.arm([], cut_of(Rights()))
        await work.decided()
        assert (seconds(), work.failed, work.problem) == (0.0, True, "the manager has not sent every cut")

    in_virtual_time(main)


@pytest.mark.parametrize("outputs", [True, False])
@pytest.mark.parametrize("admitted", [True, False])
def test_where_no_output_is_cut_the_first_call_takes_the_right(outputs: bool, admitted: bool) -> None:
    """Else the first write does."""

    async def main() -> None:
        runner, rights = Runner(), Rights(admitted=admitted)
        link, _ = link_of(runner)
        links = [link] if outputs else []
        work = importing(runner, transfer(timeout=5.0), request=replying([]))
        work.arm(links, cut_of(rights, *links))
        await work.run()
        assert rights.asked == (0 if outputs else 1)
        refused = not outputs and not admitted
        assert (work.failed, work.problem) == (refused, "the old component has resumed" if refused else None)
        assert runner.held == ([] if refused else ["made"])

    in_virtual_time(main)


@pytest.mark.parametrize(
    ("outputs", "now", "admission"),
    [(True, 0.5, "make"), (False, 0.5, "drop"), (True, 1.5, "hold"), (False, 1.5, "hold")],
)
def test_what_belongs_before_the_cut_is_made_behind_the_gate_and_dropped_where_there_is_none(
    outputs: bool, now: float, admission: Admission
) -> None:
    """Nothing has been imported yet; what belongs to the new side waits for that."""

    async def main() -> None:
        runner = Runner()
        link, _ = link_of(runner)
        links = [link] if outputs else []
        work = importing(runner, transfer(at=1.0))
        work.arm(links, cut_of(Rights(), *links, at=1.0))
        await asyncio.sleep(now)
        assert work.admit(cast(Any, runner), call()) == admission

    in_virtual_time(main)


def test_the_old_side_counts_what_it_has_received_from_the_first_of_its_cuts_on() -> None:
    async def main() -> None:
        runner = Runner()
        work = exporting(runner, transfer(at=9.0, cuts=2))
        await asyncio.sleep(5.0)
        work.arm([], cut_of(Rights(), at=9.0))
        await asyncio.sleep(1.0)
        work.arm([], cut_of(Rights(), at=9.0))
        for publisher, source in (("a", 7), ("b", 3), ("a", 5), ("a", 8)):
            assert work.admit(cast(Any, runner), call(MessageInfo(source, None, publisher))) == "make"
        await asyncio.sleep(5.0)
        await work.passed("one")
        await work.passed("other")
        fetched = await work.fetch()
        assert (fetched.state, fetched.since, fetched.handled) == (b"state", 5 * SECOND, {"a": 8, "b": 3})
        assert work.admit(cast(Any, runner), call(MessageInfo(9, None, "a"))) == "hold", "the state has left"

    in_virtual_time(main)


class Port:
    """An input: the messages that it has received, each when it was published (s)."""

    def __init__(self, *times: float) -> None:
        self.times = list(times)

    def last_receipts(self) -> list[Any]:
        return [(round(at * SECOND), MessageInfo(round(at * SECOND), None, "a")) for at in self.times]


def test_the_old_side_waits_for_a_message_that_shows_that_none_is_on_its_way() -> None:
    """What it had received before it learned of the cut is its own, too."""

    async def main() -> None:
        runner, port = Runner(), Port(0.97, 0.98, 0.99)
        runner.inputs = (port,)
        work = exporting(runner, transfer(at=2.0))
        await asyncio.sleep(1.0)
        work.arm([], cut_of(Rights(), at=2.0))
        await asyncio.sleep(1.0)
        passed = asyncio.ensure_future(work.passed("one"))
        await asyncio.sleep(0.2)
        assert not passed.done()
        assert work.admit(cast(Any, runner), call(MessageInfo(SECOND, None, "a"))) == "make", "one that was on its way"
        port.times.append(2.1)
        await asyncio.sleep(2 * TICK)
        assert passed.done()
        assert (await work.fetch()).handled == {"a": SECOND}

    in_virtual_time(main)


@pytest.mark.parametrize(
    ("times", "outputs", "waits"),
    [
        ((1.98, 1.99), False, CATCH_UP),
        ((1.98, 1.99), True, 0.0),  # outputs wait for the state
        ((1.88, 1.89), True, CATCH_UP),  # the next message is overdue
        ((0.0, 1.0), False, 0.0),  # too slow to be expected
        ((1.0,), False, 0.0),  # not known how often
    ],
)
def test_how_long_the_old_side_waits(times: tuple[float, ...], outputs: bool, waits: float) -> None:
    async def main() -> None:
        runner, answering_runner = Runner(), Runner()
        runner.inputs = (Port(*times),)
        work = exporting(runner, transfer(at=2.0))
        await asyncio.sleep(1.9)
        work.arm([link_of(answering_runner)[0]] if outputs else [], cut_of(Rights(), at=2.0))
        await asyncio.sleep(0.1)
        await work.passed("one")
        assert seconds() - 2.0 == pytest.approx(waits, abs=3 * TICK)

    in_virtual_time(main)

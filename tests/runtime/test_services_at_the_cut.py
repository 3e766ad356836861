"""Requests to a component whose state moves: each is answered once, and what it changes is in the state that moves."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest

from midstride.errors import Unreachable
from midstride.node.control.component_end import REQUESTS_SECONDS, RESPONSE_SECONDS
from midstride.plan.request import PlanRequest
from midstride.runtime.manager import Manager
from tests.runtime.counting import EXPORT, IMPORT, at_rates, counting, exchanged, for_messages, settle, system
from tests.runtime.services import SERVICE, SLOW_SERVICE, Caller, ServingSimulator

Body = Callable[[Manager, ServingSimulator], Awaitable[None]]


def serving(
    folder: Path, body: Body, *, seed: int = 0, export: str = EXPORT, import_: str = IMPORT, more: str = SERVICE
) -> None:
    simulator = ServingSimulator(seed=seed, latency=0.0003, jitter=0.0003)
    program = at_rates(export, import_, more, out=50)

    async def run(manager: Manager, _: Any) -> None:
        await body(manager, simulator)

    counting(system(folder, program, out=50), run, simulator)


def assert_each_once(caller: Caller, noted: list[str]) -> None:
    assert sorted(noted) == sorted(caller.sent), "the state has each request once"


@pytest.mark.parametrize("seed", range(2))
def test_every_request_is_in_the_state_that_moves(seed: int, tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: ServingSimulator) -> None:
        caller = Caller(simulator, seed=seed)
        for _ in range(5):
            await settle(0.1)
            outcome = await exchanged(manager)
            assert (outcome.outcome, outcome.because, outcome.late) == ("done", None, {})
        assert_each_once(caller, await caller.stop())
        assert set(caller.answered_by) == {"counter", "counter_2", "counter_3"}

    serving(tmp_path, body, seed=seed)


def test_the_new_one_answers_without_a_message_of_its_own(tmp_path: Path) -> None:
    """Messages drive it, and there is none after the cut: it answers once its state has arrived all the same."""

    async def body(manager: Manager, simulator: Any) -> None:
        changing = asyncio.ensure_future(exchanged(manager))
        while manager.log()[-1].kind != "step" or "hand over" not in manager.log()[-1].words:
            await asyncio.sleep(0.001)
        caller = Caller(simulator, interval=0.005)
        while caller.answered_by["counter_2"] < 20:
            await asyncio.sleep(0.01)
        assert_each_once(caller, await caller.stop())
        outcome = await changing
        assert (outcome.outcome, outcome.because) == ("done", None)

    program = for_messages(1, import_=f"time.sleep(0.05); {IMPORT}").replace("\ncomp.start", SERVICE + "\ncomp.start")
    counting(system(tmp_path, program, source=1), body, ServingSimulator())


# The first call after the import raises: by then the new one may have answered.
_RAISES_LATER = f"{IMPORT}; count['out'] = None"


@pytest.mark.parametrize(
    "parts",
    [
        {"export": "raise ValueError('lost')"},
        {"import_": "raise ValueError('lost')"},
        {"import_": f"time.sleep(9); {IMPORT}"},
        {"import_": _RAISES_LATER},
    ],
)
def test_where_the_hand_over_is_rolled_back_the_old_one_answers_again(parts: dict[str, str], tmp_path: Path) -> None:
    """What came meanwhile waits, and is answered once: by the old one, or by the new one before it failed."""

    async def body(manager: Manager, simulator: ServingSimulator) -> None:
        await settle(0.1)
        caller = Caller(simulator, interval=0.005)
        outcome = await exchanged(manager)
        assert outcome.outcome == "rolled_back"
        await settle(10 if "sleep" in parts.get("import_", "") else 0.2)
        before = caller.answered_by["counter"]
        await settle(0.1)
        assert caller.answered_by["counter"] >= before + 10
        assert await caller.stop() == [name for name in caller.sent if caller.answers[name][0][0] == "counter"]
        assert (caller.answered_by["counter_2"] > 0) == (parts.get("import_") == _RAISES_LATER)

    serving(tmp_path, body, export=parts.get("export", EXPORT), import_=parts.get("import_", IMPORT))


@pytest.mark.parametrize(
    "op", ["answer", "await_cut", *(pytest.param(op, marks=pytest.mark.full) for op in ("cut_out", "cut_in", "detach"))]
)
def test_requests_are_answered_whenever_the_manager_dies(op: str, tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: ServingSimulator) -> None:
        send, dead, over = manager._client._send, asyncio.Event(), asyncio.Event()

        async def until_then(instance: str, command: Any, revision: Any) -> Any:
            if command.name == op or dead.is_set():
                dead.set()
                await over.wait()
                raise Unreachable("the manager is dead")
            return await send(instance, command, revision)

        manager._client._send = until_then  # type: ignore[method-assign]
        await settle(0.1)
        caller = Caller(simulator, interval=0.005)
        changing = asyncio.ensure_future(exchanged(manager))
        if op == "answer":  # there is none: the components have done it themselves
            assert (await changing).outcome == "done" and not dead.is_set()
        else:
            await dead.wait()
        await settle(1)
        assert_each_once(caller, await caller.stop())
        states = {name: state for name in simulator.processes if (state := simulator.state(name)) is not None}
        assert sum(state.answers for name, state in states.items() if name.startswith("counter")) == 1
        manager._client._send = send  # type: ignore[method-assign]
        over.set()
        changing.cancel()
        await asyncio.wait({changing})

    serving(tmp_path, body)


@pytest.mark.parametrize(("op", "kept"), [("fetch_state", True), ("importing", False)])
def test_a_new_one_that_dies_in_the_transfer_leaves_the_old_one_answering(op: str, kept: bool, tmp_path: Path) -> None:
    """What waits is answered by the old one, unless the new one may have answered it already."""

    async def body(manager: Manager, simulator: ServingSimulator) -> None:
        caller = Caller(simulator, interval=0.005)

        async def look(to: str, sent: str) -> None:
            if sent == op:
                simulator.faults.kill("counter_2")

        simulator.control.before_request = look
        await settle(0.1)
        outcome = await exchanged(manager)
        assert outcome.outcome == "rolled_back"
        await settle(0.2)
        caller._task.cancel()
        await settle(0.2)
        unanswered = len(caller.sent) - len(caller.answers)
        assert unanswered == 0 if kept else unanswered < 200
        late = Caller(simulator, interval=0.005, name="late")
        await settle(0.1)
        assert late.answered_by["counter"] > 10

    serving(tmp_path, body)


@pytest.mark.parametrize(("seconds", "waited_for"), [(0.1, True), (0.5, False), (4.0, False)])
def test_a_request_under_way_is_waited_for_before_the_export(seconds: float, waited_for: bool, tmp_path: Path) -> None:
    """For a bounded time: what a longer one changes after the export is not in the state. It is answered all the same,
    before its process ends."""

    async def body(manager: Manager, simulator: ServingSimulator) -> None:
        await settle(0.1)
        caller = Caller(simulator, interval=0.01)
        outcome = await exchanged(manager)
        assert (outcome.outcome, outcome.because) == ("done", None)
        noted = await caller.stop()
        assert set(caller.answered_by) == {"counter", "counter_2"}
        if waited_for:
            assert_each_once(caller, noted)
        else:
            assert set(noted) < set(caller.sent), "the state has moved before"

    serving(tmp_path, body, more=SLOW_SERVICE.format(seconds=seconds))


@pytest.mark.parametrize("ask", [PlanRequest(remove=("counter",)), None])
def test_a_request_under_way_is_answered_before_its_process_ends(ask: PlanRequest | None, tmp_path: Path) -> None:
    """By a removal and by `down`, too, which have no successor."""

    async def body(manager: Manager, simulator: ServingSimulator) -> None:
        caller = Caller(simulator, interval=0.01)
        await settle(2.0)
        caller._task.cancel()
        await settle(0.01)  # the last one is on its way
        if ask is None:
            await manager.down()
        else:
            assert (await manager.change(ask)).outcome == "done"
        assert len(await caller.stop()) == len(caller.sent)

    serving(tmp_path, body, more=SLOW_SERVICE.format(seconds=4.0))


def test_an_instance_that_has_just_responded_stays_until_its_response_has_arrived(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: ServingSimulator) -> None:
        caller = Caller(simulator, interval=0.01)
        await settle(0.5)
        await caller.stop()
        responded = simulator.clock.steady()
        await manager.down()
        assert simulator.clock.steady() - responded >= RESPONSE_SECONDS - 0.1  # its last one may be so old

    serving(tmp_path, body)


@pytest.mark.parametrize(
    ("discovered", "interval"), [(0.5, 0.05), (3.0, 0.05), (3.0, 1.0), pytest.param(8.0, 0.05, marks=pytest.mark.full)]
)
def test_one_that_has_discovered_no_successor_yet_keeps_the_old_one(
    discovered: float, interval: float, tmp_path: Path
) -> None:
    """A client whose middleware is late sends to the old instance alone, which passes its requests on until then."""

    async def body(manager: Manager, simulator: ServingSimulator) -> None:
        await settle(0.1)
        begun: list[float] = []  # when the new one began to answer

        def knows(instance: str) -> bool:
            if instance == "counter":
                return True
            now, state = simulator.clock.steady(), simulator.state(instance)
            if state is not None and state.answers and not begun:
                begun.append(now)
            return now >= min(begun, default=now) + discovered

        late = Caller(simulator, interval=interval, name="late", knows=knows)
        outcome = await exchanged(manager)
        assert (outcome.outcome, outcome.because) == ("done", None)
        ended = simulator.clock.steady() - begun[0]
        await settle(max(0.0, discovered - ended) + 1.0)
        assert_each_once(late, await late.stop())
        assert ended > discovered and set(late.answered_by) == {"counter", "counter_2"}
        assert not [event.words for event in manager.log() if event.kind == "killed"]

    serving(tmp_path, body)


def test_one_that_never_discovers_the_successor_does_not_keep_the_old_one_for_ever(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: ServingSimulator) -> None:
        Caller(simulator, interval=0.05, knows=lambda instance: instance == "counter")
        await settle(0.1)
        old, begun = simulator.processes["counter"], simulator.clock.steady()
        assert (await exchanged(manager)).outcome == "done"
        assert REQUESTS_SECONDS < simulator.clock.steady() - begun < REQUESTS_SECONDS + 5.0
        assert not [event.words for event in manager.log() if event.kind == "killed"]
        assert re.search("counter ends, but (a request to a service of it|after 10 s, a client)", old.log.tail())

    serving(tmp_path, body)


def test_a_request_that_takes_too_long_is_given_up(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: ServingSimulator) -> None:
        Caller(simulator, interval=1.0)
        await settle(0.5)
        old = simulator.processes["counter"]
        assert (await exchanged(manager)).outcome == "done"
        assert "counter ends, but a request to a service of it was not answered within 10 s" in old.log.tail()

    serving(tmp_path, body, more=SLOW_SERVICE.format(seconds=60.0))

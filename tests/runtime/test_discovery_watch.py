"""A component whose middleware has stopped discovering is noticed, shown, and replaced before its peers."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import NoReturn

import pytest

from midstride.backends.simulator import Simulator
from midstride.plan.request import PlanRequest
from midstride.runtime.manager import Manager
from midstride.runtime.watch.discovery_watch import INTERVAL, PATIENCE, SOON
from tests.planting import plant
from tests.runtime.systems import managed, replace

NOTICED = INTERVAL + SOON + sum(PATIENCE) + 1


def faults(manager: Manager) -> list[tuple[str, str]]:
    found = manager._monitor.faults(manager.configuration)
    return [(fault.kind, fault.instance) for fault in found]


async def noticed(manager: Manager, simulator: Simulator, *names: str) -> None:
    await asyncio.sleep(INTERVAL)  # they have discovered something before
    for name in names:
        simulator.faults.stop_discovery(name)
    await asyncio.sleep(NOTICED)


@pytest.mark.parametrize("name", ["talker", "listener"])
def test_a_standstill_is_noticed_although_data_flows(name: str, tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        await noticed(manager, simulator, name)
        assert faults(manager) == [("not_discovering", name)]
        status = await manager.status()
        [fault] = status.silences
        assert not status.valid and fault.kind == "not_discovering"
        assert isinstance(fault.seconds, float) and 0 < fault.seconds < NOTICED
        words = f"{name} discovers no new endpoints, although its data flows: its middleware has hung"
        assert [event.words for event in manager.log() if event.kind == "silence"] == [words]

    managed("talker", tmp_path, body)


def test_a_standstill_is_noticed_soon_after_a_change_by_the_same_probe(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        await asyncio.sleep(INTERVAL)
        outcome = await manager.change(replace("talker", "NewTalker"))
        assert outcome.outcome == "done"
        simulator.faults.stop_discovery("listener")
        await asyncio.sleep(SOON + sum(PATIENCE) + 0.5)
        assert faults(manager) == [("not_discovering", "listener")]

    managed("talker", tmp_path, body)


def test_a_healthy_system_is_never_suspected(tmp_path: Path) -> None:
    """Nor one that is stopped for a while, slow to discover, or never discovers what the manager creates."""

    async def body(manager: Manager, simulator: Simulator) -> None:
        await asyncio.sleep(3 * INTERVAL)
        simulator.faults.freeze("listener", 12.0)
        await asyncio.sleep(6 * INTERVAL)
        simulator.network.discovery = 4.0
        await asyncio.sleep(6 * INTERVAL)
        kinds = {event.kind for event in manager.log() if event.words.startswith(("talker discovers", "listener disc"))}
        assert kinds == set() and faults(manager) == []

    managed("talker", tmp_path, body)


def test_one_out_of_the_managers_reach_is_not_suspected(tmp_path: Path) -> None:
    simulator = Simulator()

    async def body(manager: Manager, _: Simulator) -> None:
        simulator.faults.stop_discovery("listener")  # before it has discovered anything
        manager._watch._discovering.clear()
        await asyncio.sleep(5 * INTERVAL)
        assert faults(manager) == []

    managed("talker", tmp_path, body, simulator)


def test_where_none_discovers_the_probe_the_manager_is_suspected(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        await noticed(manager, simulator, "talker", "listener")
        await asyncio.sleep(2 * INTERVAL)
        assert faults(manager) == []
        [note] = [event.words for event in manager.log() if event.kind == "note"]
        assert "the manager's own middleware may have stopped discovering" in note

    managed("talker", tmp_path, body)


def test_one_that_discovers_again_is_no_fault_any_longer(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        await noticed(manager, simulator, "listener")
        simulator.network.undiscovering.clear()
        await asyncio.sleep(NOTICED)
        assert faults(manager) == [] and (await manager.status()).valid
        assert manager.log()[-1].words == "listener discovers endpoints again"

    managed("talker", tmp_path, body)


def test_a_look_that_fails_in_the_platform_is_not_the_last_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        def failing() -> NoReturn:
            raise RuntimeError("error not set")  # as rclpy does where there is no memory, or no descriptor, left

        with monkeypatch.context() as patch:
            plant(patch, simulator, "probe", failing)
            await asyncio.sleep(3 * (INTERVAL + SOON))
        assert [record.exc_text is not None for record in caplog.records] == [True], "it is logged once"
        await noticed(manager, simulator, "listener")
        assert faults(manager) == [("not_discovering", "listener")]

    managed("talker", tmp_path, body)


@pytest.mark.parametrize(
    "strategy", ["minimal", *(pytest.param(name, marks=pytest.mark.full) for name in ("paper", "quiesce"))]
)
@pytest.mark.parametrize("how", ["replace", "restart", "apply"])
def test_a_subscriber_is_replaced_before_the_publisher_that_it_must_hear(
    how: str, strategy: str, tmp_path: Path
) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        await noticed(manager, simulator, "listener")
        target = replace("talker", "NewTalker").target(manager.specification)
        request = {
            "replace": replace("talker", "NewTalker", strategy),
            "restart": PlanRequest(restart=("talker",), strategy=strategy),
            "apply": PlanRequest(to=target, strategy=strategy),
        }[how]
        specification = request.target(manager.specification)
        plan = await manager.plan(request)
        assert plan.remarks == ("listener is replaced first: its middleware discovers no new endpoints",)
        outcome = await manager.change(request)
        assert outcome.outcome == "done", outcome.because
        assert outcome.silences == [] and sorted(manager.configuration.instances) == ["listener_2", "talker_2"]
        assert manager.specification == specification, "the order is not part of it"
        assert sum(swap.missed or 0 for swap in outcome.swaps) == 0 or strategy != "minimal"
        actions = [type(step.action).__name__ for step in plan.steps]
        steps = [step.action.instances() for step in plan.steps]
        if strategy == "minimal":
            assert actions.index("Remove") < actions.index("Handover"), (actions, steps)
        await asyncio.sleep(NOTICED)
        assert faults(manager) == [] and (await manager.status()).valid

    managed("talker", tmp_path, body)


def test_a_publisher_is_replaced_before_the_subscriber_that_must_hear_it(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        await noticed(manager, simulator, "talker")
        outcome = await manager.change(PlanRequest(restart=("listener",)))
        assert outcome.outcome == "done", outcome.because
        assert sorted(manager.configuration.instances) == ["listener_2", "talker_2"]

    managed("talker", tmp_path, body)


@pytest.mark.full
def test_what_a_change_does_not_touch_is_left_alone(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        await noticed(manager, simulator, "source")
        outcome = await manager.change(PlanRequest(restart=("sink",)))
        assert outcome.outcome == "done" and "source" in manager.configuration.instances

    managed("filter", tmp_path, body)

"""``changes require`` on the simulator, in virtual time: what is heard, what is unknown, what changes do then."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import replace as changed
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from midstride.backends.simulator import Simulator
from midstride.backends.simulator.messages import message_class
from midstride.backends.simulator.network import SimulatedWriter
from midstride.errors import ChangeForbidden
from midstride.model.contract import OneOf, Predicate, QoS
from midstride.model.respawn import RespawnPolicy
from midstride.model.specification import ChangeRequirement, Specification
from midstride.plan.lowering import PlanLowering
from midstride.plan.request import PlanRequest
from midstride.runtime.backend_protocol import Backend
from midstride.runtime.change.change_permission import Override
from midstride.runtime.change.running_change import RunningChange
from midstride.runtime.manager import Manager
from midstride.wire.pipe import MEMORY
from tests.plan.slow_lowering import is_better_finished
from tests.planting import plant
from tests.runtime.systems import example, managed, replace

TOPIC = "/estop/released"
BOOL = "std_msgs/msg/Bool"
RELEASED = ChangeRequirement(TOPIC, Predicate(BOOL, fields=(("data", OneOf.of([True])),)))
VOLATILE, LATCHED = QoS(), QoS(durability="transient_local")
RESTART = PlanRequest(restart=("talker",))


class EmergencyStop:
    """A publisher outside the system."""

    def __init__(self, simulator: Simulator, qos: QoS = VOLATILE, type_: str = BOOL) -> None:
        self._network = simulator.network
        process = SimpleNamespace(node="/estop", thawed_at=0.0, own_clock=simulator.time, on=MEMORY)
        self.writer: SimulatedWriter = self._network.create_writer(cast(Any, process), TOPIC, type_, qos)

    async def says(self, released: bool) -> None:
        """Publish, once the manager has found it, and wait until that has arrived."""
        await asyncio.sleep(0.01)
        self.writer.publish(message_class(BOOL)(data=released))
        await asyncio.sleep(0.01)

    def gone(self) -> None:
        self.writer.destroy()


def requiring(*requirements: ChangeRequirement, system: str = "talker") -> Specification:
    return changed(example(system), requirements=requirements or (RELEASED,))


def run(
    body: Callable[[Manager, Simulator], Awaitable[None]], folder: Path, specification: Specification | None = None
) -> None:
    managed("talker", folder, body, specification=specification or requiring())


async def outcome(manager: Manager, request: PlanRequest = RESTART, override: Override | None = None) -> str:
    """How a change ended: what it is, and why."""
    found = await manager.change(request, by="bob: it", override=override or Override())
    return found.outcome if found.because is None else f"{found.outcome}: {found.because}"


async def incidents(manager: Manager, kind: str) -> list[str]:
    return [each.words for each in (await manager.history(100)).incidents if each.kind == kind]


@pytest.mark.parametrize(
    "qos", [VOLATILE, LATCHED, QoS(reliability="best_effort")], ids=["volatile", "latched", "effort"]
)
def test_the_last_message_decides_whatever_the_qos_of_its_publisher(tmp_path: Path, qos: QoS) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        assert "no publisher" in await outcome(manager)
        estop = EmergencyStop(simulator, qos)
        await asyncio.sleep(0.1)
        assert "no message has arrived" in await outcome(manager)
        await estop.says(True)
        assert await outcome(manager) == "done"
        await estop.says(False)
        refused = await outcome(manager)
        assert refused.startswith(f"refused: changes require {TOPIC} : {BOOL} where data = true: data is False; ")
        assert refused.endswith("`--despite-requirements` changes the system all the same")
        [status] = (await manager.status()).requirements
        assert not status.holds and status.because is not None and status.because.startswith("data is False")
        await estop.says(True)
        assert await outcome(manager) == "done"
        assert len(await incidents(manager, "forbidden")) == 3

    run(body, tmp_path)


def test_what_was_latched_before_the_manager_listened_is_heard(tmp_path: Path) -> None:
    simulator = Simulator()

    async def body(manager: Manager, _: Simulator) -> None:
        estop = EmergencyStop(simulator, LATCHED)
        await estop.says(True)
        await manager.change(PlanRequest(to=requiring()))
        await asyncio.sleep(0.1)
        assert await outcome(manager) == "done"
        # An older one that arrives later, by the second subscription, changes nothing.
        await estop.says(False)
        await asyncio.sleep(1)
        assert (await outcome(manager)).startswith("refused")

    managed("talker", tmp_path, body, simulator)


def test_what_a_publisher_has_said_that_is_gone_is_not_known_any_more(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        first, second = EmergencyStop(simulator), EmergencyStop(simulator, LATCHED)
        await second.says(False)
        await first.says(True)
        assert await outcome(manager) == "done"
        first.gone()
        assert "no message has arrived of the publishers that are there now" in await outcome(manager)
        await asyncio.sleep(0.1)  # what the other has latched is heard again
        assert "data is False" in await outcome(manager)
        second.gone()
        assert "no publisher" in await outcome(manager)

    run(body, tmp_path)


def test_a_message_that_is_too_old_does_not_count(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        estop = EmergencyStop(simulator)
        await estop.says(True)
        await asyncio.sleep(0.4)
        assert await outcome(manager) == "done"
        await estop.says(True)
        await asyncio.sleep(0.6)
        assert "the last message is older than 0.5 s" in await outcome(manager)

    run(body, tmp_path, requiring(changed(RELEASED, max_age=0.5)))


def test_a_topic_of_another_type_is_said(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        EmergencyStop(simulator, type_="std_msgs/msg/String")
        assert "std_msgs/msg/String is published there" in await outcome(manager)

    run(body, tmp_path)


def test_where_the_manager_cannot_listen_that_is_why_nothing_may_change(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on ROS 1, whose back end has what the protocol says by default."""
    plant(monkeypatch, Simulator, "listen", Backend.listen)

    async def body(manager: Manager, _: Simulator) -> None:
        assert "on sim, the manager cannot listen to topics" in await outcome(manager)
        [status] = (await manager.status()).requirements
        assert (status.holds, status.because) == (False, "on sim, the manager cannot listen to topics")

    run(body, tmp_path)


def test_every_requirement_has_to_hold_and_each_that_does_not_is_named(tmp_path: Path) -> None:
    quiet = ChangeRequirement("/speed", Predicate("std_msgs/msg/Float64", fields=RELEASED.assumption.fields))

    async def body(manager: Manager, simulator: Simulator) -> None:
        await EmergencyStop(simulator).says(False)
        refused = await outcome(manager)
        assert "data is False" in refused and "/speed : std_msgs/msg/Float64" in refused

    run(body, tmp_path, requiring(RELEASED, quiet))


def test_parameters_are_changes_and_down_is_none(tmp_path: Path) -> None:
    async def body(manager: Manager, _: Simulator) -> None:
        with pytest.raises(ChangeForbidden, match="no publisher"):
            await manager.set_parameters("listener", {"use_sim_time": True})
        await manager.down()

    run(body, tmp_path)


def test_it_is_overridden_deliberately_and_the_history_says_so(tmp_path: Path) -> None:
    async def body(manager: Manager, _: Simulator) -> None:
        assert await outcome(manager, override=Override(requirements=True)) == "done"
        [words] = await incidents(manager, "override")
        assert words.startswith("bob: it: carried out although changes require") and words.endswith("no publisher")
        assert (await outcome(manager, override=Override(lock=True))).startswith("refused")

    run(body, tmp_path)


def test_what_holds_is_not_said_to_be_overridden(tmp_path: Path) -> None:
    quiet = ChangeRequirement("/speed", Predicate("std_msgs/msg/Float64", fields=RELEASED.assumption.fields))

    async def body(manager: Manager, simulator: Simulator) -> None:
        await EmergencyStop(simulator).says(True)
        assert await outcome(manager, override=Override(requirements=True)) == "done"
        [words] = await incidents(manager, "override")
        assert "/speed" in words and TOPIC not in words

    run(body, tmp_path, requiring(RELEASED, quiet))


@pytest.mark.parametrize("recovery", [False, True])
def test_recovery_goes_on_unless_it_requires_it_as_well(tmp_path: Path, recovery: bool) -> None:
    specification = requiring(changed(RELEASED, recovery=recovery))
    specification = specification.with_node(changed(specification.nodes["talker"], respawn=RespawnPolicy()))

    async def body(manager: Manager, simulator: Simulator) -> None:
        simulator.faults.kill("talker")
        await asyncio.sleep(5)
        assert ("talker" in manager.configuration.instances) == (not recovery)
        await EmergencyStop(simulator).says(True)
        await asyncio.sleep(3)
        assert "talker" in manager.configuration.instances

    run(body, tmp_path, specification)


def test_a_change_of_the_requirements_is_held_to_those_before_it(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        without = PlanRequest(to=changed(manager.specification, requirements=()))
        assert (await outcome(manager, without)).startswith("refused")
        estop = EmergencyStop(simulator)
        await estop.says(True)
        assert await outcome(manager, without) == "done"
        await estop.says(False)
        assert await outcome(manager) == "done" and (await manager.status()).requirements == []
        assert simulator.network.topic(TOPIC).readers == []

    run(body, tmp_path)


def test_the_log_says_when_a_requirement_begins_and_ceases_to_hold(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        estop = EmergencyStop(simulator)
        for released in (True, False, True):
            await estop.says(released)
            await asyncio.sleep(1)
        said = [event.words.rpartition(": ")[2] for event in manager.log() if event.kind == "requirement"]
        assert said == ["no publisher", "it holds", "data is False", "it holds"]

    run(body, tmp_path)


# -- in the middle of a change -----------------------------------------------------------------------------


REQUESTS = [
    ("talker", replace("talker", "NewTalker")),
    ("talker", replace("talker", "NewTalker", "paper")),
    ("talker", replace("talker", "NewTalker", "quiesce")),
    ("talker", replace("talker", "NewTalker", "stop")),
    ("talker", PlanRequest(remove=("talker",))),
    ("filter", PlanRequest(restart=("filter",), strategy="stop")),
    ("filter", PlanRequest(remove=("filter",))),
    ("filter", PlanRequest(replace=(("filter", "MedianFilter"),), restart=("source",), strategy="paper")),
]


@pytest.mark.parametrize(
    ("system", "request_"), REQUESTS, ids=[f"{s}-{r.describe()}-{r.strategy}" for s, r in REQUESTS]
)
def test_where_it_turns_false_in_the_middle_what_lowers_less_is_done(
    tmp_path: Path, system: str, request_: PlanRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before each step in turn: the change ends as the slow twin of the choice says, and what runs is whole."""
    before = RunningChange.take

    async def body(manager: Manager, simulator: Simulator) -> None:
        estop = EmergencyStop(simulator)
        await estop.says(True)
        plan = await manager.plan(request_)
        lowering, endings = PlanLowering(plan), set()
        for index in range(len(plan.steps)):
            await estop.says(True)
            whole = manager.configuration
            plan = await manager.plan(request_)
            lowering = PlanLowering(plan)
            asked: list[int] = []

            async def take(change: RunningChange, steps: Any, at: int = index, seen: list[int] = asked) -> None:
                require = change.require

                def turned(indices: Any) -> None:
                    if indices[0] >= at and not seen:
                        seen.append(indices[0])
                        simulator.network.topic(TOPIC).writers.clear()
                    require(indices)

                change.require = turned
                await before(change, steps)

            monkeypatch.setattr(RunningChange, "take", take)
            found = await manager.change(request_)
            monkeypatch.setattr(RunningChange, "take", before)
            rounds = [number for number in range(asked[0], len(plan.steps)) if lowering.lowers(number)]
            ends = "rolled_back" if any(not is_better_finished(plan, number) for number in rounds) else "done"
            assert found.outcome == ends, (index, found.because)
            endings.add(ends)
            if ends == "rolled_back":
                assert "no publisher" in str(found.because) and "to roll back" in str(found.because)
                assert manager.configuration.modes == whole.modes
            assert (await manager.status()).valid
            estop = EmergencyStop(simulator)
            await estop.says(True)
            if ends == "done":
                again = PlanRequest(to=changed(specification, nodes=specification.nodes))
                assert (await manager.change(again)).outcome == "done"
        told = [event for event in manager.log() if event.kind == "finished_despite"]
        assert bool(told) == bool(request_.replace and request_.restart)  # only there a step lowers after a removal
        assert "rolled_back" in endings or not any(map(lowering.lowers, range(len(plan.steps))))

    specification = requiring(system=system)
    if system == "filter":  # which would take long to start again
        slow = changed(specification.components["MeanFilter"], startup_seconds=20.0)
        specification = changed(specification, components=specification.components.set("MeanFilter", slow))
    managed(system, tmp_path, body, specification=specification)

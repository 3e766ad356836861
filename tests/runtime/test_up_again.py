"""`up` after the manager and components have died: what lives is found, what is without support is degraded, and the
rest is restored by a plan."""

from __future__ import annotations

import asyncio
import itertools
import shlex
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import replace as changed
from pathlib import Path
from typing import Any

import pytest

from midstride.backends.simulator import Simulator
from midstride.errors import ManagerError, MidstrideError, Unreachable
from midstride.model.component import FunctionalityRef
from midstride.model.contract import DEFAULT_QOS
from midstride.model.specification import Keep, Order, Specification, initial
from midstride.plan.request import PlanRequest
from midstride.runtime.backend_protocol import Launch
from midstride.runtime.manager import Manager
from midstride.runtime.records.reports import UpReport
from midstride.runtime.workspace import Workspace
from midstride.wire.commands import Command
from tests.planting import plant
from tests.runtime.systems import EXAMPLES, example, replace, rewritten, saved


def again(
    name: str,
    folder: Path,
    between: Callable[[Manager, Simulator], Awaitable[None]],
    after: Callable[[Manager, Simulator, UpReport], Awaitable[None]],
    specification: Specification | None = None,
    before: Callable[[Manager], Awaitable[object]] = lambda _: asyncio.sleep(0),
) -> None:
    """Bring the example up, run ``before``, close the manager, run ``between``, bring it up again, run ``after``."""
    simulator, specification = Simulator(), specification or example(name)

    async def main() -> None:
        first = Manager(specification, simulator, Workspace(folder), EXAMPLES / name)
        await first.up()
        await before(first)
        await first.close()
        await between(first, simulator)
        await asyncio.sleep(1)
        second = Manager(saved(Workspace(folder)).specification, simulator, Workspace(folder), EXAMPLES / name)
        try:
            await after(second, simulator, await second.up())
        finally:
            await second.close()

    simulator.run(main())


async def whole(manager: Manager, simulator: Simulator, report: UpReport) -> None:
    """Everything runs, in the modes that the specification allows, and nothing runs twice."""
    assert report.degraded == []
    assert sorted(simulator.processes) == sorted(manager.configuration.instances)
    expected = initial(manager.specification)
    assert list(manager.configuration.instances_by_role) == list(expected.instances_by_role)
    status = await manager.status()
    assert status.valid and status.crashed == []
    assert all(row.normal for each in status.instances for row in each.functionalities)


def test_an_earlier_manager_saves_nothing_more_once_the_next_one_looks_at_what_runs(tmp_path: Path) -> None:
    """What that one finds would not be so any more."""
    simulator, specification, workspace = Simulator(), example("filter"), Workspace(tmp_path)
    superseded: list[bool] = []

    async def main() -> None:
        first = Manager(specification, simulator, workspace, EXAMPLES / "filter")
        await first.up()
        second = Manager(saved(workspace).specification, simulator, workspace, EXAMPLES / "filter")
        adopt = second._launcher.adopt

        async def looking(*arguments: Any, **options: Any) -> Any:
            superseded.append(first._store.superseded)
            return await adopt(*arguments, **options)

        second._launcher.adopt = looking  # type: ignore[method-assign]
        await second.up()
        await second.close()
        await first.close()

    simulator.run(main())
    assert superseded == [True] * 3


@pytest.mark.parametrize(
    "killed",
    [("source",), ("filter",), ("sink",), ("source", "filter"), ("filter", "sink"), ("source", "filter", "sink")],
    ids=" and ".join,
)
def test_what_has_died_with_the_manager_is_restored(killed: tuple[str, ...], tmp_path: Path) -> None:
    pids: dict[str, int] = {}

    async def between(_: Manager, simulator: Simulator) -> None:
        for name in killed:
            simulator.faults.kill(name)
        pids.update({name: process.pid for name, process in simulator.processes.items()})

    async def after(manager: Manager, simulator: Simulator, report: UpReport) -> None:
        await whole(manager, simulator, report)
        assert report.instances == ["filter", "sink", "source"]
        assert {name: simulator.processes[name].pid for name in pids} == pids, "what lives is left alone"
        words = [event.words for event in manager.log()]
        assert {f"{name} is no longer running" for name in killed} <= set(words)

    again("filter", tmp_path, between, after)


def test_what_relies_on_the_dead_one_is_degraded_before_it_is_restored(tmp_path: Path) -> None:
    async def between(_: Manager, simulator: Simulator) -> None:
        simulator.faults.kill("source")

    async def after(manager: Manager, simulator: Simulator, _: UpReport) -> None:
        words = [event.words for event in manager.log()]
        created = next(number for number, each in enumerate(words) if "create source" in each)
        for lowered in ("degrade filter.smooth from normal to degraded", "degrade sink.use from normal to degraded"):
            assert lowered in words[:created]
        assert "the plan asked for it" in (await manager.peek("filter")).functionalities["smooth"].because

    again("filter", tmp_path, between, after)


def test_what_runs_is_taken_over_whatever_the_specification_names(tmp_path: Path) -> None:
    async def before(manager: Manager) -> None:
        constraints = (Order("no node", "sink"), Keep(FunctionalityRef("sink", "gone"), "normal"))
        manager._store.write_specification(changed(manager.specification, constraints=constraints))

    async def between(_: Manager, simulator: Simulator) -> None:
        simulator.faults.kill("source")

    again("filter", tmp_path, between, whole, before=before)


def test_topics_that_do_not_depend_on_the_dead_one_are_not_disturbed(tmp_path: Path) -> None:
    """The sink is restored behind the source and the filter, which publish all the time."""

    async def between(_: Manager, simulator: Simulator) -> None:
        await asyncio.sleep(1)
        simulator.faults.kill("sink")
        (topic,) = {attached for node in [example("filter").nodes["filter"]] for attached in node.attachments["out"]}
        contract = example("filter").connectors[topic].guarantee
        times.append(simulator.clock.steady())
        simulator.network.create_reader(
            simulator.processes["source"], topic, contract.type, DEFAULT_QOS,
            lambda: times.append(simulator.clock.steady()),
        )  # fmt: skip

    times: list[float] = []

    async def after(manager: Manager, simulator: Simulator, report: UpReport) -> None:
        await whole(manager, simulator, report)
        await asyncio.sleep(1)
        assert len(times) > 100
        assert max(later - earlier for earlier, later in itertools.pairwise(times)) < 2.5 * 0.005

    again("filter", tmp_path, between, after)


async def change_until(manager: Manager, op: str) -> None:
    """Replace the talker, until the manager is about to send ``op``: from then on it does nothing, as if killed."""
    client, launcher = manager._client, manager._launcher
    send, reached = client._send, asyncio.Event()

    async def dead(*_: object, **__: object) -> None:
        raise Unreachable("the manager has been killed")

    async def until(instance: str, command: Command[Any], revision: int | None) -> Any:
        if command.name == op:
            reached.set()
        return await (dead() if reached.is_set() else send(instance, command, revision))

    client._send = until  # type: ignore[method-assign]
    change = asyncio.ensure_future(manager.change(replace("talker", "NewTalker")))
    await asyncio.wait({change, asyncio.ensure_future(reached.wait())}, return_when=asyncio.FIRST_COMPLETED)
    assert reached.is_set(), op
    launcher.end = launcher.kill = launcher.abandon = dead  # type: ignore[method-assign]
    for name in ("write_instance", "remove_instance"):
        plant(pytest.MonkeyPatch(), manager._store, name, lambda *_, **__: None)
    with suppress(MidstrideError):
        await change


@pytest.mark.parametrize("op", ["attach", "modes", "await_write", "cut_out", "cut_in", "await_cut", "detach"])
@pytest.mark.parametrize(
    "killed", [("talker",), ("talker_2",), ("listener",), ("talker", "talker_2")], ids=" and ".join
)
def test_a_swap_was_under_way(op: str, killed: tuple[str, ...], tmp_path: Path) -> None:
    async def between(_: Manager, simulator: Simulator) -> None:
        assert {"talker", "talker_2", "listener"} == set(simulator.processes)
        for name in killed:
            simulator.faults.kill(name)

    again("talker", tmp_path, between, whole, before=lambda manager: change_until(manager, op))


def test_a_component_that_hangs_is_named_with_what_to_do_and_nothing_is_changed(tmp_path: Path) -> None:
    simulator = Simulator()

    async def main() -> None:
        first = Manager(example("filter"), simulator, Workspace(tmp_path), EXAMPLES / "filter")
        await first.up()
        for name, handle in first.system.life.handles.items():  # the simulator's have no process number
            first._store.write_instance(first.configuration.instances[name], changed(handle, pid=4711))
        await first.close()
        simulator.faults.kill("source")
        simulator.faults.freeze("sink", 60)
        simulator.faults.freeze("filter", 60)
        second = Manager(example("filter"), simulator, Workspace(tmp_path), EXAMPLES / "filter")
        with pytest.raises(Unreachable) as raised:
            await second.up()
        remedy = "continue it (`kill -CONT 4711`) or end it (`kill -9 4711`), then run `midstride up` again"
        assert str(raised.value) == "; ".join(
            f"{name} runs (process 4711), but does not answer on its control socket: {remedy}"
            for name in ("filter", "sink")
        )
        await second.close()
        await asyncio.sleep(60)
        third = Manager(example("filter"), simulator, Workspace(tmp_path), EXAMPLES / "filter")
        await whole(third, simulator, await third.up())
        await third.close()

    simulator.run(main())


def test_a_component_that_answers_and_cannot_be_degraded_is_named(tmp_path: Path) -> None:
    """Its control thread answers; a call of its code does not return."""
    simulator = Simulator()

    async def main() -> None:
        first = Manager(example("talker"), simulator, Workspace(tmp_path), EXAMPLES / "talker")
        await first.up()
        await first.close()
        simulator.faults.kill("talker")
        simulator.faults.fail_next("listener", "modes", "refused", times=9)
        second = Manager(example("talker"), simulator, Workspace(tmp_path), EXAMPLES / "talker")
        with pytest.raises(
            ManagerError, match=r"listener\.listen lacks what it relies on, and could not be degraded: .*kill -9"
        ):
            await second.up()
        await second.close()

    simulator.run(main())


def by_hand() -> Specification:
    """The talker's example, in which the talker is started by hand."""
    specification = example("talker")
    talker = changed(specification.components["Talker"], run=None)
    return changed(specification, components=specification.components.set("Talker", talker))


def test_a_component_started_by_hand_that_is_missing_does_not_keep_the_rest_down(tmp_path: Path) -> None:
    simulator, launch = Simulator(), Launch("talker", "", ("python3", "talker.py"), "", EXAMPLES / "talker")

    async def main() -> None:
        await simulator.start(launch)
        first = Manager(by_hand(), simulator, Workspace(tmp_path), EXAMPLES / "talker")
        await first.up()
        await first.close()
        simulator.faults.kill("talker")
        simulator.faults.kill("listener")
        await asyncio.sleep(1)
        begun = simulator.clock.steady()
        second = Manager(by_hand(), simulator, Workspace(tmp_path), EXAMPLES / "talker")
        report = await second.up()
        assert simulator.clock.steady() - begun < 10, "it is not waited for"
        assert report.instances == ["listener"]
        assert [(each.functionality, each.after, each.planned) for each in report.degraded] == [
            ("listener.listen", "degraded", False),
            ("talker.talk", None, False),
        ]
        assert report.degraded[1].because == "talker exited unexpectedly"
        status = await second.status()
        assert [each.remedy for each in status.crashed] == ["start it, then `midstride restart talker` restores it"]
        assert second.specification == by_hand() == saved(Workspace(tmp_path)).specification
        await simulator.start(launch)
        restored = await second.change(PlanRequest(restart=("talker",)))
        assert (restored.outcome, restored.remaining_degradations) == ("done", [])
        assert (await second.status()).crashed == []
        await second.close()

    simulator.run(main())


def test_what_cannot_be_restored_is_missing_and_the_rest_keeps_its_manager(tmp_path: Path) -> None:
    """Of two that have died, one program is broken: the other is restored, and the manager stays."""
    folder, simulator = rewritten("filter", tmp_path / "programs", lambda _, text: text), Simulator()
    specification = example("filter", folder)
    (source,) = shlex.split(specification.component_of("source").run or "")[1:2]

    async def main() -> None:
        first = Manager(specification, simulator, Workspace(tmp_path), folder)
        await first.up()
        await first.close()
        for name in ("source", "sink"):
            simulator.faults.kill(name)
        text = (folder / source).read_text()
        (folder / source).write_text("raise ValueError('no such device')\n")
        await asyncio.sleep(1)
        second = Manager(specification, simulator, Workspace(tmp_path), folder)
        report = await second.up()
        assert (report.outcome, report.instances) == ("incomplete", ["filter", "sink"])
        assert list(report.missing) == ["source"] and "no such device" in report.missing["source"]
        assert [(each.functionality, each.planned) for each in report.degraded] == [
            ("filter.smooth", False),
            ("sink.use", False),
            (f"source.{next(iter(specification.component_of('source'))).name}", False),
        ]
        assert next(event.words for event in second.log() if event.kind == "up").startswith(
            "filter is up without source: 2 components; degraded: "
        )
        status = await second.status()
        assert [each.remedy for each in status.crashed] == ["`midstride restart source` restores it"]
        again = await second.change(PlanRequest(restart=("source",)))
        assert again.outcome == "rolled_back"
        assert len((await second.status()).crashed) == 1, "it is still missing"
        (folder / source).write_text(text)
        restored = await second.change(PlanRequest(restart=("source",)))
        assert (restored.outcome, restored.remaining_degradations) == ("done", []), restored.because
        await whole(second, simulator, UpReport("done", []))
        await second.close()

    simulator.run(main())

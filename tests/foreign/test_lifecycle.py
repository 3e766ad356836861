"""Lifecycle nodes without a gate inside: started, moded, replaced, and what happens if they do not play along."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import pytest
from rich.console import Console

from midstride.backends.simulator import virtual_loop as virtual
from midstride.cli import render
from midstride.errors import CommandRefused
from midstride.foreign.graph_watch import LOOK
from midstride.foreign.lifecycle_transitions import INACTIVE, NodeLifecycle
from midstride.foreign.record import ForeignRecord
from midstride.model.rules import violations
from midstride.plan.request import PlanRequest
from midstride.runtime.backend_protocol import Handle
from midstride.runtime.manager import Manager
from midstride.runtime.records.reports import Outcome
from midstride.runtime.workspace import Workspace
from tests.foreign import simulated
from tests.foreign.chat import chat
from tests.foreign.full_disk import FullDisk
from tests.foreign.simulated import SimulatedNode, SimulatedRos
from tests.runtime.systems import saved

T = TypeVar("T")

TEXT = chat("lifecycle", talker='parameters { word = "hello" }')
REPLACE = PlanRequest(replace=(("talker", "Other"),))


def managed(
    folder: Path,
    body: Callable[[Manager, SimulatedRos], Awaitable[T]],
    behaviour: Mapping[str, Mapping[str, Any]] | None = None,
) -> T:
    async def begun(manager: Manager, simulator: SimulatedRos) -> T:
        assert simulator.active() == ["listener", "talker"]
        return await body(manager, simulator)

    return simulated.managed(folder, TEXT, begun, behaviour)


async def settled(manager: Manager, outcome: Outcome, active: list[str], simulator: SimulatedRos) -> None:
    assert violations(manager.configuration) == []
    await asyncio.sleep(20)  # that nothing counts their messages is no silence
    assert (await manager.status()).valid
    assert simulator.active() == active, outcome


def test_the_old_one_is_deactivated_before_the_new_one_is_activated(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: SimulatedRos) -> None:
        old = simulator.nodes["talker"]
        old.values |= {"word": "bye", "own": 2.5}
        outcome = await manager.change(REPLACE)
        assert (outcome.outcome, outcome.because, outcome.own_state) == ("done", None, {})
        assert simulator.events == [
            "talker_2 configure",
            "talker deactivate",
            "talker_2 activate",
            "talker cleanup",
            "talker shutdown",
            "talker ended",
        ]
        # What was set on the old one, the new one had from its start, before it was configured.
        assert simulator.nodes["talker_2"].values == {"word": "bye", "own": 2.5}
        await settled(manager, outcome, ["listener", "talker_2"], simulator)
        assert old.closed

    managed(tmp_path, body)


def test_what_is_set_later_is_taken_over_by_each_replacement(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: SimulatedRos) -> None:
        simulator.nodes["talker"].values["own"] = 2.5
        await manager.change(REPLACE)
        outcome = await manager.change(PlanRequest(replace=(("talker", "Talker"),)))
        assert (outcome.outcome, outcome.because) == ("done", None)
        assert simulator.of("talker").values == {"word": "hello", "own": 2.5}
        assert [value.fate for value in outcome.parameters] == ["kept"]
        outcome = await manager.change(PlanRequest(replace=(("talker", "Other"),), declared_parameters=True))
        assert outcome.outcome == "done"
        assert simulator.of("talker").values == {"word": "hello", "own": 1.5}

    managed(tmp_path, body)


STUBBORN = "{} had not ended 10 s after it was asked to, and was killed (SIGKILL)"


def test_what_does_not_end_when_it_is_asked_to_is_in_the_report_the_log_and_the_history(tmp_path: Path) -> None:
    words = STUBBORN.format("talker")

    async def body(manager: Manager, simulator: SimulatedRos) -> None:
        begun = simulator.time.steady()
        outcome = await manager.change(REPLACE)
        assert (outcome.outcome, outcome.because) == ("done", None)
        assert simulator.events[-1] == "talker killed"
        assert simulator.time.steady() - begun > 10.0, "5 s for SIGINT, and 5 s for SIGTERM"
        assert [(each.instance, each.words) for each in outcome.killed] == [("talker", words)]
        console = Console(width=200)
        with console.capture() as shown:
            console.print(render.outcome(outcome))
        assert f"Not measurable here: {words}: what it does at its end is lost.\n" in shown.get()
        assert [event.words for event in manager.log() if event.kind == "killed"] == [words]
        report = await manager.change_report()
        assert report.outcome is not None and report.outcome.killed == outcome.killed
        history = await manager.history(10)
        assert words in [incident.words for incident in history.incidents]
        # Of the next change, it is no part; of the end of the system, what that has to kill is.
        assert (await manager.change(PlanRequest(replace=(("talker", "Talker"),)))).killed == []
        down = await manager.down()
        assert [(each.instance, each.words) for each in down.killed] == [("talker_3", STUBBORN.format("talker_3"))]

    managed(tmp_path, body, {"Talker": {"ends_on": None}})


def test_a_program_that_ends_on_sigterm_alone_is_given_the_time_for_it(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: SimulatedRos) -> None:
        begun = simulator.time.steady()
        outcome = await manager.change(REPLACE)
        assert (outcome.outcome, outcome.killed) == ("done", [])
        assert simulator.events[-1] == "talker ended"
        assert simulator.time.steady() - begun > 5.0

    managed(tmp_path, body, {"Talker": {"ends_on": "SIGTERM"}})


def test_the_time_without_an_active_node_begins_when_it_was_last_seen_active(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: SimulatedRos) -> None:
        def inactive() -> float:
            state = manager.system.life.latest_states["talker"].state
            return state.ports["out"]["/chat"].inactive or 0.0

        await asyncio.sleep(5.3)
        assert inactive() == 0.0
        simulator.nodes["talker"].state = INACTIVE
        begun = simulator.time.steady()
        while inactive() == 0.0:
            await asyncio.sleep(0.001)
        silent = simulator.time.steady() - begun
        assert silent <= inactive() < silent + LOOK + 0.1

    managed(tmp_path, body)


def test_a_node_that_loses_its_input_is_inactive(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: SimulatedRos) -> None:
        talker = manager.specification.nodes["talker"]
        outcome = await manager.change(PlanRequest(remove=("talker",)))
        assert (outcome.outcome, outcome.because) == ("done", None)
        await settled(manager, outcome, [], simulator)
        assert simulator.events[0] == "listener deactivate"
        outcome = await manager.change(PlanRequest(add=(talker,)))
        assert (outcome.outcome, outcome.because) == ("done", None)
        await settled(manager, outcome, ["listener", "talker"], simulator)

    managed(tmp_path, body)


@pytest.mark.parametrize(
    ("behaviour", "because"),
    [
        ({"refuses": {"configure"}}, "talker_2 has answered `configure` with a failure; it is unconfigured"),
        ({"hangs": {"configure"}}, "talker_2 has not answered `configure` within 12 s; it was unconfigured before"),
        ({"refuses": {"activate"}}, "talker_2 has answered `activate` with a failure; it is inactive"),
        ({"hangs": {"activate"}}, "talker_2 has not answered `activate` within 5 s; it was inactive before"),
    ],
)
def test_one_that_does_not_make_a_transition_is_not_let_in(
    behaviour: Mapping[str, Any], because: str, tmp_path: Path
) -> None:
    async def body(manager: Manager, simulator: SimulatedRos) -> None:
        outcome = await manager.change(REPLACE)
        assert outcome.outcome == "rolled_back"
        assert because in str(outcome.because)
        assert ("talker deactivate" in simulator.events) == ("activate" in because)
        await settled(manager, outcome, ["listener", "talker"], simulator)
        assert sorted(simulator.nodes) == ["listener", "talker"]

    managed(tmp_path, body, {"Other": behaviour})


@pytest.mark.parametrize("transition", ["configure", "activate"])
@pytest.mark.parametrize("is_stated", [False, True])
def test_a_slow_transition_has_the_time_that_is_stated(transition: str, is_stated: bool, tmp_path: Path) -> None:
    """Unstated, the message says how long it has been waited, and what to state."""
    behaviour: dict[str, Any] = {"Other": {"slow": {transition: 14.0}}}
    word, waited = ("takes", 12) if transition == "configure" else ("activate", 5)
    text = TEXT.replace(" gate lifecycle", f" {word} 20 s gate lifecycle") if is_stated else TEXT

    async def body(manager: Manager, simulator: SimulatedRos) -> None:
        outcome = await manager.change(REPLACE)
        if is_stated:
            assert (outcome.outcome, outcome.because) == ("done", None)
            return await settled(manager, outcome, ["listener", "talker_2"], simulator)
        assert outcome.outcome == "rolled_back"
        words = f"talker_2 has not answered `{transition}` within {waited} s; it was "
        assert words in str(outcome.because)
        assert f"(if it needs longer, state `{word} {2 * waited} s` after its `run` command)" in str(outcome.because)

    simulated.managed(tmp_path, text, body, behaviour)


@pytest.mark.parametrize("during", ["configure", "activate"])
def test_one_whose_process_ends_in_a_transition_is_not_let_in(during: str, tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: SimulatedRos) -> None:
        change = asyncio.ensure_future(manager.change(REPLACE))
        while not ("talker_2" in simulator.nodes and simulator.nodes["talker_2"].hung):
            await asyncio.sleep(0.01)
        simulator.die("talker_2")
        outcome = await change
        assert outcome.outcome == "rolled_back"
        assert "talker_2" in str(outcome.because)
        await settled(manager, outcome, ["listener", "talker"], simulator)

    managed(tmp_path, body, {"Other": {"hangs": {during}}})


@pytest.mark.parametrize("request_", [REPLACE, PlanRequest(restart=("talker",))])
def test_an_old_one_that_hangs_or_is_stopped_is_killed(request_: PlanRequest, tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: SimulatedRos) -> None:
        simulator.nodes["talker"].hung = True
        outcome = await manager.change(request_)
        assert (outcome.outcome, outcome.because) == ("done", None)
        assert simulator.events == ["talker_2 configure", "talker killed", "talker_2 activate"]
        assert [(each.instance, each.how) for each in outcome.fenced] == [("talker", "killed")]
        await settled(manager, outcome, ["listener", "talker_2"], simulator)

    managed(tmp_path, body)


def test_a_failed_activation_is_undone_in_the_time_that_the_plan_says_however_slow_the_old_one_is(
    tmp_path: Path,
) -> None:
    async def body(manager: Manager, simulator: SimulatedRos) -> None:
        change, silent = asyncio.ensure_future(manager.change(REPLACE)), 0.0
        while not change.done():
            await asyncio.sleep(0.01)
            silent += 0.0 if {"talker", "talker_2"} & {*simulator.active()} else 0.01
        assert (await change).outcome == "rolled_back" and 9.5 < silent < 18.0
        await settled(manager, await change, ["listener", "talker"], simulator)

    slow = {"slow": {"deactivate": 4.5, "activate": 4.5}}
    managed(tmp_path, body, {"Other": {"hangs": {"activate"}}, "Talker": {**slow}})


def test_an_old_one_that_has_been_deactivated_is_not_blamed_for_a_new_one_that_hangs(tmp_path: Path) -> None:
    """On a busy machine it takes longer to say its state than one that may hang has for that (``PATIENCE``)."""

    async def body(manager: Manager, simulator: SimulatedRos) -> None:
        simulator.nodes["talker"].slow["state"] = 0.7
        outcome = await manager.change(REPLACE)
        assert outcome.outcome == "rolled_back", outcome.because
        assert "talker_2 has not answered `activate` within 5 s" in str(outcome.because)
        await settled(manager, outcome, ["listener", "talker"], simulator)

    managed(tmp_path, body, {"Other": {"hangs": {"activate"}}})


def test_an_old_one_that_cannot_be_deactivated_goes_on(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: SimulatedRos) -> None:
        outcome = await manager.change(REPLACE)
        assert outcome.outcome == "rolled_back"
        assert "talker has answered `deactivate` with a failure; it is active" in str(outcome.because)
        await settled(manager, outcome, ["listener", "talker"], simulator)

    managed(tmp_path, body, {"Talker": {"refuses": {"deactivate"}}})


@pytest.mark.full
def test_the_next_manager_finds_one_of_two_active(tmp_path: Path) -> None:
    """A manager ends at any moment of a hand-over."""
    for moment in range(30):
        folder = tmp_path / str(moment)
        folder.mkdir()

        async def body(manager: Manager, simulator: SimulatedRos, moment: int = moment, folder: Path = folder) -> None:
            change = asyncio.ensure_future(manager.change(REPLACE))
            while "talker_2 configure" not in simulator.events:
                await asyncio.sleep(0.001)
            await asyncio.sleep(moment * 0.003)
            # What ends the old node's process goes on here, as only the connections of this manager are closed.
            assert "talker cleanup" not in simulator.events, "the hand-over is over, and the old node is being ended"
            workspace = Workspace(folder / "system")
            manager._client.close()  # as if it had been killed
            manager._store.close()
            await simulator.manager_killed()
            again = Manager(saved(workspace).specification, simulator, workspace, folder)
            await again.up()
            assert len([name for name in simulator.active() if name.startswith("talker")]) == 1, simulator.events
            assert (await again.status()).valid
            change.cancel()
            await asyncio.wait({change})
            await again.close()

        managed(folder, body)


def test_one_that_leaves_its_state_by_itself_is_degraded(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: SimulatedRos) -> None:
        simulator.nodes["talker"].state = "inactive"
        while simulator.active():  # its dependant falls with it
            await asyncio.sleep(0.1)
        status = await manager.status()
        assert "its lifecycle state is inactive" in str(status)

    managed(tmp_path, body)


def test_what_the_disk_refuses_is_written_later(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async def body(manager: Manager, simulator: SimulatedRos) -> None:
        disk = FullDisk(monkeypatch, "talker.json")
        simulator.nodes["talker"].state = "inactive"
        while simulator.active():
            await asyncio.sleep(0.1)
        status = await manager.status()
        assert status.unwritten == f"{tmp_path / 'gates' / 'talker.json'} cannot be written: No space left on device"
        disk.has_room()
        while (await manager.status()).unwritten is not None:
            await asyncio.sleep(0.1)
        record = ForeignRecord.read(tmp_path / "gates", "talker")
        assert record is not None and record.modes == {"talk": "degraded"}
        FullDisk(monkeypatch, "talker.json")  # the next manager finds it so
        await simulator.manager_killed()
        assert await simulator.adopt(Handle("talker"))

    managed(tmp_path, body)


def reached(state: str, target: str, later: Mapping[float, str], **behaviour: Any) -> SimulatedNode:
    """A node once it has reached ``target``. It was in ``state``, and ``later`` (by s) enters others by itself."""
    node = SimulatedNode("talker", [], state=state, **behaviour)

    async def scenario() -> None:
        for seconds, entered in later.items():
            asyncio.get_running_loop().call_later(seconds, setattr, node, "state", entered)
        await NodeLifecycle("talker", node, startup=20.0).reach(target)
        assert node.state == target

    virtual.run(scenario())
    return node


def test_a_transition_that_was_begun_before_is_waited_for() -> None:
    assert reached("activating", "inactive", {3.0: "active"}).events == ["talker deactivate"]


@pytest.mark.parametrize(
    ("state", "target", "behaviour", "words"),
    [
        ("finalized", "active", {}, "talker cannot become active: it is finalized, so replace it"),
        ("activating", "active", {}, "talker cannot become active: it stays in state activating"),
        ("unconfigured", "inactive", {"hangs": {"configure"}}, "not answered `configure` within 32 s"),
        ("inactive", "finalized", {"hangs": {"cleanup"}}, "not answered `cleanup` within 5 s; it was inactive before"),
        ("unconfigured", "finalized", {"refuses": {"shutdown"}}, "`shutdown` with a failure; it is unconfigured"),
        ("active", "inactive", {"hung": True}, "talker cannot become inactive: talker has not answered within 2 s"),
    ],
)
def test_what_cannot_be_reached_is_said(state: str, target: str, behaviour: dict[str, Any], words: str) -> None:
    with pytest.raises(CommandRefused, match=words):
        reached(state, target, {}, **behaviour)

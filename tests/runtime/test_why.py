"""`midstride why`: what to do about a functionality that is below its normal mode."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from msgspec import structs

from midstride.backends.simulator import Simulator
from midstride.errors import ManagerError, PlanRefused
from midstride.model.respawn import RespawnPolicy
from midstride.plan.request import PlanRequest
from midstride.runtime.instance_life import LifeTable
from midstride.runtime.manager import Manager
from midstride.runtime.view.why import LONG_CALL
from midstride.runtime.workspace import Workspace
from tests.runtime.systems import example, managed
from tests.runtime.test_lowered import raising
from tests.runtime.test_respawn import crash, respawning

RESTART = "`midstride restart talker` restores it"


def test_after_an_exception_the_node_that_raised_is_named_and_how_to_go_on(tmp_path: Path) -> None:
    directory, simulator = raising(tmp_path / "programs", "talker.py", 3), Simulator()

    async def main() -> None:
        manager = Manager(example("talker", directory), simulator, Workspace(tmp_path / "w"), directory)
        await manager.up()
        talk = await manager.why("talker.talk")
        assert talk.chain == ["not normal: its assumptions are satisfied"]
        assert talk.remedies == [f"fix the cause, then {RESTART}"]
        assert (await manager.why("listener.listen")).remedies == [f"talker.talk: fix the cause, then {RESTART}"]
        await manager.close()

    simulator.run(main())


@pytest.mark.parametrize(
    ("policy", "remedy"),
    [(None, re.escape(RESTART)), (RespawnPolicy(delay=9.0), r"restarting in \d\.\d s \(1 of 5 in 60 s\)")],
)
def test_after_a_crash_what_comes_next_is_named(tmp_path: Path, policy: RespawnPolicy | None, remedy: str) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        await crash(simulator, "talker")
        [found] = (await manager.why("listener.listen")).remedies
        assert re.fullmatch(f"talker exited unexpectedly; {remedy}", found)
        for asked in ("talker.talk", "talker"):
            with pytest.raises(PlanRefused, match=f"nothing serves {asked} now: talker exited unexpectedly; {remedy}"):
                await manager.why(asked)
        with pytest.raises(ManagerError, match=f"talker is not running; {re.escape(RESTART)}"):
            await manager.set_parameters("talker", {"gain": 1})

    managed("talker", tmp_path, body, specification=None if policy is None else respawning(policy))


def test_of_two_that_have_crashed_each_is_explained(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        for name in ("talker", "listener"):
            await crash(simulator, name)
        for name in ("talker", "listener"):
            with pytest.raises(PlanRefused, match=f"nothing serves {name} now: {name} exited unexpectedly"):
                await manager.why(name)

    managed("talker", tmp_path, body)


def test_the_cause_at_the_end_of_a_chain_is_found(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        assert (await manager.why("sink.use")).remedies == []
        await crash(simulator, "source")
        assert not (await manager.why("filter.smooth")).normal
        remedy = "source exited unexpectedly; `midstride restart source` restores it"
        assert (await manager.why("sink.use")).remedies == [remedy]

    managed("filter", tmp_path, body)


def test_a_node_that_hangs_is_to_be_restarted(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        assert (await manager.why("talker.talk")).remedies == []
        simulator.faults.freeze("talker", 60.0)
        await simulator.clock.sleep(5.0)
        found = await manager.why("talker.talk")
        assert found.normal
        [remedy] = found.remedies
        assert re.fullmatch(r"talker does not answer \(for [\d.]+ s\); `midstride restart talker` replaces it", remedy)
        assert (await manager.why("listener.listen")).remedies == []

    managed("talker", tmp_path, body)


def test_an_input_without_its_messages_and_a_call_that_does_not_return_are_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        simulator.faults.hang("listener", 60.0)
        await simulator.clock.sleep(LONG_CALL + 3.0)
        [remedy] = (await manager.why("listener.listen")).remedies
        silent = r"listener\.in receives nothing of what is published on /chatter \(for [\d.]+ s\)"
        assert re.fullmatch(f"{silent}; `midstride restart listener` replaces it", remedy)
        state = manager.system.life.responsive("listener")
        assert state is not None
        listen = structs.replace(state.functionalities["listen"], busy=LONG_CALL)
        busy = structs.replace(state, functionalities={"listen": listen})
        states = {"listener": busy, "talker": manager.system.life.responsive("talker")}
        monkeypatch.setattr(LifeTable, "responsive", lambda _, name: states[name])
        [remedy] = (await manager.why("listener.listen")).remedies
        assert re.fullmatch(
            f"{silent}; a call of its code has not returned for 5.00 s; `midstride restart listener` replaces it",
            remedy,
        )

    managed("talker", tmp_path, body)


def test_what_a_user_has_removed_needs_no_remedy(tmp_path: Path) -> None:
    async def body(manager: Manager, _: Simulator) -> None:
        assert (await manager.change(PlanRequest(remove=("talker",)))).outcome == "done"
        found = await manager.why("listener.listen")
        assert (found.normal, found.remedies) == (False, [])

    managed("talker", tmp_path, body)

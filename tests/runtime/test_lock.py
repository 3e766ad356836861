"""Locks on the simulator, in virtual time: what they refuse, what they let happen, and how they end."""

from __future__ import annotations

import asyncio
import time
from dataclasses import replace as changed
from pathlib import Path

import pytest

from midstride.backends.simulator import Simulator
from midstride.errors import ChangeForbidden
from midstride.model.respawn import RespawnPolicy
from midstride.model.specification import Specification
from midstride.plan.forms.request_form import decode_request
from midstride.plan.request import PlanRequest
from midstride.runtime.change.change_permission import Override
from midstride.runtime.manager import Manager
from midstride.runtime.workspace import Workspace
from tests.runtime.systems import EXAMPLES, example, managed, replace, saved

OVERRIDE = Override(lock=True)


def respawning() -> Specification:
    specification = example("talker")
    return specification.with_node(changed(specification.nodes["talker"], respawn=RespawnPolicy()))


async def incidents(manager: Manager, kind: str) -> list[str]:
    return [each.words for each in (await manager.history(100)).incidents if each.kind == kind]


def requests(specification: Specification) -> list[PlanRequest]:
    """One of each kind of change."""
    return [
        replace("talker", "NewTalker"),
        PlanRequest(restart=("talker",)),
        PlanRequest(remove=("talker",)),
        decode_request({"add": [{"role": "second", "component": "Listener", "attachments": {"in": ["/chatter"]}}]}),
        PlanRequest(to=specification.without_node("talker")),
    ]


def test_every_change_is_refused_with_reason_who_and_until_when(tmp_path: Path) -> None:
    async def body(manager: Manager, _: Simulator) -> None:
        lock = manager.lock("the brake is held", "alice@robot", time.time() + 7200)
        assert (await manager.status()).lock == lock
        before = manager.configuration
        for request in requests(manager.specification):
            outcome = await manager.change(request, by="bob: it")
            assert outcome.outcome == "refused" and outcome.because is not None
            end = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(lock.until))
            assert "locked by alice@robot since" in outcome.because and f"until {end}" in outcome.because
            assert ": the brake is held; `midstride unlock` ends that" in outcome.because
        with pytest.raises(ChangeForbidden, match="the brake is held"):
            await manager.set_parameters("listener", {"use_sim_time": True}, by="bob")
        assert manager.configuration is before
        refused = await incidents(manager, "forbidden")
        assert len(refused) == 6 and refused[0].startswith(
            "bob: it: refused, since the system is locked by alice@robot"
        )
        assert refused[-1].startswith("bob: param set listener use_sim_time = True: refused")
        assert manager.unlock("carol@desk") == lock
        assert (await manager.change(replace("talker", "NewTalker"))).outcome == "done"
        [ended] = await incidents(manager, "unlock")
        assert ended == "carol@desk has unlocked the system, which alice@robot had locked: the brake is held"
        assert (await manager.status()).lock is None

    managed("talker", tmp_path, body)


def test_a_lock_is_overridden_deliberately_and_the_history_says_so(tmp_path: Path) -> None:
    async def body(manager: Manager, _: Simulator) -> None:
        manager.lock("moving", "alice", None)
        outcome = await manager.change(replace("talker", "NewTalker"), by="bob: replace", override=OVERRIDE)
        assert outcome.outcome == "done"
        [words] = await incidents(manager, "override")
        assert words.startswith("bob: replace: carried out although the system is locked by alice since")
        assert (await manager.change(PlanRequest(restart=("talker",)))).outcome == "refused"

    managed("talker", tmp_path, body)


def test_one_lock_at_a_time_and_none_that_has_ended_before_it_began(tmp_path: Path) -> None:
    async def body(manager: Manager, _: Simulator) -> None:
        with pytest.raises(ChangeForbidden, match="the system is not locked"):
            manager.unlock("bob")
        with pytest.raises(ChangeForbidden, match="in the past"):
            manager.lock("moving", "alice", time.time() - 1)
        manager.lock("moving", "alice", None)
        with pytest.raises(
            ChangeForbidden, match=r"locked by alice since .*: moving; `midstride unlock` ends that lock"
        ):
            manager.lock("a visitor", "bob", None)
        assert manager.watched.permission.current_lock is not None
        assert manager.watched.permission.current_lock.by == "alice"

    managed("talker", tmp_path, body)


def test_a_change_in_progress_goes_on_and_one_that_waits_is_refused(tmp_path: Path) -> None:
    async def body(manager: Manager, _: Simulator) -> None:
        first = asyncio.ensure_future(manager.change(replace("talker", "NewTalker")))
        await asyncio.sleep(0.05)
        second = asyncio.ensure_future(manager.change(PlanRequest(restart=("listener",))))
        await asyncio.sleep(0.05)
        manager.lock("moving", "alice", None)
        assert (await first).outcome == "done"
        assert (await second).outcome == "refused"

    managed("talker", tmp_path, body)


def test_a_lock_ends_when_it_said(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        begun = simulator.time.steady()
        manager.lock("moving", "alice", time.time() + 60)
        await asyncio.sleep(59)
        assert (await manager.change(PlanRequest(restart=("talker",)))).outcome == "refused"
        while manager.watched.permission.current_lock is not None:
            await asyncio.sleep(0.1)
        assert simulator.time.steady() - begun == pytest.approx(60, abs=0.5)
        assert await incidents(manager, "unlock") == ["the lock of alice has ended, as it said: moving"]
        assert (await manager.change(PlanRequest(restart=("talker",)))).outcome == "done"

    managed("talker", tmp_path, body)


def test_recovery_goes_on_unless_the_lock_holds_it_back(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        manager.lock("moving", "alice", None)
        simulator.faults.kill("talker")
        await asyncio.sleep(3)
        assert "talker" in manager.configuration.instances
        manager.unlock("alice")
        manager.lock("a person is inside", "alice", None, holds_recovery=True)
        simulator.faults.kill("talker")
        await asyncio.sleep(30)
        assert "talker" not in manager.configuration.instances
        [crash] = (await manager.status()).crashed
        assert crash.respawn is not None and crash.respawn.restarting
        assert crash.respawn.words.startswith(
            "it will be restarted when that may happen: the system is locked by alice"
        )
        assert crash.respawn.restarts == 2  # waiting uses up none
        manager.unlock("alice")
        await asyncio.sleep(3)
        assert "talker" in manager.configuration.instances and (await manager.status()).valid

    managed("talker", tmp_path, body, specification=respawning())


def test_the_next_manager_keeps_the_lock(tmp_path: Path) -> None:
    """Also one that ends while no manager runs: it has then ended."""
    simulator, workspace = Simulator(), Workspace(tmp_path)

    async def main() -> None:
        first = Manager(example("talker"), simulator, workspace, EXAMPLES / "talker")
        await first.up()
        lock = first.lock("moving", "alice", None)
        assert saved(workspace).lock == lock  # at once: a manager may be killed at any moment
        await first.close()
        second = Manager(saved(workspace).specification, simulator, workspace, EXAMPLES / "talker")
        await second.up()
        assert (await second.status()).lock == lock
        assert (await second.change(PlanRequest(restart=("talker",)))).outcome == "refused"
        second.unlock("bob")
        second.lock("moving", "alice", time.time() + 0.05)
        await second.close()
        while time.time() < lock.since + 0.1:
            time.sleep(0.01)
        third = Manager(saved(workspace).specification, simulator, workspace, EXAMPLES / "talker")
        await third.up()
        await asyncio.sleep(0.1)
        assert (await third.status()).lock is None and saved(workspace).lock is None
        third.lock("moving", "alice", None)
        await third.down()
        assert next(each.words for each in third.log() if each.kind == "down").startswith(
            "talker is down, although the system is locked by alice since"
        )
        await third.close()
        fourth = Manager(example("talker"), simulator, workspace, EXAMPLES / "talker")
        await fourth.up()
        assert (await fourth.status()).lock is None
        await fourth.down()
        await fourth.close()

    simulator.run(main())

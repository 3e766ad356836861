"""The first `up` where some nodes do not start: the others run, and what failed is crashed, with its reason."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import replace as changed
from pathlib import Path

import pytest

from midstride.backends.simulator import Simulator
from midstride.errors import StepFailed
from midstride.model.component import FunctionalityRef
from midstride.model.respawn import RespawnPolicy
from midstride.model.specification import Keep, Limit, Order, Specification
from midstride.plan.request import PlanRequest
from midstride.runtime.manager import Manager
from midstride.runtime.options import SystemOptions
from midstride.runtime.process.pending_starts import REGISTRATION_TIMEOUT
from midstride.runtime.records.reports import UpReport
from midstride.runtime.workspace import Workspace
from tests.runtime.systems import EXAMPLES, example, replace, rewritten, saved, up

BROKEN = "raise RuntimeError('no camera')\n"
# Runs, and never registers.
HANGS = "import time\nwhile True:\n    time.sleep(1)\n"
REASON = "talker exited with status 1 before it registered: RuntimeError: no camera"

Body = Callable[[Manager, Simulator, UpReport], Awaitable[None]]


@pytest.fixture
def programs(tmp_path: Path) -> Path:
    return rewritten("talker", tmp_path / "programs", lambda _, text: text)


def broken(programs: Path, text: str = BROKEN, file: str = "talker.py") -> Specification:
    (programs / file).write_text(text)
    return example("talker", programs)


def mended(programs: Path) -> None:
    (programs / "talker.py").write_text((EXAMPLES / "talker" / "talker.py").read_text())


async def modes(manager: Manager) -> dict[str, str]:
    instances = (await manager.status()).instances
    return {f"{each.name}.{row.name}": row.mode for each in instances for row in each.functionalities}


def test_what_can_be_started_runs_and_what_cannot_is_crashed_with_its_reason(tmp_path: Path, programs: Path) -> None:
    async def body(manager: Manager, simulator: Simulator, report: UpReport) -> None:
        assert (report.outcome, report.instances) == ("incomplete", ["listener"])
        assert list(report.missing) == ["talker"]
        assert report.missing["talker"].startswith(REASON) and "no camera" in report.missing["talker"]
        assert [(each.functionality, each.after, each.because) for each in report.degraded] == [
            ("listener.listen", "degraded", "it has been in this mode since it started"),
            ("talker.talk", None, REASON),
        ]
        assert sorted(simulator.processes) == ["listener"]
        [crashed] = (await manager.status()).crashed
        assert (crashed.name, crashed.role, crashed.status) == ("talker", "talker", 1)
        assert "no camera" in crashed.log and crashed.remedy == "`midstride restart talker` restores it"
        why = await manager.why("listener.listen")
        assert why.remedies == [f"{REASON}; `midstride restart talker` restores it"]
        history = await manager.history(10)
        assert [(each.command, each.outcome) for each in history.changes] == [("up", "incomplete")]
        assert {each.version for each in history.changes} == {1}
        assert [each.words.partition(":")[0] for each in history.incidents if each.kind == "left_out"] == [
            "talker is left out"
        ]
        assert [each.instance.name for each in saved(Workspace(tmp_path)).instances] == ["listener"]
        assert saved(Workspace(tmp_path)).specification == manager.specification == example("talker", programs)
        mended(programs)
        restored = await manager.change(PlanRequest(restart=("talker",)))
        assert (restored.outcome, restored.remaining_degradations) == ("done", []), restored.because
        assert await modes(manager) == {"talker.talk": "normal", "listener.listen": "normal"}
        assert (await manager.status()).crashed == []

    up(broken(programs), tmp_path, programs, body)


def test_a_command_that_does_not_exist_is_a_node_that_fails(tmp_path: Path, programs: Path) -> None:
    specification = example("talker", programs)
    component = changed(specification.components["Talker"], run="no_such_program --fast")
    specification = changed(specification, components=specification.components.set("Talker", component))

    async def body(manager: Manager, simulator: Simulator, report: UpReport) -> None:
        assert (report.outcome, report.instances) == ("incomplete", ["listener"])
        assert "no_such_program" in report.missing["talker"]

    up(specification, tmp_path, programs, body)


@pytest.mark.parametrize("op", ["attach", "modes", "welcome"])
def test_a_node_that_fails_in_a_later_step_is_ended_and_left_out(op: str, tmp_path: Path, programs: Path) -> None:
    async def body(manager: Manager, simulator: Simulator, report: UpReport) -> None:
        assert (report.outcome, report.instances) == ("incomplete", ["listener"])
        assert list(report.missing) == ["talker"]
        assert sorted(simulator.processes) == ["listener"]
        assert await modes(manager) == {"listener.listen": "degraded"}
        assert (await manager.status()).violations == []

    def refuse(simulator: Simulator) -> None:
        simulator.faults.fail_next("talker", op, "refused", times=99)

    up(example("talker", programs), tmp_path, programs, body, prepare=refuse)


def test_strict_starts_all_or_nothing(tmp_path: Path, programs: Path) -> None:
    async def body(manager: Manager, simulator: Simulator, report: UpReport) -> None:
        raise AssertionError

    with pytest.raises(StepFailed, match="no camera"):
        up(broken(programs), tmp_path, programs, body, SystemOptions(strict=True))


def test_where_nothing_can_be_started_nothing_is_up(tmp_path: Path, programs: Path) -> None:
    async def body(manager: Manager, simulator: Simulator, report: UpReport) -> None:
        raise AssertionError

    broken(programs, file="listener.py")
    with pytest.raises(StepFailed, match=r"(?s)listener exited.*talker exited"):
        up(broken(programs), tmp_path, programs, body)
    assert not Workspace(tmp_path).state.exists()


def test_the_first_start_follows_the_restart_policy(tmp_path: Path, programs: Path) -> None:
    specification = broken(programs)
    node = changed(specification.nodes["talker"], respawn=RespawnPolicy(delay=1.0))

    async def body(manager: Manager, simulator: Simulator, report: UpReport) -> None:
        assert report.outcome == "incomplete"
        assert report.missing["talker"].endswith("It is started again after 1 s to 30 s, at most 5 in 60 s.")
        [crashed] = (await manager.status()).crashed
        assert crashed.respawn is not None and crashed.respawn.restarting
        await asyncio.sleep(2.5)  # the first restart has failed
        mended(programs)
        await asyncio.sleep(5)
        assert await modes(manager) == {"talker.talk": "normal", "listener.listen": "normal"}
        assert next(each.words for each in manager.log() if each.kind == "respawn") == (
            f"{REASON}; restarting talker in 1.0 s (1 of 5 in 60 s)"
        )

    up(specification.with_node(node), tmp_path, programs, body)


def test_a_system_of_which_nothing_runs_yet_stays_for_its_restart_policies(tmp_path: Path, programs: Path) -> None:
    specification = broken(programs).without_node("listener")
    node = changed(specification.nodes["talker"], respawn=RespawnPolicy(delay=1.0))

    async def body(manager: Manager, simulator: Simulator, report: UpReport) -> None:
        assert (report.outcome, report.instances) == ("incomplete", [])
        mended(programs)
        await asyncio.sleep(3)
        assert await modes(manager) == {"talker.talk": "normal"}

    up(specification.with_node(node), tmp_path, programs, body)


def test_those_that_hang_are_waited_for_at_the_same_time(tmp_path: Path, programs: Path) -> None:
    specification = broken(programs, HANGS)
    specification = specification.with_node(changed(specification.nodes["talker"], role="another"))

    async def body(manager: Manager, simulator: Simulator, report: UpReport) -> None:
        assert sorted(report.missing) == ["another", "talker"]
        assert "did not register within" in report.missing["talker"]
        assert simulator.clock.steady() < REGISTRATION_TIMEOUT + 5

    up(specification, tmp_path, programs, body)


def seen_at(seconds: float, found: list[dict[str, str]]) -> Callable[[Simulator], None]:
    """Note which modes the components are in so many seconds after the start, by the components themselves."""

    def prepare(simulator: Simulator) -> None:
        simulator.time.loop.call_later(seconds, lambda: found.append(simulated_modes(simulator)))

    return prepare


def simulated_modes(simulator: Simulator) -> dict[str, str]:
    return {
        f"{name}.{functionality}": state.mode
        for name, process in sorted(simulator.processes.items())
        if process.state is not None
        for functionality, state in process.state.functionalities.items()
    }


def test_what_does_not_need_a_node_that_hangs_comes_up_meanwhile(tmp_path: Path, programs: Path) -> None:
    found: list[dict[str, str]] = []

    async def body(manager: Manager, simulator: Simulator, report: UpReport) -> None:
        assert "did not register within" in report.missing["talker"]
        assert found == [{"listener.listen": "degraded", "other.talk": "normal"}]
        assert sorted(simulator.processes) == ["listener", "other"] == report.instances
        assert await modes(manager) == {"listener.listen": "degraded", "other.talk": "normal"}

    specification = talkers(programs)
    (programs / "talker.py").write_text(HANGS)
    up(specification, tmp_path, programs, body, prepare=seen_at(5.0, found))


def test_one_that_hangs_and_one_that_crashes_do_not_delay_the_third(tmp_path: Path, programs: Path) -> None:
    found: list[dict[str, str]] = []

    async def body(manager: Manager, simulator: Simulator, report: UpReport) -> None:
        assert sorted(report.missing) == ["listener", "talker"]
        assert found == [{"other.talk": "normal"}] and sorted(simulator.processes) == ["other"]

    specification = talkers(programs)
    (programs / "talker.py").write_text(HANGS)
    (programs / "listener.py").write_text(BROKEN)
    up(specification, tmp_path, programs, body, prepare=seen_at(5.0, found))


def test_a_node_that_takes_long_joins_the_others_and_is_not_started_twice(tmp_path: Path, programs: Path) -> None:
    found: list[dict[str, str]] = []

    async def body(manager: Manager, simulator: Simulator, report: UpReport) -> None:
        assert (report.outcome, report.missing, report.degraded) == ("done", {}, [])
        assert found == [{"listener.listen": "degraded", "other.talk": "normal"}]
        assert set((await modes(manager)).values()) == {"normal"}
        assert sorted(simulator.processes) == ["listener", "other", "talker"]
        assert 20 < simulator.clock.steady() < 25

    specification = talkers(programs)
    (programs / "talker.py").write_text(
        "import time\ntime.sleep(20)\n" + (EXAMPLES / "talker" / "talker.py").read_text()
    )
    up(specification, tmp_path, programs, body, prepare=seen_at(5.0, found))


def test_a_constraint_on_what_relies_on_it_does_not_keep_the_rest_down(tmp_path: Path, programs: Path) -> None:
    listen = FunctionalityRef("listener", "listen")
    constraints = (Keep(listen, "normal"), Limit(listen, 0.5), Order("talker", "listener"))

    async def body(manager: Manager, simulator: Simulator, report: UpReport) -> None:
        assert (report.instances, list(report.missing)) == (["listener"], ["talker"])

    up(changed(broken(programs), constraints=constraints), tmp_path, programs, body)


def test_what_exits_while_the_others_start_is_missing_too(tmp_path: Path, programs: Path) -> None:
    """It has registered, and exits before the others have."""
    slow = "import time\ntime.sleep(5)\n" + (EXAMPLES / "talker" / "talker.py").read_text()

    async def body(manager: Manager, simulator: Simulator, report: UpReport) -> None:
        assert (report.outcome, report.instances) == ("incomplete", ["talker"])
        assert list(report.missing) == ["listener"]

    def kill(simulator: Simulator) -> None:
        simulator.time.loop.call_later(2, simulator.faults.kill, "listener")

    up(broken(programs, slow), tmp_path, programs, body, prepare=kill)


def test_the_next_manager_tries_again(tmp_path: Path, programs: Path) -> None:
    async def body(manager: Manager, simulator: Simulator, report: UpReport) -> None:
        assert report.outcome == "incomplete"
        await manager.close()
        mended(programs)
        second = Manager(manager.specification, simulator, Workspace(tmp_path), programs)
        again = await second.up()
        assert (again.outcome, again.degraded) == ("done", [])
        await second.close()

    up(broken(programs), tmp_path, programs, body)


# -- later changes -----------------------------------------------------------------------------------------


def talkers(programs: Path) -> Specification:
    """The broken talker, the listener, and another talker on another topic, which runs."""
    specification = broken(programs)
    (programs / "other.py").write_text((EXAMPLES / "talker" / "talker.py").read_text())
    other = changed(specification.components["Talker"], name="Other", run="python3 other.py")
    topic = changed(specification.connectors["/chatter"], name="/other", topic="/other")
    specification = changed(
        specification,
        components=specification.components.set("Other", other),
        connectors=specification.connectors.set("/other", topic),
    )
    node = specification.nodes["talker"]
    [port] = node.attachments
    return specification.with_node(
        changed(node, role="other", component="Other", attachments=node.attachments.set(port, ("/other",)))
    )


def renamed(specification: Specification) -> Specification:
    """Another specification that says nothing else of the talker: the other one is replaced."""
    other = changed(specification.components["Other"], run="python3 -B other.py")
    return changed(specification, components=specification.components.set("Other", other))


@pytest.mark.parametrize(
    "request_",
    [
        lambda old: PlanRequest(restart=("other",)),
        lambda old: PlanRequest(restart=("other", "listener")),
        lambda old: replace("other", "Other"),
        lambda old: PlanRequest(remove=("other",)),
        lambda old: PlanRequest(to=renamed(old)),
        lambda old: PlanRequest(to=renamed(old), strategy="paper"),
    ],
    ids=["restart", "restart two", "replace", "remove", "apply", "apply as the paper"],
)
def test_a_later_change_neither_needs_nor_restores_it(
    request_: Callable[[Specification], PlanRequest], tmp_path: Path, programs: Path
) -> None:
    async def body(manager: Manager, simulator: Simulator, report: UpReport) -> None:
        assert report.instances == ["listener", "other"]
        outcome = await manager.change(request_(manager.specification))
        assert outcome.outcome == "done", outcome.because
        assert not manager.system.has_instance("talker") and "talker" in manager.specification.nodes
        assert [each.name for each in (await manager.status()).crashed] == ["talker"]
        assert outcome.plan is not None and outcome.plan.remarks
        assert outcome.plan.remarks[0] == (
            "talker does not run, and this change does not start it: `midstride restart talker` restores it"
        )

    up(talkers(programs), tmp_path, programs, body)


@pytest.mark.parametrize("how", ["same", "changed", "named"])
def test_it_comes_back_when_it_is_asked_for(how: str, tmp_path: Path, programs: Path) -> None:
    async def body(manager: Manager, simulator: Simulator, report: UpReport) -> None:
        running = manager.specification
        talker = changed(running.components["Talker"], run="python3 other.py")
        other = changed(renamed(running), components=renamed(running).components.set("Talker", talker))
        request = {
            "same": PlanRequest(to=running),
            "changed": PlanRequest(to=other),
            "named": PlanRequest(to=renamed(running), restart=("talker",)),
        }[how]
        if how != "changed":
            failed = await manager.change(request)
            assert (failed.outcome, sorted(manager.configuration.instances)) == ("rolled_back", report.instances)
            mended(programs)
        outcome = await manager.change(request)
        assert outcome.outcome == "done", outcome.because
        assert set((await modes(manager)).values()) == {"normal"}
        assert manager.system.has_instance("talker") and (await manager.status()).crashed == []

    up(talkers(programs), tmp_path, programs, body)

"""Containers of composable nodes that crash or hang at a bad moment, on real ROS 2, with the stand-in in C."""

from __future__ import annotations

import asyncio
import os
import re
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from midstride.foreign import build
from midstride.foreign.page import GATES_FOLDER, PAGE, Page
from midstride.foreign.page_layout import NODE
from midstride.lang.load import load
from midstride.model.specification import Specification
from midstride.plan.request import PlanRequest
from midstride.runtime.process import reaper
from midstride.runtime.records.state_store import StateStore
from midstride.runtime.workspace import Workspace
from midstride.wire.environment import ENV_INSTANCE, ENV_TOKEN
from tests.acceptance.foreign_support import Robot, manager_of, robot
from tests.acceptance.support import ROOT, ended
from tests.acceptance.test_shared_containers import ROBOT, pids
from tests.backends.ros2_support import Bare, run
from tests.composition import StandIn

pytestmark = [pytest.mark.ros2, pytest.mark.full, pytest.mark.long]

ALL = ("front/maker", "front/other", "front/talker")
TALKER = "front/talker"
CONTAINER = re.compile(r"/pipeline(_\d+)?$|_container$")


@pytest.fixture
def stand_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> StandIn:
    monkeypatch.setenv("STAND_IN_FAULTS", str(tmp_path / "faults"))
    return StandIn.in_use(tmp_path, monkeypatch)


def faults(folder: Path, *lines: str) -> None:
    """From now on, the nodes have these faults and no others."""
    new = folder / "faults.new"
    new.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")
    new.replace(folder / "faults")


def system(folder: Path, text: str = ROBOT) -> Specification:
    path = folder / "grouped.stride"
    path.write_text(text, encoding="utf-8")
    return load(path).require()


def roles(made: Robot) -> list[str]:
    return sorted(each.role for each in made.manager.configuration.instances.values())


async def run_on(made: Robot, expected: Sequence[str]) -> dict[str, int | None]:
    """Wait until exactly these roles run, and see that each node is there once; by role, the process."""
    await made.until(lambda: roles(made) == sorted(expected), 120)

    # Some are called after their instance.
    assert [re.sub(r"_\d+$", "", name) for name in nodes(made.folder)] == [f"/{role}" for role in sorted(expected)]
    return await pids(made)


def nodes(folder: Path) -> list[str]:
    """The full names of the ROS nodes that live, as their processes say, without those of containers."""
    page = Page(Workspace(folder / "system").components / GATES_FOLDER / PAGE, build.library())
    found = (port for port in page.every_port() if port.kind == NODE and not page.is_dead(port.node - 1))
    names = (port.topic.decode() for port in found)
    return sorted(name for name in names if name.startswith("/front/") and not CONTAINER.search(name))


async def kill(made: Robot, role: str) -> int:
    pid = (await pids(made))[role]
    assert pid is not None
    os.kill(pid, signal.SIGKILL)
    await made.until(lambda: role not in roles(made))
    return pid


async def another(made: Robot) -> None:
    """The manager ends, and the next one is brought up at once."""
    await made.manager.close()
    made.manager = manager_of(made.manager.specification, made.folder)
    await made.manager.up()


def events(made: Robot, kind: str) -> list[str]:
    return [event.words for event in made.manager.log() if event.kind == kind]


def test_one_that_has_left_is_restarted_by_itself_with_its_own_code(stand_in: StandIn, tmp_path: Path) -> None:
    async def main() -> None:
        async with robot(system(tmp_path), tmp_path, topic="/front/chat") as made:
            before = await run_on(made, ALL)
            stand_in.install("demo", text="new")
            assert (await made.change("Later", role=TALKER)).outcome == "done"
            for ends in (False, True):
                await made.hears()
                await kill(made, TALKER)
                if ends:
                    await another(made)
                after = await run_on(made, ALL)
                await made.hears()
                assert made.heard[-1][1].endswith("-new")
                assert after["front/other"] == after["front/maker"] == before["front/other"] != after[TALKER]

    with ended():
        run(main())


def test_one_that_ends_its_container_as_it_is_loaded_does_so_once(stand_in: StandIn, tmp_path: Path) -> None:
    async def main() -> None:
        async with robot(system(tmp_path), tmp_path, topic="/front/other") as made:
            await run_on(made, ALL)
            faults(tmp_path, f"/{TALKER} abort")
            await kill(made, "front/other")
            alone = await run_on(made, ("front/maker", "front/other"))
            await made.hears()
            [said] = [each for each in events(made, "note") if "beside others" in each]
            assert said.startswith(f"{TALKER} is not loaded beside others again until `midstride restart front/pipe")
            await made.until(lambda: bool(events(made, "respawn_ended")), 120)
            assert (await pids(made))["front/other"] == alone["front/other"], "its restarts have ended nothing else"
            faults(tmp_path)
            done = await made.meanwhile(made.manager.change(PlanRequest(restart=(TALKER,))))
            assert (done.outcome, done.because) == ("done", None)
            whole = await run_on(made, ALL)
            assert whole["front/other"] == whole["front/maker"] == alone["front/other"] != whole[TALKER]
            assert (
                await made.manager.change(PlanRequest(restart=("front/pipeline",), with_other_nodes=True))
            ).outcome == "done"
            assert len(set((await run_on(made, ALL)).values())) == 1

    with ended():
        run(main())


def test_one_whose_constructor_hangs_is_never_there_twice(stand_in: StandIn, tmp_path: Path) -> None:
    async def main() -> None:
        node = system(tmp_path).nodes[TALKER]
        specification = system(tmp_path).without_node(TALKER)
        async with robot(specification, tmp_path, topic="/front/other") as made:
            before = await run_on(made, ("front/maker", "front/other"))
            faults(tmp_path, f"/{TALKER} hang")
            refused = await made.meanwhile(made.manager.change(PlanRequest(add=(node,))))
            assert refused.outcome == "rolled_back", refused
            assert "The constructor of front/talker may still run in front/pipeline" in str(refused.because)
            assert await pids(made) == before
            condition = (await made.manager.status()).condition
            # The container has one thread, so its other nodes may be reported as silent as well.
            said = [each for each in condition.faults if "has not answered the request to load" in each]
            assert len(said) == 1 and said[0].startswith("front/pipeline has not answered the request to load"), said
            assert "front/talker. " in said[0]
            again = await made.meanwhile(made.manager.change(PlanRequest(add=(node,))))
            assert "front/talker would be there twice" in str(again.because), again
            await another(made)
            faults(tmp_path)
            done = None
            while done is None or done.outcome != "done":
                done = await made.meanwhile(made.manager.change(PlanRequest(add=(node,))))
                assert done.outcome == "done" or "would be there twice" in str(done.because), done
                await asyncio.sleep(0.1)
            assert len(set((await run_on(made, ALL)).values())) == 1
            await made.hears()

    with ended():
        run(main())


def test_one_whose_destructor_hangs_has_ended_once_it_returns(stand_in: StandIn, tmp_path: Path) -> None:
    """The replacement goes on. The container has one thread, so the others stand still until then."""

    async def main() -> None:
        async with robot(system(tmp_path), tmp_path, topic="/front/chat") as made:
            before = await run_on(made, ALL)
            faults(tmp_path, f"/{TALKER} linger")
            failed = await made.change("Later", role=TALKER)
            assert failed.outcome == "failed"
            unknown = f"{TALKER} may still end in front/pipeline, which has not answered"
            assert unknown in str(failed.because) and "; what has been done stays" in str(failed.because)
            await made.hears()  # only the new one can write
            assert any(each.startswith(unknown) for each in (await made.manager.status()).condition.faults)
            faults(tmp_path)
            await made.until(lambda: TALKER not in made.manager.configuration.instances)
            after = await run_on(made, ALL)
            assert after["front/other"] == after["front/maker"] == before["front/other"] != after[TALKER]

    with ended():
        run(main())


@pytest.mark.parametrize("manager", ["the same", "another"])
@pytest.mark.parametrize("fault", ["linger", "stay"])
def test_a_container_that_hangs_as_a_node_is_to_end_is_restarted(
    stand_in: StandIn, tmp_path: Path, manager: str, fault: str
) -> None:
    """With all of its nodes, although it answers no request; then each of them is replaced as before."""

    async def main() -> None:
        async with robot(system(tmp_path), tmp_path, topic="/front/chat") as made:
            before = await run_on(made, ALL)
            faults(tmp_path, f"/{TALKER} {fault}")
            failed = await made.change("Later", role=TALKER)
            assert failed.outcome == ("failed" if fault == "linger" else "done")
            if manager == "another":
                await another(made)
            beside = await made.change("Later", role="front/other")
            assert beside.outcome in {"failed", "rolled_back"}, beside
            assert "front/other goes on in front/pipeline" in str(beside.because)
            assert "`midstride restart front/pipeline`" in str(beside.because)
            whole = PlanRequest(restart=("front/pipeline",), with_other_nodes=True)
            done = await made.meanwhile(made.manager.change(whole))
            assert (done.outcome, done.because) == ("done", None), done
            after = await run_on(made, ALL)
            assert len({*after.values()}) == 1 and {*after.values()}.isdisjoint(before.values())
            assert {*containers(tmp_path)} == {*after.values()}
            assert (await made.manager.status()).condition.faults == []
            faults(tmp_path)
            for role in ("front/other", TALKER):
                swapped = await made.change("Later", role=role)
                assert (swapped.outcome, swapped.because) == ("done", None)
            apart = await run_on(made, ALL)
            assert apart["front/maker"] == after["front/maker"] and len({*apart.values()}) == 3

    with ended():
        run(main())


POINTS = [
    ("up", 1.0),
    ("up", 2.0),
    ("up", 3.0),
    ("alone", 0.5),
    ("alone", 2.0),
    ("alone", 4.0),
    ("repack", 0.5),
    ("repack", 1.5),
    ("repack", 3.0),
    ("repack", 5.0),
    ("repack", 6.0),
    ("crash", 0.05),
    ("crash", 0.5),
    ("crash", 1.5),
    ("crash", 3.0),
]


@pytest.mark.timeout(1500)
@pytest.mark.parametrize("both", [False, True], ids=["the manager", "the manager and a container"])
def test_a_manager_that_is_killed_leaves_nothing_that_runs_twice(stand_in: StandIn, tmp_path: Path, both: bool) -> None:
    """At many moments of what it does. The next one restores everything, in one plan."""
    specification = system(tmp_path)
    (tmp_path / "system").mkdir()

    async def main() -> None:
        manager = manager_of(specification, tmp_path)
        with Bare("recorder") as bare:
            for doing, seconds in POINTS:
                made = Robot(tmp_path, manager, bare)
                said = await asyncio.to_thread(be_killed, stand_in, tmp_path, doing, seconds)
                assert said == "", (doing, seconds)
                if both:
                    await asyncio.to_thread(kill_a_container, tmp_path)
                made.manager = manager_of(specification, tmp_path)
                report = await made.manager.up()
                changes = len(events(made, "plan"))
                print(doing, seconds, report.outcome, report.half_done, changes, flush=True)
                processes = await run_on(made, ALL)
                assert {*containers(tmp_path)} == {*processes.values()}, (doing, seconds)
                assert (await made.manager.status()).valid
                heard = await writers_of(made, "/front/chat")
                assert len(heard) == 1, (doing, seconds, heard)
                await made.manager.close()
            manager = manager_of(specification, tmp_path)
            await manager.up()
            await manager.down()
            await manager.close()

    with ended():
        run(main(), 1480)


def be_killed(stand_in: StandIn, folder: Path, doing: str, seconds: float) -> str:
    """Have a manager killed that has begun with that; what it has said of errors."""
    command = [sys.executable, "-m", "tests.acceptance._container_manager", str(folder), doing, str(seconds)]
    paths = filter(None, (str(stand_in.python), os.environ.get("PYTHONPATH")))
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}
    done = subprocess.run(
        command, cwd=ROOT, env=environment, check=False, timeout=100, stderr=subprocess.PIPE, text=True
    )
    assert done.returncode == -signal.SIGKILL, done.stderr
    return "".join(line for line in done.stderr.splitlines(keepends=True) if "Error" in line)


def containers(folder: Path) -> dict[int, str]:
    """The processes of containers that run, each with the name that it was started with."""
    saved = StateStore(Workspace(folder / "system").state).load()
    assert saved is not None
    found = {}
    for process in reaper.processes():
        own = reaper.environment_value(process.pid, ENV_TOKEN) == saved.token
        if own and reaper.program_name(process.pid) == "component_container"[:15]:
            found[process.pid] = str(reaper.environment_value(process.pid, ENV_INSTANCE))
    return found


def kill_a_container(folder: Path) -> None:
    for pid in list(containers(folder))[:1]:
        os.kill(pid, signal.SIGKILL)


async def writers_of(made: Robot, topic: str) -> set[str]:
    """The names of those that are heard on ``topic`` in a second."""
    from std_msgs.msg import String

    heard: list[str] = []
    listening = made.bare.node.create_subscription(String, topic, lambda message: heard.append(message.data), 1000)
    await made.until(lambda: len(heard) >= 60)
    made.bare.node.destroy_subscription(listening)
    return {each.split()[0] for each in heard[10:]}

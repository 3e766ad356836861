"""`down`, and the end of the manager, while it waits: for a node that does not come, a probation, another program.

In virtual time, with a real manager on the simulator. What is waited for takes tens of seconds.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import replace as changed
from pathlib import Path

import pytest

from midstride.backends.simulator import Simulator
from midstride.errors import ManagerError
from midstride.model.component import ComponentSpec
from midstride.model.specification import Node, Specification
from midstride.runtime.manager import Manager
from midstride.runtime.options import NO_OPTIONS, SystemOptions
from midstride.runtime.process.pending_starts import REGISTRATION_TIMEOUT
from midstride.runtime.records.reports import Event
from midstride.runtime.workspace import Workspace
from midstride.server.manager_lifecycle import Lifecycle
from tests.runtime.systems import EXAMPLES, example, replace, rewritten

# Runs, and never registers.
HANGS = "import time\nwhile True:\n    time.sleep(1)\n"
LATE = "import time\ntime.sleep(20)\n" + (EXAMPLES / "talker" / "talker.py").read_text()
# Within which time everything has ended (s): the processes are sent a signal, and some are killed.
SOON = 6.0

Robot = Callable[[Path], Specification]


@pytest.fixture
def programs(tmp_path: Path) -> Path:
    return rewritten("talker", tmp_path / "programs", lambda _, text: text)


def hanging(programs: Path) -> Specification:
    """Its talker never registers."""
    (programs / "talker.py").write_text(HANGS)
    return example("talker", programs)


def late(programs: Path) -> Specification:
    """Its talker takes 20 s to register."""
    (programs / "talker.py").write_text(LATE)
    return example("talker", programs)


def unfinished(programs: Path) -> Specification:
    """It has a program that is to end, and does not."""
    (programs / "once.py").write_text(HANGS)
    specification = example("talker", programs)
    once = ComponentSpec.of("Once", run="python3 once.py", once=True, gate="none")
    components = specification.components.set("Once", once)
    return changed(specification, components=components).with_node(Node("once", "Once"))


async def ends(lifecycle: Lifecycle, how: str) -> None:
    """End the system, or leave it to the next manager."""
    if how == "down":
        await lifecycle.take_down()
        assert lifecycle.phase == "down"
    else:
        await lifecycle.interrupt()
        assert lifecycle.phase == "failed"


@pytest.mark.parametrize("how", ["down", "terminated"])
@pytest.mark.parametrize("strict", [False, True])
@pytest.mark.parametrize("robot", [hanging, late, unfinished])
@pytest.mark.parametrize("after", [0.5, 5.0])
def test_a_start_that_waits_is_broken_off_at_once(
    robot: Robot, how: str, strict: bool, after: float, tmp_path: Path, programs: Path
) -> None:
    simulator = Simulator()

    async def main() -> None:
        options = SystemOptions(strict=True) if strict else NO_OPTIONS
        manager = Manager(robot(programs), simulator, Workspace(tmp_path), programs, options=options)
        lifecycle = Lifecycle(manager)
        lifecycle.bring_up()
        over = asyncio.ensure_future(lifecycle.until_over())
        await asyncio.sleep(after)
        assert simulator.processes and not lifecycle.up_ended.is_set(), "the test missed what it is about"
        begun = simulator.clock.steady()
        await ends(lifecycle, how)
        assert simulator.clock.steady() - begun < SOON
        assert not simulator.processes and not Workspace(tmp_path).state.exists()
        why = "`down` stops the system" if how == "down" else "the manager was terminated"
        with pytest.raises(ManagerError, match=f"not up: {why}; the operation was interrupted and rolled back"):
            await lifecycle.outcome_of_up()
        await over
        await manager.close()

    simulator.run(main())


@pytest.mark.parametrize("how", ["down", "terminated"])
def test_a_manager_that_waits_for_what_an_earlier_one_has_left_is_interrupted_at_once(
    how: str, tmp_path: Path, programs: Path
) -> None:
    simulator = Simulator()

    async def main() -> None:
        workspace = Workspace(tmp_path)
        first = Manager(example("talker", programs), simulator, workspace, programs)
        await first.up()
        await first.close()
        simulator.faults.kill("talker")
        (programs / "talker.py").write_text(HANGS)
        manager = Manager(first.specification, simulator, workspace, programs)
        lifecycle = Lifecycle(manager)
        lifecycle.bring_up()
        await asyncio.sleep(5)
        assert sorted(simulator.processes) == ["listener", "talker"] and not lifecycle.up_ended.is_set()
        begun = simulator.clock.steady()
        await ends(lifecycle, how)
        assert simulator.clock.steady() - begun < SOON
        assert sorted(simulator.processes) == ([] if how == "down" else ["listener"])
        assert workspace.state.exists() is (how != "down")
        await manager.close()

    simulator.run(main())


def test_nothing_else_is_started_where_the_cancellation_comes_in_a_roll_back(tmp_path: Path, programs: Path) -> None:
    """The roll-back goes on to its end, and each missing node would then be tried alone."""
    simulator = Simulator()
    specification = example("talker", programs)
    specification = specification.with_node(changed(specification.nodes["talker"], role="another"))

    async def main() -> None:
        workspace = Workspace(tmp_path)
        first = Manager(specification, simulator, workspace, programs)
        await first.up()
        await first.close()
        for name in ("talker", "another"):
            simulator.faults.kill(name)
        manager = Manager(specification, simulator, workspace, programs)
        lifecycle = Lifecycle(manager)
        interrupting: list[asyncio.Task[None]] = []

        def interrupt(event: Event) -> None:
            if event.kind == "step" and "create" in event.words:  # what has lost its input has been degraded by then
                simulator.faults.fail_next("listener", "modes", "refused", times=99)
            if event.kind == "rollback":
                interrupting.append(asyncio.ensure_future(lifecycle.interrupt()))

        manager.events.listeners.append(interrupt)
        await lifecycle.bring_up()
        await asyncio.gather(*interrupting)
        assert len(interrupting) == 1 and sorted(simulator.processes) == ["listener"]
        assert lifecycle.phase == "failed"
        await manager.close()

    simulator.run(main())


def test_down_breaks_off_a_change_that_waits(tmp_path: Path, programs: Path) -> None:
    simulator = Simulator()
    specification = example("talker", programs)
    (programs / "new_talker.py").write_text(HANGS)

    async def main() -> None:
        manager = Manager(specification, simulator, Workspace(tmp_path), programs)
        lifecycle = Lifecycle(manager)
        await lifecycle.bring_up()
        changing = asyncio.ensure_future(lifecycle.carry_out(manager.change(replace("talker", "NewTalker"))))
        waiting = asyncio.ensure_future(lifecycle.carry_out(manager.change(replace("listener", "Listener"))))
        await asyncio.sleep(5)
        assert "talker_2" in simulator.processes and not changing.done()
        begun = simulator.clock.steady()
        await lifecycle.take_down()
        assert simulator.clock.steady() - begun < SOON < REGISTRATION_TIMEOUT
        for each in (changing, waiting):
            with pytest.raises(ManagerError, match=r"^`down` stops the system; the operation was interrupted"):
                await each
        assert not simulator.processes and lifecycle.phase == "down"
        await manager.close()

    simulator.run(main())


def test_a_start_that_could_not_be_ended_whole_leaves_a_manager_that_exits(tmp_path: Path, programs: Path) -> None:
    simulator = Simulator()

    async def main() -> None:
        manager = Manager(hanging(programs), simulator, Workspace(tmp_path), programs)
        lifecycle = Lifecycle(manager)
        lifecycle.bring_up()
        over = asyncio.ensure_future(lifecycle.until_over())
        await asyncio.sleep(5)

        async def fails(_: str | None) -> None:
            raise ManagerError("listener could not be ended")

        manager.down = fails  # type: ignore[method-assign, assignment]
        with pytest.raises(ManagerError, match="listener could not be ended"):
            await lifecycle.carry_out(lifecycle.take_down(), breakable=False)
        await asyncio.wait_for(over, 10)
        assert lifecycle.phase == "failed"
        await manager.close()

    simulator.run(main())

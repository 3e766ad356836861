"""A component that starts in a spare process is replaced, found by the next manager, and ended like any other."""

from __future__ import annotations

import asyncio
import json
import os
import signal
from pathlib import Path
from typing import Any

import pytest

from midstride import backends
from midstride.backends.fork_client import ForkServer
from midstride.backends.processes import ProcessBackend
from midstride.lang.load import load_text
from midstride.model.specification import Specification
from midstride.runtime.manager import Manager
from midstride.runtime.options import SystemOptions
from midstride.runtime.process.reaper import process_info
from midstride.runtime.workspace import Workspace
from tests.acceptance.support import BENCHMARKS, ended, other_source, swap_specification
from tests.backends.ros2_support import (
    TALKER,
    messages_are_numbered,
    publishers_are_told_apart,
    run,
    until_async,
)

pytestmark = [pytest.mark.ros2, pytest.mark.full]

SHOW = """
import json, os, sys
print(json.dumps({
    "argv": sys.argv, "file": __file__, "name": __name__, "directory": os.getcwd(), "path": sys.path[0],
    # The token is that of the system, and the mark that of the start.
    "environment": {k: v for k, v in os.environ.items() if k not in ("MIDSTRIDE_TOKEN", "MIDSTRIDE_START")},
    "leads": os.getsid(0) == os.getpid(), "manager": os.getppid(), "threads": len(os.listdir("/proc/self/task")),
}))
"""
TALKERS = """
system forks
contract Ticks = std_msgs/msg/String @ 50 Hz
component Talker {
  run "python3 talker.py 'one two' --three"
  output out
  functionality talk { produces out
    mode normal { guarantee out : Ticks }
    mode degraded { } }
}
"""


def talkers(number: int) -> Specification:
    nodes = (f"topic /t{n} : Ticks\nnode talker{n} : Talker {{ out -> /t{n} }}" for n in range(number))
    return load_text("\n".join([TALKERS, *nodes]), "forks.stride").require()


def test_components_start_in_spares_and_outlive_their_manager(tmp_path: Path) -> None:
    (tmp_path / "system").mkdir()
    workspace = Workspace(tmp_path / "system")

    def new_manager(specification: Specification) -> tuple[Manager, ProcessBackend]:
        backend = backends.make("ros2", workspace)
        assert isinstance(backend, ProcessBackend)
        options = SystemOptions(spares=1)
        return Manager(specification, backend, workspace, BENCHMARKS, options=options), backend

    async def ready(backend: ProcessBackend) -> int:
        await until_async(lambda: asyncio.sleep(0, backend.spares() == 1))
        assert backend._spares is not None
        return backend._spares._spares[0].process.pid

    async def scenario() -> None:
        manager, backend = new_manager(swap_specification())
        await manager.up()
        spares = []
        for _ in range(3):
            spares.append(await ready(backend))
            outcome = await manager.change(other_source(manager))
            assert (outcome.outcome, outcome.because) == ("done", None)
            [swap] = outcome.swaps
            assert swap.lost == 0 or (swap.lost is None and not messages_are_numbered())
            assert swap.duplicates == 0 or (swap.duplicates is None and not publishers_are_told_apart())
            source = next(each for each in (await manager.status()).instances if each.role == "source")
            assert source.pid == spares[-1]
        status = await manager.status()
        assert status.valid and status.spares.kept == 1 and status.spares.unused_by == []
        idle = await ready(backend)
        await manager.close()
        assert process_info(idle) is None  # it exits with its manager

        manager, _ = new_manager(manager.specification)
        await manager.up()
        status = await manager.status()
        assert status.valid and spares[-1] in [each.pid for each in status.instances]
        await manager.down()
        await manager.close()
        ended_process = process_info(spares[-1])  # which is a child of this process, so nothing has reaped it
        assert ended_process is None or not ended_process.alive

    with ended():
        run(scenario())


def test_a_component_that_is_forked_is_as_one_that_is_started(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "system").mkdir()
    (tmp_path / "talker.py").write_text(
        # In both, the threads of LTTng and of OpenBLAS then exist, whose own are started when they are needed.
        "import rclpy.node, numpy\nnumpy.ones((300, 300)) @ numpy.ones((300, 300))\n"
        + SHOW
        + TALKER.replace("comp.start()", 'comp.on_stop(lambda: print("stopped"))\ncomp.start()')
    )
    workspace, specification = Workspace(tmp_path / "system"), talkers(1)
    forked: list[int] = []
    fork = ForkServer.fork

    async def counted(server: ForkServer, request: bytes) -> Any:
        process, channel = await fork(server, request)
        forked.append(process.pid)
        return process, channel

    monkeypatch.setattr(ForkServer, "fork", counted)

    async def scenario(spares: int) -> tuple[Any, list[str]]:
        def new_manager() -> Manager:
            options = SystemOptions(spares=spares)
            return Manager(specification, backends.make("ros2", workspace), workspace, tmp_path, options=options)

        manager = new_manager()
        await manager.up()
        (component,) = (await manager.status()).instances
        log = Path(str(manager.system.life.handles["talker0"].log))
        assert (component.pid in forked) == bool(spares)
        await manager.close()
        manager = new_manager()  # which finds what has outlived the other one
        await manager.up()
        status = await manager.status()
        assert status.valid and [each.pid for each in status.instances] == [component.pid]
        await manager.down()
        await manager.close()
        begun, shown, *lines = log.read_text().splitlines()
        assert begun.startswith("==== talker0 was started ")
        log.unlink()
        return json.loads(shown), lines

    with ended():
        started, forked_ = run(scenario(0)), run(scenario(1))
    assert started[0] == forked_[0]
    assert "stopped" in started[1] and "stopped" in forked_[1]


def test_killing_the_fork_server_harms_no_component_and_no_bring_up(tmp_path: Path) -> None:
    (tmp_path / "system").mkdir()
    (tmp_path / "talker.py").write_text(TALKER)
    workspace = Workspace(tmp_path / "system")

    async def scenario() -> None:
        backend = backends.make("ros2", workspace)
        assert isinstance(backend, ProcessBackend)
        options = SystemOptions(spares=1)
        manager = Manager(talkers(4), backend, workspace, tmp_path, options=options)

        async def kill() -> ForkServer:
            await until_async(lambda: asyncio.sleep(0, backend._spares and backend._spares.server))
            assert backend._spares is not None and backend._spares.server is not None
            server = backend._spares.server
            await until_async(lambda: asyncio.sleep(0, server.loaded or backend.spares() == 1))
            os.kill(server.process.pid, signal.SIGKILL)
            await until_async(lambda: asyncio.sleep(0, server.failed))
            return server

        first, _ = await asyncio.gather(kill(), manager.up())
        status = await manager.status()
        assert status.valid and len(status.instances) == 4
        assert await kill() is not first
        again = await manager.status()
        assert again.valid and [each.pid for each in again.instances] == [each.pid for each in status.instances]
        await manager.down()
        await manager.close()

    with ended():
        run(scenario())

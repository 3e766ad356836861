"""A component that starts in a spare process is replaced, found by the next manager, and ended like any other."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from midstride import backends
from midstride.backends.processes import ProcessBackend
from midstride.model.specification import Specification
from midstride.runtime.manager import Manager
from midstride.runtime.options import SystemOptions
from midstride.runtime.reaper import process_info
from midstride.runtime.workspace import Workspace
from tests.acceptance.support import BENCHMARKS, ended, other_source, swap_specification
from tests.backends.ros2_support import run, until_async

pytestmark = [pytest.mark.ros2, pytest.mark.full]


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
            assert [(swap.lost, swap.duplicates) for swap in outcome.swaps] == [(0, 0)]
            source = next(each for each in (await manager.status()).components if each.role == "source")
            assert source.pid == spares[-1]
        status = await manager.status()
        assert status.valid and status.spares.kept == 1 and status.spares.unused_by == []
        idle = await ready(backend)
        await manager.close()
        assert process_info(idle) is None  # it exits with its manager

        manager, _ = new_manager(manager.specification)
        await manager.up()
        status = await manager.status()
        assert status.valid and spares[-1] in [each.pid for each in status.components]
        await manager.down()
        await manager.close()
        ended_process = process_info(spares[-1])  # which is a child of this process, so nothing has reaped it
        assert ended_process is None or not ended_process.alive

    with ended():
        run(scenario(), 120)

"""Replacements on real ROS 2 while subscribers still count publishers that were killed, whose leases run out."""

from __future__ import annotations

import asyncio
import os
import signal
import time
from pathlib import Path

import pytest

from midstride.plan.request import PlanRequest
from tests.acceptance.support import ended, managed, other_source, pids, swap_specification
from tests.backends.ros2_support import run, until_async

pytestmark = [pytest.mark.ros2, pytest.mark.long, pytest.mark.timeout(900)]

KILLS = 6
# For how long Fast DDS counts a publisher that was killed (s), and a margin.
LEASE, MARGIN = 20.0, 5.0


def test_no_replacement_is_refused_while_leases_of_killed_publishers_run_out(tmp_path: Path) -> None:
    specification = swap_specification()

    async def main() -> None:
        async with managed(tmp_path, specification) as (manager, _):
            killed: set[int] = set()
            for _ in range(KILLS):
                killed.add(pids(manager)["source"])
                os.kill(pids(manager)["source"], signal.SIGKILL)

                async def noticed() -> bool:
                    return all(row.name != "source" for row in (await manager.status()).instances)

                await until_async(noticed, 30.0)
                assert (await manager.change(PlanRequest(to=specification))).outcome == "done"
            assert len(killed) == KILLS
            until = time.monotonic() + LEASE + MARGIN
            while time.monotonic() < until:
                result = await manager.change(other_source(manager))
                assert result.outcome == "done", result.because
                await asyncio.sleep(0)

    with ended():
        run(main(), 600.0)

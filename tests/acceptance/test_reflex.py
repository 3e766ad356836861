"""On real ROS 2, a chain of components falls into its safe modes without a manager when its publisher is stopped."""

from __future__ import annotations

import asyncio
import os
import signal
import time
from pathlib import Path

import pytest

from midstride.node.control.shortfall import FLOOR
from tests.acceptance.support import benchmark, ended
from tests.backends.ros2_support import run

pytestmark = pytest.mark.ros2

# How long a loaded machine may take beyond the tolerated silence, for each hop (s).
SLACK = 10.0


@pytest.mark.full
def test_dependants_of_a_stopped_publisher_fall_without_a_manager_and_are_restored(tmp_path: Path) -> None:
    async def body() -> None:
        reflex = benchmark("reflex")
        system, falls = reflex.System(tmp_path), reflex.Falls(tmp_path)
        await system.up()
        try:
            await system.restored()
            pid = await system.pid()
            await system.close()  # as good as dead: components hear nothing of it
            begun = time.monotonic_ns()
            os.kill(pid, signal.SIGSTOP)
            try:
                times: list[float | None] = [None]
                while None in times:
                    await asyncio.sleep(0.1)
                    times = [falls.since(name, begun) for name in reflex.CHAIN[1:]]
                    assert time.monotonic_ns() - begun < 3 * (FLOOR + SLACK) * 1e9, times
            finally:
                os.kill(pid, signal.SIGCONT)
            found = [at for at in times if at is not None]
            # The last message came up to a period before; each hop takes as long, and no less.
            assert found[0] >= FLOOR - 0.05
            assert found[1] - found[0] >= FLOOR - 0.05
            assert found[2] - found[1] >= FLOOR - 0.05
        finally:
            if system.manager is None:
                await system.up()
            await system.restored()
            await system.manager.down()
            await system.close()

    with ended():
        run(body())


@pytest.mark.long
@pytest.mark.timeout(1800)
def test_faults_are_noticed_in_time_and_nothing_else_is(tmp_path: Path) -> None:
    """As often as `MIDSTRIDE_REFLEX_RUNS` says; then `MIDSTRIDE_REFLEX_HEALTHY` seconds with both cores busy."""
    count = int(os.environ.get("MIDSTRIDE_REFLEX_RUNS", "5"))
    seconds = float(os.environ.get("MIDSTRIDE_REFLEX_HEALTHY", "300"))

    async def body() -> None:
        reflex = benchmark("reflex")
        rows = await reflex.measure(tmp_path, count, list(reflex.FAULTS), ["alive", "dead"], seconds)
        windows = {"crash": FLOOR, "hang": FLOOR, "stop": FLOOR, "slow": 4 * FLOOR}
        for row in rows:
            if row["who"] not in reflex.CHAIN:
                continue
            if "false" in row:
                assert row["false"] == 0, row
                continue
            assert row["fell"] == row["runs"] == count, row
            alive = row["manager"] == "alive"
            hops = 0 if alive and row["fault"] == "crash" else 1 if alive else reflex.CHAIN.index(row["who"])
            assert row["p50"] <= windows[row["fault"]] + hops * (FLOOR + 0.5), row

    with ended():
        run(body(), 1700.0)

"""A publisher that is killed on real ROS 2 comes back by its restart policy, and is heard again."""

from __future__ import annotations

import asyncio
import os
import signal
import time
from dataclasses import replace
from pathlib import Path

import pytest

from midstride.model.respawn import RespawnPolicy
from tests.acceptance.support import Recorder, ended, managed, swap_specification
from tests.backends.ros2_support import run, until_async

pytestmark = [pytest.mark.ros2, pytest.mark.full]

# How long the restart may take (s): it takes 2 on an idle machine.
RESTORED = 120.0


def test_a_killed_publisher_comes_back_and_bare_subscribers_hear_it_again(tmp_path: Path) -> None:
    (tmp_path / "later").mkdir()
    specification = swap_specification()
    specification = specification.with_node(replace(specification.nodes["source"], respawn=RespawnPolicy()))

    async def main() -> None:
        async with managed(tmp_path / "system", specification) as (manager, _):
            recorder = Recorder(tmp_path)
            await asyncio.to_thread(recorder.wait_until_it_hears)
            pids = {row.name: row.pid for row in (await manager.status()).instances}
            assert pids["source"] is not None
            killed = time.time_ns()
            os.kill(pids["source"], signal.SIGKILL)

            async def restored() -> bool:
                status = await manager.status()
                running = {row.name: row.pid for row in status.instances}
                dependants = await manager.why("sink.listen")
                again = running.get("source") not in (None, pids["source"])
                return again and status.valid and dependants.normal

            await until_async(restored, RESTORED)
            words = [event.words for event in manager.log()]
            [degraded] = [number for number, each in enumerate(words) if each.startswith("degrade sink.listen")]
            [restarted] = [number for number, each in enumerate(words) if each == "respawn source"]
            assert degraded < restarted
            later = Recorder(tmp_path / "later")  # by then, the first one has had time to find the new publisher
            await asyncio.to_thread(later.wait_until_it_hears)
            later.kill()
            assert any(row.source is not None and row.source > killed + 100_000_000 for row in recorder.stop())

    with ended():
        run(main(), 2 * RESTORED)

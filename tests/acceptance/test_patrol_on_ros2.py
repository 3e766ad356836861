"""The patrol robot on real ROS 2 with nodes that do not use Midstride's API: one of them watches it from outside."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from midstride.errors import CommandRefused
from midstride.lang.load import load
from midstride.plan.request import PlanRequest
from midstride.runtime.options import SystemOptions
from tests.acceptance.support import ROOT, ended, managed

FOLDER = ROOT / "examples" / "patrol"

pytestmark = [pytest.mark.ros2, pytest.mark.full]


def test_the_robot_never_drives_blind_while_drivers_are_replaced_and_die(tmp_path: Path) -> None:
    specification = load(FOLDER / "patrol_ros2.stride").require()
    observed = tmp_path / "observed.json"
    observer = specification.nodes["observer"]
    parameters = observer.parameters.set("file", str(observed))
    specification = specification.with_node(replace(observer, parameters=parameters))

    async def seen(name: str, at_least: float) -> dict[str, Any]:
        """What the observer has written once ``name`` is so large."""
        deadline = time.monotonic() + 60.0
        while True:
            found: dict[str, Any] = json.loads(observed.read_text() or "{}") if observed.exists() else {}
            if found.get(name, 0) >= at_least:
                return found
            assert time.monotonic() < deadline, found
            await asyncio.sleep(0.2)

    async def main() -> None:
        async with managed(tmp_path / "system", specification, FOLDER) as (manager, _):
            await seen("moved", 0.3)
            for role, component in (("camera", "LifecycleCamera"), ("lidar", "SmoothLidar")):
                outcome = await manager.change(PlanRequest(replace=((role, component),)))
                assert (outcome.outcome, outcome.because) == ("done", None)
            crashed = next(each for each in (await manager.status()).instances if each.role == "lidar")
            assert crashed.pid is not None
            os.kill(crashed.pid, signal.SIGKILL)
            written = (await seen("commands", 1))["commands"]
            found = await seen("commands", written + 100)
            # The stated time of reaction, and as much again for a machine that is busy.
            assert found["moved_blind"] < 1.0, found

    with ended():
        asyncio.run(main())


@pytest.mark.long
def test_the_hall_s_clock_drives_the_robot_twice_as_fast_as_real_time(tmp_path: Path) -> None:
    specification = load(FOLDER / "patrol.stride").require()
    world, trace = specification.nodes["world"], tmp_path / "trace.jsonl"
    parameters = world.parameters.set("trace", str(trace))
    specification = specification.with_node(replace(world, parameters=parameters))

    async def later(by: float) -> tuple[float, dict[str, Any]]:
        """When it wrote that the hall is ``by`` seconds further (s), and its state then.

        That is the time of the file: on a busy machine, the line may be read long after it was written.
        """
        begun, deadline = last()["time"], time.monotonic() + 60.0
        while True:
            written, found = changed(), last()
            if found["time"] >= begun + by and changed() == written:
                return written / 1e9, found
            assert time.monotonic() < deadline, found
            await asyncio.sleep(0.01)

    def changed() -> int:
        return trace.stat().st_mtime_ns if trace.exists() else 0

    def last() -> dict[str, Any]:
        """The last whole line that it has written."""
        lines = trace.read_text().split("\n")[:-1] if trace.exists() else []
        found: dict[str, Any] = json.loads(lines[-1]) if lines else {"time": 0.0}
        return found

    async def main() -> None:
        options = SystemOptions(use_sim_time=True)
        async with managed(tmp_path / "system", specification, FOLDER, options) as (manager, _):
            assert all(each.simulated_time for each in (await manager.status()).instances)
            await later(1.0)
            await manager.set_parameters("world", {"speed": 2.0})
            begun, before = await later(2.0)
            ended, after = await later(12.0)
            simulated = after["at"] - before["at"]
            assert simulated / (ended - begun) == pytest.approx(2.0, abs=0.3)
            while after["progress"] < before["progress"] + 2.0:  # at first it may wait for people
                after = last()
                assert after["time"] < before["time"] + 200.0, after
                await asyncio.sleep(0.1)
            # It drives as it does in real time, by its own clock: at 1.5 m/s at most.
            assert after["progress"] - before["progress"] < 1.6 * (after["at"] - before["at"])
            outcome = await manager.change(PlanRequest(replace=(("lidar", "SmoothLidar"),)))
            assert (outcome.outcome, outcome.because) == ("done", None)
            assert last()["collisions"] == 0
            with pytest.raises(CommandRefused, match=r"from 0 .* to 10, not 50"):
                await manager.set_parameters("world", {"speed": 50.0})

    with ended():
        asyncio.run(main())

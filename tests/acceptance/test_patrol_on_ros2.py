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

from midstride.lang.load import load
from midstride.plan.request import PlanRequest
from tests.acceptance.support import ROOT, ended, managed

FOLDER = ROOT / "examples" / "patrol"

pytestmark = [pytest.mark.ros2, pytest.mark.full]


@pytest.mark.timeout(240)
def test_it_never_drives_blind_while_drivers_are_replaced_and_die(tmp_path: Path) -> None:
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
            crashed = next(each for each in (await manager.status()).components if each.role == "lidar")
            assert crashed.pid is not None
            os.kill(crashed.pid, signal.SIGKILL)
            written = (await seen("commands", 1))["commands"]
            found = await seen("commands", written + 100)
            # The stated time of reaction, and as much again for a machine that is busy.
            assert found["moved_blind"] < 1.0, found

    with ended():
        asyncio.run(main())

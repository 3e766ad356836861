"""On real ROS 2, what the local reflex has degraded comes back without a command when its input does."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from tests.acceptance.support import BENCHMARKS, benchmark, ended
from tests.backends.ros2_support import run, until_async

pytestmark = [pytest.mark.ros2]

# At this rate a busy machine keeps what is promised, and does not pause for as long as is tolerated (s).
RATE, TOLERATED = 10.0, 3.0
ENVIRONMENT = {"MIDSTRIDE_REFLEX_RATE": f"{RATE:g}", "MIDSTRIDE_REFLEX_TOLERATED": f"{TOLERATED:g}"}
# How long a loaded machine may take beyond what is tolerated, for each hop (s).
SLACK = 20.0


@pytest.mark.full
def test_dependants_of_a_publisher_that_is_stopped_and_continued_come_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in ENVIRONMENT.items():
        monkeypatch.setenv(name, value)

    async def body() -> None:
        reflex = benchmark("reflex")
        system = reflex.System(tmp_path, reflex.specification(tmp_path, RATE, TOLERATED))
        falls = reflex.Falls(tmp_path)
        await system.up()
        try:
            await system.restored()
            pid, before = await system.pid(), len(system.manager.log())
            begun = time.monotonic_ns()
            os.kill(pid, signal.SIGSTOP)
            try:

                async def fallen() -> bool:
                    return all(falls.since(name, begun) is not None for name in reflex.CHAIN[1:])

                await until_async(fallen, 60.0)
            finally:
                os.kill(pid, signal.SIGCONT)

            async def restored() -> bool:
                status = await system.manager.status()
                modes = [each.mode for instance in status.instances for each in instance.functionalities]
                return modes == ["normal"] * 4 and bool(status.valid)

            await until_async(restored, 120.0)
            commands = [event.words for event in system.manager.log()[before:] if event.kind == "command"]
            assert commands and all(words.startswith("restore ") for words in commands), commands
        finally:
            await system.manager.down()
            await system.close()

    with ended():
        run(body())


def cut(folder: Path, count: int, *options: str, seconds: float) -> list[dict[str, Any]]:
    """What benchmarks/partition.py finds, in two network namespaces."""
    words = [sys.executable, str(BENCHMARKS / "partition.py"), "--runs", str(count), "--out", str(folder / "out.json")]
    with ended():
        process = subprocess.Popen([*words, *options], env={**os.environ, **ENVIRONMENT})
        try:
            assert process.wait(seconds) == 0
        finally:
            process.terminate()
            try:
                process.wait(30.0)
            finally:
                process.kill()
                for number in (1, 2):
                    subprocess.run(["ip", "netns", "del", f"midstride-{process.pid}-{number}"], capture_output=True)
    found: list[dict[str, Any]] = json.loads((folder / "out.json").read_text())
    assert len(found) == count
    for row in found:
        for hops, name in enumerate(("b", "c", "d"), start=1):
            assert TOLERATED - 0.5 <= row[name] <= hops * (TOLERATED + SLACK), row
        assert row["commands"] and all(words.startswith("restore ") for words in row["commands"]), row
    return found


@pytest.mark.hosts
@pytest.mark.timeout(420)
@pytest.mark.parametrize("length", [pytest.param(5, marks=pytest.mark.full), pytest.param(25, marks=pytest.mark.long)])
def test_components_beyond_a_link_that_is_cut_fall_and_come_back(length: float, tmp_path: Path) -> None:
    """For a moment, and for longer than the middleware remembers the other side (s)."""
    cut(tmp_path, 1, "--cut", f"{length:g}", "--calm", "1", seconds=360.0)


@pytest.mark.long
@pytest.mark.hosts
@pytest.mark.timeout(2400)
def test_components_beyond_a_link_that_is_cut_often_come_back_each_time(tmp_path: Path) -> None:
    """As often as `MIDSTRIDE_PARTITION_RUNS` says."""
    count = int(os.environ.get("MIDSTRIDE_PARTITION_RUNS", "20"))
    cut(tmp_path, count, "--cut", "5", "--calm", "20", seconds=2300.0)

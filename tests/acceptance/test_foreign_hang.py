"""A publisher in plain rclpy hangs: what relies on it is degraded within the stated window, and restored later.

Each of the two, the publisher and the node that relies on it, may have a library preloaded, or be behind a relay.
"""

from __future__ import annotations

import asyncio
import os
import signal
import sys
import time
from pathlib import Path

import pytest

from midstride import backends
from midstride.lang.load import load
from midstride.node.control.shortfall import LONG_FLOOR
from midstride.runtime.manager import Manager
from midstride.runtime.workspace import Workspace
from tests.acceptance.support import ended
from tests.acceptance.test_mode_parameters import PROGRAM, TEXT
from tests.backends.ros2_support import Bare, run
from tests.test_ament_index import planted

pytestmark = [pytest.mark.ros2, pytest.mark.full]

# How long a loaded machine may take beyond the tolerated silence (s).
SLACK = 20.0
OURS = """
from midstride import Component
from std_msgs.msg import String

comp = Component("Guard")
scan = comp.create_input("scan", String, rate=20)
watch = comp.create_functionality("watch", inputs=[scan])
watch.set_normal_mode(lambda message: None, inputs=[scan])
watch.set_degraded_mode(lambda: None)
comp.start()
"""
GUARD = """
component Guard {
  run "python3 guard.py"
  input scan : std_msgs/msg/String @ 20 Hz
  functionality watch {
    uses scan
    mode normal   { assume scan }
    mode degraded { }
  }
}

node guard : Guard { scan <- /scan }
"""


def program_of(pid: int) -> int:
    """The process of the program behind the relay ``pid``."""
    children = [path.read_text(encoding="ascii") for path in Path(f"/proc/{pid}/task").glob("*/children")]
    (found,) = " ".join(children).split()
    return int(found)


@pytest.mark.parametrize(
    ("lidar", "driver"),
    [
        ("preload", "preload"),
        ("relay", "relay"),
        pytest.param("relay", "preload", marks=pytest.mark.long),
        pytest.param("preload", "relay", marks=pytest.mark.long),
    ],
)
def test_dependants_of_a_hung_publisher_are_degraded_and_restored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, lidar: str, driver: str
) -> None:
    """One in plain rclpy, whose next mode is a set of parameters, and one that uses Midstride's API."""
    monkeypatch.setenv("AMENT_PREFIX_PATH", planted(tmp_path / "prefix", "drive_nodes", "start"))
    start = tmp_path / "prefix" / "lib" / "drive_nodes" / "start"
    start.write_text(f'#!/bin/sh\nexec {sys.executable} node.py "$@"\n', encoding="utf-8")
    (tmp_path / "node.py").write_text(PROGRAM, encoding="utf-8")
    (tmp_path / "guard.py").write_text(OURS, encoding="utf-8")
    text = TEXT.replace('"drive_nodes" gate preload', f'"drive_nodes" gate {lidar}')
    text = text.replace('driver" gate preload', f'driver" gate {driver}')
    (tmp_path / "drive.stride").write_text(text + GUARD, encoding="utf-8")
    (tmp_path / "system").mkdir()
    workspace = Workspace(tmp_path / "system")
    manager = Manager(load(tmp_path / "drive.stride").require(), backends.make("ros2", workspace), workspace, tmp_path)
    heard: list[str] = []

    async def scenario() -> None:
        from std_msgs.msg import String

        await manager.up()
        with Bare("recorder") as bare:
            bare.node.create_subscription(String, "/cmd", lambda message: heard.append(message.data), 1000)

            async def modes() -> tuple[str, str]:
                drive, watch = await manager.peek("driver"), await manager.peek("guard")
                return drive.functionalities["drive"].mode, watch.functionalities["watch"].mode

            async def become(wanted: tuple[str, str], seconds: float) -> None:
                deadline = time.monotonic() + seconds
                while (found := await modes()) != wanted:
                    assert time.monotonic() < deadline, (found, await manager.status())
                    await asyncio.sleep(0.05)

            await bare.until(lambda: heard[-5:] == ["1.0 2"] * 5, 60)
            pid = (await manager.peek("lidar")).pid
            if lidar == "relay":
                pid = program_of(pid)
            begun = time.monotonic()
            os.kill(pid, signal.SIGSTOP)
            try:
                await become(("slow", "degraded"), LONG_FLOOR + SLACK)
                assert time.monotonic() - begun >= LONG_FLOOR - 0.5
                await bare.until(lambda: heard[-5:] == ["0.25 5"] * 5, 60)
                drive = (await manager.peek("driver")).functionalities["drive"]
                assert drive.reflex and "input scan received nothing on /scan" in drive.because
            finally:
                os.kill(pid, signal.SIGCONT)
            await become(("normal", "normal"), 60)
            await bare.until(lambda: heard[-5:] == ["1.0 2"] * 5, 60)
        await manager.down()
        await manager.close()

    with ended():
        run(scenario())

"""A system on real ROS 1 beside nodes with the names of its replacements, and whose manager is killed."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from midstride.backends.ros1.master import Master
from tests.backends.ros1_support import free_port, own_master_uri, program
from tests.backends.ros2_support import run, until_async
from tests.backends.test_ros1_relay import OURS, TALKER
from tests.cli.conftest import Midstride

pytestmark = [pytest.mark.ros1, pytest.mark.full, pytest.mark.timeout(200)]

SYSTEM = """
system beside
contract Words = std_msgs/msg/String @ 50 Hz
topic /chat  : Words
topic /chat2 : Words
component Talker {
  run "python3 talker.py" gate relay
  parameters { say.word = "hello" }
  output out as chatter
  functionality talk { produces out  mode normal { guarantee out : Words }  mode degraded { } }
}
component Ours {
  run "python3 ours.py"
  output out
  functionality talk { produces out  mode normal { guarantee out : Words }  mode degraded { } }
}
node talker : Talker { out -> /chat }
node ours   : Ours { out -> /chat2 }
"""

# Of a program behind a relay, the status shows the node of the relay.
OWN = {"talker": "/talker_2_relay", "ours": "/ours_3"}


@pytest.fixture
def beside(midstride: Midstride, tmp_path: Path) -> tuple[Midstride, Path]:
    (tmp_path / "talker.py").write_text(TALKER)
    (tmp_path / "ours.py").write_text(OURS)
    file = tmp_path / "beside.stride"
    file.write_text(SYSTEM)
    return midstride, file


def nodes(midstride: Midstride) -> dict[str, str]:
    return {each["role"]: each["node"] for each in midstride("status", "--json").json["instances"]}


def test_nodes_outside_and_another_master(beside: tuple[Midstride, Path], tmp_path: Path) -> None:
    midstride, file = beside
    up = ("up", str(file), "-d", "--backend", "ros1")
    with own_master_uri() as uri:
        midstride.environment |= {"ROS_MASTER_URI": uri, "ROS_IP": "127.0.0.1"}
        done = midstride(*up, timeout=120)
        assert done.status == 0, done.out + done.err
        try:
            with (
                program("talker_2", "/chat", str(tmp_path / "first")),
                program("ours_2", "/chat2", str(tmp_path / "second")),
            ):
                names_are_free(midstride, uri)
                another_master_is_refused(midstride, up, uri)
                # The manager that has come knows which node is whose, and takes nothing back of those outside.
                assert midstride("restart", "talker", "ours", "--yes", timeout=60).status == 0
                assert {"/talker_2", "/ours_2"} <= registered(uri)
        finally:
            down = midstride("down", timeout=60)
        assert down.status == 0, down.err


def registered(uri: str) -> frozenset[str]:
    found: list[frozenset[str]] = []

    async def ask() -> None:
        found.append((await Master(uri, "/test").state()).nodes())

    run(ask())
    return found[0]


def names_are_free(midstride: Midstride, uri: str) -> None:
    async def known() -> bool:
        return {"/talker_2", "/ours_2"} <= (await Master(uri, "/test").state()).nodes()

    run(until_async(known))
    for node in ("talker", "ours"):
        restarted = midstride("restart", node, "--yes", timeout=60)
        assert restarted.status == 0, restarted.out + restarted.err
    assert nodes(midstride) == OWN
    assert {"/talker_2", "/ours_2", "/talker_3", "/ours_3"} <= registered(uri)


def another_master_is_refused(midstride: Midstride, up: tuple[str, ...], uri: str) -> None:
    os.kill(midstride.manager("beside"), signal.SIGKILL)
    other = f"http://127.0.0.1:{free_port()}"
    refused = midstride(*up, timeout=60, ROS_MASTER_URI=other)
    assert refused.status == 1, refused.out
    assert f"run with ROS_MASTER_URI={uri}, and this manager has ROS_MASTER_URI={other}, so it would" in refused.err
    done = midstride(*up, timeout=60)
    assert done.status == 0 and "was reattached unchanged" in done.out, done.out + done.err
    assert nodes(midstride) == OWN

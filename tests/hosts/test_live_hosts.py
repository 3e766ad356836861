"""A system on two hosts, over SSH and real ROS 2: network namespaces, an SSH server, and a link that can be cut."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from midstride.runtime.process.reaper import process_info
from tests.acceptance.support import ended
from tests.cli.conftest import EXAMPLES, Done
from tests.hosts.two_hosts import TwoHosts, two_hosts

pytestmark = [pytest.mark.ros2]
SECONDS = 40.0


@dataclass
class Robot:
    """The example `talker` with its talker on the host `arm`, and the command on the manager's host."""

    hosts: TwoHosts
    folder: Path
    text: str

    def __call__(self, *words: str, timeout: float = 90.0) -> Done:
        command = self.hosts.inside(sys.executable, "-m", "midstride", *words)
        done = subprocess.run(command, capture_output=True, text=True, timeout=timeout, env=self.environment, cwd="/")
        return Done(done.returncode, done.stdout, done.stderr)

    @property
    def environment(self) -> dict[str, str]:
        return {
            **os.environ,
            "XDG_RUNTIME_DIR": str(self.folder / "run"),
            "MIDSTRIDE_SSH_CONFIG": str(self.hosts.config),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET",
        }

    @property
    def file(self) -> str:
        path = self.folder / "talker" / "two.stride"
        path.write_text(self.text)
        return str(path)

    @property
    def status(self) -> Any:
        done = self("status", "--json")
        assert done.out, done.err
        return done.json

    def instance(self, role: str) -> Any:
        (found,) = (each for each in self.status["instances"] if each["role"] == role)
        return found

    def modes(self, role: str) -> list[str]:
        return [each["mode"] for each in self.instance(role)["functionalities"]]

    def running(self, program: str) -> list[int]:
        """The processes of this program in the test's folders, by number."""
        found = []
        for path in Path("/proc").glob("[0-9]*"):
            with contextlib.suppress(OSError):
                words = (path / "cmdline").read_bytes().split(b"\0")
                if program.encode() in words and self.folder in (path / "cwd").resolve().parents:
                    found.append(int(path.name))
        return sorted(found)

    def until(self, condition: Callable[[], bool], what: str, seconds: float = SECONDS) -> None:
        deadline = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < deadline, f"{what}: {self('status').out} {self('log').out}"
            time.sleep(0.2)

    @property
    def workspace(self) -> Path:
        """The one of the host process."""
        return self.folder / "far" / ".midstride" / "talker.arm"

    @property
    def host_process(self) -> int:
        return int((self.workspace / "lock").read_text())

    @property
    def manager(self) -> int:
        return int((self.folder / "run" / "midstride" / "talker" / "lock").read_text())


@pytest.fixture
def robot() -> Iterator[Robot]:
    folder = Path(tempfile.mkdtemp(prefix="ms-"))
    try:
        with ended(), two_hosts(folder) as hosts:
            for name in ("run", "far"):
                (folder / name).mkdir(mode=0o700)
            for name in ("talker", "far"):
                shutil.copytree(EXAMPLES / "talker", folder / name, dirs_exist_ok=True)
            text = (EXAMPLES / "talker" / "talker.stride").read_text()
            text = text.replace("system talker\n", f"system talker\n{hosts.declaration(folder / 'far')}")
            text = text.replace("node talker   : Talker ", "node talker : Talker on arm ")
            assert " on arm " in text
            robot = Robot(hosts, folder, text)
            try:
                yield robot
            finally:
                robot("down", timeout=60)
                for path in (robot.workspace / "lock",):
                    _end(int(path.read_text()) if path.exists() else None)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _end(pid: int | None) -> None:
    """End a host process of this test."""
    if pid is not None and (info := process_info(pid)) is not None and info.alive:
        command = Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0")
        if b"_host" in command:
            os.kill(pid, signal.SIGTERM)


@pytest.mark.full
@pytest.mark.timeout(120)
def test_a_system_on_two_hosts_comes_up_is_changed_crashes_and_is_ended(robot: Robot) -> None:
    up = robot("up", robot.file, "-d")
    assert up.status == 0, up.out + up.err
    talker = robot.instance("talker")
    assert talker["host"] == "arm" and talker["log_file"].startswith(f"arm:{robot.workspace}/logs/")
    assert Path(f"/proc/{talker['pid']}/cwd").resolve() == robot.folder / "far"
    assert "I heard: hello world" in robot("logs", "listener").out
    assert robot("logs", "talker").status == 0
    replaced = robot("replace", "talker", "NewTalker", "--yes", "--json")
    assert replaced.status == 0 and replaced.json["outcome"] == "done", replaced.out + replaced.err
    (swap,) = replaced.json["swaps"]
    assert (swap["topic"], swap["missed"]) == ("/chatter", 0), swap
    os.kill(robot.instance("talker")["pid"], signal.SIGKILL)
    robot.until(lambda: robot.status["crashed"] != [], "the crash is noticed")
    assert robot("down").status == 0
    robot.until(lambda: not (robot.workspace / "host.sock").exists(), "the host process ends once nothing is left")


@pytest.mark.long
@pytest.mark.timeout(300)
def test_a_host_outlives_the_manager_the_link_and_its_own_process(robot: Robot) -> None:
    assert robot("up", robot.file, "-d").status == 0
    pid = robot.instance("talker")["pid"]
    started = process_info(pid)
    # The manager is killed, and the next one finds all as it was.
    os.kill(robot.manager, signal.SIGKILL)
    assert robot("up", robot.file, "-d").status == 0
    assert robot.instance("talker")["pid"] == pid
    # The link is cut: the host is unreachable, and nothing is started elsewhere.
    robot.hosts.link("down")
    robot.until(lambda: not robot.instance("talker")["reachable"], "the host is not reachable")
    assert "arm cannot be reached" in _until_said(robot, "cannot be reached")
    assert robot.status["crashed"] == [] and process_info(pid) == started
    robot.hosts.link("up")
    robot.until(lambda: bool(robot.instance("talker")["reachable"]), "the host is reachable again")
    # The host process is killed, and started again; its components go on.
    os.kill(robot.host_process, signal.SIGKILL)
    robot.until(lambda: not robot.instance("talker")["reachable"], "the host process is gone")
    robot.until(lambda: bool(robot.instance("talker")["reachable"]), "the host process is there again")
    assert robot.instance("talker")["pid"] == pid
    # An exit while nothing watched is noticed.
    os.kill(robot.host_process, signal.SIGKILL)
    os.kill(pid, signal.SIGKILL)
    robot.until(lambda: robot.status["crashed"] != [], "the exit is noticed")
    assert robot("restart", "talker", "--yes").status == 0
    assert robot.instance("talker")["host"] == "arm"
    assert robot("down").status == 0


def _until_said(robot: Robot, words: str) -> str:
    robot.until(lambda: words in robot("log", "--all").out, words)
    return robot("log", "--all").out


OTHER_WAY = """
topic /back : Text

node caller : Talker { out -> /back }
node hearer : Listener on arm { in <- /back }
"""


@pytest.mark.long
@pytest.mark.timeout(300)
def test_while_the_link_is_cut_each_side_degrades_what_relies_on_the_other_and_then_all_is_as_it_was(
    robot: Robot,
) -> None:
    """To the nodes on `arm`, it is the manager's host that is cut off."""
    robot.text += OTHER_WAY
    assert robot("up", robot.file, "-d").status == 0
    before = {each["name"]: each["pid"] for each in robot.status["instances"]}
    (host,) = robot.status["hosts"]
    assert host["connected"] and host["instances"] == ["hearer", "talker"] and host["version"]
    assert "host arm (arm): connected since" in robot("status").out
    robot.hosts.link("down")
    robot.until(lambda: robot.instance("talker")["unreachable"], "the host is unreachable")
    robot.until(lambda: robot.modes("listener") == ["degraded"], "what relies on the host is degraded")
    shown = robot("status")
    assert shown.status == 3 and "host arm (arm): unreachable since" in shown.out, shown.out
    assert "nothing is known of hearer, talker" in shown.out
    assert robot.status["crashed"] == []
    assert "host arm cannot be reached" in robot("why", "talker.talk").out
    refused = robot("restart", "talker", "--yes")
    assert refused.status != 0 and "host arm cannot be reached" in refused.out + refused.err
    assert set(robot.running("talker.py")) == {before["talker"], before["caller"]}  # nothing is started elsewhere
    log = next((robot.workspace / "logs").glob("hearer*.log"))
    robot.until(lambda: "I hear nothing" in log.read_text(), "what relies on the manager's host is degraded there")
    robot.hosts.link("up")
    robot.until(lambda: robot.status["condition"]["state"] == "up", "all is as it was")
    after = robot.status
    assert {each["name"]: each["pid"] for each in after["instances"]} == before and after["valid"]
    assert after["hosts"][0]["connected"] and after["hosts"][0]["since"] > host["since"]
    replaced = robot("replace", "talker", "NewTalker", "--yes", "--json")
    assert replaced.status == 0 and replaced.json["swaps"][0]["missed"] == 0, replaced.out + replaced.err
    assert robot("down").status == 0


@pytest.mark.long
@pytest.mark.timeout(300)
def test_what_prevents_a_start_is_said_by_check_and_by_up(robot: Robot) -> None:
    assert robot("check", "--hosts", robot.file).status == 0
    program = robot.folder / "far" / "talker.py"
    program.rename(program.with_suffix(".away"))
    robot.text = robot.text.replace('"python3 talker.py"', '"./talker.py"')
    for words in (("check", "--hosts", robot.file), ("up", robot.file, "-d")):
        done = robot(*words)
        assert done.status != 0 and "there is no program ./talker.py" in done.out + done.err, done
    assert robot("down").status == 0
    robot.hosts.stop_serving()
    robot.hosts.serve("AllowStreamLocalForwarding no")
    for words in (("check", "--hosts", robot.file), ("up", robot.file, "-d")):
        done = robot(*words)
        assert done.status != 0 and "AllowStreamLocalForwarding yes" in done.out + done.err, done
    assert robot("down").status == 0
    robot.hosts.stop_serving()
    for words in (("check", "--hosts", robot.file), ("up", robot.file, "-d")):
        done = robot(*words)
        assert done.status != 0 and "refuses connections of SSH" in done.out + done.err, done
    assert robot("down").status == 0
    assert json.loads(robot("check", "--hosts", robot.file, "--json").out)["hosts"][0]["ok"] is False

"""The statements of the page on the security of several computers, each with its test."""

from __future__ import annotations

import asyncio
import json
import os
import re
import stat
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest

from midstride.cli.remote_logs import RemoteLogs
from midstride.errors import ManagerError
from midstride.model.hosts import HostSpec
from midstride.runtime.hosts import call_forms as calls
from midstride.runtime.hosts import host_frames as frames
from midstride.runtime.hosts import host_service, host_start, ssh
from midstride.runtime.hosts.host_order import HostOrder
from midstride.runtime.hosts.host_start import workspace_of
from midstride.runtime.hosts.hosts_backend import remove_socket_folder, socket_folder
from midstride.runtime.records.state_store import StateStore
from midstride.runtime.workspace import Workspace
from tests.cli.conftest import EXAMPLES
from tests.hosts.robots import Robot, robots
from tests.hosts.test_host_link import Far, launch, run

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "security-of-hosts.md"
TESTS = {
    "The manager has the rights of the SSH user there, and no others.": "test_a_workspace_of_another_user_is_refused",
    "Nothing of a declaration becomes an option of `ssh` or a command but `setup`.": (
        "test_nothing_of_the_declaration_is_taken_for_an_option_or_a_command"
    ),
    "SSH answers no question and forwards no agent and no display.": "test_ssh_asks_nothing_and_forwards_nothing_else",
    "What a host answers is data: nothing of it becomes a command, and no path but that of its socket, which SSH takes "
    "back to the host.": "test_a_path_that_a_host_answers_with_is_checked_before_it_is_forwarded",
    "Of its logs, only files with names of logs are copied, into a folder of this host alone below that of logs.": (
        "test_a_host_names_no_file_outside_the_folder_of_logs"
    ),
    "The folders of sockets have mode 0700 and the sockets 0600, on both sides.": (
        "test_nobody_else_can_open_a_socket_of_either_side"
    ),
    "The host process asks the kernel who connects, and answers its own user and root alone.": (
        "test_another_user_gets_no_answer"
    ),
    "No TCP port is opened, on no side.": "test_no_port_is_opened_no_secret_is_told_and_ros_commands_nothing",
    "A client that reads can change nothing,": "test_a_client_that_reads_can_change_nothing",
    "A manager of another start of the system is refused": (
        "test_the_next_manager_has_no_exits_of_the_one_before_and_another_system_is_refused"
    ),
    "The token of the system is in no argument of a process, in no log and not in the journal.": (
        "test_no_port_is_opened_no_secret_is_told_and_ros_commands_nothing"
    ),
    "The order of a manager is not in the arguments of a process either;": (
        "test_nothing_secret_and_nothing_of_the_order_is_in_the_arguments"
    ),
    "No command comes from the ROS network:": "test_no_port_is_opened_no_secret_is_told_and_ros_commands_nothing",
}


def test_each_statement_of_the_page_has_a_test() -> None:
    text = " ".join(PAGE.read_text().split())
    assert sorted(re.findall(r"\*\*(.+?)\*\*", text)) == sorted(TESTS)
    defined = "".join(path.read_text() for path in Path(__file__).parent.glob("test_*.py"))
    assert [name for name in TESTS.values() if f"def {name}(" not in defined] == []


@pytest.fixture
def folder() -> Iterator[Path]:
    """A folder with a short path, as sockets need it."""
    with tempfile.TemporaryDirectory(prefix="ms-") as name:
        yield Path(name)


@pytest.mark.skipif(os.getuid() != 0, reason="only root can give a folder to another user")
def test_a_workspace_of_another_user_is_refused(folder: Path) -> None:
    order = HostOrder(protocol=frames.HOST_PROTOCOL, system="home", host="arm", folder=str(folder))
    workspace = workspace_of(order)
    os.chown(workspace.path, 65534, 65534)
    with pytest.raises(ManagerError, match="belongs to another user"):
        workspace_of(order)


def test_a_check_beside_a_running_system_leaves_its_host_process_alone(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its own environment does not state all that the manager's order has."""
    ended: list[int] = []
    monkeypatch.setattr(host_start, "_end", ended.append)
    monkeypatch.setattr(host_start, "start", lambda order, workspace: None)
    order = HostOrder(protocol=frames.HOST_PROTOCOL, system="home", host="arm", folder=str(folder))
    workspace_of(order)
    for running in (0, 2):
        greeting = frames.HostGreeting(
            protocol=frames.HOST_PROTOCOL,
            version="1",
            control=1,
            system="home",
            host="arm",
            uuid="u",
            pid=7,
            running=running,
            variables={"ROS_DOMAIN_ID": "0"},
        )
        monkeypatch.setattr(host_start, "running", lambda workspace, greeting=greeting: greeting)
        assert host_start.find_or_start(msgspec.structs.replace(order, reads=True), "1").problem is None
        assert ended == []
    assert "with other settings (ROS_DOMAIN_ID=0)" in str(host_start.find_or_start(order, "1").problem)


def test_ssh_asks_nothing_and_forwards_nothing_else(tmp_path: Path) -> None:
    words = ssh.connect_command(HostSpec("arm", "robot@arm"), tmp_path / "c", {})
    asked = {"BatchMode=yes", "ForwardAgent=no", "ForwardX11=no", "ClearAllForwardings=yes", "PermitLocalCommand=no"}
    assert asked <= set(words) and not any("StrictHostKeyChecking" in word for word in words)


def test_nobody_else_can_open_a_socket_of_either_side(folder: Path) -> None:
    order = HostOrder(protocol=frames.HOST_PROTOCOL, system="home", host="arm", folder=str(folder))
    there = workspace_of(order)
    here = folder / "here"
    here.mkdir(mode=0o700)
    folders = [there.path.parent, there.path, socket_folder(Workspace(here))]
    assert [stat.S_IMODE(folder.stat().st_mode) for folder in folders] == [0o700] * 3
    assert "StreamLocalBindMask=0177" in ssh.connect_command(HostSpec("arm", "arm"), folder / "c", {})

    async def body() -> None:
        far = Far(folder)
        await far.run()
        assert stat.S_IMODE((folder / "host.sock").stat().st_mode) == 0o600
        await far.kill()

    run(body())


def test_another_user_gets_no_answer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async def body() -> None:
        far = Far(tmp_path)
        await far.run()
        reader, writer = await asyncio.open_unix_connection(tmp_path / "host.sock")
        frames.decode_greeting((await reader.readline()).rstrip(b"\n"))
        writer.close()
        monkeypatch.setattr(host_service, "_user", lambda _: 12345)
        reader, writer = await asyncio.open_unix_connection(tmp_path / "host.sock")
        assert await reader.read() == b""
        writer.close()
        await far.kill()

    run(body())


def test_a_client_that_reads_can_change_nothing(tmp_path: Path) -> None:
    async def body() -> None:
        far = Far(tmp_path)
        await far.run()
        reader, writer = await asyncio.open_unix_connection(tmp_path / "host.sock")
        await reader.readline()
        hello = frames.ReaderHello(protocol=frames.HOST_PROTOCOL)
        for frame, answer in (
            (hello, frames.Accepted),
            (frames.CallFrame(number=1, call=calls.ReadClock()), frames.ResultFrame),
        ):
            writer.write(frames.encode(frame) + b"\n")
            assert isinstance(frames.decode_from_host((await reader.readline()).rstrip(b"\n")), answer)
        start = calls.Start(launch=calls.LaunchForm.of(launch("a")))
        writer.write(frames.encode(frames.CallFrame(number=2, call=start)) + b"\n")
        assert await reader.read() == b"" and far.platform.launches == []
        writer.close()
        await far.kill()

    run(body())


def test_a_host_names_no_file_outside_the_folder_of_logs(tmp_path: Path) -> None:
    names = ["../escaped.log", "/tmp/escaped.log", "manager.log", "state.db", ".log/x.log", "a b.log"]

    async def accepted(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        greeting = frames.HostGreeting(
            protocol=frames.HOST_PROTOCOL, version="1", control=1, system="home", host="arm", uuid="u", pid=1
        )
        writer.write(frames.encode(greeting) + b"\n")
        await reader.readline()
        writer.write(frames.encode(frames.Accepted()) + b"\n")
        while line := await reader.readline():
            call = frames.decode_from_manager(line.rstrip(b"\n"))
            assert isinstance(call, frames.CallFrame)
            lengths = json.dumps(dict.fromkeys([*names, "a.log"], 4)).encode()
            result = lengths if isinstance(call.call, calls.ListLogs) else b'{"content": "bGllcw=="}'
            writer.write(b'{"frame": "result", "number": %d, "result": %s}\n' % (call.number, result))
        writer.close()

    async def body() -> None:
        workspace = Workspace(tmp_path / "home")
        workspace.path.mkdir(exist_ok=True)
        workspace.logs.mkdir(exist_ok=True)
        server = await asyncio.start_unix_server(accepted, socket_folder(workspace) / "arm.sock")
        logs = RemoteLogs(workspace, lambda _: True)
        await asyncio.to_thread(logs.refresh)
        assert logs.problems == {} and [*workspace.logs.rglob("*.log")] == [workspace.logs / "arm" / "a.log"]
        assert list(tmp_path.rglob("*escaped*")) == []
        logs.close()
        server.close()
        remove_socket_folder(workspace)

    run(body())


@pytest.fixture
def robot() -> Iterator[Robot]:
    text = (EXAMPLES / "talker" / "talker.stride").read_text()
    with robots(EXAMPLES / "talker", text.replace("node talker   : Talker ", "node talker : Talker on arm ")) as robot:
        yield robot


SERVED = """
import sys, time
import rclpy
rclpy.init()
node = rclpy.create_node("looks", start_parameter_services=False, enable_rosout=False)
time.sleep(3.0)
for name, namespace in node.get_node_names_and_namespaces():
    if "midstride" in name:
        for of in (node.get_service_names_and_types_by_node, node.get_subscriber_names_and_types_by_node):
            print("node", name, *(each for each, _ in of(name, namespace)))
rclpy.shutdown()
"""


@pytest.mark.ros2
@pytest.mark.hosts
@pytest.mark.long
@pytest.mark.timeout(120)
def test_no_port_is_opened_no_secret_is_told_and_ros_commands_nothing(robot: Robot) -> None:
    before = {side: robot.hosts.listening(side) for side in ("near", "far")}
    assert robot("up", robot.file, "-d").status == 0
    assert {side: robot.hosts.listening(side) for side in ("near", "far")} == before
    assert robot("replace", "talker", "NewTalker", "--yes").status == 0

    workspace = robot.folder / "run" / "midstride" / robot.system
    saved = StateStore(workspace / "state.db").load()
    assert saved is not None and len(saved.token) >= 32
    token = saved.token.encode()
    files = [path for path in robot.folder.rglob("*") if path.is_file()]
    assert [path.name for path in files if token in path.read_bytes() and "state.db" not in path.name] == []
    assert (workspace / "journal.db") in files and any(path.suffix == ".log" for path in files)
    commands = [path.read_bytes() for path in Path("/proc").glob("[0-9]*/cmdline") if path.exists()]
    assert not any(token in command for command in commands)

    looks = robot.hosts.inside(sys.executable, "-c", SERVED)
    done = subprocess.run(looks, capture_output=True, text=True, timeout=60, env=robot.environment)
    found = [line.split()[1:] for line in done.stdout.splitlines() if line.startswith("node ")]
    assert found and all(len(each) == 1 for each in found), done.stdout + done.stderr

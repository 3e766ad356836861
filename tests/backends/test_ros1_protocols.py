"""The manager's XML-RPC, connection headers, names and environments: plain Python, no ROS needed."""

from __future__ import annotations

import asyncio
import os
import socket
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xmlrpc.server import SimpleXMLRPCServer

import pytest

from midstride.backends import common, processes
from midstride.backends.ros1 import connection_headers, launching, master_process, names, rpc
from midstride.backends.ros1.backend import Ros1Backend
from midstride.backends.ros1.master import Master
from midstride.errors import BackendError, CallTimeout, NodeError, StartFailed, Unreachable
from midstride.model.component import KILL_AT_ONCE, ComponentSpec
from midstride.model.contract import QoS
from midstride.runtime.backend_protocol import Exited, Handle, Launch
from tests.backends.ros1_support import free_port
from tests.backends.ros2_support import run


@contextmanager
def python_server(**methods: Any) -> Iterator[str]:
    """Python's own XML-RPC server, as rospy's is built upon it."""
    with SimpleXMLRPCServer(("127.0.0.1", 0), logRequests=False, allow_none=False) as server:
        for name, method in methods.items():
            server.register_function(method, name)
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_address[1]}/"
        finally:
            server.shutdown()
            thread.join()


def test_a_call_is_understood_by_pythons_own_server() -> None:
    def echo(*arguments: Any) -> Any:
        return [1, "well", list(arguments)]

    with python_server(echo=echo) as uri:
        answer = run(rpc.call(uri, "echo", "/node", 3, [["TCPROS"]], {"a": 1.5}, "grün & <b>"))
        assert answer == [1, "well", ["/node", 3, [["TCPROS"]], {"a": 1.5}, "grün & <b>"]]


def test_a_method_that_is_refused_says_so_and_is_not_unreachable() -> None:
    with python_server() as uri, pytest.raises(BackendError, match="getName") as caught:
        run(rpc.call(uri, "getName", "/node"))
    assert not isinstance(caught.value, (Unreachable, CallTimeout))


def test_a_port_where_nothing_listens_is_unreachable_at_once() -> None:
    async def scenario() -> None:
        closing = await asyncio.start_server(lambda reader, writer: None, "127.0.0.1")
        port = closing.sockets[0].getsockname()[1]
        closing.close()
        await closing.wait_closed()
        with pytest.raises(Unreachable):
            await rpc.call(f"http://127.0.0.1:{port}/", "getPid", "/node")

    run(scenario())


def test_a_call_that_is_cancelled_is_cancelled_whenever_that_is() -> None:
    """At each turn of the loop, also the one in which the refusal arrives: else a manager could miss its own end."""

    async def ended_before(turns: int) -> bool:
        calling = asyncio.ensure_future(rpc.call(f"http://127.0.0.1:{free_port()}/", "getPid", "/test"))
        for _ in range(turns):
            await asyncio.sleep(0)
        late = not calling.cancel()
        await asyncio.wait({calling})
        assert calling.cancelled() or isinstance(late and calling.exception(), Unreachable)
        return late

    async def scenario() -> int:
        turns = 0
        while not await ended_before(turns):
            turns += 1
        return turns

    assert run(scenario()) > 0


@pytest.mark.parametrize("said", [b"", b"SSH-2.0-OpenSSH\r\n\r\n", b"HTTP/1.0 404 Not Found\r\n\r\n", b"\0" * 200_000])
def test_a_server_of_another_protocol_is_unreachable(said: bytes) -> None:
    async def other(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(said)
        writer.close()

    async def scenario() -> None:
        async with await asyncio.start_server(other, "127.0.0.1") as server:
            port = server.sockets[0].getsockname()[1]
            with pytest.raises(Unreachable):
                await rpc.call(f"http://127.0.0.1:{port}/", "getPid", "/node")

    run(scenario())


def test_a_frozen_peer_is_given_up() -> None:
    """It accepts and never answers: rospy's own calls would wait for ever."""

    async def silent(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.read()
        writer.close()

    async def scenario() -> None:
        async with await asyncio.start_server(silent, "127.0.0.1") as server:
            port = server.sockets[0].getsockname()[1]
            with pytest.raises(CallTimeout):
                await rpc.call(f"http://127.0.0.1:{port}/", "getPid", "/node", timeout=0.2)

    run(scenario())


def test_a_request_is_a_comment_to_other_publishers() -> None:
    definition = connection_headers.request("string data\n", QoS(durability="transient_local", depth=3))
    assert [line for line in definition.splitlines() if not line.startswith("#")] == ["string data"]
    assert connection_headers.requested({"message_definition": definition}) == QoS(
        durability="transient_local", depth=3
    )
    for plain in ({}, {"message_definition": "string data"}, {"message_definition": "string data\n# midstride: [3]"}):
        assert connection_headers.requested(plain) is None
        assert connection_headers.grant(plain, "endpoint", QoS()) == {}


def test_a_grant_depends_on_what_is_offered() -> None:
    header = {"message_definition": connection_headers.request("", QoS(durability="transient_local"))}
    granted = connection_headers.grant(header, "endpoint", QoS(durability="transient_local"))
    assert connection_headers.publisher_of(granted) == "endpoint" and connection_headers.is_compatible(granted)
    refused = connection_headers.grant(header, "endpoint", QoS())
    assert connection_headers.publisher_of(refused) == "endpoint" and not connection_headers.is_compatible(refused)
    assert connection_headers.publisher_of({"callerid": "/bare"}) is None and connection_headers.is_compatible(
        {"callerid": "/bare"}
    )


def test_no_process_of_ros_1_sees_ros_2(tmp_path: Path) -> None:
    (tmp_path / "two" / "rclpy").mkdir(parents=True)
    (tmp_path / "own").mkdir()
    base = {
        "PYTHONPATH": f"{tmp_path / 'two'}{os.pathsep}{tmp_path / 'own'}{os.pathsep}/opt/ros/jazzy/lib/python3",
        "LD_LIBRARY_PATH": "/opt/ros/jazzy/lib",
        "AMENT_PREFIX_PATH": "/opt/ros/jazzy",
        "ROS_DISTRO": "jazzy",
        "ROS_VERSION": "2",
        "ROS_DOMAIN_ID": "3",
        "HOME": "/home/robot",
    }
    made = launching.environment(base, "http://localhost:11311")
    assert made["PYTHONPATH"] == str(tmp_path / "own")
    assert not {"LD_LIBRARY_PATH", "AMENT_PREFIX_PATH", "ROS_DISTRO", "ROS_VERSION", "ROS_DOMAIN_ID"} & set(made)
    assert (made["HOME"], made["ROS_IP"], made["ROS_MASTER_URI"]) == (
        "/home/robot",
        "127.0.0.1",
        "http://localhost:11311",
    )
    sourced = {"ROS_DISTRO": "noetic", "ROS_VERSION": "1", "ROS_HOSTNAME": "robot"}
    kept = launching.environment(sourced, "http://robot:11311")
    assert kept["ROS_DISTRO"] == "noetic" and "ROS_IP" not in kept


def test_a_master_elsewhere_needs_an_address_of_this_machine() -> None:
    assert launching.own_host({}, "http://localhost:11311") == "127.0.0.1"
    assert launching.own_host({"ROS_IP": "10.0.0.2"}, "http://robot:11311") == "10.0.0.2"
    with pytest.raises(BackendError, match="ROS_IP"):
        launching.own_host({}, "http://robot:11311")
    with pytest.raises(BackendError, match="ROS_IP"):
        launching.environment({}, "http://robot:11311")


@pytest.mark.parametrize("uri", ["localhost:11311", "http://localhost", "http://localhost:x", "robot"])
@pytest.mark.parametrize("address", [None, "127.0.0.1"])
def test_an_address_that_is_none_of_a_master_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, uri: str, address: str | None
) -> None:
    monkeypatch.setenv("ROS_MASTER_URI", uri)
    monkeypatch.delenv("ROS_HOSTNAME", raising=False)
    monkeypatch.delenv("ROS_IP", raising=False)
    if address is not None:
        monkeypatch.setenv("ROS_IP", address)
    with pytest.raises(BackendError, match=f"ROS_MASTER_URI .*'{uri}' is not an address like"):
        run(Ros1Backend(tmp_path).open(lambda _: None))


def test_the_parameters_of_a_program_behind_a_relay_end_with_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A later program of its name would read them, although its specification states them no more."""
    shown: dict[str, Any] = {"/chat/own": 1}

    def set_param(_: str, name: str, value: Any) -> Any:
        shown[name] = value
        return [1, "", 0]

    def delete_param(_: str, name: str) -> Any:
        return [-1, "not set", 0] if shown.pop(name, None) is None else [1, "", 0]

    async def spawned(self: Any, launch: Launch, *_: Any) -> Handle:
        return Handle(launch.instance)

    async def scenario(uri: str) -> None:
        backend = Ros1Backend(tmp_path)
        with master_process.hold(uri) as backend._mark:
            backend._master = Master(uri, names.MANAGER)
            component = ComponentSpec("Talker")
            values: dict[str, object] = {"word": "hello", "unset": True}
            launch = Launch("chat", "", ("true",), "token", tmp_path, values, {"rate": 2}, foreign=component)
            await backend.start(launch)
            assert shown == {"/chat/own": 1, "/chat/word": "hello", "/chat/unset": True, "/chat/rate": 2}
            del shown["/chat/unset"]
            await backend.end("chat", KILL_AT_ONCE)
        assert shown == {"/chat/own": 1}

    monkeypatch.setenv("MIDSTRIDE_ROS1_PYTHON", sys.executable)
    monkeypatch.setattr(Ros1Backend, "_spawn", spawned)
    unknown = {"lookupNode": lambda *_: [-1, "unknown", 0]}
    with python_server(setParam=set_param, deleteParam=delete_param, **unknown) as uri:
        run(scenario(uri))


def test_an_exit_is_reported_whatever_the_master_answers(tmp_path: Path) -> None:
    async def scenario(uri: str) -> None:
        backend, exits = Ros1Backend(tmp_path), list[Exited]()
        with master_process.hold(uri) as backend._mark:
            backend._master, backend._on_exit = Master(uri, names.MANAGER), exits.append
            process: Any = SimpleNamespace(last_words=lambda: "the end")
            backend._exited("chat", 1, process)
            await asyncio.gather(*backend._tidying, return_exceptions=True)
        assert exits == [Exited("chat", 1, "the end")]

    with python_server(
        lookupNode=lambda *_: [1, "", "http://127.0.0.1:1/"], getSystemState=lambda _: [1, "", ["?"]]
    ) as uri:
        run(scenario(uri))


def test_another_manager_is_found_among_the_sockets_of_programs_that_name_theirs_in_any_bytes() -> None:
    async def nodes() -> bool:
        return await master_process._in_use(Master(uri, "/x"))

    with python_server(getSystemState=lambda _: [1, "", [[], [], []]]) as uri, socket.socket(socket.AF_UNIX) as other:
        other.bind(b"\0\xff\xfe")
        assert run(nodes()) is False
        with master_process.hold(uri):
            assert run(nodes()) is True


def test_a_component_listens_where_its_manager_or_its_user_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    folder = tmp_path / "midstride" / "robot" / "components"
    by_environment = {"MIDSTRIDE_SYSTEM": "robot"}
    other = {"MIDSTRIDE_SYSTEM": "other"}
    for environment, arguments in (
        (by_environment, ()),
        ({}, ("--standalone", "--system", "robot", "__name:=talker")),
        (other, ("--system=robot",)),
        ({**other, "MIDSTRIDE_CONTROL": str(folder)}, ("--system", "other")),
    ):
        transport, words = common.control_transport(environment, arguments)
        assert transport is not None and transport.folder == folder and str(folder) in words
    transport, words = common.control_transport({}, ("--verbose",))
    assert transport is None and "--system NAME" in words and "MIDSTRIDE_SYSTEM=NAME" in words


@pytest.mark.parametrize("arguments", [("--system",), ("--system=",), ("--system", ""), ("--system", "../other")])
def test_what_names_no_system_is_refused(
    arguments: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    with pytest.raises(NodeError, match="system"):
        common.control_transport({}, arguments)
    assert list(tmp_path.iterdir()) == []


def test_python_in_a_command_is_the_one_that_has_ros_1(tmp_path: Path) -> None:
    def python() -> str:
        return "/somewhere/python"

    assert processes.command(("python3", "a.py"), tmp_path, os.environ, python) == ("/somewhere/python", "a.py")
    assert processes.command(("/bin/sh", "-c", "x"), tmp_path, os.environ, python)[0] == "/bin/sh"
    with pytest.raises(StartFailed, match="no program nothing_of_this_name"):
        processes.command(("nothing_of_this_name",), tmp_path, os.environ, python)

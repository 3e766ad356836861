"""Slow clients, too many clients, and no descriptors left: the manager closes what is slow, and its socket answers."""

from __future__ import annotations

import asyncio
import os
import resource
import socket
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager, suppress

import httpx
import pytest

from midstride.runtime.workspace import Workspace
from midstride.server import connections, serve
from midstride.server.connections import connection_limit
from midstride.server.serve import Tcp
from tests.cli.conftest import EXAMPLES, running
from tests.server.scripted import ScriptedManager
from tests.server.support import free_port, run, serving

STATUS = b"GET /api/v1/programs HTTP/1.1\r\nHost: manager\r\n"


@contextmanager
def impatient() -> Iterator[None]:
    """A request must arrive at once. Not while the fixtures talk to the manager: theirs may be late."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(connections, "REQUEST_TIMEOUT", 0.2)
        yield


@pytest.mark.parametrize(
    "sent",
    [
        b"",
        STATUS,
        b"POST /api/v1/plan HTTP/1.1\r\nHost: manager\r\nContent-Length: 9\r\n\r\n{",
        STATUS + b"\r\nG",  # the begin of the next request
        STATUS + b"Content-Length: 2\r\n\r\n{",  # answered before its body has arrived
    ],
)
def test_a_connection_is_closed_if_a_request_does_not_arrive(
    workspace: Workspace, caplog: pytest.LogCaptureFixture, sent: bytes
) -> None:
    async def test() -> None:
        async with serving(ScriptedManager(), workspace):
            with impatient():
                reader, writer = await asyncio.open_unix_connection(workspace.socket)
                writer.write(sent)
                with closing(writer), suppress(ConnectionError):
                    await asyncio.wait_for(reader.read(), 30)

    run(test)
    assert not caplog.records


def test_bytes_that_trickle_in_do_not_prolong_a_request(workspace: Workspace) -> None:
    async def test() -> None:
        async with serving(ScriptedManager(), workspace):
            with impatient():
                reader, writer = await asyncio.open_unix_connection(workspace.socket)
                with closing(writer):
                    closed = asyncio.ensure_future(reader.read())
                    while not closed.done():
                        writer.write(b"G")
                        await asyncio.wait({closed}, timeout=0.02)
                    assert isinstance(closed.exception(), (ConnectionError, type(None)))

    run(test)


def test_a_request_may_take_long_to_answer(workspace: Workspace) -> None:
    async def test() -> None:
        manager = ScriptedManager()
        async with serving(manager, workspace):
            with impatient():
                manager.holds["programs"] = asyncio.Event()
                asking, asked = await asyncio.open_unix_connection(workspace.socket)
                asked.write(STATUS + b"\r\n")
                while ("programs", None) not in manager.asked:
                    await asyncio.sleep(0.01)
                waiting, idle = await asyncio.open_unix_connection(workspace.socket)
                assert await asyncio.wait_for(waiting.read(), 30) == b""  # opened later, so its time ends later
                manager.holds["programs"].set()
                assert (await asking.readline()).startswith(b"HTTP/1.1 200")
                asked.close()
                idle.close()

    run(test)


def test_connections_on_tcp_are_bounded_and_leave_the_socket_alone(
    workspace: Workspace, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(serve, "_TCP_LIMIT", (2, 1.0))

    async def test() -> None:
        port = free_port()
        async with serving(ScriptedManager(), workspace, Tcp(port)) as (client, _):
            opened = [await asyncio.open_connection("127.0.0.1", port) for _ in range(2)]
            async with httpx.AsyncClient(base_url=f"http://127.0.0.1:{port}/api/v1", timeout=30) as third:
                asking = asyncio.ensure_future(third.get("/programs"))
                for _ in range(10):
                    assert (await client.get("/programs")).status_code == 200
                assert not asking.done()
                opened[0][1].close()
                assert (await asking).status_code == 401
            for _, writer in opened:
                writer.close()

    run(test)


def test_a_client_without_the_token_does_not_keep_its_connection(workspace: Workspace) -> None:
    async def test() -> None:
        port = free_port()
        async with serving(ScriptedManager(), workspace, Tcp(port)):
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            writer.write(STATUS + b"\r\n" + STATUS + b"\r\n")
            with closing(writer):
                assert (await reader.read()).count(b"401 Unauthorized") == 1

    run(test)


def test_answers_on_tcp_do_not_wait_for_acknowledgements() -> None:
    """Otherwise the body of each response but the first leaves 40 ms after its header."""
    port = free_port()
    with (
        serve._tcp(Tcp(port)) as listening,
        socket.create_connection(("127.0.0.1", port)),
        listening.accept()[0] as connection,
    ):
        assert connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)


@contextmanager
def no_descriptors() -> Iterator[None]:
    """This process cannot open another one."""
    lowest = os.dup(0)
    os.close(lowest)
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (lowest, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def test_the_limit_of_descriptors_is_logged_once_and_waited_out(
    workspace: Workspace, caplog: pytest.LogCaptureFixture
) -> None:
    async def test() -> None:
        async with serving(ScriptedManager(), workspace):
            with socket.socket(socket.AF_UNIX) as client:
                client.setblocking(False)
                client.connect(str(workspace.socket))  # the kernel accepts it
                await asyncio.get_running_loop().sock_sendall(client, STATUS + b"\r\n")
                with no_descriptors():
                    while not caplog.records:
                        await asyncio.sleep(0.01)
                    await asyncio.sleep(5 * connections._RETRY)  # time for many more records
                answer = await asyncio.get_running_loop().sock_recv(client, 1000)
                assert answer.startswith(b"HTTP/1.1 200")
        assert [record.message for record in caplog.records] == [
            "cannot accept a connection, trying again: Too many open files"
        ]

    run(test)


def test_a_low_limit_of_descriptors_leaves_most_of_them_to_the_control_plane(monkeypatch: pytest.MonkeyPatch) -> None:
    for soft, allowed in {1024: 64, 256: 32, 4: 1, resource.RLIM_INFINITY: 64}.items():
        monkeypatch.setattr(resource, "getrlimit", lambda _, soft=soft: (soft, resource.RLIM_INFINITY))
        assert connection_limit(64, 1 / 8) == allowed


@pytest.mark.full
def test_slow_connections_to_a_running_manager() -> None:
    """A manager that may open 128 files has 300 slow connections on TCP: its socket answers, its log stays empty."""
    for midstride in running():
        port = free_port()
        specification = str(EXAMPLES / "talker" / "talker.stride")
        command = midstride.command("up", specification, "--backend", "sim", "-d", "--http", str(port))
        limited = ["sh", "-c", 'ulimit -n 128 && exec "$@"', "sh", *command]
        up = subprocess.run(
            limited, env=midstride.environment, capture_output=True, text=True, timeout=100, check=False
        )
        assert up.returncode == 0, up.stderr
        with ExitStack() as stack:
            for _ in range(300):
                slow = stack.enter_context(socket.socket())
                slow.setblocking(False)
                slow.connect_ex(("127.0.0.1", port))
            for _ in range(20):
                assert midstride("status").status == 0
            opened = len(os.listdir(f"/proc/{midstride.manager('talker')}/fd"))
            assert 16 <= opened < 64
        assert (midstride.runtime / "midstride" / "talker" / "logs" / "manager.log").read_text() == ""

"""What systemd is told by a manager: the datagrams that arrive at the socket of NOTIFY_SOCKET."""

from __future__ import annotations

import asyncio
import os
import signal
import socket
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from midstride.errors import ManagerError
from midstride.runtime.workspace import Workspace
from midstride.server import service_notice
from midstride.server.serve import serve
from midstride.server.service_notice import ServiceNotice
from tests.server.scripted import ScriptedManager
from tests.server.support import over_socket, run


class Told:
    """A socket as systemd's, and the datagrams that have come to it."""

    def __init__(self, address: str) -> None:
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.bind(address)
        self.socket.setblocking(False)
        self.came: list[list[str]] = []

    def all(self) -> list[list[str]]:
        while True:
            try:
                self.came.append(self.socket.recv(65536).decode().split("\n"))
            except BlockingIOError:
                return self.came

    def has(self, assignment: str) -> bool:
        return any(assignment in each for each in self.all())

    async def until(self, condition: Callable[[], bool]) -> None:
        for _ in range(1000):
            if condition():
                return
            await asyncio.sleep(0.01)
        raise AssertionError(self.came)


@pytest.fixture
def told(tmp_path: Path) -> Iterator[Told]:
    found = Told(str(tmp_path / "notify"))
    with found.socket:
        yield found


def serving(manager: ScriptedManager, workspace: Workspace, told: Told, watchdog: float | None) -> asyncio.Task[int]:
    notice = ServiceNotice(told.socket.getsockname(), watchdog)
    served = serve(manager.as_manager, workspace, backend="scripted", notice=notice, alone=True)
    return asyncio.ensure_future(served)


def test_a_system_that_is_up_is_ready_and_one_that_is_down_stops(workspace: Workspace, told: Told) -> None:
    async def test() -> None:
        manager = ScriptedManager()
        manager.holds["up"] = asyncio.Event()
        server = serving(manager, workspace, told, None)
        await told.until(lambda: told.has("STATUS=starting"))
        assert told.came[-1] == ["WATCHDOG=1", "EXTEND_TIMEOUT_USEC=30000000", "STATUS=starting"]
        manager.holds["up"].set()
        await told.until(lambda: told.has("READY=1"))
        ready = next(each for each in told.came if "READY=1" in each)
        # None of its components has reported: it is ready all the same, and degraded in words.
        assert ready[:2] == ["WATCHDOG=1", "READY=1"] and ready[2].startswith("STATUS=degraded, all 2 nodes run, 2 of")
        async with over_socket(workspace) as client:
            await client.post("/down")
        assert await asyncio.wait_for(server, 20) == 0
        assert told.all()[-1] == ["STOPPING=1", "STATUS=down"]
        assert sum("READY=1" in each for each in told.came) == 1

    run(test)


def test_the_watchdog_is_fed_from_the_loop_and_starves_with_it(workspace: Workspace, told: Told) -> None:
    async def test() -> None:
        server = serving(ScriptedManager(), workspace, told, 0.3)
        await told.until(lambda: told.has("READY=1"))
        before = len(told.all())
        await told.until(lambda: len(told.all()) > before + 2)
        assert all("WATCHDOG=1" in each for each in told.came)
        assert "EXTEND_TIMEOUT_USEC=30000000" not in told.came[-1]  # it has nothing to do
        os.kill(os.getpid(), signal.SIGTERM)
        assert await asyncio.wait_for(server, 20) == 128 + signal.SIGTERM
        assert told.all()[-1] == ["STOPPING=1", "STATUS=the manager ends, and its components keep running"]

    run(test)


def test_a_system_that_does_not_come_up_is_never_ready(workspace: Workspace, told: Told) -> None:
    async def test() -> None:
        manager = ScriptedManager()
        manager.answers["up"] = ManagerError("no disk\nis left")
        assert await asyncio.wait_for(serving(manager, workspace, told, None), 20) == 1
        assert told.all()[-1] == ["STATUS=not up: no disk is left"] or told.has("STATUS=not up: no disk is left")
        assert not told.has("READY=1")

    run(test)


def test_what_is_missing_is_in_the_status_after_an_event(
    workspace: Workspace, told: Told, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def test() -> None:
        manager = ScriptedManager()
        server = serving(manager, workspace, told, None)
        await told.until(lambda: told.has("READY=1"))
        monkeypatch.setattr(service_notice, "status_words", lambda _: "degraded, 1 of 2 nodes runs")
        manager.events.add("exited", "listener exited unexpectedly (status -9)")
        await told.until(lambda: told.has("STATUS=degraded, 1 of 2 nodes runs"))
        os.kill(os.getpid(), signal.SIGINT)
        assert await asyncio.wait_for(server, 20) == 128 + signal.SIGINT

    run(test)


def test_a_fault_in_the_words_does_not_look_as_if_the_manager_hung(
    workspace: Workspace, told: Told, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object) -> None:
        raise KeyError("talker")

    async def test() -> None:
        monkeypatch.setattr(service_notice, "status", broken)
        server = serving(ScriptedManager(), workspace, told, 0.3)
        await told.until(lambda: told.has("READY=1"))
        before = len(told.all())
        await told.until(lambda: len(told.all()) > before + 2)
        assert told.has("STATUS=internal error: KeyError: 'talker'")
        os.kill(os.getpid(), signal.SIGTERM)
        await asyncio.wait_for(server, 20)

    run(test)


def test_a_notice_that_is_not_taken_comes_again(workspace: Workspace, tmp_path: Path) -> None:
    async def test() -> None:
        notice = ServiceNotice(str(tmp_path / "later"), 0.3)
        served = serve(ScriptedManager().as_manager, workspace, backend="scripted", notice=notice, alone=True)
        server = asyncio.ensure_future(served)
        async with over_socket(workspace) as client:
            while not workspace.socket.exists():
                await asyncio.sleep(0.01)
            await client.get("/up")
            told = Told(str(tmp_path / "later"))
            with told.socket:
                await told.until(lambda: told.has("READY=1"))
            await client.post("/down")
        await asyncio.wait_for(server, 20)

    run(test)


def test_the_address_is_taken_out_of_the_environment() -> None:
    me = str(os.getpid())
    environment = {"NOTIFY_SOCKET": "/run/n", "WATCHDOG_USEC": "30000000", "WATCHDOG_PID": me, "PATH": "/bin"}
    assert ServiceNotice.taken_from(environment) == ServiceNotice("/run/n", 30.0)
    assert environment == {"PATH": "/bin"}
    assert ServiceNotice.taken_from(environment) is None
    assert ServiceNotice.taken_from({"NOTIFY_SOCKET": "vsock:2:1"}) is None  # of virtual machines; no Unix socket
    other = {"NOTIFY_SOCKET": "@n", "WATCHDOG_USEC": "30000000", "WATCHDOG_PID": "1"}
    assert ServiceNotice.taken_from(other) == ServiceNotice("@n", None)
    assert ServiceNotice.taken_from({"NOTIFY_SOCKET": "@n", "WATCHDOG_USEC": "x"}) == ServiceNotice("@n", None)
    assert ServiceNotice("@n", 6.0).every == 2.0 and ServiceNotice("@n").every == 5.0


def test_an_address_without_a_file() -> None:
    name = f"midstride-test-{os.getpid()}"
    told = Told(f"\0{name}")
    with told.socket:
        assert ServiceNotice(f"@{name}").send("READY=1", "STATUS=up")
        assert told.all() == [["READY=1", "STATUS=up"]]
    assert not ServiceNotice(f"@{name}").send("READY=1")

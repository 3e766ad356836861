"""A component greets with the place of its locks of cuts: those of two components exclude each other in one place."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from midstride.runtime.process.component_client import ComponentClient
from midstride.wire.command_server import CommandServer
from midstride.wire.frames import PROTOCOL, Greeting
from midstride.wire.sockets import SocketFolder
from midstride.wire.transport import Connection, Serve, StopListening
from tests.runtime.scripted import TOKEN
from tests.wire.support import done


class Forwarded:
    """A transport that reaches components in several folders, as if their sockets were forwarded."""

    def __init__(self, **folders: SocketFolder) -> None:
        self.folders = folders
        self.cut_lock = next(iter(folders.values())).cut_lock

    def address(self, instance: str, seen_from: str | None = None) -> str:
        return self.folders[instance].address(instance)

    async def connect(self, address: str) -> Connection:
        return await next(iter(self.folders.values())).connect(address)

    async def listen(self, instance: str, serve: Serve) -> StopListening:
        raise AssertionError("the manager does not listen")

    def present(self) -> dict[str, str]:
        return {}


class SteadyClock:
    def steady(self) -> float:
        return 0.0


@pytest.mark.parametrize("same", [True, False])
def test_two_folders_have_two_locks(same: bool, tmp_path: Path) -> None:
    one = SocketFolder(tmp_path / "a")
    other = SocketFolder(tmp_path / ("a" if same else "b"))

    async def main() -> None:
        servers = []
        for name, folder in (("old", one), ("new", other)):
            greeting = Greeting(protocol=PROTOCOL, instance=name, uuid=name, pid=7, start_token=TOKEN)
            servers.append(CommandServer(greeting, done))
            await servers[-1].open(folder)
        client = ComponentClient(Forwarded(old=one, new=other), SteadyClock(), TOKEN)  # type: ignore[arg-type]
        assert await client.share_locks("old", "new") is same
        client.disconnect("old")
        client.disconnect("new")
        for server in servers:
            await server.close(1.0)

    asyncio.run(main())


def test_a_lock_that_is_nowhere_is_shared_with_none(tmp_path: Path) -> None:
    """As where the file cannot be opened: then a lock could not be taken either."""
    folder = SocketFolder(tmp_path / "missing")
    assert folder.cut_lock("").place == ""

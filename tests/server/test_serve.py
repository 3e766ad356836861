"""The doors: the Unix socket, the TCP door with its token, the event stream, and how it all ends."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import socket
import stat
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from midstride import errors
from midstride.runtime.workspace import Workspace
from midstride.server.serve import Tcp, serve
from tests.server.scripted import ScriptedManager
from tests.server.support import free_port, run, serving


async def events(response: httpx.Response) -> AsyncIterator[tuple[str, dict[str, Any]]]:
    """Each event of a stream as its number and its document."""
    number = ""
    async for line in response.aiter_lines():
        name, _, value = line.partition(": ")
        if name == "id":
            number = value.rpartition(".")[2]
        elif name == "data":
            yield number, json.loads(value)


def test_the_socket_is_its_user_s_alone_and_goes_at_the_end(workspace: Workspace) -> None:
    workspace.socket.touch()  # what a killed manager leaves

    async def test() -> None:
        manager = ScriptedManager()
        async with serving(manager, workspace) as (client, server):
            assert stat.S_IMODE(workspace.socket.stat().st_mode) == 0o600
            assert stat.S_IMODE(workspace.path.stat().st_mode) == 0o700
            assert (await client.post("/down")).json() == {"outcome": "done", "killed": []}
            assert await asyncio.wait_for(server, 20) == 0
        assert not workspace.socket.exists()
        assert [operation for operation, _ in manager.asked] == ["up", "down", "close"]

    run(test)


def test_a_path_too_long_for_a_socket_is_told(tmp_path: Path) -> None:
    workspace = Workspace(tmp_path / ("x" * 100))
    workspace.path.mkdir()
    manager = ScriptedManager()
    with pytest.raises(errors.ManagerError, match="is the path too long"):
        asyncio.run(serve(manager.as_manager, workspace, backend="scripted"))
    assert manager.asked == []


def test_the_stream_tells_what_was_and_what_comes_and_ends_with_the_system(workspace: Workspace) -> None:
    async def test() -> None:
        manager = ScriptedManager()
        async with serving(manager, workspace) as (client, _):
            await client.get("/up")
            heard: list[tuple[str, str]] = []
            async with client.stream("GET", "/view/stream?only=event") as response:
                assert response.headers["content-type"].startswith("text/event-stream")
                async for number, event in events(response):
                    heard.append((number, event["kind"]))
                    if event["kind"] == "up":
                        manager.events.add("note", "a line\nand another")
                    if event["kind"] == "note":
                        assert event["words"] == "a line\nand another"
                        await client.post("/down")
            assert heard == [("1", "up"), ("2", "note"), ("3", "down")]

    run(test)


def test_a_stream_taken_up_again_misses_nothing(workspace: Workspace) -> None:
    async def test() -> None:
        manager = ScriptedManager()
        async with serving(manager, workspace) as (client, _):
            await client.get("/up")
            for words in "0123":
                manager.events.add("note", words)
            async with client.stream(
                "GET", "/view/stream?only=event&since=1", headers={"Last-Event-ID": "3"}
            ) as response:
                heard = []
                async for number, event in events(response):
                    heard.append((number, event["words"]))
                    if len(heard) == 2:
                        break
            assert heard == [("4", "2"), ("5", "3")]

    run(test)


def test_a_system_that_cannot_come_up_says_why_and_ends(workspace: Workspace) -> None:
    async def test() -> None:
        manager = ScriptedManager()
        manager.answers["up"] = errors.StartFailed("talker exited with status 1")
        manager.holds["up"] = asyncio.Event()
        async with serving(manager, workspace) as (client, server):
            async with client.stream("GET", "/view/stream?only=event") as response:
                manager.events.add("step", "1/1 create talker")
                manager.holds["up"].set()
                heard = [(number, event["kind"], event["words"]) async for number, event in events(response)]
            assert heard == [
                ("1", "step", "1/1 create talker"),
                ("2", "up_failed", "talker exited with status 1"),
            ]
            answer = await client.get("/up")
            assert (answer.status_code, answer.json()["error"]["kind"]) == (502, "StartFailed")
            assert await asyncio.wait_for(server, 20) == 1
        assert manager.asked[-1] == ("close", None)

    run(test)


def test_leaving_ends_the_manager_and_not_the_system(workspace: Workspace) -> None:
    async def test() -> None:
        manager = ScriptedManager()
        async with serving(manager, workspace) as (client, server):
            await client.get("/up")
            async with client.stream("GET", "/view/stream?only=event") as response:
                stream = events(response)
                assert (await anext(stream))[1]["kind"] == "up"
                os.kill(os.getpid(), signal.SIGTERM)
                assert await anext(stream, None) is None
            assert await asyncio.wait_for(server, 20) == 128 + signal.SIGTERM
        assert [operation for operation, _ in manager.asked] == ["up", "close"]

    run(test)


class Changing(ScriptedManager):
    """Has a change under way until it is broken off, and takes ``seconds`` to take it back."""

    def __init__(self, seconds: float) -> None:
        super().__init__()
        self.seconds = seconds

    async def change(self, *_: object, **__: object) -> Any:
        self.asked.append(("change", None))
        try:
            await asyncio.Event().wait()
        finally:
            await asyncio.sleep(self.seconds)
            self.asked.append(("taken back", None))


async def told_to_end_in_a_change(manager: Changing, workspace: Workspace) -> httpx.Response:
    """SIGTERM while a change is under way; what the client that asked for the change gets as an answer."""
    async with serving(manager, workspace) as (client, server):
        await client.get("/up")
        changing = asyncio.ensure_future(client.post("/change", json={"request": {"remove": ["talker"]}}))
        while ("change", None) not in manager.asked:
            assert not changing.done()
            await asyncio.sleep(0.01)
        os.kill(os.getpid(), signal.SIGTERM)
        response = await changing
        assert await asyncio.wait_for(server, 20) == 128 + signal.SIGTERM
        return response


def test_a_change_under_way_when_the_manager_is_told_to_end_is_taken_back_first(workspace: Workspace) -> None:
    async def test() -> None:
        manager = Changing(0.05)
        response = await told_to_end_in_a_change(manager, workspace)
        assert response.status_code == 409
        assert "interrupted and rolled back" in response.json()["error"]["message"]
        assert [operation for operation, _ in manager.asked] == ["up", "change", "taken back", "close"]

    run(test)


def test_a_change_that_takes_long_to_take_back_still_has_an_answer(
    workspace: Workspace, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The doors do not wait for ever; the client gets the reason, not an internal error."""
    monkeypatch.setattr("midstride.server.connections.LAST_ANSWERS", 1)

    async def test() -> None:
        manager = Changing(1.5)
        response = await told_to_end_in_a_change(manager, workspace)
        assert response.status_code == 409, response.text
        assert "still rolling back" in response.json()["error"]["message"]
        assert ("taken back", None) in manager.asked

    run(test)


def test_a_change_that_arrives_after_the_manager_was_told_to_end_is_refused(workspace: Workspace) -> None:
    """It was begun, and then nothing interrupted it: the manager closed in the middle of its steps."""

    async def test() -> None:
        manager = Changing(0.0)
        async with serving(manager, workspace) as (client, server):
            await client.get("/up")
            arriving = asyncio.Event()

            async def body() -> AsyncIterator[bytes]:
                yield b'{"request": {"remove": '
                await arriving.wait()
                yield b'["talker"]}}'

            headers = {"Content-Type": "application/json"}
            changing = asyncio.ensure_future(client.post("/change", content=body(), headers=headers))
            async with client.stream("GET", "/view/stream?only=event") as response:
                stream = events(response)
                assert (await anext(stream))[1]["kind"] == "up"
                os.kill(os.getpid(), signal.SIGTERM)
                assert await anext(stream, None) is None
            arriving.set()
            refused = await changing
            assert refused.status_code == 409
            assert "the manager is shutting down" in refused.json()["error"]["message"]
            assert await asyncio.wait_for(server, 20) == 128 + signal.SIGTERM
        assert [operation for operation, _ in manager.asked] == ["up", "close"]

    run(test)


def test_a_down_under_way_when_the_manager_is_told_to_end_is_not_said_to_be_rolled_back(
    workspace: Workspace, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("midstride.server.connections.LAST_ANSWERS", 0)

    async def test() -> None:
        manager = ScriptedManager()
        manager.holds["down"] = asyncio.Event()
        async with serving(manager, workspace) as (client, server):
            await client.get("/up")
            downing = asyncio.ensure_future(client.post("/down"))
            while ("down", None) not in manager.asked:
                await client.get("/log")
            os.kill(os.getpid(), signal.SIGTERM)
            message = (await downing).json()["error"]["message"]
            assert "still ends the components" in message and "rolling back" not in message
            manager.holds["down"].set()
            assert await asyncio.wait_for(server, 20) == 0

    run(test)


def test_a_system_whose_manager_is_told_to_end_while_it_comes_is_not_said_to_be_up(workspace: Workspace) -> None:
    async def test() -> None:
        manager = ScriptedManager()
        manager.holds["up"] = asyncio.Event()
        async with serving(manager, workspace) as (client, server):
            asking = asyncio.ensure_future(client.get("/up"))
            await client.get("/log")
            os.kill(os.getpid(), signal.SIGTERM)
            response = await asking
            assert (response.status_code, response.json()["error"]["kind"]) == (409, "ManagerError")
            assert await asyncio.wait_for(server, 20) == 1

    run(test)


def test_the_tcp_door_is_on_loopback_and_wants_the_token(workspace: Workspace) -> None:
    async def test() -> None:
        port = free_port()
        async with serving(ScriptedManager(), workspace, Tcp(port)):
            file = workspace.path / "token"
            assert stat.S_IMODE(file.stat().st_mode) == 0o600
            token = file.read_text()
            async with httpx.AsyncClient(base_url=f"http://127.0.0.1:{port}/api/v1") as client:
                for headers in ({}, {"Authorization": "Bearer wrong"}, {"Authorization": token}):
                    for path in ("/programs", "/openapi.json", "/view/stream"):
                        refused = await client.get(path, headers=headers)
                        assert (refused.status_code, refused.headers["www-authenticate"]) == (401, "Bearer")
                headers = {"Authorization": f"Bearer {token}"}
                assert (await client.get("/programs", headers=headers)).json() == []
            listening = Path("/proc/net/tcp").read_text()
            assert f"0100007F:{port:04X} 00000000:0000 0A" in listening  # 127.0.0.1, and
            assert f"00000000:{port:04X}" not in listening  # no other address
        assert not file.exists()

    run(test)


def test_a_port_that_is_taken_is_told_before_anything_is_started(workspace: Workspace) -> None:
    with socket.create_server(("127.0.0.1", 0)) as door:
        port = door.getsockname()[1]
        manager = ScriptedManager()
        with pytest.raises(errors.ManagerError, match=f"cannot listen on 127.0.0.1, port {port}"):
            asyncio.run(serve(manager.as_manager, workspace, backend="scripted", tcp=Tcp(port)))
    assert manager.asked == []
    assert not workspace.socket.exists()

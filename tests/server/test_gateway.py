"""What `midstride dashboard` runs: from loopback to the manager's socket, also while no manager is there."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import httpx
import pytest

from midstride.errors import ManagerError
from midstride.runtime.records.reports import DownReport
from midstride.runtime.workspace import Workspace
from midstride.server.gateway import listen, run_gateway
from midstride.server.requests import LARGEST_BODY
from tests.server.scripted import ScriptedManager
from tests.server.support import run, serving
from tests.wire.support import full_socket

TOKEN = "the-token"


@asynccontextmanager
async def opened(workspace: Workspace) -> AsyncIterator[httpx.AsyncClient]:
    """A browser that has opened the dashboard."""
    with listen(0) as listening:
        base = f"http://127.0.0.1:{listening.getsockname()[1]}"
        task = asyncio.ensure_future(run_gateway(listening, workspace.socket, "talker", TOKEN))
        try:
            async with httpx.AsyncClient(base_url=base, headers={"Origin": base}, timeout=20) as client:
                assert (await client.get("/", params={"token": TOKEN})).status_code == 200
                yield client
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)


def test_requests_reach_the_manager_as_they_are(workspace: Workspace) -> None:
    async def test() -> None:
        manager = ScriptedManager()
        async with opened(workspace) as client, serving(manager, workspace):
            assert (await client.get("/api/v1")).json()["system"] == "talker"
            assert (await client.get("/api/v1/why", params={"functionality": "a b/é.c"})).status_code == 200
            assert manager.asked[-1] == ("why", "a b/é.c")
            refused = await client.post("/api/v1/plan", json={"replace": [["talker", 7]]})
            assert refused.status_code == 422 and "replace" in refused.json()["error"]["message"]
            assert (await client.get("/api/v1/none")).status_code == 404
            assert len((await client.get("/api/v1")).headers.get_list("date")) == 1

    run(test)


def test_the_page_outlives_the_manager(workspace: Workspace) -> None:
    async def test() -> None:
        async with opened(workspace) as client:
            for _ in range(2):  # it goes away, and comes back
                absent = await client.get("/api/v1/view")
                assert (absent.status_code, absent.json()["error"]["kind"]) == (503, "NoManager")
                assert (await client.get("/dashboard/vendor/elkjs/LICENSE.md")).status_code == 200
                async with serving(ScriptedManager(), workspace):
                    assert (await client.get("/api/v1/view")).json()["system"] == "talker"

    run(test)


def test_a_manager_that_accepts_no_connection_is_not_said_to_be_absent(workspace: Workspace) -> None:
    async def test() -> None:
        async with opened(workspace) as client:
            with full_socket(workspace.socket):
                answered = await client.get("/api/v1/view")
        error = answered.json()["error"]
        assert (answered.status_code, error["kind"]) == (503, "Unreachable")
        assert error["message"].startswith("the manager of talker does not answer: its socket accepts no connection")

    run(test)


def test_a_stream_arrives_as_it_comes_and_ends_with_the_manager(workspace: Workspace) -> None:
    async def test() -> None:
        manager = ScriptedManager()
        async with (
            opened(workspace) as client,
            serving(manager, workspace) as (direct, _),
            client.stream("GET", "/api/v1/view/stream?only=event&since=0") as response,
        ):
            lines = response.aiter_lines()
            while '"kind":"up"' not in await anext(lines):
                pass
            manager.events.add("note", "something happened")
            while "something happened" not in await anext(lines):
                pass
            manager.answers["down"] = DownReport()
            await direct.post("/down")
            assert '"kind":"down"' in "".join([line async for line in lines])

    run(test)


def test_a_client_that_goes_away_leaves_nothing_behind(workspace: Workspace) -> None:
    async def test() -> None:
        manager = ScriptedManager()
        async with opened(workspace) as client, serving(manager, workspace):
            async with client.stream("GET", "/api/v1/view/stream?only=event&since=0") as response:
                await anext(response.aiter_lines())
                assert len(manager.events.wakers) == 1
            while manager.events.wakers:
                await asyncio.sleep(0.01)

    run(test)


def test_a_large_body_is_refused_here(workspace: Workspace) -> None:
    async def test() -> None:
        async with opened(workspace) as client:
            refused = await client.post("/api/v1/plan", content=b" " * (LARGEST_BODY + 1))
            assert (refused.status_code, refused.json()["error"]["kind"]) == (413, "TooLarge")

    run(test)


def test_a_port_that_is_taken() -> None:
    with listen(0) as first:
        port = first.getsockname()[1]
        with pytest.raises(ManagerError, match=f"cannot listen on 127.0.0.1, port {port}: Address already in use"):
            listen(port)
        with listen(None) as second, listen(None) as third:
            assert len({port, second.getsockname()[1], third.getsockname()[1]}) == 3

"""A manager that serves on its sockets, in this process, and a client of it."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager, suppress
from typing import Any

import httpx

from midstride.runtime.records.reports import DownReport
from midstride.runtime.workspace import Workspace
from midstride.server.serve import Tcp, serve
from tests.server.scripted import ScriptedManager


def over_socket(workspace: Workspace) -> httpx.AsyncClient:
    transport = httpx.AsyncHTTPTransport(uds=str(workspace.socket))
    return httpx.AsyncClient(transport=transport, base_url="http://manager/api/v1", timeout=30)


@asynccontextmanager
async def serving(
    manager: ScriptedManager, workspace: Workspace, tcp: Tcp | None = None
) -> AsyncIterator[tuple[httpx.AsyncClient, asyncio.Task[int]]]:
    """A server over ``manager``, with a client over its socket. What is left of it at the end is an error."""
    server = asyncio.ensure_future(serve(manager.as_manager, workspace, backend="scripted", tcp=tcp))
    async with over_socket(workspace) as client:
        try:
            while True:
                try:
                    await client.get("/log")
                    break
                except httpx.TransportError:
                    if server.done():
                        server.result()
                    await asyncio.sleep(0.01)
            yield client, server
        finally:
            if not server.done():
                manager.answers["down"] = DownReport()
                with suppress(httpx.TransportError):  # it may be ending
                    await client.post("/down")
            await asyncio.wait_for(server, 20)


def run(test: Callable[[], Coroutine[Any, Any, None]]) -> None:
    asyncio.run(test())


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as door:
        return int(door.getsockname()[1])

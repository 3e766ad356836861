"""Leads from loopback TCP to a manager's Unix socket: what `midstride dashboard` runs.

A manager that comes and goes is the same origin to the page, and what slow tabs cost is not the manager's. The page
itself comes from here, so that it can be opened while there is no manager.
"""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any, Final

import h11
from fastapi import FastAPI, HTTPException, Request, Response
from starlette.requests import ClientDisconnect
from starlette.types import ASGIApp, Receive, Scope, Send

from midstride.errors import CallTimeout, ManagerError, Unreachable
from midstride.server.auth import TokenAuth
from midstride.server.connections import Server, connection_limit, listen_tcp
from midstride.server.error_answers import Failure, answer
from midstride.server.requests import read_body
from midstride.server.static import dashboard
from midstride.wire.sockets import open_socket

HOST: Final = "127.0.0.1"
# Where the dashboard is unless another port is asked for: the page keeps its settings by its origin.
PORT: Final = 7420
_LIMIT: Final = (64, 1 / 8)
_CHUNK: Final = 65_536
# Of one connection alone, added on this side, or not for the manager.
_NOT_PASSED_ON: Final = frozenset(
    b"connection keep-alive transfer-encoding te date server authorization cookie".split(),
)


def listen(port: int | None) -> socket.socket:
    """A socket on loopback: on ``port``, or on :data:`PORT` or any free one if that is taken. Raises ManagerError."""
    for number in [PORT, 0] if port is None else [port]:
        try:
            return listen_tcp((HOST, number))
        except OSError as error:
            failure = error
    raise ManagerError(f"cannot listen on {HOST}, port {port}: {failure.strerror or failure}") from None


def gateway(manager: Path, system: str, token: str, port: int) -> ASGIApp:
    """The application that serves the dashboard, and passes all else on to the manager at the socket ``manager``."""
    app = FastAPI(openapi_url=None)
    app.include_router(dashboard())
    app.mount("/", _PassedOn(manager, system))
    return TokenAuth(app, token, host=HOST, port=port)


async def run_gateway(listening: socket.socket, manager: Path, system: str, token: str) -> None:
    """Serve until it is cancelled."""
    app = gateway(manager, system, token, listening.getsockname()[1])
    server = Server(app, listening, connection_limit(*_LIMIT))
    serving = asyncio.ensure_future(server.serve())
    try:
        await asyncio.shield(serving)
    finally:
        server.should_exit = server.force_exit = True  # streams do not end
        await asyncio.wait({serving})


class _PassedOn:
    """Passes a request on to the manager, and its answer back, as fast as the client takes it."""

    def __init__(self, manager: Path, system: str) -> None:
        self._manager = manager
        self._system = system

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            return
        try:
            body = await read_body(Request(scope, receive))
        except ClientDisconnect:
            return
        except HTTPException as error:  # the manager would not accept so much
            failure = Failure.named("TooLarge", error.detail)
            await answer(failure, error.status_code, {"Connection": "close"})(scope, receive, send)
            return
        started = False

        async def sending(message: Any) -> None:
            nonlocal started
            started = True
            await send(message)

        try:
            await self._pass_on(scope, receive, body, sending)
        except CallTimeout as error:
            words = f"the manager of {self._system} does not answer: {error}"
            await self._failed("Unreachable", words)(scope, receive, send)
        except (Unreachable, OSError, h11.RemoteProtocolError, EOFError):
            if started:
                raise  # the connection is closed: the client sees that the answer is not whole
            words = f"no manager of {self._system} answers; `midstride up FILE` starts one"
            await self._failed("NoManager", words)(scope, receive, send)

    @staticmethod
    def _failed(kind: str, words: str) -> Response:
        return answer(Failure.named(kind, words), 503, {"Cache-Control": "no-store", "Retry-After": "1"})

    async def _pass_on(
        self, scope: Scope, receive: Receive, body: bytes, send: Callable[[Any], Awaitable[None]]
    ) -> None:
        reader, writer = await open_socket(self._manager, "its socket")
        try:
            connection = h11.Connection(h11.CLIENT)
            for event in _request(scope, body):
                writer.write(connection.send(event) or b"")
            await writer.drain()
            gone = asyncio.ensure_future(_disconnected(receive))
            answering = asyncio.ensure_future(_answer(connection, reader, send))
            try:
                await asyncio.wait({gone, answering}, return_when=asyncio.FIRST_COMPLETED)
                if answering.done():
                    answering.result()
            finally:
                gone.cancel()
                answering.cancel()
                await asyncio.gather(gone, answering, return_exceptions=True)
        finally:
            writer.close()


def _request(scope: Scope, body: bytes) -> list[h11.Event]:
    target = scope.get("raw_path") or scope["path"].encode()
    if scope["query_string"]:
        target += b"?" + scope["query_string"]
    headers = [(name, value) for name, value in scope["headers"] if name not in _NOT_PASSED_ON | {b"content-length"}]
    headers += [(b"connection", b"close"), (b"content-length", b"%d" % len(body))]
    request = h11.Request(method=scope["method"], target=target, headers=headers)
    return [request, *([h11.Data(data=body)] if body else []), h11.EndOfMessage()]


async def _disconnected(receive: Receive) -> None:
    while (await receive())["type"] != "http.disconnect":
        pass


async def _answer(
    connection: h11.Connection, reader: asyncio.StreamReader, send: Callable[[Any], Awaitable[None]]
) -> None:
    """Send what the manager answers, until that is complete. Raises EOFError if the manager exits before."""
    while True:
        event = connection.next_event()
        if event is h11.NEED_DATA:
            data = await reader.read(_CHUNK)
            if not data and connection.their_state is h11.SEND_RESPONSE:
                raise EOFError
            connection.receive_data(data)
        elif isinstance(event, h11.Response):
            headers = [(name, value) for name, value in event.headers if name not in _NOT_PASSED_ON]
            await send({"type": "http.response.start", "status": event.status_code, "headers": headers})
        elif isinstance(event, h11.Data):
            await send({"type": "http.response.body", "body": bytes(event.data), "more_body": True})
        elif isinstance(event, h11.EndOfMessage):
            await send({"type": "http.response.body", "body": b"", "more_body": False})
            return

"""What tests of the control plane share: a component and a client without a robot, and a connection that blocks."""

from __future__ import annotations

import asyncio
import contextlib
import os
import resource
import socket
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from midstride.codec.component_form import NamedComponentForm, decode_component
from midstride.errors import Unreachable
from midstride.wire.command_server import CommandServer, RequestHandler
from midstride.wire.frames import PROTOCOL, Greeting, Hello, Registration, Reply, Request, StateChanged, encode
from midstride.wire.pipe import MEMORY
from midstride.wire.state import ComponentState
from tests.conformance import puppets

GREETING = Greeting(protocol=PROTOCOL, instance="talker", uuid="u", pid=7, start_token="secret", place=MEMORY)
HELLO = encode(Hello(protocol=PROTOCOL, token="secret"))
REGISTRATION = Registration(
    declaration=NamedComponentForm.of(decode_component(puppets.talker()["component"])), endpoints=[]
)


def state(revision: int) -> StateChanged:
    return StateChanged(
        state=ComponentState(
            instance="talker",
            uuid="u",
            pid=7,
            revision=revision,
            functionalities={},
            ports={},
            parameters={},
            stopping=3.0,
        )
    )


async def done(request: Request, _: str) -> Reply:
    """A handler that carries out everything."""
    return Reply(id=request.id, revision=1)


def server(handler: RequestHandler = done) -> CommandServer:
    return CommandServer(GREETING, handler)


async def eventually(found: Callable[[], Any]) -> None:
    """Wait until ``found`` is true, which it becomes without time passing."""
    while not found():
        await asyncio.sleep(0)


@contextlib.contextmanager
def full_socket(path: Path) -> Iterator[socket.socket]:
    """A socket that listens at ``path`` and has as many connections waiting as it may, as that of a stopped process."""
    with socket.socket(socket.AF_UNIX) as full, socket.socket(socket.AF_UNIX) as waiting:
        full.bind(str(path))
        full.listen(0)
        waiting.connect(str(path))
        yield full


@contextlib.contextmanager
def descriptors_left(number: int) -> Iterator[None]:
    """As if the limit left this process so many more descriptors."""
    lowest = os.dup(0)
    os.close(lowest)
    limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (lowest + number, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, limits)


class BlockedConnection:
    """A connection to a client that does not read: ``sent`` grows by one frame for each ``let_through``."""

    peer: int | None = None

    def __init__(self, *frames: bytes) -> None:
        self.sent: list[bytes] = []
        self.fail = False
        self.closed = asyncio.Event()
        self._to_receive = list(frames)
        self._room = asyncio.Semaphore(0)

    def let_through(self, frames: int) -> None:
        for _ in range(frames):
            self._room.release()

    async def send(self, frame: bytes) -> None:
        await self._room.acquire()
        if self.fail:
            raise Unreachable("the client is gone")
        self.sent.append(frame)

    async def receive(self) -> bytes | None:
        if not self._to_receive:
            await self.closed.wait()
            return None
        return self._to_receive.pop(0)

    @property
    def unread(self) -> int:
        """How many frames the server has not taken yet."""
        return len(self._to_receive)

    def close(self) -> None:
        self.closed.set()

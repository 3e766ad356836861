"""The processes that a manager has ready, so that a component's process need not start when it is needed.

Starting a component costs the start of Python, the imports of the client library, and joining ROS. A spare
(:mod:`.spare`) has done all of that; a process that is forked from the fork server (:mod:`.fork_server`), all but the
last.
"""

from __future__ import annotations

import asyncio
import logging
import socket
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import msgspec

from midstride.backends import fork_client
from midstride.backends.common import in_background
from midstride.backends.fork_client import ForkServer
from midstride.backends.fork_server import JOINED, LOADED
from midstride.backends.process_title import VALUE_ROOM
from midstride.backends.spare import READY, SpareProgram
from midstride.errors import StartFailed
from midstride.runtime.process.child_process import Process
from midstride.wire.environment import ENV_INSTANCE

log: Final = logging.getLogger(__name__)


def fits(command: Sequence[str], directory: Path) -> bool:
    """Return whether a spare can run ``command``, whose first word is a Python: ``FILE …`` or ``-m MODULE …`` without
    options.

    ROS's own arguments concern the process as a whole, which has joined already.
    """
    if len(command) < 2 or "--ros-args" in command or not directory.is_dir():
        return False
    if command[1] == "-m":
        return len(command) > 2
    return not command[1].startswith("-") and (directory / command[1]).is_file() and command[1].endswith(".py")


def _shared(environment: Mapping[str, str]) -> dict[str, str]:
    """The variables that a process may have read when it imported a library or joined: all but what is Midstride's."""
    return {name: value for name, value in environment.items() if not name.startswith("MIDSTRIDE_")}


@dataclass(slots=True)
class _Spare:
    process: Process
    channel: socket.socket
    ready: bool = False


class Spares:
    """To be used on the manager's event loop, and closed. ``module`` prepares each, in the interpreter ``python``."""

    def __init__(self, module: str, python: str, log: Path) -> None:
        self.python = python
        self.wanted = 0
        self.server: ForkServer | None = None
        self._module = module
        self._log = log
        self._environment: Mapping[str, str] = {}
        self._spares: list[_Spare] = []
        self._starting = 0
        self._cannot_fork = False
        self._tasks: set[asyncio.Task[None]] = set()

    @property
    def ready(self) -> int:
        return sum(spare.ready for spare in self._spares)

    def keep(self, number: int, environment: Mapping[str, str]) -> None:
        """Have so many, and a fork server; those that are missing are started now. Raises StartFailed."""
        self.wanted = number
        if _shared(environment) != _shared(self._environment):
            self._end_all()
        self._environment = environment
        while len(self._spares) > number:
            self._end(self._spares[-1])
        if self.server is not None and (self.server.failed or not number):
            self._end_server(self.server)
        if self.server is None and number and not self._cannot_fork:
            self.server = ForkServer(self._module, self.python, environment, self._log)
        for _ in range(number - len(self._spares) - self._starting):
            self._starting += 1
            in_background(self._start(), self._tasks)

    async def _start(self) -> None:
        """Start a spare."""
        try:
            forked = await self._fork(JOINED)
            found = forked or fork_client.start("spare", self._module, self.python, self._environment, self._log)
        except StartFailed as error:
            log.warning("no spare process can be started: %s", error)
            return
        finally:
            self._starting -= 1
        spare = _Spare(*found)
        self._spares.append(spare)
        spare.process.on_exit = lambda status: self._exited(spare)
        asyncio.get_running_loop().add_reader(spare.channel, self._heard, spare)
        if len(self._spares) > self.wanted:
            self._end(spare)

    async def _fork(self, request: bytes) -> tuple[Process, socket.socket] | None:
        """A process of the fork server; None where there is none."""
        if (server := self.server) is None:
            return None
        try:
            return await server.fork(request)
        except StartFailed as error:
            if server is self.server:
                self._cannot_fork = not server.loaded
                self._end_server(server)
                log.warning("%s; its log: %s", error, self._log)
            return None

    def _heard(self, spare: _Spare) -> None:
        """Note that ``spare`` is ready, or that its end of the socket has closed."""
        asyncio.get_running_loop().remove_reader(spare.channel)
        with suppress(OSError):
            spare.ready = spare.channel.recv(len(READY)) == READY
        if not spare.ready:
            self._end(spare)

    async def run(
        self, command: Sequence[str], directory: Path, environment: Mapping[str, str], log: Path
    ) -> Process | None:
        """The process of a spare that runs ``command`` from now on; where none is ready, one that is forked.

        None where ``command`` does not fit, or none can be had.
        """
        if (
            command[0] != self.python
            or len(environment[ENV_INSTANCE]) > len(VALUE_ROOM)
            or _shared(environment) != _shared(self._environment)
            or not fits(command, directory)
        ):
            return None
        program = SpareProgram(list(command), str(directory), dict(environment), str(log))
        for spare in [each for each in self._spares if each.ready]:
            self._forget(spare)
            if self._load(program, spare.process, spare.channel):
                return spare.process
        if (forked := await self._fork(LOADED)) is not None and self._load(program, *forked):
            return forked[0]
        return None

    def _load(self, program: SpareProgram, process: Process, channel: socket.socket) -> bool:
        with channel:
            try:
                log = Path(program.log)
                log.parent.mkdir(parents=True, exist_ok=True)
                process.log_to(log)
                channel.setblocking(True)  # it is waiting for just that
                channel.sendall(msgspec.json.encode(program) + b"\n")
            except OSError:
                in_background(fork_client.leave(process), self._tasks)
                return False
        process.on_exit = None
        return True

    def _exited(self, spare: _Spare) -> None:
        self._forget(spare)
        spare.channel.close()
        spare.process.close()

    def _forget(self, spare: _Spare) -> None:
        if spare in self._spares:
            self._spares.remove(spare)
            with suppress(RuntimeError):
                asyncio.get_running_loop().remove_reader(spare.channel)

    def _end(self, spare: _Spare) -> None:
        """End ``spare``, which exits when its socket closes."""
        self._forget(spare)
        spare.channel.close()
        in_background(fork_client.leave(spare.process), self._tasks)

    def _end_all(self) -> None:
        for spare in list(self._spares):
            self._end(spare)
        if self.server is not None:
            self._end_server(self.server)

    def _end_server(self, server: ForkServer) -> None:
        self.server = None
        in_background(server.close(), self._tasks)

    async def close(self) -> None:
        """End them all."""
        self.wanted = 0
        self._end_all()
        while self._tasks:
            await asyncio.gather(*self._tasks)

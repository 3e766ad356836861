"""The spares that a manager keeps ready, so that a component's process need not start when it is needed.

Starting a component costs the start of Python, the imports of the client library, and joining ROS; a spare
(:mod:`.spare`) has done all of that. Its price is the memory of an idle process of ROS.
"""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import msgspec

from midstride.backends.process_title import ARGUMENT_ROOM, VALUE_ROOM
from midstride.backends.spare import READY, SpareProgram
from midstride.errors import MidstrideError
from midstride.runtime.process import Process, spawn
from midstride.runtime.timeouts import within
from midstride.wire.environment import ENV_INSTANCE

# How long a spare that is not needed any more may take to exit (s).
_LEAVE: Final = 2.0


def fits(command: Sequence[str], directory: Path) -> bool:
    """Whether a spare can run ``command``, whose first word is a Python: ``FILE …`` or ``-m MODULE …`` without options.

    ROS's own arguments concern the process as a whole, which has joined already.
    """
    if len(command) < 2 or "--ros-args" in command or not directory.is_dir():
        return False
    if command[1] == "-m":
        return len(command) > 2
    return not command[1].startswith("-") and (directory / command[1]).is_file() and command[1].endswith(".py")


def _shared(environment: Mapping[str, str]) -> dict[str, str]:
    """What a process may have read when it imported a library or joined: all but what is Midstride's."""
    return {name: value for name, value in environment.items() if not name.startswith("MIDSTRIDE_")}


@dataclass(slots=True)
class _Spare:
    process: Process
    channel: socket.socket
    environment: dict[str, str]
    ready: bool = False


class Spares:
    """To be used on the manager's event loop, and closed. ``module`` prepares each, in the interpreter ``python``."""

    def __init__(self, module: str, python: str, log: Path) -> None:
        self.python = python
        self.wanted = 0
        self._module = module
        self._log = log
        self._spares: list[_Spare] = []
        self._ending: set[asyncio.Task[None]] = set()

    @property
    def ready(self) -> int:
        return sum(spare.ready for spare in self._spares)

    def keep(self, number: int, environment: Mapping[str, str]) -> None:
        """Have so many; those that are missing are started now. Raises StartFailed."""
        self.wanted = number
        while len(self._spares) > number:
            self._end(self._spares[-1])
        while len(self._spares) < number:
            self._spares.append(self._start(environment))

    def _start(self, environment: Mapping[str, str]) -> _Spare:
        ours, theirs = socket.socketpair()
        with theirs:
            command = [self.python, "-m", f"{__package__}.spare", self._module, str(theirs.fileno()), ARGUMENT_ROOM]
            given = {**environment, ENV_INSTANCE: VALUE_ROOM}
            try:
                process = spawn(command, Path("/"), given, self._log, descriptors=(theirs.fileno(),))
            except MidstrideError:
                ours.close()
                raise
        ours.setblocking(False)
        spare = _Spare(process, ours, _shared(environment))
        process.on_exit = lambda status: self._exited(spare)
        asyncio.get_running_loop().add_reader(ours, self._heard, spare)
        return spare

    def _heard(self, spare: _Spare) -> None:
        """It is ready, or its end of the socket has closed."""
        asyncio.get_running_loop().remove_reader(spare.channel)
        with suppress(OSError):
            spare.ready = spare.channel.recv(len(READY)) == READY
        if not spare.ready:
            self._end(spare)

    def run(self, command: Sequence[str], directory: Path, environment: Mapping[str, str], log: Path) -> Process | None:
        """The process of a spare that runs ``command`` from now on; None where none is ready, or it does not fit."""
        if (
            command[0] != self.python
            or len(environment[ENV_INSTANCE]) > len(VALUE_ROOM)
            or not fits(command, directory)
        ):
            return None
        program = SpareProgram(list(command), str(directory), dict(environment), str(log))
        shared = _shared(environment)
        for spare in [each for each in self._spares if each.ready and each.environment == shared]:
            try:
                log.parent.mkdir(parents=True, exist_ok=True)
                spare.process.log_to(log)
                spare.channel.setblocking(True)  # it is waiting for just that
                spare.channel.sendall(msgspec.json.encode(program) + b"\n")
            except OSError:
                self._end(spare)
                continue
            spare.process.on_exit = None
            self._forget(spare)
            return spare.process
        return None

    def _exited(self, spare: _Spare) -> None:
        self._forget(spare)
        spare.process.close()

    def _forget(self, spare: _Spare) -> None:
        if spare in self._spares:
            self._spares.remove(spare)
            with suppress(RuntimeError):
                asyncio.get_running_loop().remove_reader(spare.channel)
            spare.channel.close()

    def _end(self, spare: _Spare) -> None:
        """It exits when its socket closes."""
        self._forget(spare)
        task = asyncio.get_running_loop().create_task(_ended(spare.process))
        self._ending.add(task)
        task.add_done_callback(self._ending.discard)

    async def close(self) -> None:
        """End them all."""
        self.wanted = 0
        for spare in list(self._spares):
            self._end(spare)
        await asyncio.gather(*self._ending)


async def _ended(process: Process) -> None:
    process.on_exit = None
    with suppress(asyncio.TimeoutError):
        async with within(_LEAVE):
            await process.wait()
    with suppress(MidstrideError):  # the kernel does not remove it: nothing waits for its name
        await process.end(0.0)
    process.close()

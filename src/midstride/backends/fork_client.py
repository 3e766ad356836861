"""The manager's side of processes that wait for their program: the fork server (:mod:`.fork_server`), and spares."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Final

from midstride.backends.fork_server import NUMBER_BYTES
from midstride.backends.process_title import ARGUMENT_ROOM, VALUE_ROOM
from midstride.backends.spare import READY
from midstride.errors import MidstrideError, StartFailed
from midstride.model.component import KILL_AT_ONCE
from midstride.runtime.process import reaper
from midstride.runtime.process.child_process import Process, adopting_orphans, spawn
from midstride.runtime.timeouts import within
from midstride.wire.environment import ENV_INSTANCE

# How long the server may take to load, and to fork, on a busy machine (s).
_PATIENCE: Final = 30.0
# How long a process that is not needed any more may take to exit (s).
_LEAVE: Final = 2.0


def start(
    program: str, module: str, python: str, environment: Mapping[str, str], log: Path
) -> tuple[Process, socket.socket]:
    """Start ``program`` of this package, and a socket to it, which does not block. Raises StartFailed."""
    ours, theirs = socket.socketpair()
    with theirs:
        command = [python, "-m", f"{__package__}.{program}", module, str(theirs.fileno()), ARGUMENT_ROOM]
        given = {**environment, ENV_INSTANCE: VALUE_ROOM}
        try:
            process = spawn(command, Path("/"), given, log, descriptors=(theirs.fileno(),))
        except MidstrideError:
            ours.close()
            raise
    ours.setblocking(False)
    return process, ours


async def leave(process: Process) -> None:
    """End a process that exits when its socket is closed, as it has been."""
    process.on_exit = None
    with suppress(asyncio.TimeoutError):
        async with within(_LEAVE):
            await process.wait()
    with suppress(MidstrideError):  # the kernel does not remove it: nothing waits for its name
        await process.end(KILL_AT_ONCE)
    process.close()


class ForkServer:
    """To be used on the manager's event loop, and closed. Raises StartFailed.

    ``module`` says what is loaded, in the interpreter ``python``.
    """

    def __init__(self, module: str, python: str, environment: Mapping[str, str], log: Path) -> None:
        self.process, self._channel = start("fork_server", module, python, environment, log)
        self.process.on_exit = self._exited
        self.failed = False
        self.loaded = False
        self._log = log
        self._one_at_a_time = asyncio.Lock()

    async def fork(self, request: bytes) -> tuple[Process, socket.socket]:
        """A process, with a socket to it which does not block. Raises StartFailed; then the server is of no use."""
        ours, theirs = socket.socketpair()
        ours.setblocking(False)
        try:
            with theirs:
                async with within(_PATIENCE):
                    return await self._fork(request, ours, theirs), ours
        except (OSError, asyncio.TimeoutError) as error:
            ours.close()
            self.failed = True
            raise StartFailed(f"no process could be forked: {str(error) or 'no answer'}") from None
        except BaseException:
            ours.close()  # the process exits
            raise

    async def _fork(self, request: bytes, ours: socket.socket, theirs: socket.socket) -> Process:
        loop = asyncio.get_running_loop()
        async with self._one_at_a_time:
            if not self.loaded:
                self.loaded = await loop.sock_recv(self._channel, len(READY)) == READY
                if not self.loaded:
                    raise OSError("the fork server has exited")
            with adopting_orphans():
                socket.send_fds(self._channel, [request], [theirs.fileno()])
                theirs.close()  # the end of the server ends the wait
                number = int.from_bytes(await loop.sock_recv(ours, NUMBER_BYTES), "little")
        info = reaper.process_info(number) if number else None
        if info is None:
            raise OSError("the fork server could not fork")
        return Process(number, info.started, child=True, log=self._log)

    def _exited(self, status: int | None) -> None:
        self.failed = True

    async def close(self) -> None:
        """Close the server; the processes that it has forked continue."""
        with suppress(OSError):
            self._channel.shutdown(socket.SHUT_RDWR)  # which also ends the wait for it
        await leave(self.process)
        self._channel.close()

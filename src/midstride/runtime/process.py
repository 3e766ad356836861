"""The operating-system processes of components: started in a session of their own, ended as a group.

Each process is started as the leader of its own session and process group, so that a signal reaches
what it starts in turn (a shell, `ros2 run`), and a terminal's Ctrl-C passes it by. Its exit is known
at once through a file descriptor of the process, whoever its parent is: a process that an earlier
manager started is watched like an own one, only that nobody can tell its exit status. Where the
leader ends by itself, the rest of its group is ended with it.
"""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Final

from midstride.errors import BackendError, StartFailed
from midstride.runtime.logs import shorten, tail
from midstride.runtime.reaper import carries, look, members, send
from midstride.runtime.timeouts import within

# How long the kernel may take to end what was killed (s).
KILL_PATIENCE: Final = 10.0
_TICK: Final = 0.02


class Process:
    """A running process and its group. To be used on the event loop it was made on; :meth:`close` lets go of it."""

    def __init__(self, pid: int, started: float, child: bool, log: Path | None = None, log_begins: int = 0) -> None:
        """Watches from now on; what ``log`` holds before ``log_begins`` is another one's.

        Raises ProcessLookupError where ``pid`` is no longer that process.
        """
        self.pid = pid
        self.started = started
        self.log = log
        self._log_begins = log_begins
        self._child = child
        self._status: int | None = None
        self._exited = asyncio.Event()
        self._ending = False
        self._on_exit: Callable[[int | None], None] | None = None
        self._fd = os.pidfd_open(pid)
        seen = look(pid)
        if seen is None or seen.started != started:
            os.close(self._fd)
            raise ProcessLookupError(f"process {pid} is not the one that was started")
        self._group = seen.group
        self._loop = asyncio.get_running_loop()
        self._loop.add_reader(self._fd, self._ended)

    @property
    def running(self) -> bool:
        return not self._exited.is_set()

    @property
    def status(self) -> int | None:
        """The exit status, negative for a signal; None while it runs, and where nobody can tell."""
        return self._status

    def last_words(self) -> str:
        """The end of what it has written to its log."""
        return tail(self.log, since=self._log_begins)

    def shorten_log(self, longest: int, kept: int) -> None:
        """Cut its log to the last ``kept`` bytes where it is longer than ``longest``."""
        if self.log is not None and shorten(self.log, longest, kept):
            self._log_begins = 0

    def on_exit(self, callback: Callable[[int | None], None] | None) -> None:
        """Call ``callback(status)`` when it has ended, instead of what was asked for before."""
        self._on_exit = callback

    async def wait(self) -> int | None:
        await self._exited.wait()
        return self._status

    def _ended(self) -> None:
        self._loop.remove_reader(self._fd)
        if self._child:
            try:
                result = os.waitid(os.P_PIDFD, self._fd, os.WEXITED)
            except ChildProcessError:  # somebody else has reaped it
                result = None
            if result is not None:
                self._status = result.si_status if result.si_code == os.CLD_EXITED else -result.si_status
        if not self._ending and self._group == self.pid:
            # What it started has lost its head: a shell that is killed must not leave the component it ran.
            send(self._group, signal.SIGKILL)
        self._exited.set()
        if self._on_exit is not None:
            self._on_exit(self._status)

    async def end(self, grace: float) -> None:
        """End the process and all of its group: in order, and by force after ``grace`` seconds.

        Returns when all of them are gone. Raises BackendError where the kernel does not let them go.
        """
        self._ending = True
        deadline = self._loop.time() + grace
        self._signal(signal.SIGTERM)
        self._signal(signal.SIGCONT)  # one that was stopped ends in order, too
        await self._gone(deadline)
        deadline = self._loop.time() + KILL_PATIENCE
        while self._left():
            if self._loop.time() > deadline:
                raise BackendError(f"process {self.pid} was killed, but the kernel does not let go of {self._left()}")
            self._signal(signal.SIGKILL)
            await self._gone(self._loop.time() + 0.5)

    async def _gone(self, deadline: float) -> None:
        try:
            async with within(max(0.0, deadline - self._loop.time())):
                await self._exited.wait()
        except asyncio.TimeoutError:
            return
        while self._left() and self._loop.time() < deadline:
            await asyncio.sleep(_TICK)

    def _left(self) -> list[int]:
        if self._group == self.pid:
            return members(self._group)
        return [self.pid] if self.running else []

    def _signal(self, number: signal.Signals) -> None:
        if self._group == self.pid:
            send(self._group, number)
        elif self.running:
            signal.pidfd_send_signal(self._fd, number)

    def close(self) -> None:
        """Let go of it; it goes on."""
        if self._fd >= 0:
            if not self._loop.is_closed():
                self._loop.remove_reader(self._fd)
            os.close(self._fd)
            self._fd = -1


def spawn(arguments: Sequence[str], directory: Path, environment: Mapping[str, str], log: Path) -> Process:
    """Start a process whose output goes to the end of ``log``. Raises StartFailed, naming what is missing."""
    try:
        log.parent.mkdir(parents=True, exist_ok=True)
        with open(log, "ab") as output:
            begins = output.tell()
            child = subprocess.Popen(
                list(arguments),
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                cwd=directory,
                env=dict(environment),
                start_new_session=True,
            )
    except (OSError, ValueError) as error:
        command = " ".join(arguments)
        if not directory.is_dir():
            raise StartFailed(f"cannot start `{command}`: the folder {directory} does not exist") from None
        raise StartFailed(f"cannot start `{command}`: {getattr(error, 'strerror', None) or error}") from None
    child.returncode = 0  # it is waited for by its file descriptor: Popen need not, and must not, reap it
    seen = look(child.pid)
    assert seen is not None, "a child stays in /proc until it is waited for"
    try:
        return Process(child.pid, seen.started, child=True, log=log, log_begins=begins)
    except OSError as error:  # no file descriptor is left for it: what cannot be watched must not run
        send(child.pid, signal.SIGKILL)
        os.waitpid(child.pid, 0)
        raise StartFailed(f"cannot watch `{' '.join(arguments)}`: {error.strerror or error}") from None


def find(pid: int, started: float, variable: str, value: str, log: Path | None = None) -> Process | None:
    """The process that an earlier manager started, or None where it is no longer running.

    It is known by its number, the time of its start, and what it carries in its environment.
    """
    seen = look(pid)
    if seen is None or not seen.alive or seen.started != started or not carries(pid, variable, value):
        return None
    try:
        return Process(pid, started, child=False, log=log)
    except ProcessLookupError:
        return None

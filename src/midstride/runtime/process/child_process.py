"""The operating-system processes of components: each starts as a session leader and is ended with all it has started.

Since each process leads a session and a process group, a signal also reaches its children (of a shell, of
`ros2 run`), and Ctrl-C in the manager's terminal does not reach it. A pidfd reports its exit at once. This also
works for a process that an earlier manager started, except that its exit status is then unknown. When the leader
exits unexpectedly, the rest of its :mod:`.family` is killed.

A component appends to its log itself for as long as it runs. The logs are in the workspace, often in memory
(``XDG_RUNTIME_DIR``): without a limit they would fill it after some days, and a component that cannot write to its log
fails.
"""

from __future__ import annotations

import asyncio
import ctypes
import os
import signal
import subprocess
import threading
from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Final

from midstride.errors import BackendError, StartFailed
from midstride.model.component import StopTimes
from midstride.runtime.backend_protocol import RemainingProcess
from midstride.runtime.process import family, reaper
from midstride.runtime.process.descriptors import restore_limit
from midstride.runtime.process.family import mark_of
from midstride.runtime.timeouts import within
from midstride.wire.environment import ENV_INSTANCE, ENV_TOKEN

# How long the kernel may take to remove a killed process (s).
KILL_PATIENCE: Final = 10.0
# How long what a component has started in other sessions may take to end after SIGTERM (s), once the component has.
LEFT_GRACE: Final = 3.0
# How often a process that has exited is reaped again, while a debugger keeps it (s).
REAP_AGAIN: Final = 1.0
_TICK: Final = 0.02
_LIBC: Final = ctypes.CDLL(None)
_PR_SET_CHILD_SUBREAPER: Final = 36


class Process:
    """A running process and its group, to be used on the event loop that created it. :meth:`close` stops watching."""

    def __init__(self, pid: int, started: float, child: bool, log: Path | None = None, log_begins: int = 0) -> None:
        """Watch the process ``pid`` that started at ``started`` (s since boot).

        ``log`` before the byte ``log_begins`` was written by an earlier process. Raises ProcessLookupError if ``pid``
        is no longer the same process.
        """
        self.pid = pid
        self.started = started
        self.log = log
        self.status: int | None = None  # negative for a signal, None while it runs and if unknown
        self.on_exit: Callable[[int | None], object] | None = None  # called with the status if it exits unexpectedly
        self.mark: str | None = None  # by which its orphans are found; None: not known
        self._log_begins = log_begins
        self._child = child
        self._exited = asyncio.Event()
        self._ending = False
        self._fd = os.pidfd_open(pid)
        info = reaper.process_info(pid)
        if info is None or info.started != started:
            os.close(self._fd)
            raise ProcessLookupError(f"process {pid} is not the one that was started")
        self._info = info
        self._group = info.group
        self._known: dict[int, float] = {}  # what has belonged to it, since its end began: number and start
        self._loop = asyncio.get_running_loop()
        self._loop.add_reader(self._fd, self._ended)

    @property
    def running(self) -> bool:
        return not self._exited.is_set()

    def log_to(self, log: Path) -> None:
        """From now on, what the process writes is appended to ``log``."""
        self.log = log
        self._log_begins = log.stat().st_size if log.exists() else 0

    def last_words(self) -> str:
        """The end of what the process has written to its log."""
        return tail(self.log, since=self._log_begins)

    def shorten_log(self, longest: int, kept: int) -> None:
        """Truncate a log longer than ``longest`` bytes to its last ``kept`` bytes."""
        if self.log is not None and shorten(self.log, longest, kept):
            self._log_begins = 0

    async def wait(self) -> int | None:
        await self._exited.wait()
        return self.status

    def _ended(self) -> None:
        self._loop.remove_reader(self._fd)
        if self._child:
            self._reap()
        self._exited.set()
        if not self._ending:
            self._ended_unexpectedly()

    def _reap(self) -> None:
        """Collect its exit status without waiting: a debugger sees the exit first, and may hold it back for ever."""
        try:
            result = os.waitid(os.P_PID, self.pid, os.WEXITED | os.WNOHANG)  # not reused before: it is a zombie
        except ChildProcessError:  # already reaped elsewhere
            return
        if result is None:
            self._loop.call_later(REAP_AGAIN, self._reap)
        else:
            self.status = result.si_status if result.si_code == os.CLD_EXITED else -result.si_status

    def _ended_unexpectedly(self) -> None:
        if self._group == self.pid:
            # A shell that is killed must not leave the component that it ran.
            reaper.signal_group(self._group, signal.SIGKILL)
            _send(self._members()[1], signal.SIGKILL)
        if self.on_exit is not None:
            self.on_exit(self.status)

    async def end(self, stop: StopTimes) -> list[RemainingProcess]:
        """End the process and its group, then what it has started besides; those that had to be killed.

        One that is killed at once, if it is stopped, does not run again, not for an instant. Returns when all of them
        have exited. Raises BackendError if the kernel does not remove a killed process; then ``on_exit`` is called as
        soon as it has.
        """
        self._ending = True
        try:
            killed = await self._end(stop)
        except BaseException:
            self._ending = False
            if not self.running:  # but one of its group is
                self._ended_unexpectedly()
            raise
        if self.running and self._fd >= 0:  # a debugger keeps one of its threads: the pidfd does not tell
            self._ended()
        return killed

    async def _end(self, stop: StopTimes) -> list[RemainingProcess]:
        group, _ = self._members()
        if stop.asked > 0 and group:
            group = await self._gone(self._loop.time() + stop.asked)
        for number, patience in ((signal.SIGINT, stop.sigterm), (signal.SIGTERM, stop.sigkill)):
            if patience > 0 and group:
                self._signal(number)
                self._signal(signal.SIGCONT)  # a stopped process must run to handle the signal
                group = await self._gone(self._loop.time() + patience)
        killed = _killed(group, stop.longest)
        deadline = self._loop.time() + KILL_PATIENCE
        while group:
            if self._loop.time() > deadline:
                raise BackendError(f"process {self.pid} was killed, but {sorted(group)} did not exit")
            self._signal(signal.SIGKILL)
            group = await self._gone(self._loop.time() + 0.5)
        killed += await self._end_left(LEFT_GRACE if stop.longest else 0.0)
        return killed if stop.longest else []

    async def _gone(self, deadline: float) -> list[int]:
        """Wait until the process and its group have exited, no longer than ``deadline``; those that have not."""
        with suppress(asyncio.TimeoutError):
            async with within(max(0.0, deadline - self._loop.time())):
                await self._exited.wait()
        while (group := self._members()[0]) and self._loop.time() < deadline:
            await asyncio.sleep(_TICK)
        return group

    async def _end_left(self, grace: float) -> list[RemainingProcess]:
        """End what it has started in other groups, once its own has ended; those that had to be killed."""
        _, left = self._members()
        if grace > 0 and left:
            _send(left, signal.SIGTERM, signal.SIGCONT)
            deadline = self._loop.time() + grace
            while (left := self._members()[1]) and self._loop.time() < deadline:
                await asyncio.sleep(_TICK)
        killed = _killed(left, grace)
        deadline = self._loop.time() + KILL_PATIENCE
        while left:
            if self._loop.time() > deadline:
                raise BackendError(f"{sorted(left)}, which process {self.pid} had started, did not exit when killed")
            _send(left, signal.SIGKILL)
            await asyncio.sleep(_TICK)
            left = self._members()[1]
        return killed

    def _members(self) -> tuple[list[int], list[int]]:
        """The processes that run of its group, itself included, and what it has started in other groups.

        What has been found once is found again.
        """
        if self._group != self.pid:
            return [self.pid] if self.running else [], []
        found = family.members(self._info, self.mark, self._known)
        self._known |= {pid: process.started for pid, process in found.items()}
        group = [pid for pid, process in found.items() if process.group == self._group]
        return group, [pid for pid in found if pid not in group]

    def family(self, all_processes: Iterable[reaper.ProcessInfo]) -> set[int]:
        """The numbers of the process and of all that it has started; ``all_processes``: those of this machine."""
        return {self.pid, *family.members(self._info, self.mark, self._known, all_processes)}

    def _signal(self, number: signal.Signals) -> None:
        if self._group == self.pid:
            reaper.signal_group(self._group, number)
        elif self.running:
            signal.pidfd_send_signal(self._fd, number)

    def close(self) -> None:
        """Stop watching; the process continues."""
        if self._fd >= 0:
            if not self._loop.is_closed():
                self._loop.remove_reader(self._fd)
            os.close(self._fd)
            self._fd = -1


def _killed(pids: Iterable[int], seconds: float) -> list[RemainingProcess]:
    """The processes ``pids`` that still run, to be killed after they had ``seconds`` to end."""
    return [RemainingProcess(pid, name, seconds) for pid in pids if (name := reaper.program_name(pid)) is not None]


def _send(processes: Iterable[int], *numbers: signal.Signals) -> None:
    """Send signals to processes, in this order; one that has exited meanwhile is not an error."""
    for pid in processes:
        for number in numbers:
            with suppress(ProcessLookupError, PermissionError):
                os.kill(pid, number)


def spawn(
    arguments: Sequence[str],
    directory: Path,
    environment: Mapping[str, str],
    log: Path,
    descriptors: Sequence[int] = (),
) -> Process:
    """Start a process that appends its output to ``log``, and inherits ``descriptors``.

    Raises StartFailed with the reason.
    """
    try:
        log.parent.mkdir(parents=True, exist_ok=True)
        with open(log, "ab") as output, _interruptible():
            begins = output.tell()
            child = subprocess.Popen(
                list(arguments),
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                cwd=directory,
                env=dict(environment),
                pass_fds=descriptors,
                start_new_session=True,
            )
    except (OSError, ValueError) as error:
        command = " ".join(arguments)
        if not directory.is_dir():
            raise StartFailed(f"cannot start `{command}`: the folder {directory} does not exist") from None
        raise StartFailed(f"cannot start `{command}`: {getattr(error, 'strerror', None) or error}") from None
    restore_limit(child.pid)
    child.returncode = 0  # the pidfd reaps it: Popen must not
    info = reaper.process_info(child.pid)
    assert info is not None, "a child stays in /proc until it is reaped"
    try:
        return Process(child.pid, info.started, child=True, log=log, log_begins=begins)
    except OSError as error:  # no file descriptor left: a process that cannot be watched must not run
        reaper.signal_group(child.pid, signal.SIGKILL)
        os.waitpid(child.pid, 0)
        raise StartFailed(f"cannot watch `{' '.join(arguments)}`: {error.strerror or error}") from None


@contextmanager
def _interruptible() -> Iterator[None]:
    """Meanwhile a process that is started does not ignore SIGINT, with which it is ended.

    A shell starts what is in the background, such as a manager, with SIGINT ignored, and that is inherited.
    """
    ignored = signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    if not ignored or threading.current_thread() is not threading.main_thread():
        yield
        return
    signal.signal(signal.SIGINT, lambda *_: None)  # in the new process, it is the default
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)


_adopting = 0


@contextmanager
def adopting_orphans() -> Iterator[None]:
    """Meanwhile a descendant whose parent exits becomes a child of this process, which then learns its exit status."""
    global _adopting
    _adopting += 1
    _LIBC.prctl(_PR_SET_CHILD_SUBREAPER, 1)
    try:
        yield
    finally:
        _adopting -= 1
        _LIBC.prctl(_PR_SET_CHILD_SUBREAPER, int(_adopting > 0))


def find(pid: int, started: float, variable: str, value: str, log: Path | None = None) -> Process | None:
    """The process that an earlier manager started, or None if it no longer runs.

    It is identified by its number, its start time (s since boot) and ``variable`` in its environment.
    """
    info = reaper.process_info(pid)
    if info is None or not info.alive or info.started != started or reaper.environment_value(pid, variable) != value:
        return None
    try:
        return Process(pid, started, child=False, log=log)
    except ProcessLookupError:
        return None


async def end_orphans(token: str, known: Container[str], stop: StopTimes) -> list[str]:
    """End the system's processes whose instance is not ``known``; returns the names of those instances.

    An earlier manager started them, but could not record them before it was killed: they would run forever and keep
    their names in use. ``token`` in their environment identifies them. The children of a known component have that
    component's name in their environment, and are left alone. Raises BackendError if the kernel does not remove a
    killed process.
    """
    orphans: dict[str, list[reaper.ProcessInfo]] = {}
    for process in reaper.processes():
        if process.alive and reaper.environment_value(process.pid, ENV_TOKEN) == token:
            name = reaper.environment_value(process.pid, ENV_INSTANCE)
            if name is not None and name not in known:
                orphans.setdefault(name.strip(), []).append(process)
    await asyncio.gather(*(_end(process, token, stop) for found in orphans.values() for process in _leaders(found)))
    return sorted(filter(None, orphans))  # a spare has no name yet


def _leaders(found: list[reaper.ProcessInfo]) -> list[reaper.ProcessInfo]:
    """The group leaders, with which their groups end, and the processes whose leader is not among ``found``."""
    leaders = {process.pid for process in found if process.pid == process.group}
    return [process for process in found if process.pid == process.group or process.group not in leaders]


async def _end(orphan: reaper.ProcessInfo, token: str, stop: StopTimes) -> None:
    process = find(orphan.pid, orphan.started, ENV_TOKEN, token)
    if process is not None:
        with closing(process):
            process.mark = mark_of(orphan.pid)
            await process.end(stop)


def tail(log: Path | None, length: int = 4000, since: int = 0) -> str:
    """The last ``length`` bytes of a log, in whole lines, and nothing before the byte ``since``.

    One that is shorter by now has been emptied, by hand or by logrotate: all that is in it was written since.
    """
    if log is None:
        return ""
    try:
        with open(log, "rb") as file:
            size = file.seek(0, os.SEEK_END)
            since = since if since <= size else 0
            file.seek(max(since, size - length))
            text = file.read().decode(errors="replace")
    except OSError:
        return ""
    return text if size - since <= length else text.partition("\n")[2]


def shorten(log: Path, longest: int, kept: int) -> bool:
    """Truncate a log longer than ``longest`` bytes to its last ``kept`` bytes, in whole lines; returns whether it did.

    The component continues at the new end, since it opened the log for appending. A line that it writes during the
    truncation may be lost.
    """
    try:
        size = log.stat().st_size
        if size <= longest:
            return False
        with open(log, "r+b") as file:
            file.seek(max(0, size - kept))
            end = file.read().partition(b"\n")[2]
            file.truncate(0)
        with open(log, "ab") as file:
            file.write(end)
    except OSError:
        return False
    return True

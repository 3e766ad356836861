"""The reaper: a small process that ends the processes of a system when its manager is killed.

It holds the reading end of a pipe from the manager. When that pipe reaches its end, for whatever reason
(``kill -9`` of the manager included), it ends every process group that the manager registered and every
process that has the system's token in its environment, registered or not. ``demo`` and the tests use a
reaper. ``up`` does not: there, components outlive their manager (docs/semantics.md).

The process runs this file alone, without the package and without site-packages: it starts in milliseconds,
and no environment can break it. So this module imports only the standard library, and slow modules only where
they are used. This is also why it parses ``/proc`` itself; psutil, besides, offers neither the process group
nor a start time that survives a step of the system clock. The process leads a session, so a signal to the
manager's terminal or process group does not reach it.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import suppress
from typing import TYPE_CHECKING, Final, NamedTuple

if TYPE_CHECKING:
    from subprocess import Popen

# How long processes may take to exit after SIGTERM, and the kernel to remove them after SIGKILL (s).
GRACE: Final = 3.0
KILL_PATIENCE: Final = 10.0
_TICK: Final = 0.02
# The reaper ends after the manager, not before.
_IGNORED: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_TICKS_PER_SECOND: Final = os.sysconf("SC_CLK_TCK")


class ProcessInfo(NamedTuple):
    """One process as ``/proc`` shows it.

    ``started`` (s since boot) and ``pid`` together identify it: a later process with the same number has another start
    time, and a step of the system clock does not change it. ``stopped``: by a signal, not by a debugger.
    """

    pid: int
    group: int
    started: float
    alive: bool
    stopped: bool = False
    parent: int = 0


def process_info(pid: int) -> ProcessInfo | None:
    """The process ``pid``, or None if it does not exist. A zombie is not alive."""
    try:
        with open(f"/proc/{pid}/stat", "rb") as file:
            text = file.read()
    except OSError:
        return None
    fields = text[text.rindex(b")") + 2 :].split()  # the command name, in parentheses, may contain anything
    alive, stopped = fields[0] not in (b"Z", b"X"), fields[0] == b"T"
    return ProcessInfo(pid, int(fields[2]), int(fields[19]) / _TICKS_PER_SECOND, alive, stopped, int(fields[1]))


def processes() -> Iterator[ProcessInfo]:
    """All processes of this machine."""
    for name in os.listdir("/proc"):
        if name.isdigit() and (process := process_info(int(name))) is not None:
            yield process


def environment_value(pid: int, variable: str) -> str | None:
    """The variable in the environment with which the process started; None if it is not set or cannot be read."""
    name = f"{variable}=".encode()
    try:
        with open(f"/proc/{pid}/environ", "rb") as file:
            entries = file.read().split(b"\0")
    except OSError:
        return None
    return next((os.fsdecode(entry[len(name) :]) for entry in entries if entry.startswith(name)), None)


def program_name(pid: int) -> str | None:
    """The name of its program, as the kernel has it; None if the process does not exist."""
    try:
        with open(f"/proc/{pid}/comm", "rb") as file:
            return os.fsdecode(file.read()).strip()
    except OSError:
        return None


def signal_group(group: int, number: signal.Signals) -> None:
    """Send a signal to a process group. A group that no longer exists is not an error."""
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(group, number)


def remaining_groups(watched: dict[int, float], variable: str, token: str) -> set[int]:
    """The process groups with a living member that are ``watched`` (group: start of its leader) or have the token."""
    own = os.getpgrp()
    groups: set[int] = set()
    for process in processes():
        if not process.alive or process.group == own:
            continue
        if environment_value(process.pid, variable) == token:
            groups.add(process.group)
        elif process.group in watched:
            leader = process_info(process.group)  # its number is not reused while the group has members
            if leader is None or leader.started == watched[process.group]:
                groups.add(process.group)
    return groups


def end_groups(watched: dict[int, float], variable: str, token: str, grace: float = GRACE) -> None:
    """End all remaining groups: with SIGTERM, and after ``grace`` seconds with SIGKILL."""
    kill = time.monotonic() + grace
    terminated: set[int] = set()
    while (groups := remaining_groups(watched, variable, token)) and time.monotonic() < kill + KILL_PATIENCE:
        for group in groups:
            if time.monotonic() >= kill:
                signal_group(group, signal.SIGKILL)
            elif group not in terminated:
                signal_group(group, signal.SIGTERM)
                signal_group(group, signal.SIGCONT)
        terminated |= groups
        time.sleep(_TICK)


def main(lines: Iterable[str], variable: str, token: str) -> None:
    """``+GROUP STARTED`` watches a group, ``-GROUP`` releases it. The end of ``lines`` is the end of the manager."""
    watched: dict[int, float] = {}
    for line in lines:
        group, _, started = line[1:].strip().partition(" ")
        if line.startswith("+"):
            watched[int(group)] = float(started)
        else:
            watched.pop(int(group), None)
    end_groups(watched, variable, token)


class Reaper:
    """The manager's handle of the reaper process. As a context manager it ends what remains, then the reaper itself."""

    def __init__(self, variable: str, token: str) -> None:
        """Every process of the system has the environment variable ``variable`` set to ``token``."""
        import subprocess

        # Blocked, which it inherits, until it ignores them: else a signal in its first moments would end it.
        earlier = signal.pthread_sigmask(signal.SIG_BLOCK, _IGNORED)
        try:
            self._process: Popen[bytes] = subprocess.Popen(
                [sys.executable, "-I", "-S", __file__, variable, token],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                cwd="/",
                start_new_session=True,
            )
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, earlier)
        assert self._process.stdin is not None
        self._pipe = self._process.stdin

    @property
    def pid(self) -> int:
        return self._process.pid

    def watch(self, group: int, started: float) -> None:
        """End the group with the manager; ``started`` is the start time of its leader (s since boot)."""
        self._write(f"+{group} {started}\n")

    def release(self, group: int) -> None:
        self._write(f"-{group}\n")

    def _write(self, line: str) -> None:
        if not self._pipe.closed:
            with suppress(BrokenPipeError):  # the reaper was killed: the manager continues without it
                self._pipe.write(line.encode())
                self._pipe.flush()

    def close(self) -> None:
        """End what remains, and return when it has ended."""
        with suppress(BrokenPipeError):
            self._pipe.close()
        self._process.wait()

    def __enter__(self) -> Reaper:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


if __name__ == "__main__":
    for number in _IGNORED:
        signal.signal(number, signal.SIG_IGN)
    main(sys.stdin, sys.argv[1], sys.argv[2])

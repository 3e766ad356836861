"""Nothing is left behind: a small process that ends what a manager started, should the manager be killed.

It holds the reading end of a pipe from the manager. At the end of that pipe, however it came about
(kill -9 included), it ends every process group it was told of, and every process whose environment
carries the system's token, told of or not. ``demo`` and the tests use one; under ``up`` components
outlive their manager, so there it has no place (semantics.md section 7).

The process runs this very file, without the package and without site-packages, so that it starts in
milliseconds and no environment can break it: only the standard library is imported here, and what is
slow to import only where it is used. It has a session of its own: what ends a terminal or a process
group passes it by.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import suppress
from types import TracebackType
from typing import TYPE_CHECKING, Final, NamedTuple

if TYPE_CHECKING:
    from subprocess import Popen

# How long what is left may take to end in order, and then how long the kernel may take to end it (s).
GRACE: Final = 3.0
KILL_PATIENCE: Final = 10.0
_TICK: Final = 0.02
_TICKS_PER_SECOND: Final = os.sysconf("SC_CLK_TCK")


class Seen(NamedTuple):
    """One process as ``/proc`` shows it. ``started`` (s since the system's start) tells it from a later one."""

    pid: int
    group: int
    started: float
    alive: bool


def look(pid: int) -> Seen | None:
    """The process ``pid``, or None where there is none. A zombie is not alive."""
    try:
        with open(f"/proc/{pid}/stat", "rb") as file:
            text = file.read()
    except OSError:
        return None
    fields = text[text.rindex(b")") + 2 :].split()  # the command's name in parentheses may hold anything
    return Seen(pid, int(fields[2]), int(fields[19]) / _TICKS_PER_SECOND, fields[0] not in (b"Z", b"X"))


def processes() -> Iterator[Seen]:
    """Every process there is."""
    for name in os.listdir("/proc"):
        if name.isdigit() and (seen := look(int(name))) is not None:
            yield seen


def members(group: int) -> list[int]:
    """The living processes of a process group."""
    return [seen.pid for seen in processes() if seen.group == group and seen.alive]


def value_of(pid: int, variable: str) -> str | None:
    """The variable in the environment that the process was started with; None without, or where nobody may know."""
    name = f"{variable}=".encode()
    try:
        with open(f"/proc/{pid}/environ", "rb") as file:
            entries = file.read().split(b"\0")
    except OSError:
        return None
    return next((os.fsdecode(entry[len(name) :]) for entry in entries if entry.startswith(name)), None)


def carries(pid: int, variable: str, value: str) -> bool:
    """Whether the process was started with this variable in its environment."""
    return value_of(pid, variable) == value


def send(group: int, number: signal.Signals) -> None:
    """Send a signal to a process group; that it is gone already is no error."""
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(group, number)


def left(told: dict[int, float], variable: str, token: str) -> set[int]:
    """The process groups, told of or carrying the token, that still have a living member."""
    own = os.getpgrp()
    groups: set[int] = set()
    for seen in processes():
        if not seen.alive or seen.group == own:
            continue
        if carries(seen.pid, variable, token):
            groups.add(seen.group)
        elif seen.group in told:
            leader = look(seen.group)  # where the leader is gone, its number cannot have been given to another one
            if leader is None or leader.started == told[seen.group]:
                groups.add(seen.group)
    return groups


def end_all(told: dict[int, float], variable: str, token: str, grace: float = GRACE) -> None:
    """End them all: in order, by force after ``grace`` seconds."""
    deadline = time.monotonic() + grace
    asked: set[int] = set()
    while (groups := left(told, variable, token)) and time.monotonic() < deadline:
        for group in groups - asked:
            send(group, signal.SIGTERM)
            send(group, signal.SIGCONT)
        asked |= groups
        time.sleep(_TICK)
    deadline = time.monotonic() + KILL_PATIENCE
    while (groups := left(told, variable, token)) and time.monotonic() < deadline:
        for group in groups:
            send(group, signal.SIGKILL)
        time.sleep(_TICK)


def main(lines: Iterable[str], variable: str, token: str) -> None:
    """``+GROUP STARTED``: watch this group; ``-GROUP``: no longer. The end of ``lines`` is the manager's end."""
    told: dict[int, float] = {}
    for line in lines:
        group, _, started = line[1:].strip().partition(" ")
        if line.startswith("+"):
            told[int(group)] = float(started)
        else:
            told.pop(int(group), None)
    end_all(told, variable, token)


class Reaper:
    """The manager's end of it. A context manager: leaving it ends what is left, and then the guardian itself."""

    def __init__(self, variable: str, token: str) -> None:
        """``variable`` and ``token``: what the environment of every process of the system carries."""
        import subprocess

        self._process: Popen[bytes] = subprocess.Popen(
            [sys.executable, "-I", "-S", __file__, variable, token],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            cwd="/",
            start_new_session=True,
        )

    @property
    def pid(self) -> int:
        return self._process.pid

    def watch(self, group: int, started: float) -> None:
        self._tell(f"+{group} {started}\n")

    def release(self, group: int) -> None:
        self._tell(f"-{group}\n")

    def _tell(self, line: str) -> None:
        pipe = self._process.stdin
        if pipe is not None and not pipe.closed:
            with suppress(BrokenPipeError):  # somebody killed the guardian: the manager goes on without
                pipe.write(line.encode())
                pipe.flush()

    def close(self) -> None:
        """End what is left, and return when it has ended."""
        if self._process.stdin is not None and not self._process.stdin.closed:
            with suppress(BrokenPipeError):
                self._process.stdin.close()
        self._process.wait()

    def __enter__(self) -> Reaper:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


if __name__ == "__main__":
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):  # it ends when the manager does, not before
        signal.signal(number, signal.SIG_IGN)
    main(sys.stdin, sys.argv[1], sys.argv[2])

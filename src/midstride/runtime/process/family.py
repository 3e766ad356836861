"""The processes that belong to a component: its group, what they have started, and orphans that bear its mark.

A program may start others in new sessions, as `setsid` and daemons do, which no signal to its process group
reaches. Two things show that such a process belongs to it: a chain of parents, and a word in its environment that is
another for each start, which also an orphan has, and which a later manager can read.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from typing import Final

from midstride.runtime.process import reaper
from midstride.runtime.process.reaper import ProcessInfo
from midstride.wire.environment import ENV_START


def mark_of(pid: int) -> str | None:
    """Return what the environment of a process says of the start that it belongs to; None where that is not known."""
    return reaper.environment_value(pid, ENV_START) or None


# While the kernel loads its program, a process has no environment: that it has no mark is only known later (s).
STARTING: Final = 10.0
# The marks that have been read: an environment is that with which a process has started.
_marks: Final[dict[tuple[int, float], str | None]] = {}


def _mark(process: ProcessInfo) -> str | None:
    key = process.pid, process.started
    if key in _marks:
        return _marks[key]
    mark = mark_of(process.pid)
    if mark is not None or time.clock_gettime(time.CLOCK_BOOTTIME) - process.started > STARTING:
        _marks[key] = mark
    return mark


def members(
    leader: ProcessInfo,
    mark: str | None,
    known: Mapping[int, float],
    all_processes: Iterable[ProcessInfo] | None = None,
) -> dict[int, ProcessInfo]:
    """The living processes that belong to ``leader``, itself included, by number.

    ``mark``: that of its start (:func:`mark_of`). ``known``: those that belonged to it before, number and start, as a
    chain of parents breaks when one of them exits. ``all_processes``: those of this machine, where they are known.
    """
    found = {process.pid: process for process in (reaper.processes() if all_processes is None else all_processes)}
    for key in [key for key in _marks if (seen := found.get(key[0])) is None or seen.started != key[1]]:
        del _marks[key]
    belonging: dict[int, ProcessInfo] = {}
    children: dict[int, list[ProcessInfo]] = {}
    for process in found.values():
        children.setdefault(process.parent, []).append(process)
        if (
            (process.pid, process.started) == (leader.pid, leader.started)
            or (process.group == leader.group == leader.pid and process.started >= leader.started)
            or known.get(process.pid) == process.started
            or (mark is not None and process.started >= leader.started and _mark(process) == mark)
        ):
            belonging[process.pid] = process
    pending = list(belonging.values())
    while pending:
        for child in children.get(pending.pop().pid, ()):
            if child.pid not in belonging:
                belonging[child.pid] = child
                pending.append(child)
    return {pid: process for pid, process in belonging.items() if process.alive}

"""The memory that a process has, and how much is left for another one (Linux)."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Final, NamedTuple

_PROC: Final = Path("/proc")
_CGROUPS: Final = Path("/sys/fs/cgroup")
# Where middlewares keep the segments by which processes exchange messages.
SHARED: Final = Path("/dev/shm")
_ENTRY: Final = re.compile(r"^(\w+):\s+(\d+) kB$", re.MULTILINE)


class Memory(NamedTuple):
    """Amounts of memory (bytes). ``own``: that no file is behind, in RAM or swapped out; a second process of the same
    program shares the rest with the first. ``shared``: in the files of shared memory, those of other processes included
    that it has mapped.
    """

    own: int
    shared: int

    def plus(self, other: Memory) -> Memory:
        return Memory(self.own + other.own, self.shared + other.shared)


def memory_of(pid: int, proc: Path = _PROC) -> Memory | None:
    """The memory that a process has now; None where that cannot be read."""
    found = _entries(proc / str(pid) / "status")
    if "RssAnon" not in found:
        return None
    return Memory(found["RssAnon"] + found.get("VmSwap", 0), found.get("RssShmem", 0))


def free_memory(proc: Path = _PROC, cgroups: Path = _CGROUPS, shared: Path = SHARED) -> Memory | None:
    """The memory that processes can get beside those that run, without swapping; None where that cannot be read.

    Also within the control groups (version 2) of this process, of which those that it has started are.
    """
    available = _entries(proc / "meminfo").get("MemAvailable")
    if available is None:
        return None
    try:
        found = os.statvfs(shared)
        left = found.f_bavail * found.f_frsize
    except OSError:
        return None
    return Memory(min([available, *_left_in_groups(proc, cgroups)]), left)


def _left_in_groups(proc: Path, cgroups: Path) -> Iterator[int]:
    try:
        lines = (proc / "self" / "cgroup").read_text(encoding="utf-8").splitlines()
    except OSError:
        return
    name = next((line.removeprefix("0::").strip("/") for line in lines if line.startswith("0::")), None)
    group = None if name is None else cgroups / name
    while group is not None and group.is_relative_to(cgroups):
        try:
            limit = int((group / "memory.max").read_text(encoding="utf-8"))  # `max` where there is none
            used = int((group / "memory.current").read_text(encoding="utf-8"))
            stat = dict(line.split() for line in (group / "memory.stat").read_text(encoding="utf-8").splitlines())
            yield max(0, limit - used + int(stat.get("inactive_file", 0)))  # which the kernel takes back
        except (OSError, ValueError):
            pass
        group = group.parent if group != cgroups else None


def _entries(path: Path) -> dict[str, int]:
    try:
        text = path.read_text(encoding="utf-8")
    except OSError:
        return {}
    return {name: int(number) * 1024 for name, number in _ENTRY.findall(text)}

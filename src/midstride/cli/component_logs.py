"""The log files of a node's instances: which they are, the run that each ends with, and what is appended to them."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Final

from midstride.cli.render import time_of_day
from midstride.model.instance_names import dotted_name, is_named_after, log_file_name
from midstride.runtime.process.log_runs import run_begun
from midstride.runtime.workspace import Workspace

if TYPE_CHECKING:
    from midstride.runtime.records.status_forms import CrashedInstance, Status

# How much of the end of a file is read for its last lines, and how much at once of what is appended to it (bytes).
LONGEST_TAIL: Final = 4 * 1024 * 1024
LONGEST_PIECE: Final = 1024 * 1024
# ROS's stamp (Unix time) at the begin of a line: [INFO] [1795230947.628793895] [listener]: I heard: …
_STAMP: Final = re.compile(r"(\[[A-Z]+\] \[)(\d{9,}\.\d+)(?=\])")


def log_files(workspace: Workspace, node: str, status: Status | None) -> list[Path]:
    """The logs of ``node``, a role, an instance or a container: those of what has crashed first, the live one's last.

    Nodes that share the process of a container share its log. Without the manager's ``status``, those of every instance
    that has had its name, the newest last.
    """
    if status is not None:
        named = (each for each in status.instances if node in (each.role, each.name, each.container, each.process))
        hosts = {each.name for each in status.hosts}
        live = [
            _folder(workspace, each.host if each.host in hosts else None) / log_file_name(each.process or each.name)
            for each in named
        ]
        gone = (each for each in status.crashed if is_named_after(each.name, node) or each.container == node)
        crashed = [_log_of_crashed(workspace, each) for each in gone]
        paths = list(dict.fromkeys([*(path for path in crashed if path not in live), *live]))
        if not paths:  # an instance that is no more, as after a roll-back
            paths = [_latest(workspace, node)]
        return [path for path in paths if path.exists() and path != workspace.manager_log]
    found = [path for path in _all_logs(workspace) if is_named_after(path.stem, dotted_name(node))]
    return sorted((path for path in found if path != workspace.manager_log), key=lambda path: path.stat().st_mtime)


def is_of(stem: str, node: str, status: Status | None) -> bool:
    """Return whether the log with this name is one of ``node``, as :func:`log_files` finds them."""
    names = () if status is None else (each for each in status.instances if node in (each.container, each.process))
    own = {dotted_name(each.process or each.name) for each in names}
    return is_named_after(stem, dotted_name(node)) or stem in own


def _log_of_crashed(workspace: Workspace, crashed: CrashedInstance) -> Path:
    """The log of an instance that has crashed; where it has none, that of the latest process of its container."""
    own = _latest(workspace, crashed.name)
    if crashed.container is None or own.exists():
        return own
    container = dotted_name(crashed.container)
    processes = [path for path in _all_logs(workspace) if is_named_after(path.stem, container)]
    return max(processes, key=lambda path: path.stat().st_mtime, default=own)


def _folder(workspace: Workspace, host: str | None) -> Path:
    """The folder of the logs of this host, or of the copies of those of another one."""
    return workspace.logs if host is None else workspace.logs / host


def _all_logs(workspace: Workspace) -> list[Path]:
    """The logs of this host, and the copies of those of others."""
    return [*workspace.logs.glob("*.log"), *workspace.logs.glob("*/*.log")]


def _latest(workspace: Workspace, instance: str) -> Path:
    """The log of an instance that is no more, wherever it was; that of this host where there is none."""
    name = log_file_name(instance)
    found = (path for path in _all_logs(workspace) if path.name == name)
    return max(found, key=lambda path: path.stat().st_mtime, default=workspace.logs / name)


def ended_since(workspace: Workspace, node: str, shown: Sequence[Path]) -> list[str]:
    """The instances of ``node`` whose logs are not ``shown``, and are newer than the begin of the latest of those.

    As of a replacement that did not succeed.
    """
    begun = max((run for path in shown for run in latest_run(last_lines(path)[0])[1][-1:]), default=None)
    found: list[tuple[str, str]] = []
    for path in _all_logs(workspace):
        if begun is not None and path not in shown and is_named_after(path.stem, dotted_name(node)):
            runs = latest_run(last_lines(path)[0])[1]
            if runs and runs[-1] > begun:
                found.append((runs[-1], path.stem))
    return [name for _, name in sorted(found)]


def known_nodes(workspace: Workspace, status: Status | None) -> list[str]:
    """The names that ``logs`` can be asked for."""
    if status is None:
        return sorted({path.stem for path in _all_logs(workspace) if path != workspace.manager_log})
    live = [name for each in status.instances for name in (each.role, each.name, each.container) if name is not None]
    crashed = [name for each in status.crashed for name in (each.role, each.name, each.container) if name is not None]
    return sorted({*live, *crashed})


def latest_run(lines: Sequence[str]) -> tuple[list[str], list[str]]:
    """The output of an instance's latest process, and when its runs in the log began (local times)."""
    begins = [index for index, line in enumerate(lines) if run_begun(line) is not None]
    times = [time for line in lines if (time := run_begun(line)) is not None]
    return [*lines[begins[-1] + 1 if begins else 0 :]], times


def with_local_time(line: str) -> str:
    """The line with ROS's stamp as the local time. One of a simulated clock stays as it is."""
    return _STAMP.sub(lambda found: found[1] + time_of_day(float(found[2])), line, count=1)


def last_lines(path: Path) -> tuple[list[str], int]:
    """The lines of the last 4 MB of a file, and where it ended."""
    with path.open("rb") as file:
        end = file.seek(0, 2)
        file.seek(max(0, end - LONGEST_TAIL))
        text = file.read(min(end, LONGEST_TAIL))
    lines = text.decode(errors="replace").removesuffix("\n").split("\n") if text else []
    if end > LONGEST_TAIL:
        del lines[0]  # it began before
    return lines, end


@dataclass
class Appended:
    """The text appended to some files, in whole lines, from where they ended when they were given."""

    _ends: dict[Path, int] = field(default_factory=dict)
    _parts: dict[Path, bytes] = field(default_factory=dict)

    def follow(self, path: Path, end: int) -> None:
        """Follow a file from ``end`` on, unless it is followed already."""
        self._ends.setdefault(path, end)

    def lines(self) -> Iterator[tuple[Path, str]]:
        """The new lines. A file that has been shortened is read on from its new end."""
        for path, end in self._ends.items():
            try:
                with path.open("rb") as file:
                    size = file.seek(0, 2)
                    if size < end:
                        self._ends[path], self._parts[path] = size, b""
                        continue
                    file.seek(end)
                    new = file.read(LONGEST_PIECE)
            except OSError:
                continue
            self._ends[path] = end + len(new)
            *whole, rest = (self._parts.get(path, b"") + new).split(b"\n")
            self._parts[path] = rest
            yield from ((path, line.decode(errors="replace")) for line in whole)

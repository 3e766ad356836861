"""The files of the program that this process runs: its script, and the modules that it has imported.

Modules of the interpreter, of its environment, of ROS and of Midstride do not count.
"""

from __future__ import annotations

import os
import site
import sys
import sysconfig
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, Final

from midstride.codec.writing import expressible
from midstride.wire.program import FileFingerprint, Program

# How many files are listed at most.
MOST_FILES: Final = 1000


@dataclass
class ProgramFiles:
    """``modules``: what has been imported, by name; ``started``: when the process started (unix ns).

    A file is read when it is listed for the first time, and that result is kept.
    """

    modules: Mapping[str, Any]
    started: int
    _read: dict[str, FileFingerprint] = field(default_factory=dict)

    def listed(self) -> Program:
        """The files, the script first. Reads them, so not for an event loop's thread."""
        paths = dict.fromkeys(self._paths())
        listed = [path for path in paths if expressible(path) == path][:MOST_FILES]  # no other can be sent
        for path in listed:
            if path not in self._read and (file := FileFingerprint.read(path, self.started)) is not None:
                self._read[path] = file
        return Program(files=list(self._read.values()), started=self.started, complete=len(listed) == len(paths))

    def _paths(self) -> Iterator[str]:
        script = _file_of(self.modules.get("__main__"))
        if script is not None:
            yield script
        elsewhere = _environment()
        for module in list(self.modules.values()):
            path = _file_of(module)
            if path is not None and not (path.startswith(elsewhere) or os.path.realpath(path).startswith(elsewhere)):
                yield path


# When the program began to load, where the process had started before (unix ns).
_loading: int | None = None


def loads_now() -> None:
    """The process has existed for a while, and begins to load its program only now."""
    global _loading
    _loading = time.time_ns()


def process_started() -> int:
    """The start of this process (unix ns), to the tick of the kernel, 10 ms; now where that is not known."""
    if _loading is not None:
        return _loading
    try:
        after_name = Path("/proc/self/stat").read_bytes().rpartition(b")")[2]  # the name may not be UTF-8
        since_boot = int(after_name.split()[19]) / os.sysconf("SC_CLK_TCK")
    except (OSError, ValueError, IndexError):
        return time.time_ns()
    return time.time_ns() - int((time.clock_gettime(time.CLOCK_BOOTTIME) - since_boot) * 1e9)


def _file_of(module: Any) -> str | None:
    """Without `getattr`: it would make a lazy module load."""
    try:
        path = object.__getattribute__(module, "__dict__").get("__file__")
    except AttributeError:
        return None
    return os.path.abspath(path) if isinstance(path, str) else None


@cache
def _environment() -> tuple[str, ...]:
    """The folders whose modules are not the program's, each with a slash at its end."""
    installed = sysconfig.get_paths()
    folders = [installed[name] for name in ("stdlib", "platstdlib", "purelib", "platlib")]
    folders += [*site.getsitepackages(), site.getusersitepackages(), str(Path(__file__).parents[1])]
    for ros in filter(None, map(sys.modules.get, ("rclpy", "rospy"))):
        package = os.path.dirname(os.path.realpath(_file_of(ros) or ""))
        prefixes = map(os.path.realpath, filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)))
        folders.append(next((path for path in prefixes if package.startswith(f"{path}/")), os.path.dirname(package)))
    return tuple({f"{path}/" for folder in folders if folder for path in (folder, os.path.realpath(folder))})

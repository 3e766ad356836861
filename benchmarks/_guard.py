"""Ends all processes that a benchmark has started, however the benchmark ends, SIGKILL included.

Its network namespaces, whose names begin with `midstride-PID-`, and the folders that it has named go as well.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
import uuid
from pathlib import Path

# Each process of a benchmark has it in its environment.
MARK = "MIDSTRIDE_BENCHMARK"
NAMESPACES = Path("/run/netns")
_watching: list[subprocess.Popen[bytes]] = []  # its end of the pipe stays open


def guard() -> None:
    """From now on, what this process starts ends with it: at once, by SIGKILL."""
    os.environ[MARK] = uuid.uuid4().hex
    # It reads until this process ends, which closes the pipe: no other process inherits that end of it.
    command = [sys.executable, "-S", __file__, os.environ[MARK], str(os.getpid())]
    _watching.append(subprocess.Popen(command, stdin=subprocess.PIPE, start_new_session=True))
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # so that everything is ended as usual first


def remove_at_end(folder: Path) -> None:
    """Have ``folder`` removed when this process has ended."""
    (watching,) = _watching
    assert watching.stdin is not None
    watching.stdin.write(f"{folder}\n".encode())
    watching.stdin.flush()


def namespaces(benchmark: str) -> list[Path]:
    """The network namespaces of the process of that number."""
    return [*NAMESPACES.glob(f"midstride-{benchmark}-*")]


def inside(namespaces: list[Path]) -> list[int]:
    """The processes in these: what an SSH server starts there has no mark."""
    places = {os.stat(each).st_ino for each in namespaces}
    found = []
    for name in os.listdir("/proc"):
        try:
            if os.stat(f"/proc/{name}/ns/net").st_ino in places:
                found.append(int(name))
        except (OSError, ValueError):
            continue  # no process, or it has ended
    return found


def marked(mark: str) -> list[int]:
    """The processes of that mark, but for this one."""
    found = []
    for name in os.listdir("/proc"):
        try:
            with open(f"/proc/{name}/environ", "rb") as file:
                if name != str(os.getpid()) and f"{MARK}={mark}".encode() in file.read().split(b"\0"):
                    found.append(int(name))
        except (OSError, ValueError):
            continue  # no process, or it has ended
    return found


def main() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    folders = sys.stdin.read().splitlines()
    left = namespaces(sys.argv[2])
    while found := marked(sys.argv[1]) + inside(left):
        for pid in found:
            try:
                os.kill(pid, signal.SIGKILL)
            except ProcessLookupError:
                continue
        time.sleep(0.05)
    for each in left:
        subprocess.run(["ip", "netns", "del", each.name], check=False)
    for folder in folders:
        shutil.rmtree(folder, ignore_errors=True)


if __name__ == "__main__":
    main()

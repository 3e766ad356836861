"""Ends all processes that a benchmark has started, however the benchmark ends, SIGKILL included."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
import uuid

# Each process of a benchmark has it in its environment.
MARK = "MIDSTRIDE_BENCHMARK"
_watching: list[subprocess.Popen[bytes]] = []  # its end of the pipe stays open


def guard() -> None:
    """From now on, what this process starts ends with it: at once, by SIGKILL."""
    os.environ[MARK] = uuid.uuid4().hex
    # It reads until this process ends, which closes the pipe: no other process inherits that end of it.
    command = [sys.executable, "-S", __file__, os.environ[MARK]]
    _watching.append(subprocess.Popen(command, stdin=subprocess.PIPE, start_new_session=True))
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # so that everything is ended as usual first


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
    sys.stdin.read()
    while found := marked(sys.argv[1]):
        for pid in found:
            try:
                os.kill(pid, signal.SIGKILL)
            except ProcessLookupError:
                continue
        time.sleep(0.05)


if __name__ == "__main__":
    main()

"""A command in a pseudo-terminal, as a person sees it and types into it."""

from __future__ import annotations

import os
import pty
import re
import select
import signal
import struct
import time
from types import TracebackType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tests.cli.conftest import Midstride

PATIENCE = 90.0
_CONTROL = re.compile(r"\x1b\[[0-9;?]*[a-zA-Z]|\r")


class Terminal:
    """Runs a command in a pseudo-terminal; killed at the end, if it has not ended."""

    def __init__(self, midstride: Midstride, *words: str) -> None:
        self._command = midstride.command(*words)
        self._environment = {**midstride.environment, "TERM": "xterm-256color"}
        self._seen = ""
        self._read = 0
        self._open = True
        self.status: int | None = None

    def __enter__(self) -> Terminal:
        self._pid, self._fd = pty.fork()
        if self._pid == 0:
            os.execvpe(self._command[0], self._command, self._environment)
        import fcntl
        import termios

        fcntl.ioctl(self._fd, termios.TIOCSWINSZ, struct.pack("HHHH", 50, 140, 0, 0))
        return self

    def press(self, keys: str) -> None:
        os.write(self._fd, keys.encode())

    def close(self) -> None:
        """Close the terminal's window."""
        os.close(self._fd)
        self._open = False

    def until(self, words: str) -> str:
        """What is shown up to and with ``words``. Fails where they do not come."""
        deadline = time.monotonic() + PATIENCE
        while words not in (shown := self._shown()):
            assert self._more(deadline), f"{words!r} does not come; shown was:\n{shown}"
        end = shown.index(words) + len(words)
        self._read += end
        return shown[:end]

    def rest(self) -> str:
        """What is shown from here to the end of the command, whose exit status is ``status`` then."""
        deadline = time.monotonic() + PATIENCE
        while self._more(deadline):
            pass
        _, status = os.waitpid(self._pid, 0)
        self.status = os.waitstatus_to_exitcode(status)
        return self._shown()

    def _shown(self) -> str:
        return _CONTROL.sub("", self._seen)[self._read :]

    def _more(self, deadline: float) -> bool:
        """Read on. False at the end of the command; fails where nothing comes for too long."""
        ready, _, _ = select.select([self._fd], [], [], max(0.0, deadline - time.monotonic()))
        assert ready, f"nothing more comes; shown was:\n{self._shown()}"
        try:
            chunk = os.read(self._fd, 65536)
        except OSError:  # Linux reports the closed other end so
            return False
        self._seen += chunk.decode(errors="replace")
        return bool(chunk)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.status is None:
            os.kill(self._pid, signal.SIGKILL)
            os.waitpid(self._pid, 0)
        if self._open:
            os.close(self._fd)

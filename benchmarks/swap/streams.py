"""The stream of messages whose publisher is replaced, where its programs run, and what the recorder has written."""

from __future__ import annotations

import json
import signal
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from .judging import WINDOW_PERIODS, Row

TOPIC = "/swap"
TYPE = "std_msgs/msg/String"
# How long anything may take (s), on a busy machine.
PATIENCE = 60.0


class SwapFailed(Exception):
    """A way could not do what it is to do."""


@dataclass(frozen=True)
class Stream:
    """How often a message is published (Hz), and how many characters it has."""

    rate: float = 50.0
    size: int = 100

    @property
    def period(self) -> float:
        """The time between two messages (s)."""
        return 1 / self.rate

    @property
    def tail(self) -> float:
        """How long the stream is left alone before and after a swap (s)."""
        return max(0.4, WINDOW_PERIODS * self.period)

    @property
    def words(self) -> tuple[str, str]:
        """Rate and size, as the programs take them."""
        return f"{self.rate:g}", str(self.size)


@dataclass(frozen=True)
class Host:
    """Where the programs run: on which ROS, by which interpreter, from which file, in which environment."""

    backend: str
    python: str
    nodes: Path
    env: Mapping[str, str]

    @contextmanager
    def program(self, *words: str) -> Iterator[subprocess.Popen[bytes]]:
        """One of the programs of ``nodes``, while inside."""
        process = self.start(*words)
        try:
            yield process
        finally:
            process.kill()
            process.wait()

    def start(self, *words: str) -> subprocess.Popen[bytes]:
        """Start one of the programs of ``nodes``, which the caller ends."""
        command = [self.python, str(self.nodes), *words]
        return subprocess.Popen(command, env=dict(self.env), start_new_session=True)


@dataclass
class Recording:
    """The rows of a recorder, read from its file as it grows."""

    path: Path
    rows: list[Row] = field(default_factory=list)
    _read: int = 0

    def follow(self) -> list[Row]:
        """All rows until now."""
        if self.path.exists():
            with self.path.open("rb") as file:
                file.seek(self._read)
                text = file.read()
            whole = text[: text.rfind(b"\n") + 1]
            self._read += len(whole)
            self.rows += [Row(*json.loads(line)) for line in whole.splitlines()]
        return self.rows

    def until(self, holds: Callable[[list[Row]], Any], what: str) -> None:
        """Wait until it holds of the rows. Raises SwapFailed after ``PATIENCE``."""
        deadline = time.monotonic() + PATIENCE
        while not holds(self.follow()):
            if time.monotonic() > deadline:
                raise SwapFailed(f"{what} within {PATIENCE:g} s")
            time.sleep(0.02)


@contextmanager
def recording(host: Host, stream: Stream, path: Path) -> Iterator[Recording]:
    """A bare recorder runs inside; afterwards the recording is whole."""
    found = Recording(path)
    with host.program("recorder", str(path), str(max(10, round(stream.rate)))) as process:
        yield found
        process.send_signal(signal.SIGTERM)
        process.wait(timeout=PATIENCE)
    found.follow()

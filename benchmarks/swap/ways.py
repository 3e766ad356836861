"""What a way to replace the publisher is, and the ways that need neither Midstride, containers nor Dora."""

from __future__ import annotations

import importlib.util
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from .services import services
from .streams import PATIENCE, Host, Stream

# Replaces the publisher once. Returns None, or in words why it has stayed the one that it was.
Swap = Callable[[], str | None]


@dataclass(frozen=True)
class Setting:
    """Where and what to swap: ``rows`` is the recorder's file, ``folder`` an empty folder for the way.

    ``dora``: the folder of a virtual environment with Dora, or of one to make.
    """

    host: Host
    stream: Stream
    folder: Path
    rows: Path
    dora: Path | None = None

    def on(self, env: Mapping[str, str]) -> Setting:
        """The same in another environment."""
        return replace(self, host=replace(self.host, env=env))


class Way:
    """A way to replace the publisher of /swap. A subclass says what it is called and how it is done.

    ``title`` is what the tables call it, and ``seconds`` about how long one swap takes, to foretell a run. ``backends``
    has the versions of ROS on which it is there. If ``swaps`` is False, nothing is replaced; if ``records`` is True,
    the way itself writes the rows of a recorder.
    """

    name: str
    title: str
    seconds: float = 1.0
    backends: tuple[str, ...] = ("ros2",)
    swaps: bool = True
    records: bool = False

    def missing(self, setting: Setting) -> str | None:
        """What this way lacks here, in a sentence; None: nothing."""
        return None

    @contextmanager
    def running(self, setting: Setting) -> Iterator[Swap]:
        """While inside, one publisher writes on /swap; what is yielded replaces it by another one.

        A publisher begins each message as programs/content.py does. Raises SwapFailed.
        """
        raise NotImplementedError


class Nothing(Way):
    """The floor: a window as long as others, in which nothing is replaced."""

    name, title = "none", "no swap"
    backends = ("ros2", "ros1")
    swaps = False

    @contextmanager
    def running(self, setting: Setting) -> Iterator[Swap]:
        with setting.host.program("bare", "steady", *setting.stream.words):
            yield lambda: time.sleep(1.0)


class KillAndStart(Way):
    """The process is killed, and another one started at once."""

    name, title = "kill", "kill one, start the other"
    backends = ("ros2", "ros1")
    seconds = 1.5

    @contextmanager
    def running(self, setting: Setting) -> Iterator[Swap]:
        running = [self._start(setting)]

        def swap() -> None:
            _kill(running.pop())
            running.append(self._start(setting))

        try:
            yield swap
        finally:
            for each in running:
                _kill(each)

    def _start(self, setting: Setting) -> subprocess.Popen[bytes]:
        return setting.host.start("bare", "bare", *setting.stream.words)


class StartAndKill(KillAndStart):
    """Another process is started, and the old one killed two seconds later, as a script would do it."""

    name, title = "start", "start the other, kill one 2 s later"
    seconds = 2.0

    @contextmanager
    def running(self, setting: Setting) -> Iterator[Swap]:
        running = [self._start(setting)]

        def swap() -> None:
            running.append(self._start(setting))
            time.sleep(2.0)
            _kill(running.pop(0))

        try:
            yield swap
        finally:
            for each in running:
                _kill(each)


def _kill(process: subprocess.Popen[bytes]) -> None:
    process.kill()
    process.wait()


# A launch file in Python, with the service that carries it out.
_LAUNCH = """
import sys
from launch import LaunchDescription, LaunchService
from launch.actions import ExecuteProcess

service = LaunchService(noninteractive=True)
service.include_launch_description(
    LaunchDescription([ExecuteProcess(cmd=sys.argv[1:], respawn=True, respawn_delay=0.0, output="log")])
)
sys.exit(service.run())
"""


class Respawn(Way):
    """The process is killed, and `ros2 launch` starts it again (`respawn`, with no delay)."""

    name, title = "respawn", "kill it; launch's `respawn` starts it"
    seconds = 2.0

    def missing(self, setting: Setting) -> str | None:
        if importlib.util.find_spec("launch") is None:
            return "the Python package `launch` (that of `ros2 launch`) cannot be imported here"
        return None

    @contextmanager
    def running(self, setting: Setting) -> Iterator[Swap]:
        import psutil

        host = setting.host
        node = [host.python, str(host.nodes), "bare", "bare", *setting.stream.words]
        env = {**host.env, "ROS_LOG_DIR": str(setting.folder)}
        with (setting.folder / "launch.txt").open("wb") as said:
            command = [sys.executable, "-c", _LAUNCH, *node]
            launch = subprocess.Popen(command, env=env, stdout=said, stderr=said, start_new_session=True)

        def children() -> list[int]:
            return [each.pid for each in psutil.Process(launch.pid).children()]

        def swap() -> None:
            for each in children():
                os.kill(each, signal.SIGKILL)

        try:
            yield swap
        finally:
            launch.send_signal(signal.SIGINT)
            try:
                launch.wait(timeout=PATIENCE)
            except subprocess.TimeoutExpired:
                os.killpg(launch.pid, signal.SIGKILL)
                launch.wait()


class Lifecycle(Way):
    """Of two lifecycle nodes, which both run from the start, one is deactivated and then the other activated."""

    name, title = "lifecycle", "lifecycle: deactivate one, activate the other"
    seconds = 0.1

    @contextmanager
    def running(self, setting: Setting) -> Iterator[Swap]:
        names = ["first", "second"]
        with (
            setting.host.program("lifecycle", names[0], *setting.stream.words),
            setting.host.program("lifecycle", names[1], *setting.stream.words),
            services() as called,
        ):

            def swap() -> None:
                called.change(names[0], "deactivate")
                called.change(names[1], "activate")
                names.reverse()

            for name in names:
                called.change(name, "configure")
            called.change(names[0], "activate")
            yield swap

"""What the back ends of real platforms share: components as processes of the operating system."""

from __future__ import annotations

import asyncio
import gc
import json
import os
import shutil
import signal
import sys
from collections.abc import Awaitable, Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final, TypeVar

from midstride.errors import ManagerError, NodeError, StartFailed, Unreachable
from midstride.runtime.backend import Launch
from midstride.runtime.process import Process
from midstride.runtime.reaper import Reaper
from midstride.wire.environment import (
    ENV_BACKEND,
    ENV_CONTROL,
    ENV_INSTANCE,
    ENV_NAMESPACE,
    ENV_PARAMETERS,
    ENV_SYSTEM,
    ENV_TOKEN,
)
from midstride.wire.folders import COMPONENTS, workspace_folder
from midstride.wire.sockets import SocketFolder
from midstride.wire.transport import Transport

T = TypeVar("T")

_OURS: Final = ("python", "python3")
# On the command line of a component started by hand: the system that it belongs to.
SYSTEM_FLAG: Final = "--system"
# How often the logs of components are checked (s), how long one may get, and how much is then kept of it (bytes).
CHECK_LOGS: Final = 60.0
LONGEST_LOG: Final = 8 * 1024 * 1024
KEPT_OF_LOG: Final = 1024 * 1024
# How long the control thread may keep the data thread from running, while both are busy (s).
SWITCH_INTERVAL: Final = 0.0005


def command(
    arguments: Sequence[str], directory: Path, environment: Mapping[str, str], python: Callable[[], str]
) -> tuple[str, ...]:
    """The command with its program found. Raises StartFailed, naming what cannot be found.

    ``python`` and ``python3`` mean the interpreter that has the platform and Midstride, also where another one is first
    on the PATH. Any other interpreter is named by its path.
    """
    program, *rest = arguments
    if program in _OURS:
        return (python(), *rest)
    if "/" in program:
        found = shutil.which(os.path.join(directory, program))
    else:
        found = shutil.which(program, path=environment.get("PATH"))
    if found is None:
        raise StartFailed(f"cannot start `{' '.join(arguments)}`: there is no program {program} that can be run")
    return (found, *rest)


def identity(launch: Launch, backend: str, control: Path) -> dict[str, str]:
    """The environment variables that make a process this component (wire/environment.py).

    ``control`` is the folder of the system's control sockets.
    """
    return {
        ENV_BACKEND: backend,
        ENV_INSTANCE: launch.instance,
        ENV_NAMESPACE: launch.namespace,
        ENV_TOKEN: launch.token,
        ENV_PARAMETERS: json.dumps(launch.parameters),
        ENV_CONTROL: str(control.absolute()),
        "PYTHONUNBUFFERED": "1",
    }


def control_transport(environment: Mapping[str, str], arguments: Sequence[str]) -> tuple[SocketFolder | None, str]:
    """Where a component listens for its manager, and the same in words; None where it belongs to no system.

    The manager passes the folder. A component started by hand names its system, by ``--system NAME`` on its command
    line or by MIDSTRIDE_SYSTEM. Raises NodeError where that names no system, or where its folder cannot be used.
    """
    if folder := environment.get(ENV_CONTROL):
        return SocketFolder(Path(folder)), f"in {folder}"
    system = _named_system(arguments) or environment.get(ENV_SYSTEM)
    if not system:
        return None, f"it belongs to no system: restart it with `{SYSTEM_FLAG} NAME` or {ENV_SYSTEM}=NAME"
    try:
        path = workspace_folder(system) / COMPONENTS
    except ManagerError as error:
        raise NodeError(str(error)) from None
    return SocketFolder(path), f"in system {system}, folder {path}"


def _named_system(arguments: Sequence[str]) -> str | None:
    for index, argument in enumerate(arguments):
        flag, equals, name = argument.partition("=")
        if flag == SYSTEM_FLAG:
            name = name if equals else next(iter(arguments[index + 1 :]), "")
            if not name:
                raise NodeError(f"{SYSTEM_FLAG} needs the name of a system: `{SYSTEM_FLAG} NAME`")
            return name
    return None


async def listens(transport: Transport, instance: str) -> bool:
    """Whether a component of that name accepts control connections: one started by hand, whose process is not known."""
    try:
        connection = await transport.connect(transport.address(instance))
    except Unreachable:
        return False
    connection.close()
    return True


class Children:
    """The processes of components, by instance; to be used on one event loop.

    ``exited`` is called for each that ends by itself, once it is no longer among them.
    """

    def __init__(self, guardian: Reaper | None, exited: Callable[[str, int | None, Process], None]) -> None:
        self._guardian = guardian
        self._exited = exited
        self._processes: dict[str, Process] = {}
        self._shortening: asyncio.Task[None] | None = None

    def __contains__(self, instance: object) -> bool:
        return instance in self._processes

    def __len__(self) -> int:
        return len(self._processes)

    def take(self, instance: str, process: Process) -> None:
        """Watch a process from now on."""
        self._processes[instance] = process
        if self._guardian is not None:
            self._guardian.watch(process.pid, process.started)
        process.on_exit(lambda status: self._ended(instance, process, status))
        if self._shortening is None:
            self._shortening = asyncio.get_running_loop().create_task(self._shorten_logs())

    async def _shorten_logs(self) -> None:
        while True:
            await asyncio.sleep(CHECK_LOGS)
            for process in list(self._processes.values()):
                process.shorten_log(LONGEST_LOG, KEPT_OF_LOG)

    def _ended(self, instance: str, process: Process, status: int | None) -> None:
        self._forget(instance, process)
        self._exited(instance, status, process)

    async def end(self, instance: str, grace: float) -> None:
        """End a process if there is one, without a call of ``exited``; returns when it is gone."""
        process = self._processes.get(instance)
        if process is not None:
            process.on_exit(None)
            await process.end(grace)
            self._forget(instance, process)

    def _forget(self, instance: str, process: Process) -> None:
        if self._processes.get(instance) is process:
            del self._processes[instance]
        if self._guardian is not None:
            self._guardian.release(process.pid)
        process.close()

    def close(self) -> None:
        """Stop watching them; they go on."""
        if self._shortening is not None:
            self._shortening.cancel()
            self._shortening = None
        for process in self._processes.values():
            process.close()
        self._processes.clear()


def on_thread(function: Callable[[], T], post: Callable[[Callable[[], None]], object]) -> Awaitable[T]:
    """Have ``post`` call ``function`` in another thread; its result, on the calling event loop."""
    calling = asyncio.get_running_loop()
    done: asyncio.Future[T] = calling.create_future()

    def settle(result: T | None, error: BaseException | None) -> None:
        if done.cancelled():
            return
        if error is None:
            done.set_result(result)  # type: ignore[arg-type]
        else:
            done.set_exception(error)

    def work() -> None:
        result: T | None = None
        raised: BaseException | None = None
        try:
            result = function()
        except BaseException as error:
            raised = RuntimeError(str(error)) if isinstance(error, StopIteration) else error
        with suppress(RuntimeError):  # the loop is closed: the process is ending
            calling.call_soon_threadsafe(settle, result, raised)

    post(work)
    return done


def with_short_pauses() -> None:
    """Keep the pauses of this Python process short against a period of the data thread.

    A full garbage collection walks everything that was imported (25 ms with rclpy alone): what exists now is exempted.
    And by default a busy thread runs for 5 ms before another one gets its turn.
    """
    gc.collect()
    gc.freeze()
    sys.setswitchinterval(SWITCH_INTERVAL)


@contextmanager
def ending_on_signals(main: asyncio.Future[None]) -> Iterator[list[int]]:
    """SIGTERM and SIGINT cancel ``main``, which then ends in order; the second one of them ends the process at once.

    Yields the signals that came. What was in their place is put back. To be used on the event loop of ``main``.
    """
    loop = asyncio.get_running_loop()
    caught = (signal.SIGTERM, signal.SIGINT)
    before = {number: signal.getsignal(number) for number in caught}
    came: list[int] = []

    def interrupt(number: int) -> None:
        came.append(number)
        for other in caught:
            loop.remove_signal_handler(other)
            signal.signal(other, signal.SIG_DFL)
        main.cancel()

    try:
        for number in caught:
            loop.add_signal_handler(number, interrupt, number)
    except (ValueError, RuntimeError):  # not in the main thread: signals are handled elsewhere
        before = {}
    try:
        yield came
    finally:
        for number, handler in before.items():
            loop.remove_signal_handler(number)
            signal.signal(number, handler)

"""The common part of components' processes on every platform: the control folder, parameters, threads and signals."""

from __future__ import annotations

import asyncio
import gc
import os
import signal
import sys
import threading
import time
from collections.abc import Awaitable, Callable, Coroutine, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any, Final, TypeVar

from midstride.errors import CommandRefused, ManagerError, MidstrideError, NodeError
from midstride.node.component_host import HeldParameter
from midstride.wire.environment import ENV_CONTROL, ENV_SYSTEM
from midstride.wire.folders import COMPONENTS, workspace_folder
from midstride.wire.sockets import SocketFolder

T = TypeVar("T")

# On the command line of a component started by hand: the system that it belongs to.
SYSTEM_FLAG: Final = "--system"
# How long the control thread may keep the data thread from running, while both are busy (s).
SWITCH_INTERVAL: Final = 0.0005
_POLL: Final = 0.002


def control_transport(environment: Mapping[str, str], arguments: Sequence[str]) -> tuple[SocketFolder | None, str]:
    """The address at which a component listens for its manager, also in words; None where it belongs to no system.

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


def drop_paths(environment: dict[str, str], variable: str, unwanted: Callable[[str], bool]) -> None:
    """Take the unwanted paths out of a variable; where none is left, it is unset."""
    kept = [path for path in environment.get(variable, "").split(os.pathsep) if not unwanted(path)]
    if any(kept):
        environment[variable] = os.pathsep.join(kept)
    else:
        environment.pop(variable, None)


class KeptParameters:
    """The parameters of a component on a platform that does not keep them for its nodes. On the data thread.

    Implements :class:`midstride.node.component_host.NodeParameters`. ``show(name, value)`` is called with each value.
    """

    def __init__(self, show: Callable[[str, Any], None] = lambda name, value: None) -> None:
        self.values: dict[str, Any] = {}
        self._show = show
        self._on_change: dict[str, Callable[[Any], None]] = {}

    def declare(self, name: str, default: Any, on_change: Callable[[Any], None] | None) -> Any:
        self.values[name] = default
        self._on_change[name] = on_change or (lambda _: None)
        self._show(name, default)
        return default

    def held(self) -> Mapping[str, HeldParameter]:
        return {}

    def on_changed(self, changed: Callable[[], object]) -> None:
        pass  # each parameter says so itself

    def set(self, values: dict[str, Any]) -> None:
        if missing := [name for name in values if name not in self.values]:
            raise CommandRefused(f"there is no parameter {', '.join(missing)}")
        done: list[str] = []
        try:
            for name, value in values.items():
                self._on_change[name](value)
                done.append(name)
        except Exception as error:
            for name in reversed(done):
                self._on_change[name](self.values[name])
            words = str(error) if isinstance(error, MidstrideError) else f"{type(error).__name__}: {error}"
            raise CommandRefused(words) from None
        self.values.update(values)
        for name, value in values.items():
            self._show(name, value)


def on_thread(function: Callable[[], T], post: Callable[[Callable[[], None]], object]) -> Awaitable[T]:
    """Have ``post`` call ``function`` in another thread; its result, on the calling event loop."""
    calling = asyncio.get_running_loop()
    done: asyncio.Future[T] = calling.create_future()

    def work() -> None:
        try:
            resolve = partial(done.set_result, function())
        except BaseException as error:
            raised = RuntimeError(str(error)) if isinstance(error, StopIteration) else error
            resolve = partial(done.set_exception, raised)
        with suppress(RuntimeError):  # the loop is closed: the process is ending
            calling.call_soon_threadsafe(lambda: done.cancelled() or resolve())

    post(work)
    return done


def on_new_thread(function: Callable[[], T]) -> Awaitable[T]:
    """The result of ``function``, called in a thread that the end of the process does not wait for."""
    return on_thread(function, lambda work: threading.Thread(target=work, daemon=True).start())


def in_background(work: Coroutine[Any, Any, None], tasks: set[asyncio.Task[None]]) -> None:
    """Have the running loop do ``work``, as a task that is among ``tasks`` until it has ended."""
    task = asyncio.get_running_loop().create_task(work)
    tasks.add(task)
    task.add_done_callback(tasks.discard)


async def comes_true(condition: Callable[[], bool], timeout: float) -> bool:
    """Return whether ``condition`` is true within ``timeout`` seconds; it is evaluated again and again."""
    deadline = time.monotonic() + timeout
    while not condition():
        if time.monotonic() > deadline:
            return False
        await asyncio.sleep(_POLL)
    return True


def with_short_pauses() -> None:
    """Keep the pauses of this Python process short against a period of the data thread.

    A full garbage collection walks everything that was imported (25 ms with rclpy alone): what exists now is exempted.
    And by default a busy thread runs for 5 ms before another one may run.
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

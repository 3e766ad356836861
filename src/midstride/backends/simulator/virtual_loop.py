"""Asyncio loops in virtual time: work takes none of it, and it passes only where nothing is ready.

Then it jumps to the next timer on a :class:`VirtualLoop`, so a run of minutes takes no time, and gives the same result
every time (the idea is trio's mock clock); real sockets still work: they are polled before each jump. On a
:class:`PacedLoop` it passes as real time does, so that a user can watch.
"""

from __future__ import annotations

import asyncio
import selectors
import time
from collections.abc import Callable, Coroutine
from typing import Any, TypeVar

from midstride.errors import BackendError

T = TypeVar("T")


class _JumpingSelector(selectors.DefaultSelector):
    """Never waits: where nothing is ready, it calls ``jump`` to advance the time."""

    def __init__(self, jump: Callable[[float | None], None]) -> None:
        super().__init__()
        self._jump = jump

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        ready = super().select(0)
        if ready or (timeout is not None and timeout <= 0):
            return ready
        if timeout is None and len(self.get_map()) > 1:  # more than the loop's own wake-up: a socket may become ready
            return super().select(None)
        self._jump(timeout)
        return ready


def run_at_once(
    loop: asyncio.AbstractEventLoop, executor: Any, func: Callable[..., Any], *args: Any
) -> asyncio.Future[Any]:
    """``run_in_executor`` of a loop in virtual time, which threads do not have: ``func`` runs before this returns."""
    future = loop.create_future()
    try:
        future.set_result(func(*args))
    except Exception as error:
        future.set_exception(error)
    return future


class VirtualLoop(asyncio.SelectorEventLoop):
    """Starts at 0. Work for an executor is run at once."""

    def __init__(self) -> None:
        self._virtual = 0.0
        super().__init__(_JumpingSelector(self._jump))

    def time(self) -> float:
        return self._virtual

    def _jump(self, timeout: float | None) -> None:
        if timeout is None:
            raise BackendError(f"deadlock at {self._virtual:.6f} s: every task waits, and no timer is set")
        self._virtual += timeout

    run_in_executor = run_at_once  # type: ignore[assignment]


class _PacedSelector(selectors.DefaultSelector):
    """Waits as any other does, and calls ``advance`` with how long it was to wait, at most."""

    def __init__(self, advance: Callable[[float], None]) -> None:
        super().__init__()
        self._advance = advance

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        begun = time.monotonic()
        ready = super().select(timeout)
        waited = time.monotonic() - begun
        self._advance(waited if timeout is None else min(waited, max(timeout, 0.0)))
        return ready


class PacedLoop(asyncio.SelectorEventLoop):
    """Starts at 0, and keeps step with real time while the process gets a processor when it needs one.

    The time in which it computes, or is kept from a processor, does not count: what is simulated on a busy machine runs
    slower, and misses nothing for it.
    """

    def __init__(self) -> None:
        self._paced = 0.0
        super().__init__(_PacedSelector(self._advance))

    def time(self) -> float:
        return self._paced

    def _advance(self, seconds: float) -> None:
        self._paced += seconds


def run(main: Coroutine[Any, Any, T], loop: asyncio.AbstractEventLoop | None = None) -> T:
    """``asyncio.run`` on ``loop``, by default in virtual time; the loop is closed."""
    loop = VirtualLoop() if loop is None else loop
    try:
        return loop.run_until_complete(main)
    finally:
        try:
            tasks = asyncio.all_tasks(loop)
            for task in tasks:
                task.cancel()
            if tasks:
                loop.run_until_complete(asyncio.gather(*tasks, return_exceptions=True))
            loop.run_until_complete(loop.shutdown_asyncgens())
        finally:
            loop.close()


def run_paced(main: Coroutine[Any, Any, T]) -> T:
    """``asyncio.run`` on a :class:`PacedLoop`."""
    return run(main, PacedLoop())

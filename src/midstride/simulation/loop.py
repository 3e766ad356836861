"""An event loop in virtual time that draws from a seed what an operating system leaves open: the order.

Time jumps to the next timer. Everything that is ready at the same moment is run in a drawn order, so code that relies
on an order which asyncio happens to keep is found; what one task does stays in order. There are no threads and no
sockets: the loop implements the public interface of asyncio and is several times faster than its own loop.
"""

from __future__ import annotations

import asyncio
import contextvars
import gc
import heapq
import inspect
import random
from collections.abc import Callable, Coroutine
from typing import Any, Final, Protocol, TypeVar

from midstride.backends.simulator.virtual_loop import run_at_once
from midstride.errors import BackendError

T = TypeVar("T")

# How many callbacks may run at one moment of virtual time: more than that is a loop that waits for nothing.
MOST_AT_ONCE: Final = 200_000
# How often what is left at the end is cancelled, and what that has begun meanwhile.
MOST_ROUNDS: Final = 100


class _Callback:
    """Implements what asyncio uses of ``asyncio.Handle`` and ``asyncio.TimerHandle``."""

    __slots__ = ("args", "at", "callback", "cancelled_", "context")

    def __init__(
        self, at: float, callback: Callable[..., object], args: tuple[Any, ...], context: contextvars.Context | None
    ) -> None:
        self.at = at
        self.callback = callback
        self.args = args
        self.context = contextvars.copy_context() if context is None else context
        self.cancelled_ = False

    def cancel(self) -> None:
        self.cancelled_ = True

    def cancelled(self) -> bool:
        return self.cancelled_

    def when(self) -> float:
        return self.at


class Observer(Protocol):
    """``due``: something has happened that it has to look at."""

    @property
    def due(self) -> bool: ...

    def check(self) -> None: ...


class SeededLoop(asyncio.AbstractEventLoop):
    """Starts at 0. ``observer`` looks at the system after all that was ready at once has run.

    Work for an executor is run at once. ``deadlock`` is raised where every task waits and no timer is set.
    """

    def __init__(self, seed: int) -> None:
        self.random = random.Random(seed)
        self.observer: Observer | None = None
        self._now = 0.0
        self._ready: list[_Callback] = []
        self._timers: list[tuple[float, float, int, _Callback]] = []
        self._count = 0
        self._running = self._closed = False
        self.errors: list[dict[str, Any]] = []

    # -- what asyncio asks of a loop -------------------------------------------------------------------

    def time(self) -> float:
        return self._now

    # False; asked for each future and task, so not a function in Python.
    get_debug = bool

    def is_running(self) -> bool:
        return self._running

    def is_closed(self) -> bool:
        return self._closed

    def close(self) -> None:
        self._closed = True
        self._ready.clear()
        self._timers.clear()

    def create_future(self) -> asyncio.Future[Any]:
        return asyncio.Future(loop=self)

    def create_task(self, coro: Any, *, name: str | None = None, context: Any = None) -> asyncio.Task[Any]:
        if context is not None:
            return context.run(asyncio.Task, coro, loop=self, name=name)  # type: ignore[no-any-return]
        return asyncio.Task(coro, loop=self, name=name)

    def call_soon(self, callback: Any, *args: Any, context: Any = None) -> Any:  # type: ignore[override]
        handle = _Callback(self._now, callback, args, context)
        self._ready.append(handle)
        return handle

    call_soon_threadsafe = call_soon  # type: ignore[assignment]

    def call_later(self, delay: float, callback: Any, *args: Any, context: Any = None) -> Any:  # type: ignore[override]
        return self.call_at(self._now + delay, callback, *args, context=context)

    def call_at(self, when: float, callback: Any, *args: Any, context: Any = None) -> Any:  # type: ignore[override]
        handle = _Callback(when, callback, args, context)
        self._count += 1
        # Timers of one moment fire in any order.
        heapq.heappush(self._timers, (when, self.random.random(), self._count, handle))
        return handle

    run_in_executor = run_at_once  # type: ignore[assignment]

    def call_exception_handler(self, context: dict[str, Any]) -> None:
        self.errors.append(context)

    def run_until_complete(self, future: Any) -> Any:
        """Run until ``future`` is done. Raises BackendError at a deadlock, or if time no longer advances."""
        done = asyncio.ensure_future(future, loop=self)
        asyncio._set_running_loop(self)
        self._running = True
        try:
            self._run(done)
        finally:
            self._running = False
            asyncio._set_running_loop(None)
        return done.result()

    def end(self) -> None:
        """Cancel what is left, also what that begins meanwhile, and close.

        Raises BackendError, with what does not end, where that waits or goes on for ever.
        """
        left: list[asyncio.Task[Any]] = []
        try:
            for _ in range(MOST_ROUNDS):
                if not (left := self._tasks()):
                    break
                asyncio._set_running_loop(self)
                for task in left:
                    task.cancel()
                asyncio._set_running_loop(None)
                self.run_until_complete(asyncio.gather(*left, return_exceptions=True))
            else:
                raise BackendError(f"livelock at {self._now:.6f} s: what is cancelled begins something new for ever")
        except BackendError as error:
            words = ", ".join(sorted({_words_on(task) for task in left if not task.done()} or map(_words_on, left)))
            raise BackendError(f"{error}; these were cancelled, and did not end: {words}") from None
        finally:
            self.close()

    def _tasks(self) -> list[asyncio.Task[Any]]:
        """The tasks that have not ended, in the order in which they were made, which their names count.

        That of asyncio's set differs from run to run.
        """
        return sorted(asyncio.all_tasks(self), key=lambda task: (len(task.get_name()), task.get_name()))

    # -- running -----------------------------------------------------------------------------------

    def _run(self, done: asyncio.Future[Any]) -> None:
        draw, observer = self.random.random, self.observer
        at_once = 0
        while not done.done():
            batch = self._ready
            if not batch:
                self._jump()
                batch, at_once = self._ready, 0
            if len(batch) > 1:
                at_once += len(batch)
                for last in range(len(batch) - 1, 0, -1):  # random.shuffle, which takes several times longer
                    other = int(draw() * (last + 1))
                    batch[last], batch[other] = batch[other], batch[last]
            else:
                at_once += 1
            if at_once > MOST_AT_ONCE:
                words = f"{batch[0].callback!r} and others run for ever"
                raise BackendError(f"livelock at {self._now:.6f} s: {words}")
            self._ready = []
            for handle in batch:
                if not handle.cancelled_:
                    try:
                        handle.context.run(handle.callback, *handle.args)
                    except Exception as error:
                        self.call_exception_handler({"message": f"{handle.callback!r} raised", "exception": error})
            if observer is not None and observer.due:
                observer.check()

    def _jump(self) -> None:
        """To the moment of the next timer; what is due then becomes ready."""
        timers = self._timers
        while timers and timers[0][3].cancelled_:
            heapq.heappop(timers)
        if not timers:
            raise BackendError(f"deadlock at {self._now:.6f} s: every task waits, and no timer is set")
        self._now = max(self._now, timers[0][0])
        while timers and timers[0][0] <= self._now:
            self._ready.append(heapq.heappop(timers)[3])


def _words_on(task: asyncio.Task[Any]) -> str:
    """The coroutine of a task, and the one in which it waits."""
    outer = inner = task.get_coro()
    while inspect.iscoroutine(within := getattr(inner, "cr_await", None)):
        inner = within
    names = [getattr(each, "__qualname__", repr(each)) for each in (outer, inner)]
    return names[0] if outer is inner else f"{names[0]} in {names[1]}"


def run(loop: SeededLoop, main: Coroutine[Any, Any, T]) -> T:
    """Run ``main`` on ``loop``; cancel what is left of it, and close the loop.

    Without garbage collection: finalizers would run at moments that differ from run to run.
    """
    collects = gc.isenabled()
    gc.disable()
    try:
        return loop.run_until_complete(main)  # type: ignore[no-any-return]
    finally:
        loop.end()
        if collects:
            gc.enable()

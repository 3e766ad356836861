"""Threads that run one at a time: each component's code in its own thread, on the simulator's time.

A cooperative thread runs only while the loop waits for it, and yields only where it ends, sleeps, or waits for work.
So components cannot race, and ``time.sleep`` in user code, at import or within a call, takes virtual time only.
"""

from __future__ import annotations

import contextlib
import contextvars
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Final, TypeAlias

from midstride.errors import BackendError

# How long user code may take between two waits before its component is abandoned (s of real time, without that in which
# it is ready to run and other processes have the processors).
COMPUTE_LIMIT: Final = 30.0


class Killed(BaseException):
    """Raised in the thread of a component that is killed, wherever it waits."""


@dataclass(frozen=True, slots=True)
class Sleeps:
    """The thread waits for ``seconds``, or the async mode function that awaits this."""

    seconds: float

    def __await__(self) -> Any:
        yield self


@dataclass(frozen=True, slots=True)
class Ended:
    """The thread's function has returned, or raised."""

    error: BaseException | None


# None: it waits for work, and has finished what it was given.
ThreadYield: TypeAlias = Sleeps | Ended | None


# Its ``thread`` is the cooperative thread that the current thread is, if it is one.
_here: Final = threading.local()


class CooperativeThread:
    """``function`` in its own thread. :meth:`resume` runs it until it yields."""

    def __init__(self, name: str, function: Callable[[], None], context: contextvars.Context) -> None:
        self.name = name
        self.ended = False
        self._function = function
        self._context = context
        self._go = threading.Semaphore(0)
        self._back = threading.Semaphore(0)
        self._yielded: ThreadYield = None
        self._work: Any = None
        self._killed = False
        self._thread: threading.Thread | None = None

    # -- on the loop -------------------------------------------------------------------------------

    def resume(self, work: Any = None) -> ThreadYield:
        """Run until the thread yields. Raises BackendError where it does not within ``COMPUTE_LIMIT``."""
        if self.ended:
            return Ended(None)
        self._work = work
        if self._thread is None:
            self._thread = threading.Thread(target=self._context.run, args=(self._run,), name=self.name, daemon=True)
            self._thread.start()
        else:
            self._go.release()
        if not self._yields():
            self.ended = True  # a thread cannot be stopped: it continues, and what it does is ignored
            raise BackendError(
                f"the code of {self.name} did not return within {COMPUTE_LIMIT:g} s of real time: the simulator runs "
                "one component at a time, and of all blocking calls it can skip `time.sleep` only"
            )
        if isinstance(self._yielded, Ended):
            self.ended = True
            self._thread.join()
        return self._yielded

    def _yields(self) -> bool:
        """Wait until it does; False where it does not in time."""
        if self._back.acquire(timeout=COMPUTE_LIMIT / 2):
            return True
        # Only now, since this reads a file: the second half does not count the time in which it waits for a processor.
        assert self._thread is not None
        begun, waited = time.monotonic(), _waits_for_a_processor(self._thread)
        left = COMPUTE_LIMIT / 2
        while left > 0:
            if self._back.acquire(timeout=left):
                return True
            ready = _waits_for_a_processor(self._thread) - waited
            left = COMPUTE_LIMIT / 2 - (time.monotonic() - begun - ready)
        return False

    def kill(self) -> None:
        """End it where it waits. Its ``finally`` blocks run, which a killed process's would not."""
        if self._thread is None:
            self.ended = True
        self._killed = True
        while not self.ended:
            self.resume()

    # -- in the thread -----------------------------------------------------------------------------

    def yield_to_loop(self, yielded: ThreadYield) -> Any:
        """Let the loop run; returns the work that it resumes this thread with."""
        if self._killed:
            raise Killed
        self._yielded = yielded
        self._back.release()
        self._go.acquire()
        if self._killed:
            raise Killed
        return self._work

    def _run(self) -> None:
        _here.thread = self
        error: BaseException | None = None
        try:
            self._function()
        except BaseException as raised:
            error = raised
        self._yielded = Ended(error)
        self._back.release()


def _waits_for_a_processor(thread: threading.Thread) -> float:
    """For how long it was ready to run and did not (s); 0.0 where the system does not say."""
    try:
        with open(f"/proc/self/task/{thread.native_id}/schedstat", encoding="ascii") as file:
            return int(file.read().split()[1]) / 1e9
    except (OSError, IndexError, ValueError):
        return 0.0


_sleep: Final = time.sleep
_patches = 0


def _simulated_sleep(seconds: Any) -> None:
    thread: CooperativeThread | None = getattr(_here, "thread", None)
    if thread is None:
        _sleep(seconds)
    elif seconds < 0:
        raise ValueError("sleep length must be non-negative")
    else:
        thread.yield_to_loop(Sleeps(seconds))


@contextlib.contextmanager
def simulated_sleep() -> Iterator[None]:
    """While open, ``time.sleep`` in a cooperative thread takes simulated time, and real time elsewhere."""
    global _patches
    _patches += 1
    time.sleep = _simulated_sleep
    try:
        yield
    finally:
        _patches -= 1
        if not _patches:
            time.sleep = _sleep

"""Threads that run one at a time: a component's own code, in its own thread, on the simulator's time.

A fibre runs only while the loop waits for it, and gives way only where it asks for something: it
ends, sleeps, or waits for work. So components cannot race, and ``time.sleep`` in user code, at
import or within a call, takes virtual time and none of ours.
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

# How long user code may compute between two waits (s of real time) before the simulation is given up.
PATIENCE: Final = 30.0


class Killed(BaseException):
    """Raised inside a fibre whose component is killed, wherever it waits."""


@dataclass(frozen=True, slots=True)
class Sleeps:
    """The fibre waits for ``seconds``."""

    seconds: float


@dataclass(frozen=True, slots=True)
class Waits:
    """The fibre waits for work: it is ready, and has finished what it was given."""


@dataclass(frozen=True, slots=True)
class Ended:
    """The fibre's function has returned, or raised."""

    error: BaseException | None


Yielded: TypeAlias = Sleeps | Waits | Ended


class _Here(threading.local):
    """The fibre that a thread is, if it is one."""

    fibre: CooperativeThread | None = None


_here: Final = _Here()


class CooperativeThread:
    """``function`` in a thread of its own. :meth:`resume` runs it until it gives way."""

    def __init__(self, name: str, function: Callable[[], None], context: contextvars.Context) -> None:
        self.name = name
        self.ended = False
        self._function = function
        self._context = context
        self._go = threading.Semaphore(0)
        self._back = threading.Semaphore(0)
        self._yielded: Yielded = Waits()
        self._work: Any = None
        self._killed = False
        self._thread: threading.Thread | None = None

    # -- on the loop -------------------------------------------------------------------------------

    def resume(self, work: Any = None) -> Yielded:
        """Run until the fibre gives way. Raises BackendError where it does not within ``PATIENCE`` of real time."""
        if self.ended:
            return Ended(None)
        self._work = work
        if self._thread is None:
            self._thread = threading.Thread(target=self._context.run, args=(self._run,), name=self.name, daemon=True)
            self._thread.start()
        else:
            self._go.release()
        if not self._back.acquire(timeout=PATIENCE):
            self.ended = True  # it cannot be stopped: it is left to itself, and what it does from now on is ignored
            raise BackendError(
                f"the code of {self.name} did not come back within {PATIENCE:g} s of real time: the simulator runs one "
                "component at a time and can pass the time of `time.sleep` alone"
            )
        if isinstance(self._yielded, Ended):
            self.ended = True
            self._thread.join()
        return self._yielded

    def kill(self) -> None:
        """End it where it waits. Its ``finally`` blocks run, which a killed process's would not."""
        if self._thread is None:
            self.ended = True
        self._killed = True
        while not self.ended:
            self.resume()

    # -- in the fibre ------------------------------------------------------------------------------

    def give_way(self, yielded: Yielded) -> Any:
        """Let the loop go on; returns the work it comes back with."""
        if self._killed:
            raise Killed
        self._yielded = yielded
        self._back.release()
        self._go.acquire()
        if self._killed:
            raise Killed
        return self._work

    def _run(self) -> None:
        _here.fibre = self
        error: BaseException | None = None
        try:
            self._function()
        except BaseException as raised:
            error = raised
        self._yielded = Ended(error)
        self._back.release()


_sleep: Final = time.sleep
_patches = 0


def _simulated_sleep(seconds: Any) -> None:
    fibre = _here.fibre
    if fibre is None:
        _sleep(seconds)
    elif seconds < 0:
        raise ValueError("sleep length must be non-negative")
    else:
        fibre.give_way(Sleeps(seconds))


@contextlib.contextmanager
def simulated_sleep() -> Iterator[None]:
    """While open, ``time.sleep`` in a fibre takes simulated time; everywhere else it is the real one."""
    global _patches
    _patches += 1
    time.sleep = _simulated_sleep
    try:
        yield
    finally:
        _patches -= 1
        if not _patches:
            time.sleep = _sleep

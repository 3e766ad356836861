"""Forking a process that has loaded ROS.

A fork has one thread, the one that forks. Importing rclpy starts others: LTTng's, which wait for a tracing session,
and OpenBLAS's, for numpy. OpenBLAS ends its own before a fork, and starts them again where they are needed. LTTng
starts its own again in the fork if its functions for that purpose are called (what `liblttng-ust-fork.so` does where
it is preloaded). So a fork can be traced like a process that was started anew, and no lock is held in it by a thread
that it lacks.
"""

from __future__ import annotations

import ctypes
import os
import re
import sys
import time
from functools import partial
from pathlib import Path
from typing import Final

from midstride.errors import BackendError

_LTTNG: Final = re.compile(r"/\S*/liblttng-ust[-\w]*\.so\S*")
_SIGNAL_SET: Final = 128  # bytes of a sigset_t
# How long threads that are ending may still be seen (s).
_ENDING: Final = 1.0


def make_safe() -> None:
    """To be called once, when all has been imported. Raises BackendError where a fork would lack a thread."""
    _follow_lttng()
    os.register_at_fork(after_in_child=_reseed)
    if (trial := os.fork()) == 0:
        os._exit(min(_threads(), 255))
    _, status = os.waitpid(trial, 0)
    expected, deadline = os.waitstatus_to_exitcode(status), time.monotonic() + _ENDING
    while (threads := _threads()) > expected:
        if time.monotonic() > deadline:
            raise BackendError(f"{threads - expected} threads would be missing in a fork")
        time.sleep(0.01)


def _threads() -> int:
    return len(os.listdir("/proc/self/task"))


def _follow_lttng() -> None:
    maps = Path("/proc/self/maps").read_text(encoding="utf-8", errors="replace")
    if "/liblttng-ust-fork.so" in maps:
        return
    libraries = map(ctypes.CDLL, dict.fromkeys(_LTTNG.findall(maps)))
    prefixes = ("lttng_ust_", "ust_")  # since version 2.13, and before
    known = [(each, prefix) for each in libraries for prefix in prefixes if hasattr(each, f"{prefix}before_fork")]
    if known:
        (library, prefix), *_ = known
        saved = ctypes.create_string_buffer(_SIGNAL_SET)
        os.register_at_fork(
            before=partial(library[f"{prefix}before_fork"], saved),
            after_in_parent=partial(library[f"{prefix}after_fork_parent"], saved),
            after_in_child=partial(library[f"{prefix}after_fork_child"], saved),
        )


def _reseed() -> None:
    """Python's own generators are seeded anew in a fork, numpy's global one is not."""
    if (random := sys.modules.get("numpy.random")) is not None:
        random.seed()


def fork_for_parent() -> bool:
    """Fork a process that leads a session, and is a child of this one's parent; True in it.

    The parent has to adopt orphans meanwhile (:func:`midstride.runtime.process.child_process.adopting_orphans`).
    """
    if middle := os.fork():
        os.waitpid(middle, 0)
        return False
    middle = os.getpid()
    try:
        if os.fork():
            os._exit(0)
    except OSError:
        os._exit(1)
    while os.getppid() == middle:
        time.sleep(0.0005)
    os.setsid()
    return True

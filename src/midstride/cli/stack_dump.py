"""A manager prints the stacks of its threads and asyncio tasks when it receives SIGUSR1, for one that hangs."""

from __future__ import annotations

import asyncio
import faulthandler
import signal
import sys
from typing import Final

SIGNAL: Final = signal.SIGUSR1
# By its number: `sys.stderr` may be something that is no file.
_STDERR: Final = 2


def dump_stacks_on_signal(loop: asyncio.AbstractEventLoop) -> None:
    """From now on, SIGNAL prints stacks on standard error: of all threads at once, then of the tasks of ``loop``.

    The threads are printed by a handler in C, so that a blocked loop does not prevent it. The tasks follow when the
    loop runs its next callback. To be called on the main thread, on which ``loop`` runs.
    """
    loop.add_signal_handler(SIGNAL, print_tasks, loop)
    faulthandler.register(SIGNAL, file=_STDERR, all_threads=True, chain=True)


def print_tasks(loop: asyncio.AbstractEventLoop) -> None:
    """Print the stack of each unfinished task of ``loop`` on standard error."""
    tasks = sorted(asyncio.all_tasks(loop), key=lambda task: task.get_name())
    print(f"{len(tasks)} asyncio tasks:", file=sys.stderr)
    for task in tasks:
        task.print_stack(file=sys.stderr)
    sys.stderr.flush()

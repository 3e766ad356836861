"""The data thread: an event loop in which all user code runs, one call after another.

rospy calls back in as many threads as there are connections. Here they only queue what has arrived; so two publishers
of one topic never call user code at the same time, and a change of modes falls between two calls.
"""

from __future__ import annotations

import asyncio
import selectors
import threading
import traceback
from collections.abc import Callable, Coroutine
from typing import Any

from midstride.node.legible import legible


class DataThread:
    """Runs functions in its thread, in the order of :meth:`post`; what comes before :meth:`start` waits for it."""

    def __init__(self, failed: Callable[[str], None]) -> None:
        """``failed`` is called, in the thread, with the traceback of what a function raised."""
        # select() takes its time-out in microseconds; epoll() would make every timer up to a millisecond late.
        self.loop = asyncio.SelectorEventLoop(selectors.SelectSelector())
        self.loop.set_exception_handler(lambda loop, context: failed(_traceback_of(context)))
        self._driven: set[asyncio.Task[None]] = set()  # the loop itself refers to its tasks weakly
        self._thread = threading.Thread(target=self.loop.run_forever, name="midstride-data", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def stop(self, timeout: float) -> bool:
        """Stop and join it; False where a function does not return in time. Blocks."""
        if self._thread.ident is None:  # it never started, and nothing that waits may run now
            self.loop.close()
            return True
        if self._thread.is_alive():
            self.loop.call_soon_threadsafe(self.loop.stop)
            self._thread.join(timeout)
        if self._thread.is_alive():
            return False
        for task in asyncio.all_tasks(self.loop):
            task.cancel()
        self.loop.run_until_complete(asyncio.sleep(0))
        self.loop.close()
        return True

    def post(self, function: Callable[..., object], *arguments: Any) -> None:
        """Queue ``function``. From any thread."""
        if not self.loop.is_closed():
            self.loop.call_soon_threadsafe(function, *arguments)

    def drive(self, coroutine: Coroutine[Any, Any, None], done: Callable[[], None]) -> None:
        """Run ``coroutine`` to its end, then call ``done``. In the thread."""
        task = self.loop.create_task(coroutine)
        self._driven.add(task)

        def ended(task: asyncio.Task[None]) -> None:
            self._driven.discard(task)
            if not task.cancelled():
                done()

        task.add_done_callback(ended)


def _traceback_of(context: dict[str, Any]) -> str:
    error = context.get("exception")
    if isinstance(error, BaseException):
        return legible("".join(traceback.format_exception(error)).rstrip())
    return str(context.get("message"))

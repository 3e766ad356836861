"""Work that a cancellation must not leave half done: ``await run_to_completion(work(), on_cancel)``."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any, TypeVar

T = TypeVar("T")


async def run_to_completion(work: Coroutine[Any, Any, T], on_cancel: Callable[[], object]) -> T:
    """What ``work`` returns or raises, also where the caller is cancelled meanwhile: then ``on_cancel`` is called.

    The cancellation has no other effect: ``on_cancel`` must cut short what comes afterwards.
    ``asyncio.shield`` protects the work only, not the caller, which would go on without its result.
    """
    task = asyncio.ensure_future(work)
    while not task.done():
        try:
            await asyncio.wait({task})
        except asyncio.CancelledError:
            on_cancel()
    return task.result()

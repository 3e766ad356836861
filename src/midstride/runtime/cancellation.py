"""Work that a cancellation must not leave half done, and work that ends together."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine, Iterable
from typing import Any, TypeVar

T = TypeVar("T")


async def run_to_completion(work: Coroutine[Any, Any, T], on_cancel: Callable[[], object]) -> T:
    """Carry ``work`` to its end, also where the caller is cancelled meanwhile: then ``on_cancel`` is called.

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


async def all_of(works: Iterable[Coroutine[Any, Any, T]]) -> list[T]:
    """The results of works that run at the same time. As soon as one raises, or on a cancellation, the others end.

    A cancellation is never lost: ``asyncio.gather`` would raise what a work raises at the same moment instead.
    """
    tasks = [asyncio.ensure_future(work) for work in works]
    try:
        if tasks:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_EXCEPTION)
        for task in tasks:
            if task.done():
                task.result()
        return [task.result() for task in tasks]
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

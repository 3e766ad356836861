"""Processes that no state tells of: their manager was killed after it started them, before it could write them down.

They bear the system's token, so they can be found; nobody else would ever end them, and their names would be taken.
"""

from __future__ import annotations

import asyncio
from collections.abc import Container

from midstride.runtime.process import Process
from midstride.runtime.reaper import Seen, carries, processes, value_of
from midstride.wire.environment import ENV_INSTANCE, ENV_TOKEN


async def end_strays(token: str, known: Container[str], grace: float) -> list[str]:
    """End the processes of the system that bear the name of no ``known`` instance; the names that were ended.

    ``grace`` is how long each may take to end in order (s). What a known component has started for itself bears
    that component's name, and is left alone. Raises BackendError where the kernel does not let one go.
    """
    strays: dict[str, list[Seen]] = {}
    for seen in processes():
        if seen.alive and carries(seen.pid, ENV_TOKEN, token):
            name = value_of(seen.pid, ENV_INSTANCE)
            if name is not None and name not in known:
                strays.setdefault(name, []).append(seen)
    await asyncio.gather(*(_end(seen, grace) for found in strays.values() for seen in _heads(found)))
    return sorted(strays)


def _heads(found: list[Seen]) -> list[Seen]:
    """The leaders of process groups, with whom their groups end, and whoever has none."""
    leaders = {seen.pid for seen in found if seen.pid == seen.group}
    return [seen for seen in found if seen.pid == seen.group or seen.group not in leaders]


async def _end(seen: Seen, grace: float) -> None:
    try:
        process = Process(seen.pid, seen.started, child=False)
    except ProcessLookupError:  # it has just ended by itself
        return
    try:
        await process.end(grace)
    finally:
        process.close()

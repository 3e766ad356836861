"""Orphans: components that a manager started but could not record before it was killed.

The system's token in their environment identifies them. Without this module they would run forever and keep their
names in use.
"""

from __future__ import annotations

import asyncio
from collections.abc import Container

from midstride.runtime.process import Process
from midstride.runtime.reaper import ProcessInfo, environment_value, processes
from midstride.wire.environment import ENV_INSTANCE, ENV_TOKEN


async def end_orphans(token: str, known: Container[str], grace: float) -> list[str]:
    """End the system's processes whose instance is not ``known``; returns the names of those instances.

    After ``grace`` seconds each is killed. The children of a known component have that component's name in their
    environment, and are left alone. Raises BackendError if the kernel does not remove a killed process.
    """
    orphans: dict[str, list[ProcessInfo]] = {}
    for process in processes():
        if process.alive and environment_value(process.pid, ENV_TOKEN) == token:
            name = environment_value(process.pid, ENV_INSTANCE)
            if name is not None and name not in known:
                orphans.setdefault(name, []).append(process)
    await asyncio.gather(*(_end(process, grace) for found in orphans.values() for process in _leaders(found)))
    return sorted(orphans)


def _leaders(found: list[ProcessInfo]) -> list[ProcessInfo]:
    """The group leaders, with which their groups end, and the processes whose leader is not among ``found``."""
    leaders = {process.pid for process in found if process.pid == process.group}
    return [process for process in found if process.pid == process.group or process.group not in leaders]


async def _end(orphan: ProcessInfo, grace: float) -> None:
    try:
        process = Process(orphan.pid, orphan.started, child=False)
    except ProcessLookupError:  # it has exited meanwhile
        return
    try:
        await process.end(grace)
    finally:
        process.close()

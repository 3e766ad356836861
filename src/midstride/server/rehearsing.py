"""Rehearses a change in the simulator, in a process beside the manager: its loop must stay free for the components."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import sys
from asyncio.subprocess import PIPE
from typing import Final

import msgspec

from midstride.codec.specification_form import SpecificationForm
from midstride.errors import ManagerError
from midstride.model.specification import Specification
from midstride.runtime.records.rehearsal_forms import Rehearsal, RehearsalOrder
from midstride.runtime.timeouts import within
from midstride.server.requests import SubmittedRehearsal

# How much longer the process may take: to start, and for the seed that it has begun (s).
_STARTING: Final = 30.0
# How much of the processor it leaves to the system that runs.
_NICENESS: Final = 10


class Rehearser:
    """Rehearses one change at a time."""

    def __init__(self) -> None:
        self._running = asyncio.Lock()

    async def rehearse(self, specification: Specification, asked: SubmittedRehearsal) -> Rehearsal:
        """Rehearse the change. Raises ManagerError with the reason if that cannot be said, or not in time."""
        if self._running.locked():
            raise ManagerError("another change is being rehearsed; ask again when that is done")
        order = RehearsalOrder(
            specification=SpecificationForm.of(specification),
            request=asked.request,
            seeds=asked.seeds,
            first=asked.first,
            within=asked.seconds,
        )
        async with self._running:
            return await _run(msgspec.json.encode(order), asked.seconds + _STARTING)


async def _run(order: bytes, limit: float) -> Rehearsal:
    command = [sys.executable, "-m", "midstride.simulation.rehearsal"]
    process = await asyncio.create_subprocess_exec(
        *command, stdin=PIPE, stdout=PIPE, stderr=PIPE, start_new_session=True
    )
    try:
        with contextlib.suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, process.pid, _NICENESS)
        async with within(limit):
            out, words = await process.communicate(order)
    except asyncio.TimeoutError:
        raise ManagerError(f"the rehearsal has not ended within {limit:g} s; ask for fewer seeds") from None
    finally:
        if process.returncode is None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            await process.wait()
    if process.returncode != 0:
        last = words.decode(errors="replace").strip().rpartition("\n")[2]
        raise ManagerError(f"the change cannot be rehearsed: {last or f'exit status {process.returncode}'}")
    return msgspec.json.decode(out, type=Rehearsal)

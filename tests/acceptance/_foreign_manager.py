"""A separate process with a manager, which is killed during a swap: `_foreign_manager.py FOLDER COMPONENT [PHASE S]`.

It brings the system of tests.acceptance.foreign_support up, or finds it again, and replaces the talker by a COMPONENT.
With `down` as the component, it ends the system. It prints `TIME begins|ends PHASE` (monotonic, s) for each phase of
the swap: `swap`, the whole command; `handover`, the step of that name; `cut`, in which the two nodes are told to hand
over, and do. S seconds after PHASE has begun, it is killed.

Where two changes in turn were rolled back, the talker may be `Ours` already, and a `Plain` takes its place: two
components with Midstride's API hand over at an agreed moment, whose guard is longer (test_manager_killed.py).
"""

from __future__ import annotations

import asyncio
import os
import signal
import sys
import threading
import time
from pathlib import Path
from typing import Any

from midstride.lang.load import load
from midstride.plan.forms.step_forms import HandoverStep
from midstride.plan.request import PlanRequest
from midstride.runtime.manager import Manager
from midstride.runtime.records.reports import Event
from midstride.runtime.records.state_store import StateStore
from midstride.runtime.workspace import Workspace
from midstride.wire.commands import Command, CutOutCommand, DetachCommand
from tests.acceptance.foreign_support import manager_of


class Phases:
    """Those of the swap of ``manager``; ``seconds`` after ``fatal`` has begun, the process is killed."""

    def __init__(self, manager: Manager, fatal: str | None, seconds: float) -> None:
        self._fatal, self._seconds = fatal, seconds
        self._cutting = False
        manager.events.listeners.append(self._on_event)
        self._send = manager._client._send
        manager._client._send = self._sent  # type: ignore[method-assign]

    def begins(self, phase: str) -> None:
        print(time.monotonic(), "begins", phase, flush=True)
        if phase == self._fatal:  # from another thread, so at any moment of what the manager does
            threading.Timer(self._seconds, os.kill, (os.getpid(), signal.SIGKILL)).start()

    def ends(self, phase: str) -> None:
        print(time.monotonic(), "ends", phase, flush=True)

    def _on_event(self, event: Event) -> None:
        if isinstance(event.step, HandoverStep):
            (self.begins if event.kind == "step" else self.ends)("handover")

    async def _sent(self, instance: str, command: Command[Any], revision: int | None) -> Any:
        if isinstance(command, CutOutCommand) and not self._cutting:
            self._cutting = True
            self.begins("cut")
        elif isinstance(command, DetachCommand) and self._cutting:
            self._cutting = False
            self.ends("cut")
        return await self._send(instance, command, revision)


async def main(folder: Path, component: str, fatal: str | None = None, seconds: str = "0") -> None:
    saved = StateStore(Workspace(folder / "system").state).load()
    specification = load(folder / "swaps.stride").require() if saved is None else saved.specification
    manager = manager_of(specification, folder)
    await manager.up()
    try:
        status = await manager.status()
        assert status.valid, status
        if component == "down":
            await manager.down()
        else:
            [talker] = manager.configuration.instances.values()
            if component == talker.component.name == "Ours":
                component = "Plain"
            phases = Phases(manager, fatal, float(seconds))
            phases.begins("swap")
            outcome = await manager.change(PlanRequest(replace=(("talker", component),)))
            phases.ends("swap")
            assert (outcome.outcome, outcome.because) == ("done", None), outcome
            if fatal is not None:
                await asyncio.sleep(60)
    finally:
        await manager.close()


if __name__ == "__main__":
    asyncio.run(main(Path(sys.argv[1]), *sys.argv[2:]))

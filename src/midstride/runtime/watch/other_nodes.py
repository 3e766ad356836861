"""The nodes that would end with each instance, besides its own: asked for now and then, and when a change begins.

Others may load components into a container at any time, so what was known at the start says nothing.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from midstride.errors import BackendError
from midstride.runtime.backend_protocol import Backend, OtherNodes
from midstride.runtime.running_system import RunningSystem

log = logging.getLogger(__name__)

# How often they are asked for (s), so that those of a process that has crashed are known.
INTERVAL: Final = 2.0


@dataclass
class OtherNodesWatch:
    """Keeps :attr:`.RunningSystem.other_nodes` up to date, as the back end finds them."""

    backend: Backend
    system: RunningSystem
    _failed: bool = False
    _task: asyncio.Task[None] | None = None

    def start(self) -> None:
        if self.backend.shares_processes:
            self._task = asyncio.get_running_loop().create_task(self._run())

    async def close(self) -> None:
        if self._task is not None:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)

    async def _run(self) -> None:
        while True:
            await self.backend.clock.sleep(INTERVAL)
            self.look()

    def look(self) -> Mapping[str, OtherNodes]:
        """Ask for them now. What is known stays where the graph cannot be read."""
        try:
            found = self.backend.other_nodes(self.system.configuration.instances)
        except BackendError:
            pass
        except Exception:  # the platform's own kinds; the first of them is logged
            if not self._failed:
                log.exception("which nodes share a process could not be found out; it is tried again")
            self._failed = True
        else:
            self._failed, self.system.other_nodes = False, found
        return self.system.other_nodes

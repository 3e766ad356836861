"""Notices a component whose middleware has stopped discovering, although its data flows.

Seen with Fast DDS, which can deadlock in a process whose peers come and go (eProsima/Fast-DDS#6502). Now and then, and
after each command, the manager creates an endpoint, and each component says whether its own middleware shows it
(docs/decisions/discovery-probe.md has why).
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Collection
from dataclasses import dataclass, field
from typing import Final

from midstride.errors import BackendError, MidstrideError
from midstride.runtime.backend_protocol import Backend
from midstride.runtime.command_queue import CommandQueue
from midstride.runtime.process.component_client import ComponentClient
from midstride.runtime.records.events import EventLog
from midstride.runtime.running_system import RunningSystem
from midstride.wire.commands import DiscoverCommand

log = logging.getLogger(__name__)

# How often it is looked for (s), and how soon after a command or a crash: peers that come and go may cause it.
INTERVAL: Final = 10.0
SOON: Final = 1.0
# How long a component may take to discover an endpoint, and a second one if it has not found the first (s).
PATIENCE: Final = (5.0, 3.0)


@dataclass
class DiscoveryWatch:
    """``stopped`` has the instances that have stopped discovering, and since when that is known (steady s).

    One that has never discovered an endpoint of this manager is not among them: it may be out of its reach. Nothing is
    probed while a command runs.
    """

    backend: Backend
    client: ComponentClient
    events: EventLog
    system: RunningSystem
    commands: CommandQueue
    stopped: dict[str, float] = field(default_factory=dict)
    _discovering: set[str] = field(default_factory=set)
    _due: asyncio.Event = field(default_factory=asyncio.Event)
    _own: bool = False  # it is the manager's own middleware that seems to have stopped
    _failed: bool = False  # the last look, for another reason than that the back end was not there
    _task: asyncio.Task[None] | None = None

    def start(self) -> None:
        self._task = asyncio.get_running_loop().create_task(self._run())

    async def close(self) -> None:
        if self._task is not None:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)

    def look_soon(self) -> None:
        """Peers have come or gone."""
        self._due.set()

    async def _run(self) -> None:
        while True:
            waiting = asyncio.ensure_future(self._due.wait())
            try:
                await asyncio.wait({waiting}, timeout=INTERVAL)
            finally:
                waiting.cancel()
            self._due.clear()
            await self.backend.clock.sleep(SOON)
            if self.commands.current is None:
                await self._look_again()

    async def _look_again(self) -> None:
        """A look that fails is not the last one."""
        failed, self._failed = self._failed, False
        try:
            await self.look()
        except BackendError:
            pass
        except Exception:  # the platform's own kinds; nothing awaits this task, so the first of them is logged here
            self._failed = True
            if not failed:
                log.exception("whether components discover endpoints could not be found out; it is tried again")

    async def look(self) -> None:
        """Probe every instance. What is known of one that does not answer stays."""
        life, instances = self.client.life, self.system.configuration.instances
        names = {name for name in instances if not life.is_done(name)}
        self._discovering &= names
        for name in self.stopped.keys() - names:
            del self.stopped[name]
        suspects: Collection[str] = names
        for patience in PATIENCE:
            found = await self._probe(suspects, patience)
            shown = {name for name, shows in found.items() if shows}
            self._discovering |= shown
            for name in shown & self.stopped.keys():
                del self.stopped[name]
            suspects = {name for name, shows in found.items() if shows is False and name in self._discovering}
            if not suspects or self.commands.current is not None:
                return
        self._judge(suspects)

    def _judge(self, suspects: Collection[str]) -> None:
        """Record that ``suspects`` have found neither of two endpoints; if all have, the manager is the suspect."""
        all_at_once = len(suspects) > 1 and self._discovering == suspects and not self.stopped
        if all_at_once and not self._own:
            self.events.add(
                "note",
                "no component discovers what the manager creates: the manager's own middleware may have stopped "
                "discovering; end "
                "its process, then run `midstride up` again",
            )
        self._own = all_at_once
        if not all_at_once:
            for name in suspects:
                self.stopped.setdefault(name, self.backend.clock.steady())

    async def _probe(self, names: Collection[str], patience: float) -> dict[str, bool | None]:
        """Return which of ``names`` show a new endpoint, None for no answer; empty where there is none to show."""

        async def shows(name: str, topic: str) -> bool | None:
            try:
                return (await self.client.read(name, DiscoverCommand(topic=topic, timeout=patience))).found
            except MidstrideError:
                return None

        async with self.backend.probe() as topic:
            if topic is None:
                return {}
            asked = [name for name in sorted(names) if self.client.life.responsive(name) is not None]
            return dict(zip(asked, await asyncio.gather(*(shows(name, topic) for name in asked)), strict=True))

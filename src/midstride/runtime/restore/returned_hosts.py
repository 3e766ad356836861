"""Completes the roll-back of a change that has failed because a host could not be reached, once that is reached again.

Such a change may leave two instances of a role there (docs/protocols/recovery.md), or one on another host than the
specification says, if the other one has ended. An ordinary plan, carried out as a command in the queue, ends the one
that is not as the specification says, and starts another one if need be.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, field
from typing import Final

from midstride.plan.request import PlanRequest
from midstride.runtime.backend_protocol import HostLinkState
from midstride.runtime.change.change_session import ChangeSession
from midstride.runtime.change.reconciler import Reconciler
from midstride.runtime.manager_clock import Clock
from midstride.runtime.process.component_client import ComponentEvent, Disconnected
from midstride.runtime.records.events import EventLog
from midstride.runtime.running_system import RunningSystem

log = logging.getLogger(__name__)

# After how long it is begun (s), so that all that answers again is known; each attempt that fails doubles that. An
# attempt may leave one process more, so they are few.
PAUSE: Final = 1.0
ATTEMPTS: Final = 5
# How often it is looked whether there is anything to complete (s).
LOOK: Final = 1.0


@dataclass(slots=True)
class ReturnedHosts:
    """Brings roles with two instances on other hosts, or with one on the wrong host, back to one, by ``session``.

    ``host_links``: the state of the links to the hosts.
    """

    system: RunningSystem
    clock: Clock
    events: EventLog
    reconciler: Reconciler
    session: ChangeSession
    host_links: Callable[[], Iterable[HostLinkState]]
    _task: asyncio.Task[None] | None = None
    _looked_at: float = -LOOK  # steady s
    _left: set[str] = field(default_factory=set)  # the instances for which all attempts have failed
    _stopped: bool = False

    def stop(self) -> None:
        """Complete nothing any more: the system is being taken down, or left to the next manager."""
        self._stopped = True
        if self._task is not None:
            self._task.cancel()

    async def close(self) -> None:
        self.stop()
        if self._task is not None:
            await asyncio.gather(self._task, return_exceptions=True)

    def on_component_event(self, event: ComponentEvent) -> None:
        """A component has reported its state, or it has disconnected."""
        if isinstance(event, Disconnected) or self._stopped or self._task is not None:
            return
        instance, now = self.system.configuration.instances.get(event.instance), self.clock.steady()
        if instance is None or now - self._looked_at < LOOK:
            return
        self._looked_at = now
        if self.reconciler.commands.current is None and self._half_done():
            self._task = asyncio.get_running_loop().create_task(self._complete())

    def _half_done(self) -> tuple[str, ...]:
        """The roles with two instances on other hosts, or one on the wrong host, where all that is needed answers."""
        configuration, life, nodes = self.system.configuration, self.system.life, self.system.specification.nodes
        lost = {each.host for each in self.host_links() if each.problem is not None}

        def is_half_done(role: str, names: Collection[str]) -> bool:
            hosts = [configuration.instances[name].host for name in names]
            if len(names) == 1 and (nodes[role].host in (*hosts, *lost)):
                return False
            return any((*hosts, nodes[role].host)) and all(life.responsive(name) is not None for name in names)

        return tuple(
            role
            for role, names in sorted(configuration.instances_by_role.items())
            if role in nodes and names and not self._left.intersection(names) and is_half_done(role, names)
        )

    async def _complete(self) -> None:
        try:
            for attempt in range(ATTEMPTS):
                await self.clock.sleep(PAUSE * 2**attempt)
                await self.session.permission.until_recovery()
                if not (roles := self._half_done()):
                    return
                words = f"roll back {', '.join(roles)}"
                async with self.reconciler.command(words):
                    if not (roles := self._half_done()):
                        return
                    request = PlanRequest(half_done=roles)
                    outcome = await self.session.change(request, brief=True, by="the return of a host", recovery=True)
                if outcome.outcome != "done":
                    again = "it is tried again" if attempt + 1 < ATTEMPTS else "`midstride apply` with the file does it"
                    self.events.add("note", f"{words} failed: {outcome.because}; {again}")
            instances = self.system.configuration.instances_by_role
            self._left |= {name for role in roles for name in instances.get(role, ())}
        except Exception:  # nothing awaits this task, so errors are logged here
            log.exception("what a change has left half done could not be completed")
        finally:
            self._task = None

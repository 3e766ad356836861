"""Decides which nodes on a host that cannot be reached count as exited, so that another may take their place.

Such a node may run and write there. One that has a fallback on another host keeps a lease, and is silent once that is
over (docs/protocols/lease.md). Of the others only an operator can know: by declaring the host dead.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Final

from midstride.errors import MidstrideError
from midstride.model.contract import format_number
from midstride.model.hosts import host_in_words
from midstride.runtime.backend_protocol import Exited, HostLinkState
from midstride.runtime.change.reconciler import Reconciler
from midstride.runtime.manager_clock import Clock
from midstride.runtime.process.component_client import ComponentClient, ComponentEvent, Disconnected
from midstride.runtime.records.events import EventLog
from midstride.runtime.running_system import RunningSystem
from midstride.runtime.timeouts import within
from midstride.wire.commands import LEASE_SLACK, KeepLeaseCommand

# How often a lease is renewed while it lasts, and how often it is looked whether one is over (s).
RENEWALS: Final = 5
LOOK: Final = 0.2
# How long the manager takes at most to free the nodes from their leases when it ends (s).
FAREWELL: Final = 1.0


@dataclass(slots=True)
class _Lease:
    """``seen``: the last moment that the component has stated (its steady clock, ns), and when that arrived (steady s).
    ``until``: when the lease is surely over, if the link fails now (steady s); ``kept``: the process ``uuid`` keeps
    one.
    """

    seconds: float
    uuid: str = ""
    seen: int | None = None
    arrived: float = 0.0
    until: float = 0.0
    kept: bool = False
    refused: bool = False
    due: float = 0.0
    renewing: asyncio.Task[None] | None = None


@dataclass(slots=True)
class FallbackLeases:
    """The leases of the running system, and the hosts that were declared dead."""

    system: RunningSystem
    client: ComponentClient
    clock: Clock
    events: EventLog
    reconciler: Reconciler
    host_links: Callable[[], Iterable[HostLinkState]]
    _leases: dict[str, _Lease] = field(default_factory=dict)  # by instance
    _dead: dict[str, float] = field(default_factory=dict)  # by host: since when it was not reached (unix s)
    _task: asyncio.Task[None] | None = None
    _stopped: bool = False

    def on_component_event(self, event: ComponentEvent) -> None:
        """A component has reported its state: it may be one that is to keep a lease."""
        if self._stopped or self._task is not None or isinstance(event, Disconnected):
            return
        if event.instance in self._leases or self._seconds(event.instance) is not None:
            self._task = asyncio.get_running_loop().create_task(self._run())

    def stop(self) -> None:
        """Renew nothing any more, and have nothing take a place: the system is being taken down."""
        self._stopped = True
        for task in (self._task, *(lease.renewing for lease in self._leases.values())):
            if task is not None:
                task.cancel()

    async def close(self) -> None:
        """Free the nodes from their leases, as far as that is possible: without a manager nothing takes their place."""
        self.stop()
        if self.client.superseded():
            return

        async def end(name: str, lease: _Lease) -> None:
            try:
                async with within(FAREWELL):
                    await self.client.read(name, KeepLeaseCommand(seconds=None, seen=lease.seen))
            except (MidstrideError, asyncio.TimeoutError):
                pass  # it is silent until the next manager renews it

        running = self.system.configuration.instances
        kept = ((name, lease) for name, lease in self._leases.items() if lease.kept and name in running)
        await asyncio.gather(*(end(name, lease) for name, lease in kept))

    def declare_dead(self, host: str, by: str) -> dict[str, str]:
        """Take what runs on ``host`` for exited, as ``by`` says; returns the role of each of these instances."""
        instances, life = self.system.configuration.instances, self.system.life
        found = {name: each for name, each in instances.items() if each.host == host and not each.component.once}
        self._dead[host] = next(each.since for each in self.host_links() if each.host == host)
        for name in life.left_on_hosts(instances):  # as of a change that failed: its place is free, too
            handle = life[name].handle
            if handle is not None and handle.host == host:
                life.give_up(name)
        for name in sorted(found):
            because = f"{name} is given up: {by} has declared host {host} dead"
            self.reconciler.fell_silent(Exited(name, None, because=because, silent=True))
        return {name: found[name].role for name in sorted(found)}

    def is_given_up(self, instance: str, host: str) -> bool:
        """Return whether ``instance`` counts as exited on a host that was declared dead, and is not reached since."""
        links = [each for each in self.host_links() if each.host == host and each.problem is not None]
        return self.system.life[instance].silent and any(self._dead.get(host) == each.since for each in links)

    def in_words(self, instance: str) -> str | None:
        """Say what takes the place of an instance whose host cannot be reached, and when; None where nothing does."""
        lease, running = self._leases.get(instance), self.system.configuration.instances.get(instance)
        node = None if running is None else self.system.specification.nodes.get(running.role)
        if lease is None or not lease.kept or node is None or node.respawn is None:
            return None
        where = host_in_words(node.respawn.fallback_host or "")
        left = max(0.0, lease.until - self.clock.steady())
        return f"{node.respawn.fallback} on {where} takes the place of {instance} in {left:.1f} s"

    def _seconds(self, name: str) -> float | None:
        """The lease that an instance is to keep (s)."""
        instance = self.system.configuration.instances.get(name)
        node = None if instance is None else self.system.specification.nodes.get(instance.role)
        if instance is None or node is None or node.respawn is None or instance.component.once:
            return None
        leased = instance.component.keeps_lease and node.respawn.is_leased(instance.host)
        return node.respawn.lease_seconds if leased else None

    async def _run(self) -> None:
        try:
            while not self._stopped:
                self._look()
                if not self._leases:
                    return
                await self.clock.sleep(LOOK)
        finally:
            self._task = None

    def _look(self) -> None:
        lost = {each.host for each in self.host_links() if each.problem is not None}
        instances, now = self.system.configuration.instances, self.clock.steady()
        for name in sorted({*instances, *self._leases}):
            seconds = self._seconds(name)
            if name not in instances or (seconds is None and name not in self._leases):
                self._leases.pop(name, None)
                continue
            lease, latest = self._leases.get(name), self.system.life.latest(name)
            if lease is None or (latest is not None and latest.state.uuid != lease.uuid):
                uuid = "" if latest is None else latest.state.uuid
                lease = self._leases[name] = _Lease(seconds or 0.0, uuid)
            idle = lease.renewing is None or lease.renewing.done()
            if idle and now >= lease.due and instances[name].host not in lost and not self.client.superseded():
                lease.renewing = asyncio.get_running_loop().create_task(self._renew(name, lease, seconds))
        if lost and self.reconciler.commands.current is None and not self.client.superseded():
            self._give_up(lost, now)

    async def _renew(self, name: str, lease: _Lease, seconds: float | None) -> None:
        """Make the lease of ``name`` longer; without ``seconds``, end it."""
        seen, lease.seconds = lease.seen, seconds or lease.seconds
        lease.due = self.clock.steady() + lease.seconds / RENEWALS
        if seconds is not None and seen is not None:  # from now on, as it may arrive without an answer
            lease.until = max(lease.until, lease.arrived + seconds * LEASE_SLACK)
        try:
            answer = await self.client.read(name, KeepLeaseCommand(seconds=seconds, seen=seen))
        except MidstrideError as error:
            if name in self.system.configuration.instances and not lease.kept and not lease.refused:
                lease.refused = True
                self.events.add("note", f"{name} keeps no lease, so nothing takes its place: {error}")
            return
        if seconds is None:
            if self._leases.get(name) is lease:
                del self._leases[name]
            return
        lease.seen, lease.arrived, lease.refused = answer.now, self.clock.steady(), False
        if seen is None:
            lease.due = 0.0  # this has only asked what its clock says
        lease.kept = lease.kept or seen is not None

    def _give_up(self, lost: set[str], now: float) -> None:
        """Take for exited each instance on a host that cannot be reached whose lease is over."""
        for names in self.system.configuration.instances_by_role.values():
            found = [(self.system.configuration.instances[name], self._leases.get(name)) for name in sorted(names)]
            over = [
                (instance, lease)
                for instance, lease in found
                if lease is not None and lease.kept and now > lease.until and instance.host in lost
            ]
            if not over or len(over) < len(found):
                continue
            for instance, lease in over:
                if self._seconds(instance.name) is None or self.system.life[instance.name].silent:
                    continue
                words = (
                    f"{instance.name} is silent: {host_in_words(instance.host)} cannot be reached, and its lease of "
                    f"{format_number(lease.seconds)} s is over"
                )
                self.reconciler.fell_silent(Exited(instance.name, None, because=words, silent=True))

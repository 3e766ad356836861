"""The state of nodes without Midstride's API, where they offer it by two services (docs/protocols/foreign-state.md)."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from typing import Final

from midstride.errors import CommandRefused, ImportRefused
from midstride.foreign.graph_check import NamedServer, Served
from midstride.foreign.node import WATCH, ForeignNode
from midstride.foreign.services import NoAnswer, StateAccess
from midstride.wire import replies

# The services of a node, below its name, and their types.
EXPORT_STATE: Final = ("midstride/export_state", "rcl_interfaces/srv/GetParameters")
IMPORT_STATE: Final = ("midstride/import_state", "rcl_interfaces/srv/SetParameters")
# How the parameter is called in them whose value, bytes, is the state.
STATE: Final = "state"
# How long the graph may take to show the services of a node that has just been started (s).
SHOWN: Final = 1.0


class OfferedState:
    """The state of the node with the full name ``node()``, that of ``instance``, asked for by its ``services``.

    ``served``: what the graph shows of them now.
    """

    def __init__(
        self, instance: str, node: Callable[[], str], services: StateAccess, served: Callable[[], Served]
    ) -> None:
        self.instance = instance
        self._node = node
        self._services = services
        self._served = served

    def offers(self, service: tuple[str, str], served: Served | None = None) -> bool:
        """Return whether the node has a service, by what is ``served``; None: by what the graph shows now."""
        name, type_ = service
        found = self._served() if served is None else served
        return NamedServer("service", f"{self._node()}/{name}", type_) in found.servers

    @property
    def exports(self) -> bool:
        return self.offers(EXPORT_STATE)

    async def require_import(self) -> None:
        """Raises CommandRefused where the node cannot import state: the graph does not show it within SHOWN seconds."""
        clock = asyncio.get_running_loop().time
        deadline = clock() + SHOWN
        while not self.offers(IMPORT_STATE):
            if clock() >= deadline:
                name, type_ = IMPORT_STATE
                words = f"{self.instance} cannot import state"
                raise ImportRefused(f"{words}: its node offers no service {self._node()}/{name} ({type_})")
            await asyncio.sleep(WATCH)

    async def export(self, timeout: float) -> bytes:
        """The state. Raises CommandRefused where the node does not export it in ``timeout`` (s), and says why."""
        found = await self.exported(timeout)
        if found.state is None:
            raise CommandRefused(f"{self.instance} has not exported its state: {found.lost}")
        return found.state

    async def exported(self, timeout: float) -> replies.ExportedState:
        """The state, or that it is lost where the node does not answer in ``timeout`` (s), and would have to end.

        Raises CommandRefused where the node refuses.
        """
        try:
            found = await self._services.export_state(timeout)
        except NoAnswer as error:
            return replies.ExportedState(state=None, lost=str(error))
        if isinstance(found, str):
            raise CommandRefused(f"{self.instance} has not exported its state: {found}")
        return replies.ExportedState(state=found)

    async def import_(self, state: bytes, timeout: float) -> None:
        """Raises ImportRefused where the node refuses ``state``, and says why.

        Raises CommandRefused where it does not answer in ``timeout`` (s): it may import it yet.
        """
        words = f"{self.instance} has not imported the state"
        try:
            await self.require_import()
            refused = await self._services.import_state(state, timeout)
        except NoAnswer as error:
            raise CommandRefused(f"{words}: {error}") from None
        if refused is not None:
            raise ImportRefused(f"{words}: {refused}")


class ForeignState(OfferedState):
    """The state of ``node``, whose agent is in the manager's process."""

    def __init__(self, node: ForeignNode, services: StateAccess, served: Callable[[], Served]) -> None:
        super().__init__(node.record.instance, lambda: node.record.node, services, served)
        self.node = node

    async def import_once(self, state: bytes, timeout: float, exporter: str) -> None:
        """Import the ``state`` of the process ``exporter``, once, also where a manager dies meanwhile.

        Raises CommandRefused as :meth:`import_`, and where the node was asked to before, and has not been heard since.
        """
        node = self.node
        if exporter and exporter == node.record.imported:
            return
        if exporter and exporter == node.record.importing:
            name = node.record.instance
            raise CommandRefused(
                f"{name} was asked to import this state before, and has not answered; it may have imported it, so it "
                "is not asked again"
            )
        node.change_record(importing=exporter)
        try:
            await self.import_(state, timeout)
        except ImportRefused:
            node.change_record(importing="")
            raise
        node.change_record(importing="", imported=exporter)


@dataclass
class StatePeers:
    """Of a system, the nodes that may have state, by instance, and the transfers between them, by cut."""

    nodes: dict[str, ForeignState] = field(default_factory=dict)
    transfers: dict[str, asyncio.Task[replies.MovedState]] = field(default_factory=dict)

    def exporting(self, instance: str) -> ForeignState | None:
        """The state of ``instance``, where it exports any."""
        found = self.nodes.get(instance)
        return found if found is not None and found.exports else None


async def moved(
    old: ForeignState, new: ForeignState, timeout: float, ready: Callable[[], Awaitable[None]] | None = None
) -> int:
    """Move the state of ``old`` to ``new`` in ``timeout`` (s); how many bytes it has.

    ``ready`` is awaited between the export and the import. Raises CommandRefused where one of them fails.
    """
    clock = asyncio.get_running_loop().time
    deadline = clock() + timeout
    state = await old.export(timeout)
    if ready is not None:
        await ready()
    await new.import_(state, max(0.0, deadline - clock()))
    return len(state)

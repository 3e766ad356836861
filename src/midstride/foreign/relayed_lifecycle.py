"""The lifecycle of a node behind a relay, which another program manages: who does, and whether it was taken down.

The relay looks, since it has the clients for it: a manager looks at no node behind a relay.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Final

from midstride.errors import CommandRefused, NodeError
from midstride.foreign.graph_check import Served
from midstride.foreign.lifecycle_managers import LifecycleManagers
from midstride.foreign.lifecycle_transitions import ACTIVE, INACTIVE, STATE_TIMEOUT, NodeLifecycle, taken_down
from midstride.foreign.services import NoAnswer, NodeServices
from midstride.model.component import ComponentSpec

# How often the graph and the node are asked (s).
LOOK: Final = 1.0
# How long the old node may take to say its state to a relay that has just joined (s).
_JOINED: Final = 5.0


@dataclass
class RelayedLifecycle:
    """The lifecycle of the node with the full name ``node()``. ``served``: what the graph shows of it now.

    ``connect``: what a node, by its full name, can be asked. ``managed`` and ``faults`` are in words, as in
    :class:`midstride.wire.state.ComponentState`.
    """

    node: Callable[[], str]
    served: Callable[[], Served]
    connect: Callable[[str], Awaitable[NodeServices]]
    was_active: bool = False
    managed: list[str] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)
    _services: dict[str, NodeServices] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._managers = LifecycleManagers(self._services.get)

    async def look(self) -> bool:
        """Ask the graph, the node and its managers; return whether anything has changed."""
        before, served = (self.managed, self.faults), self.served()
        if served.has_lifecycle:
            for name in (self.node(), *(each.name for each in served.managers)):
                if name not in self._services:
                    self._services[name] = await self.connect(name)
            await self._look_at_state()
            await self._managers.ask(served.managers)
        self.managed = self._managers.reasons_to_stay(self.node(), served.managers)
        return before != (self.managed, self.faults)

    async def _look_at_state(self) -> None:
        with suppress(NoAnswer):
            state = await self._services[self.node()].lifecycle_state(STATE_TIMEOUT)
            self.was_active |= state == ACTIVE
            self.faults = [taken_down(self.node(), state)] if self.was_active and state != ACTIVE else []


async def followed(
    instance: str, component: ComponentSpec, old: NodeServices, new: NodeServices, is_there: Callable[[], bool]
) -> str | None:
    """Take the node of ``instance`` to the lifecycle state of the ``old`` one; return that state, None for no such.

    ``is_there``: waits for the node, and returns whether it has a lifecycle. Raises NodeError where it stays behind.
    """
    try:
        state = await old.lifecycle_state(_JOINED)
    except NoAnswer:
        return None
    if state not in (INACTIVE, ACTIVE) or not is_there():
        return None
    own = NodeLifecycle(instance, new, component.startup_seconds or 0.0, component.activate_seconds)
    try:
        await own.reach(state, own.services_timeout)
    except CommandRefused as error:
        raise NodeError(str(error)) from None
    return state

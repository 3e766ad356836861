"""A lifecycle node as its agent knows it: which state its modes and attachments require, and that it has this state.

It is active while a functionality of it is not in its last mode. Where nothing else holds it back (`gate lifecycle`),
also only while all outputs that the specification attaches are open. One that states no functionality, as before
`midstride capture`, is active from its start to its end.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping

from midstride.errors import CommandRefused
from midstride.foreign.lifecycle_transitions import ACTIVE, FINALIZED, INACTIVE, NodeLifecycle
from midstride.foreign.node import ForeignNode
from midstride.foreign.services import NoAnswer, NodeServices
from midstride.wire.state import GateState


class LifecycleNode:
    """``node``, whose lifecycle services are among ``services``."""

    def __init__(self, node: ForeignNode, services: NodeServices) -> None:
        self.node = node
        component = node.component
        startup, activate = component.startup_seconds or 0.0, component.activate_seconds
        self.lifecycle = NodeLifecycle(node.record.instance, services, startup, activate)
        self._inactive = 0.0  # how long its outputs have been silent, until it was last active (s)
        self._inactive_since: float | None = None  # on the loop's clock
        self._active_at: float | None = None  # when it was asked last, and was active
        if node.gates is None:
            node.inactive = self.inactive

    def inactive(self) -> float:
        """For how long in all, at most (s), nothing has written its outputs since they were first handed to it."""
        now = asyncio.get_running_loop().time()
        return self._inactive + (0.0 if self._inactive_since is None else now - self._inactive_since)

    def handed_over(self, seconds: float) -> None:
        """Add the ``seconds`` for which its outputs were silent before it was active."""
        self._inactive += seconds

    def _note_state(self) -> None:
        if self.lifecycle.state == ACTIVE and self._inactive_since is not None:
            self._inactive, self._inactive_since = self.inactive(), None

    async def configure(self) -> None:
        """After the start of its process. Raises CommandRefused."""
        await self.lifecycle.reach(self.required(self.node.record.modes, {}), self.lifecycle.services_timeout)

    async def finish(self) -> None:
        """Before its process ends: to `finalized`. Raises CommandRefused."""
        if self.lifecycle.state != FINALIZED:
            await self.lifecycle.reach(FINALIZED)

    def required(self, modes: Mapping[str, str], links: Mapping[str, GateState | None]) -> str:
        """The state for these modes (by functionality) and attachments (by port)."""
        works = any(modes[each.name] != each.modes[-1].name for each in self.node.component)
        works = works or not self.node.component.functionalities
        if self.node.gates is None:
            works = works and all(links.get(port) == "open" for port in self.node.record.outputs)
        return ACTIVE if works else INACTIVE

    async def enter_modes(self, modes: Mapping[str, str], because: str) -> None:
        """Raises CommandRefused; then the modes are as before."""
        record = self.node.record
        before = {name: mode for name, mode in record.modes.items() if name in modes}
        await self._change(
            self.required({**record.modes, **modes}, record.links),
            lambda: self.node.enter_modes(modes, because),
            lambda: self.node.enter_modes(before, "roll-back"),
        )

    async def set_links(self, links: Mapping[str, GateState | None]) -> None:
        """Open, close or take away (None) attachments, by port. Raises CommandRefused; then they are as before."""
        before = {port: self.node.record.links.get(port) for port in links}
        required = self.required(self.node.record.modes, {**self.node.record.links, **links})
        await self._change(required, lambda: self.node.set_links(links), lambda: self.node.set_links(before))

    async def _change(self, required: str, apply: Callable[[], None], undo: Callable[[], None]) -> None:
        """``apply`` once the node is active, or before it is deactivated, so that what is open is active."""
        if required == ACTIVE:
            await self.lifecycle.reach(ACTIVE)
            self._note_state()
            apply()
            return
        if self.lifecycle.state == ACTIVE:
            self._inactive_since = asyncio.get_running_loop().time()
        apply()
        try:
            await self.lifecycle.reach(INACTIVE)
        except CommandRefused:
            self._note_state()
            undo()
            raise

    def left(self) -> bool:
        """Return whether the node should be active, and was not when it was last asked."""
        return (
            self.required(self.node.record.modes, self.node.record.links) == ACTIVE and self.lifecycle.state != ACTIVE
        )

    async def look(self) -> bool:
        """Ask for the state. If it has left the one that it should have, its modes are the last ones from now on."""
        record, asked = self.node.record, asyncio.get_running_loop().time()
        try:
            state = await self.lifecycle.look()
        except NoAnswer:
            return False
        if state == ACTIVE:
            self._active_at = asked
        if not self.left() or record != self.node.record or not self.node.component.functionalities:
            return False
        if self._inactive_since is None:  # since when it has not been active is not known
            self._inactive_since = asked if self._active_at is None else self._active_at
        last = {each.name: each.modes[-1].name for each in self.node.component}
        self.node.enter_modes(last, f"its lifecycle state is {state}")
        return True

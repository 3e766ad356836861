"""The state of the program behind a relay, where its node offers it: exported and imported at the cuts of the relay.

The program cannot be held at a slot. So what it publishes until it has the state of its predecessor, and after it has
exported its own, reaches nobody (docs/protocols/foreign-state.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from midstride.foreign.foreign_state import OfferedState
from midstride.node.component_host import Host
from midstride.wire import replies


class RelayedOutput(Protocol):
    """An output that forgets what its program has published with another state.

    What was published before ``stale_before`` (ns, by :meth:`Host.message_now`) is neither passed on nor kept.
    """

    rated: bool
    stale_before: int

    def forget_kept(self) -> None:
        """Have later subscribers get nothing of what has been published so far. On the data thread."""


class RelayedState:
    """The ``state`` of the program's node. ``outputs``: those of the relay.

    Implements :class:`midstride.node.author.declaration.OutsideState`.
    """

    def __init__(self, state: OfferedState, outputs: Sequence[RelayedOutput], host: Host) -> None:
        self._state = state
        self._outputs = outputs
        self._host = host
        self.exports = False

    def look(self) -> bool:
        """Look whether the graph shows that it exports state; return whether that has changed."""
        before, self.exports = self.exports, self._state.exports
        return before != self.exports

    async def require_import(self) -> None:
        """Raises CommandRefused where the node cannot import state."""
        await self._state.require_import()

    async def exported(self, timeout: float) -> replies.ExportedState:
        """The state, or that the node has not answered in ``timeout`` (s). Raises CommandRefused where it refuses."""
        return await self._state.exported(timeout)

    async def import_(self, state: bytes, timeout: float) -> None:
        """Have the node take over ``state``. Raises CommandRefused where it does not in ``timeout`` (s).

        Of an output without a rate, what is published while it does so has the new state already.
        """

        def forget(outputs: Sequence[RelayedOutput], before: int) -> None:
            for output in outputs:
                output.forget_kept()
                output.stale_before = before

        begun = self._host.message_now()
        await self._host.on_data(lambda: forget(self._outputs, begun))
        await self._state.import_(state, timeout)
        ended = self._host.message_now()
        await self._host.on_data(lambda: forget([output for output in self._outputs if output.rated], ended))

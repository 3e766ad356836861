"""The lifecycle of a foreign node (ROS 2's managed nodes): from one state to another, by the node's own services."""

from __future__ import annotations

import asyncio
from typing import Final

from midstride.errors import CommandRefused
from midstride.foreign.services import NoAnswer, NodeServices

UNCONFIGURED, INACTIVE, ACTIVE, FINALIZED = "unconfigured", "inactive", "active", "finalized"
_ORDER: Final = (UNCONFIGURED, INACTIVE, ACTIVE)
_UP: Final = {UNCONFIGURED: "configure", INACTIVE: "activate"}
_DOWN: Final = {ACTIVE: "deactivate", INACTIVE: "cleanup", UNCONFIGURED: "shutdown"}

# How long each transition may take (s). What a component states of its start (`takes`) is added for `configure`, and
# for its services; how long `activate` may take is what it states.
TIMEOUTS: Final = {"configure": 12.0, "activate": 5.0, "deactivate": 5.0, "cleanup": 5.0, "shutdown": 3.0}
# What states how long a transition may take.
_STATED: Final = {"configure": "takes", "activate": "activate"}
# How long the node may take to offer its services after the start of its process (s), and to say its state later.
SERVICES_TIMEOUT: Final = 15.0
STATE_TIMEOUT: Final = 2.0
# How often a node that is in a transition is asked whether it has ended (s).
INTERVAL: Final = 0.05


def taken_down(node: str, state: str) -> str:
    """Return in words that the node of this full name is in ``state``, and was active before."""
    return f"lifecycle node {node} is {state}, and was active before"


class NodeLifecycle:
    """The lifecycle of the node of ``instance``. ``state`` is the last one that the node reported.

    ``responsive``: the node has answered when it was last asked.
    """

    def __init__(
        self, instance: str, services: NodeServices, startup: float = 0.0, activate: float | None = None
    ) -> None:
        """``startup`` and ``activate``: what its component states of its start, and of its activation (s)."""
        self.instance = instance
        self.state = "unknown"
        self.responsive = True
        self._services = services
        self.services_timeout = SERVICES_TIMEOUT + startup
        self._timeouts = {
            **TIMEOUTS,
            "configure": TIMEOUTS["configure"] + startup,
            "activate": activate or TIMEOUTS["activate"],
        }
        self._lock = asyncio.Lock()

    async def look(self, timeout: float = STATE_TIMEOUT) -> str:
        """The state as the node reports it. Raises NoAnswer."""
        try:
            self.state = await self._services.lifecycle_state(timeout)
        except NoAnswer:
            self.responsive = False
            raise
        self.responsive = True
        return self.state

    async def reach(self, target: str, timeout: float = STATE_TIMEOUT) -> None:
        """Make the transitions from the node's state to ``target``; ``timeout``: for its first answer (s).

        Raises CommandRefused, which says which transition failed, and in which state the node is.
        """
        async with self._lock:
            state = await self._asked(target, timeout)
            while state != target:
                state = await self._step(state, target)

    async def _step(self, state: str, target: str) -> str:
        """The state after the next transition towards ``target``."""
        if state not in _ORDER:
            return await self._after_transition(state, target)
        up = target in _ORDER and _ORDER.index(target) > _ORDER.index(state)
        name = (_UP if up else _DOWN)[state]
        patience = self._timeouts[name]
        try:
            succeeded = await self._services.transition(name, state, patience)
        except NoAnswer:
            self.responsive = False
            message = f"{self.instance} has not answered `{name}` within {patience:g} s; it was {state} before"
            if name in _STATED:
                message += f" (if it needs longer, state `{_STATED[name]} {2 * patience:g} s` after its `run` command)"
            raise CommandRefused(message) from None
        try:
            after = await self.look()
        except NoAnswer as error:
            raise CommandRefused(f"{self.instance} has answered `{name}`, but not said its state: {error}") from None
        if not succeeded or after == state:
            raise CommandRefused(f"{self.instance} has answered `{name}` with a failure; it is {after}")
        return after

    async def _after_transition(self, state: str, target: str) -> str:
        """Wait until a transition has ended that was begun before, as one that had not been answered in time."""
        deadline = asyncio.get_running_loop().time() + max(self._timeouts.values())
        while (now := await self._asked(target)) == state and state != FINALIZED:
            if asyncio.get_running_loop().time() >= deadline:
                raise CommandRefused(f"{self.instance} cannot become {target}: it stays in state {state}")
            await asyncio.sleep(INTERVAL)
        if now == FINALIZED:
            raise CommandRefused(f"{self.instance} cannot become {target}: it is {FINALIZED}, so replace it")
        return now

    async def _asked(self, target: str, timeout: float = STATE_TIMEOUT) -> str:
        try:
            return await self.look(timeout)
        except NoAnswer as error:
            raise CommandRefused(f"{self.instance} cannot become {target}: {error}") from None

"""Lifecycle managers: programs that change the lifecycle states of other nodes, such as Nav2's `lifecycle_manager`.

One is recognised by what it calls, its clients of `…/change_state`. It knows a node by its name, and Nav2's also by a
*bond*: both write on `/bond` all the time, under an identity that is another one for each process. If the bond breaks,
it deactivates all of its nodes. So a node cannot be replaced while a manager would notice (docs/protocols/foreign.md).
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Final

from midstride.foreign.services import NoAnswer, NodeServices
from midstride.model.lifecycle_management import BOND_TIMEOUT, NODE_NAMES, broken_bond

# How long the parameters of a manager are remembered, and how long it may take to say them (s). It reads them once.
_REMEMBERED: Final = 10.0
_PATIENCE: Final = 1.0


@dataclass(frozen=True, slots=True)
class LifecycleManager:
    """The node of the full name ``name``, which changes the lifecycle state of another one.

    ``asks``: it can ask for that state as well. ``bond``: it listens to a topic `bond` on which the other one writes.
    """

    name: str
    asks: bool = False
    bond: bool = False


def reason_to_stay(node: str, manager: LifecycleManager, parameters: Mapping[str, Any]) -> str | None:
    """The reason why ``node`` must not end while ``manager`` runs, in words; None where the manager would not notice.

    ``parameters``: those of the manager, as far as they are known.
    """
    timeout = parameters.get(BOND_TIMEOUT)
    if isinstance(parameters.get(NODE_NAMES), list) and isinstance(timeout, float | int):
        if timeout <= 0:  # Nav2's manager asks for states only after it has changed them
            return None
        return broken_bond(node, manager.name, timeout)
    if manager.bond:
        return broken_bond(node, manager.name, None)
    if manager.asks:
        return (
            f"lifecycle manager {manager.name} may ask {node}/get_state at any time, would find no such service any "
            "more, and may then deactivate all of its nodes"
        )
    return None


class LifecycleManagers:
    """The lifecycle managers of a system, as far as they are known. ``services(node)``: what a node can be asked."""

    def __init__(self, services: Callable[[str], NodeServices | None]) -> None:
        self._services = services
        self._asked: dict[str, NodeServices | None] = {}
        self._known: dict[str, tuple[float, Mapping[str, Any]]] = {}
        self._lock = asyncio.Lock()
        self.starting: dict[str, str] = {}  # the instances whose nodes may still create what they call, and their roles

    def reasons_to_stay(self, node: str, managers: Iterable[LifecycleManager]) -> list[str]:
        """The reasons why ``node`` must not end, in words: one for each manager known to notice."""
        known = ((each, self._known.get(each.name, (0.0, {}))[1]) for each in managers)
        found = (reason_to_stay(node, manager, parameters) for manager, parameters in known)
        return [words for words in found if words is not None]

    async def ask(self, managers: Iterable[LifecycleManager]) -> None:
        """Have each of them say its parameters, unless it has lately."""
        for manager in managers:
            await self._ask(manager.name)

    async def _ask(self, manager: str) -> None:
        async with self._lock:
            at, known = self._known.get(manager, (0.0, {}))
            if known and time.monotonic() - at < _REMEMBERED:
                return
            if manager not in self._asked:
                self._asked[manager] = self._services(manager)
            if (services := self._asked[manager]) is not None:
                with suppress(NoAnswer):
                    self._known[manager] = time.monotonic(), await services.parameters(_PATIENCE)

    def close(self) -> None:
        for services in self._asked.values():
            if services is not None:
                services.close()
        self._asked.clear()

"""A node without Midstride's API in the ROS graph while it runs: where it differs from what is declared.

Also the services and ROS actions that it has, and why a lifecycle manager keeps it from being ended.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from typing import Final

from midstride.foreign.declared_servers import DeclaredServers
from midstride.foreign.foreign_state import EXPORT_STATE, ForeignState
from midstride.foreign.graph_check import DeclaredEndpoints, GraphEndpoint, NodeGraph, Served
from midstride.foreign.lifecycle_managers import LifecycleManagers
from midstride.foreign.lifecycle_transitions import ACTIVE, taken_down
from midstride.foreign.node import ForeignNode
from midstride.foreign.services import NoAnswer, NodeServices
from midstride.wire.state import UndeclaredTopic

# How often a lifecycle node is asked for its state and its parameters (s).
LOOK: Final = 1.0
# How long the graph may take to show a new node's endpoints (s), and how often it is compared later (s).
GRAPH_TIMEOUT: Final = 5.0
GRAPH_LOOK: Final = 2.0
# How soon after its start the graph is asked for what the node serves (s).
FIRST_LOOK: Final = 0.3
# A node of which the graph has shown nothing new for so long, and that answers, will create no more of them (s).
GRAPH_UNCHANGED: Final = 2.0


class GraphWatch:
    """Looks at what ``graph`` and ``served`` show of ``node``, and calls ``report`` when that has changed.

    ``declared`` and ``servers``: what they have to show; ``managers``: what is known of lifecycle managers;
    ``services`` and ``state``: what the node can be asked, and whether it exports its state.
    """

    def __init__(
        self,
        node: ForeignNode,
        graph: NodeGraph | None,
        served: Callable[[], Served] | None,
        declared: DeclaredEndpoints,
        servers: DeclaredServers,
        managers: LifecycleManagers | None,
        services: NodeServices | None,
        state: ForeignState | None,
        report: Callable[[], None],
    ) -> None:
        self._node = node
        self._graph, self._served = graph, served
        self._declared, self._servers = declared, servers
        self._managers, self._services, self._state = managers, services, state
        self._report = report
        self._registered_at: float | None = None
        self._shown: object = None  # what the graph showed of it last, until it shows nothing new any more
        self._shown_since = 0.0

    def registered(self) -> None:
        """The node has been up since now: what the graph does not show of it in time, it never will."""
        self._registered_at = asyncio.get_running_loop().time()

    async def watch(self) -> None:
        """Look now and then whether the node still has what is declared: it may create endpoints at any time."""
        while self._graph is not None or self._served is not None:
            await self._look_at_graph()
            later = LOOK if self.may_show_more() else GRAPH_LOOK
            await asyncio.sleep(later if self._node.looked else FIRST_LOOK)

    def may_show_more(self) -> bool:
        """Return whether the node started so recently that it may still create endpoints, services and clients."""
        return self._managers is not None and self._node.record.instance in self._managers.starting

    async def look(self, seconds: float) -> None:
        """Look at the graph, and again until it is known whether the node is managed, no longer than ``seconds``."""
        node, clock = self._node, asyncio.get_running_loop().time
        deadline = clock() + seconds
        await self._look_at_graph()
        while not node.managed and (node.starting or not self._has_shown_itself()) and clock() < deadline:
            await asyncio.sleep(min(FIRST_LOOK, max(0.0, deadline - clock())))
            await self._look_at_graph()

    def _has_shown_itself(self) -> bool:
        """Return whether the graph has shown nothing new of the node for FIRST_LOOK, so what it shows is the node.

        Other processes may see a change of the graph sooner than this one.
        """
        since = asyncio.get_running_loop().time() - self._shown_since
        return not self.may_show_more() or (self._node.looked and since >= FIRST_LOOK)

    async def _look_at_graph(self) -> None:
        """Note what it shows of the node. What it has not shown for long enough, it never will, as without ROS."""
        now = asyncio.get_running_loop().time()
        never = self._registered_at is not None and now - self._registered_at > GRAPH_TIMEOUT
        served = Served() if self._served is None else self._served()
        found = [] if self._graph is None else self._graph()
        self._note_news((set(found), served), nothing=not found and served == Served(), never=never)
        await self._look_at_managers(served)
        left = await self._left_active(served)
        # A middleware that shows nothing of the node shows no server either: then nothing is known.
        lost = self._servers.differences(served) if self._registered_at is not None and served != Served() else []
        serves = [each.endpoint for each in served.own]
        seen = (
            [
                *self._declared.differences(found),
                *self._node.past_the_gate(),
                *lost,
                *left,
                *self._managed_twice(served),
            ],
            self._undeclared(found),
            serves,
            [each.name for each in served.managers],
            [*served.calls],
            self._node.looked or bool(found) or never,
            self._node.shown or bool(found) or served != Served(),
        )
        node = self._node
        keeps_state = self._state is not None and self._state.offers(EXPORT_STATE, served)
        if (*seen, keeps_state) != (*self._seen(), node.keeps_state):
            node.differences, node.undeclared, node.serves, node.lifecycle_callers, node.calls, *flags = seen
            node.looked, node.shown = flags
            node.keeps_state = keeps_state
            self._report()

    def _seen(self) -> tuple[object, ...]:
        node = self._node
        own = node.differences, node.undeclared, node.serves, node.lifecycle_callers, node.calls
        return *own, node.looked, node.shown

    def _undeclared(self, found: Sequence[GraphEndpoint]) -> list[UndeclaredTopic]:
        """The topics of the node that are no ports, of what the graph shows of it."""
        shown, gates = self._declared.undeclared(found), self._node.gates
        handed_over: set[str] = set()
        if gates is not None and any(each.output for each in shown):
            handed_over = gates.unstated_topics()
        return [
            UndeclaredTopic(
                output=each.output,
                topic=each.topic,
                type=each.type,
                handed_over=each.output and each.topic in handed_over,
            )
            for each in shown
        ]

    def _note_news(self, shown: object, *, nothing: bool, never: bool) -> None:
        """Note whether the node may still create anything, by what the graph has ``shown`` of it now."""
        if (managers := self._managers) is None or not self.may_show_more():
            return
        now = asyncio.get_running_loop().time()
        if shown != self._shown:
            self._shown, self._shown_since = shown, now
        if never if nothing else now - self._shown_since >= GRAPH_UNCHANGED:
            managers.starting.pop(self._node.record.instance, None)

    async def _look_at_managers(self, served: Served) -> None:
        """Note why the node must not end: at first by what the graph shows, which a manager's parameters may refute."""
        if (managers := self._managers) is None:
            return

        def note() -> None:
            node = self._node
            starting = [name for name, role in sorted(managers.starting.items()) if role != node.record.role]
            found = (
                managers.reasons_to_stay(node.record.node, served.managers),
                starting if served.has_lifecycle else [],
            )
            if found != (node.managed, node.starting):
                node.managed, node.starting = found
                self._report()

        note()
        await managers.ask(served.managers)
        note()

    def _managed_twice(self, served: Served) -> list[str]:
        if not self._node.component.has_lifecycle:
            return []
        gate, node = self._node.component.gate, self._node.record.node
        return [
            f"lifecycle manager {each.name} changes the state of {node}, and so does Midstride (`gate {gate}`): "
            "only one of them may, so end the manager, or declare `gate preload`"
            for each in served.managers
        ]

    async def _left_active(self, served: Served) -> list[str]:
        """In which state a lifecycle node is that has no modes to show it, if it or its predecessor was active."""
        component = self._node.component
        if not served.has_lifecycle or self._services is None:
            return []
        if component.has_lifecycle and component.functionalities:
            return []
        try:
            state = await self._services.lifecycle_state(LOOK)
        except NoAnswer:
            return []
        if state == ACTIVE and not self._node.record.was_active:
            self._node.change_record(was_active=True)
        if state == ACTIVE or not self._node.record.was_active:
            return []
        return [taken_down(self._node.record.node, state)]

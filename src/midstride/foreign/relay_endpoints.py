"""The endpoints of the program behind a relay: awaited when it starts, and compared with what is declared."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from midstride.errors import BackendError, NodeError
from midstride.foreign.declared_servers import DeclaredServers
from midstride.foreign.graph_check import DeclaredEndpoints, GraphEndpoint, Served, endpoints_seconds
from midstride.foreign.own_node_search import NODE_LOOK, OwnNodeSearch
from midstride.foreign.relayed_program import RelayedProgram, RelayOrder
from midstride.model.component import ComponentSpec

# How long a node that may advertise later is given to do so at once (s); then it is watched.
ADVERTISES: Final = 1.0
_WATCH: Final = 1.0


@dataclass(frozen=True)
class ProgramEndpoints:
    """The endpoints of the ``program`` of ``order``; ``graph`` shows them, or None while it shows no node of that name.

    ``graph`` may raise BackendError, and is then asked again. ``matched``: by output, whether its relay is connected
    with a publisher of the program, or with its server. ``late``: the program may create a publisher only when it has
    something to publish, so none is waited for. ``nodes``: the full names of the nodes of a program that gives its node
    its name itself. ``served``: what the graph shows of the services of the node.
    """

    order: RelayOrder
    component: ComponentSpec
    program: RelayedProgram
    graph: Callable[[], Sequence[GraphEndpoint] | None]
    matched: Mapping[str, Callable[[], bool]]
    late: bool
    nodes: Callable[[], Sequence[str]] = tuple
    served: Callable[[], Served] = Served

    def own_node(self) -> str:
        """Return the full name of the node that the program has named itself. Raises NodeError where it has none."""
        search = OwnNodeSearch(self.order.node, endpoints_seconds(self.component))
        while not search.look(self.nodes()):
            self._require_running()
            time.sleep(NODE_LOOK)
        if not search.node:
            raise NodeError(self._without_node("no node in its enclave", "the enclave"))
        return search.node

    def becomes(self, has_lifecycle: Callable[[], bool]) -> bool:
        """Wait until it is a lifecycle node, or has what is declared; return whether it is one. Raises NodeError."""
        begun = time.monotonic()
        while not (found := has_lifecycle()) and time.monotonic() - begun < endpoints_seconds(self.component):
            self._require_running()
            if self.component.ports() and not self._missing(self._shown()[0] or ()):
                break
            time.sleep(NODE_LOOK)
        return found

    def wait(self) -> None:
        """Return once the program has what is declared. Raises NodeError, at once where it cannot come true."""
        begun = time.monotonic()
        appeared: float | None = None
        while True:
            found, unread = self._shown()
            now = time.monotonic()
            self._require_running()
            if fault := self._past(found or ()):
                raise NodeError(fault)
            if found is not None and appeared is None:
                appeared = now
            missing = self._missing(found or ())
            if not missing and not self.late:
                break
            if not missing and appeared is not None and (now - appeared >= ADVERTISES or self._remapped(found or ())):
                break
            if now - begun >= endpoints_seconds(self.component):
                break
            time.sleep(NODE_LOOK)
        if faults := self._faults(missing, found, unread):
            raise NodeError("; ".join(faults))

    def watch(self, past: Callable[[str], None]) -> None:
        """Have ``past`` called, in a thread, when a program that advertises late does so past its relay."""
        if self.late:
            threading.Thread(target=self._watch, args=(past,), daemon=True).start()

    def _watch(self, past: Callable[[str], None]) -> None:
        before = ""
        while True:
            found, unread = self._shown()
            if self._remapped(found or ()):
                return
            if fault := self._past(found or ()):
                past(fault)
                return
            if unread and not before:
                words = f"whether {self.order.node} publishes past its relay is not known now: {unread}"
                print(words, file=sys.stderr, flush=True)
            before = unread
            time.sleep(_WATCH)

    def _shown(self) -> tuple[Sequence[GraphEndpoint] | None, str]:
        """Return what the graph shows, and why it cannot be read."""
        try:
            return self.graph(), ""
        except BackendError as error:
            return None, str(error)

    @property
    def _declared(self) -> DeclaredEndpoints:
        return DeclaredEndpoints(self.component, self.order.topics, self.order.node)

    @property
    def _servers(self) -> DeclaredServers:
        return DeclaredServers(self.component, self.order.topics, self.order.node)

    def _past(self, found: Sequence[GraphEndpoint]) -> str:
        past = self._declared.past_relay(self.order.real, found)
        if self._servers.ports:
            past += self._servers.past_relay(self.order.real, self.served())
        return "; ".join(past)

    def _remapped(self, found: Sequence[GraphEndpoint]) -> bool:
        """Return whether every output is published on its private topic, so that the program follows remappings."""
        published = {endpoint.topic for endpoint in found if endpoint.output}
        return all(self.order.topics[port] in published for port in self.component.outputs)

    def _require_running(self) -> None:
        if (status := self.program.status()) is not None:
            raise NodeError(f"`{self.program.words}` has exited with status {status}")

    def _missing(self, found: Sequence[GraphEndpoint]) -> list[str]:
        """The ports for which the program has no endpoint."""
        received = {endpoint.topic for endpoint in found if not endpoint.output}
        lazy = self.component.lazy
        missing = [] if self.late else [name for name, matched in self.matched.items() if not matched()]
        missing = [name for name in missing if name not in lazy]
        return missing + [name for name in self.component.input_order if self.order.topics[name] not in received]

    def _faults(self, missing: Sequence[str], found: Sequence[GraphEndpoint] | None, unread: str) -> list[str]:
        """The reasons why the program is not what is declared; ``missing``: the ports that it still lacks."""
        if unread:
            return [f"what {self.order.node} has is not known: {unread}"]
        if found is None and (missing or self.late):
            return [self._without_node(f"no node {self.order.node}", "its name")]
        declared, shown = self._declared, found or ()
        servers = [name for name in missing if self.component.is_service(name)]
        missing = [name for name in missing if name not in servers]
        there = declared.unseen(shown, missing)
        waited = endpoints_seconds(self.component)
        faults = declared.lacking(shown, [port for port in missing if port not in there], waited)
        faults += declared.differences(shown)
        if servers:
            faults += self._servers.differences(self.served())
        if missing and not faults:
            faults = [f"the messages of {', '.join(missing)} cannot be received"]
        if servers and not faults:
            faults = [f"no request reaches {', '.join(servers)}"]
        return faults

    def _without_node(self, what: str, argument: str) -> str:
        waited = endpoints_seconds(self.component)
        words = f"there is {what} {waited:.3g} s after `{self.order.command[0]}` was started"
        late = f"if it needs longer, state `takes {2 * waited:g} s` after its `run` command"
        return f"{words}: a program behind a relay must accept ROS's arguments, {argument} among them; {late}"

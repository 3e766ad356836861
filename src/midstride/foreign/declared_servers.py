"""Compares the servers of a node without Midstride's API with those that its component declares: names and types.

A client may come into being when it is first needed, so those are not looked for.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from midstride.foreign.graph_check import NamedServer, Served
from midstride.model.component import ComponentSpec
from midstride.model.graph_names import resolved
from midstride.model.wording import KIND_WORDS


@dataclass(frozen=True, slots=True)
class DeclaredServers:
    """The servers of ``node`` (a full name) as ``component`` declares them; ``topics`` has the full name of each."""

    component: ComponentSpec
    topics: Mapping[str, str]
    node: str

    @property
    def ports(self) -> list[str]:
        """The servers."""
        return [port for port in self.component.service_ports() if self.component.has_output(port)]

    def shown(self, served: Served) -> bool:
        """Return whether the graph shows all of them, of whatever type."""
        found = {(server.kind, server.name) for server in served.servers}
        return found.issuperset((self.component.kind_of(port), self.topics[port]) for port in self.ports)

    def differences(self, served: Served) -> list[str]:
        """Each server that the node lacks, or has with another type, in words."""
        return list(self._differences(served))

    def past_relay(self, real: Mapping[str, str], served: Served) -> list[str]:
        """For each server that the node has past its relay, as it takes no notice of the name it was given, in words.

        ``real``: by server that is attached, the name by which clients know it.
        """
        words = []
        for port in self.ports:
            given, own = self.topics[port], self.component.topic_of(port)
            others = {resolved(own, self.node), real.get(port, given)} - {given}
            kind = self.component.kind_of(port)
            for server in sorted(each for each in served.servers if each.kind == kind and each.name in others):
                words.append(
                    f"node {self.node} serves {server} itself, for {KIND_WORDS[kind].output} {port} of "
                    f"{self.component.name}; it takes no notice of the remapping `{own}:={given}`"
                )
        return words

    def _differences(self, served: Served) -> Iterator[str]:
        for port in self.ports:
            kind, name = self.component.kind_of(port), self.topics[port]
            words, type_ = KIND_WORDS[kind], self.component.type_of(port)
            types = sorted(server.type for server in served.servers if (server.kind, server.name) == (kind, name))
            declared = f"{words.output} {port} of {self.component.name}"
            if not types:
                others = ", ".join(map(str, served.own))
                instead = f"; it serves {others}" if others else ""
                yield f"node {self.node} does not serve {NamedServer(kind, name, '')}, for {declared}{instead}"
            elif type_ not in types:
                yield (
                    f"node {self.node} serves {NamedServer(kind, name, '')} of type {', '.join(types)}, "
                    f"and {declared} is declared as {type_}"
                )

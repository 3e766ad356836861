"""A specification of what a graph shows alone, as a first draft: it does not know what starts the nodes."""

from __future__ import annotations

import re

from midstride.capture.observed import ObservedEndpoint, ObservedGraph
from midstride.capture.observed_processes import container_lines
from midstride.capture.probe import Dependences
from midstride.capture.proposal import component_text, free_name, node_block, ports_of, topic_lines
from midstride.capture.reliance import by_kind, comments, relied_on
from midstride.capture.taken_over import gate_of_lifecycle
from midstride.lang.printer import format_text
from midstride.lang.token_stream import RESERVED
from midstride.model.lifecycle_management import Management


def drafted_nodes(graph: ObservedGraph) -> list[str]:
    """The full names of the nodes that a draft has: those with ports."""
    return sorted({*graph.nodes(), *(each.node for each in drafted_services(graph))})


def drafted_services(graph: ObservedGraph) -> frozenset[ObservedEndpoint]:
    """The servers and clients of the nodes of a graph that are ports in a draft."""
    every = {each.node for each in graph.services.values()}
    return relied_on(graph, every, every)


def draft(
    name: str,
    graph: ObservedGraph,
    rates: bool = False,
    findings: Dependences | None = None,
    management: Management | None = None,
) -> str:
    """The text of the system ``name``, with every node of the graph."""
    services = drafted_services(graph)
    ports = {node: ports_of(graph, node, {}, findings, services) for node in drafted_nodes(graph)}
    found_ports = [port for each in ports.values() for port in each]
    topics = by_kind(graph, {port.endpoint.topic for port in found_ports})
    heard = {port.endpoint.topic for each in ports.values() for port in each if port.endpoint.output}
    lines = [
        f"# Captured for {graph.seconds:g} s. What starts a node is not in the graph: add it to each component,",
        '# as `run "…" gate preload` for a program that does not use Midstride\'s API.',
        f"system {name}",
        "",
        *topic_lines(graph, topics, found_ports if rates else ()),
        *container_lines(graph),
        "",
    ]
    nodes: dict[str, list[str]] = {}
    components: set[str] = set()
    owns = {node.rpartition("/")[2] for node in ports}
    for node, found in ports.items():
        words = (word[0].upper() + word[1:] for word in re.split(r"[^A-Za-z0-9]+", node) if word)
        component = free_name("".join(words), components)  # of `/a/b` and `/a_b`, too
        components.add(component)
        gate = gate_of_lifecycle(graph, node, management)
        if gate is not None:
            lines.append(f"# A lifecycle node: `gate {gate}`, so that Midstride manages its lifecycle.")
        elif managers := graph.managers_of(node):
            lines.append(f"# A lifecycle node that {', '.join(managers)} manages: `gate preload`.")
        body = [*component_text(found, heard, rates, own_topics=False), *comments(graph, node, services)]
        lines += [f"component {component} {{", *body, "}", ""]
        namespace, _, own = node.rpartition("/")
        name = own if own not in RESERVED else free_name(own, {*RESERVED, *owns}, "_")
        statements = nodes.setdefault(namespace.strip("/"), [])
        if name != own:
            statements.append(f"# `{own}` is a word of the language")
        statements.append(f"node {name} : {component} {node_block(found)}")
    for namespace, statements in sorted(nodes.items()):
        word = "/" if namespace in RESERVED else ""  # as a path, it is a name
        lines += [f"namespace {word}{namespace} {{", *statements, "}", ""] if namespace else [*statements, ""]
    formatted = format_text("\n".join(lines))
    assert formatted.text is not None, [str(each) for each in formatted.diagnostics]
    return formatted.text

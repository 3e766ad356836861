"""The manager of captured lifecycle nodes from now on: the lifecycle manager that does, or Midstride; never both."""

from __future__ import annotations

from collections.abc import Container

from midstride.capture.observed import ObservedGraph
from midstride.errors import SpecificationError
from midstride.model.lifecycle_management import Management, managed_nodes
from midstride.model.specification import Specification


def gate_of_lifecycle(graph: ObservedGraph, node: str, management: Management | None) -> str | None:
    """Return the gate by which Midstride manages the lifecycle of ``node``; None where it does not.

    Unless something else is asked for, it manages those that nothing else does.
    """
    if node not in graph.lifecycle or management == "manager":
        return None
    return None if management is None and graph.managers_of(node) else "lifecycle preload"


def note_managers(graph: ObservedGraph, specification: Specification) -> None:
    """Note the lifecycle managers that a specification states by their parameters, which need not run now."""
    for role, node in specification.nodes.items():
        component = specification.components[node.component]
        values = {name: each.value for name, each in component.parameters.items()} | dict(node.parameters)
        if nodes := managed_nodes(f"/{role}", values):
            graph.managers.setdefault(f"/{role}", set()).update(nodes)


def words_on(
    graph: ObservedGraph, management: Management | None, here: Container[str], already: Container[str] = ()
) -> list[str]:
    """Return what manages which nodes that are ``here``, in sentences; ``already``: those that Midstride does."""
    words = []
    for manager, managed in sorted(graph.managers.items()):
        nodes = ", ".join(sorted(managed))
        if not any(node in here for node in managed):
            continue
        if management == "midstride":
            left = "it is left out of the file" if manager in here else "it must not run beside `midstride up`"
            words.append(f"{manager} managed the lifecycle of {nodes}; Midstride does from now on: {left}")
        else:
            words.append(
                f"{manager} manages the lifecycle of {nodes}, and goes on with it: while it does, a node with a bond "
                "to it, or whose state it may ask for, cannot be replaced; with `--lifecycle midstride`, Midstride "
                "manages them, without it"
            )
    alone = [
        node
        for node in sorted(graph.lifecycle)
        if node in here and node not in already
        if not graph.managers_of(node) and gate_of_lifecycle(graph, node, management)
    ]
    if alone:
        words.append(f"{', '.join(alone)}: managed by nothing, so Midstride manages the lifecycle from now on")
    return words


def require_all(graph: ObservedGraph, here: Container[str], name: str) -> None:
    """Raises SpecificationError if a manager that is to be left out has nodes that the file ``name`` does not have."""
    for manager, nodes in sorted(graph.managers.items()):
        away = sorted(node for node in nodes & graph.lifecycle if node not in here)
        if away and any(node in here for node in nodes):
            raise SpecificationError(
                [
                    f"{manager} manages the lifecycle of {', '.join(away)} as well, not in {name}: Midstride cannot "
                    "manage a part of its nodes; add the others, or omit `--lifecycle midstride`"
                ]
            )

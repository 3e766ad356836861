"""The nodes of a graph that are in one process, and the processes among these that are component containers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from midstride.capture.observed import ObservedGraph
from midstride.model.instance_names import full_name
from midstride.model.specification import Specification


@dataclass(frozen=True, slots=True)
class ObservedProcess:
    """A process with several ``nodes`` (full names), or a component container, by the full name of its own node."""

    nodes: tuple[str, ...]
    container: str | None = None

    @property
    def words(self) -> str:
        nodes = ", ".join(self.nodes)
        if self.container is None:
            return f"{nodes} are in one process"
        return f"{nodes} {'is' if len(self.nodes) == 1 else 'are'} in the process of the container {self.container}"


def observed_processes(graph: ObservedGraph) -> list[ObservedProcess]:
    """Processes with several nodes, and containers with any. The node of a container does not count."""
    members: dict[str, list[str]] = {}
    for node, process in sorted(graph.processes.items()):
        members.setdefault(process, []).append(node)
    found = []
    for nodes in members.values():
        container = next((node for node in nodes if node in graph.containers), None)
        others = tuple(node for node in nodes if node != container)
        if others and (container is not None or len(others) > 1):
            found.append(ObservedProcess(others, container))
    return sorted(found, key=lambda each: each.nodes)


def container_lines(graph: ObservedGraph) -> Iterator[str]:
    """The statements of a draft: the containers, and what is still to be stated of their nodes.

    Which class a node is, is not in the graph, so that nothing could load it yet: `in` is only for nodes with a class.
    """
    for process in observed_processes(graph):
        if process.container is None:
            yield f"# {process.words}: one program, which `run` starts, has them all."
            continue
        yield f'# {process.words}: state their classes (`run component "…" package "…" gate preload`),'
        run, unknown = _run_of(graph, process.container), " Its program is not in the graph, either."
        yield f"# and write `in {process.container}` after their components.{'' if run else unknown}"
        if "--params-file" in run:
            yield "# Its program reads a file of parameters: copy it if `ros2 launch` has written it below /tmp."
        yield f"container {process.container}{run}"


def _run_of(graph: ObservedGraph, container: str) -> str:
    """The block that states the program of a container; empty where it is not known, or cannot be written as it is."""
    program, package = graph.programs.get(container, ("", ""))
    if not program or not program.isprintable() or set(program + package) & {'"', "\\"}:
        return ""
    return f' {{ run "{program}" package "{package}" }}'


def not_stated(graph: ObservedGraph, specification: Specification) -> list[ObservedProcess]:
    """The containers of which ``specification`` has several nodes, and states that they are elsewhere."""
    stated = {full_name(role): node.container for role, node in specification.nodes.items()}
    return [
        process
        for process in observed_processes(graph)
        if process.container is not None
        and len(known := [stated[node] for node in process.nodes if node in stated]) > 1
        and (len(set(known)) > 1 or known[0] is None)
    ]

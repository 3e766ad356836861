"""The ROS nodes that end with an instance: those of its process, and of the processes that this has started.

The preloaded library lists the nodes of its process. Of any other process, the graph is asked: the middleware names the
process of each endpoint, and with Fast DDS that has the process's number, so that processes which a program has started
are found by ``/proc``. What neither tells is said to be unknown.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from midstride.backends.ros2 import names
from midstride.backends.ros2.middleware import PIDS, NodeProcess, RmwImplementation
from midstride.model.instance_names import full_name
from midstride.runtime.backend_protocol import OtherNode, OtherNodes

if TYPE_CHECKING:  # it imports rclpy, which what manages gates is tested without
    from midstride.backends.ros2.manager.graph import Graph


@dataclass(frozen=True, slots=True)
class AskedProcess:
    """The process of an instance, which the manager has started.

    ``node``: the full name of the node of its program, where that does not use Midstride's API. ``listed``: all nodes
    that the preloaded library has seen, None where there is none. ``programs``: how many processes it is meant to have.
    ``not_its_own``: the full names of nodes of its process that do not end with it, or are Midstride's, as that of a
    container.
    ``mark``: the identity of an endpoint of its process, where that is known: another may have a node of its name.
    """

    instance: str
    node: str | None = None
    listed: Sequence[str] | None = None
    programs: int = 1
    mark: bytes | None = None
    not_its_own: frozenset[str] = frozenset()

    @property
    def is_foreign(self) -> bool:
        return self.node is not None


@dataclass(slots=True)
class _Found:
    """The process as the graph shows it: its own nodes and, by key, the processes that have them."""

    own: set[str] = field(default_factory=set)
    processes: dict[bytes, NodeProcess] = field(default_factory=dict)


def other_nodes(
    graph: Graph, asked: Sequence[AskedProcess], families: Callable[[], Mapping[str, set[int]]]
) -> dict[str, OtherNodes]:
    """See :meth:`midstride.runtime.backend_protocol.Backend.other_nodes`.

    ``families``: the numbers of the processes that belong to each instance, asked for only where they are needed.
    """
    shown = graph.processes()
    found = {each.instance: _own(each, shown, graph.rmw) for each in asked}
    own = {(key, name) for each in found.values() for key in each.processes for name in each.own}
    visible = [(node, process) for node, process in shown if not names.is_hidden(node)]
    left = Counter((process.key, node) for node, process in visible) - Counter(own)
    rmw, pids = graph.rmw, dict[str, set[int]]()
    # The graph shows one that was killed for the lease of the middleware, also beside the next of its name.
    times = Counter(node for node, _ in visible)
    shown_twice = any(times[node] > 1 for each in found.values() for node in each.own)
    if rmw.fast_dds and (left or shown_twice):
        pids = {**families()}
        here = next((process.host for node, process in shown if node == graph.own_name), None)
        for each in asked:
            _match_pids(found[each.instance], visible, pids.get(each.instance, set()), here)
    elif not rmw.fast_dds and rmw.participant is not None and any(map(_is_unlisted, asked)):
        pids = {**families()}
    answer = {}
    for each in asked:
        mine = found[each.instance]
        in_graph = Counter(node for node, process in visible if process.key in mine.processes)
        listed = Counter(node for node in each.listed or () if not names.is_hidden(node))
        others = (in_graph | listed) - Counter(mine.own)
        unknown = _unknown(each, rmw, len(pids.get(each.instance, ())))
        if others or unknown is not None:
            nodes = tuple(_described(graph, node, mine.own) for node in sorted(others.elements()))
            without_own = bool(others) and each.is_foreign and each.node not in {**in_graph, **listed}
            answer[each.instance] = OtherNodes(nodes, unknown, without_own)
    return answer


def _own(asked: AskedProcess, shown: Iterable[tuple[str, NodeProcess]], rmw: RmwImplementation) -> _Found:
    found, marked = _Found(), None if asked.mark is None else rmw.process_with(asked.mark)
    found.own |= {each for each in (asked.node, *asked.not_its_own) if each}
    for node, process in shown:
        instance = names.controlled(node)
        if instance is not None and instance.instance == full_name(asked.instance):
            found.own.add(instance.node)
            found.processes[process.key] = process
        elif node == asked.node and (marked is None or process.key == marked.key):
            found.processes[process.key] = process
    return found


def _match_pids(
    found: _Found, visible: Iterable[tuple[str, NodeProcess]], pids: Iterable[int], here: bytes | None
) -> None:
    """Take the processes of these numbers on this computer, ``here``, and leave out nodes of the same name elsewhere.

    A number is not whole, so where one of a process with its own node is known, no other process is taken for it. What
    runs in its own container has another number there: it is known by the name of its node.
    """
    low = {pid % PIDS for pid in pids}
    known = {(process.host, process.pid): process.key for process in found.processes.values()}
    matching = {
        process.key: process
        for _, process in visible
        if process.pid in low and process.host == here and known.get((here, process.pid), process.key) == process.key
    }
    if matching:
        found.processes = matching


def _is_unlisted(asked: AskedProcess) -> bool:
    return asked.is_foreign and asked.listed is None


def _unknown(asked: AskedProcess, rmw: RmwImplementation, processes: int) -> str | None:
    """The reason why some nodes of a program without Midstride's API may not be known; None where they are."""
    if not _is_unlisted(asked) or rmw.fast_dds:
        return None
    if rmw.participant is None:
        return f"{rmw.identifier} does not tell which process a node belongs to"
    if processes > asked.programs:
        return f"it has started other processes, and {rmw.identifier} does not tell which nodes these have"
    return None


def _described(graph: Graph, node: str, own: set[str]) -> OtherNode:
    if node in own:  # the graph does not tell which of them has an endpoint
        return OtherNode(node, namesake=True)
    return OtherNode(node, tuple(graph.published_by(node)), tuple(map(str, graph.served_by(node).own)))

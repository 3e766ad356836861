"""Publishers whose process has ended on this computer, which the graph shows until their lease has run out.

Fast DDS names the low bits of the number of a process, so the process of a publisher is found in `/proc` when it is
first seen, and its end is noticed there. A publisher of another computer, user or middleware, or one that may be of
several processes, is there as long as the graph shows it.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from midstride.backends.ros2.manager.node_owner import host_of, pids_of
from midstride.backends.ros2.middleware import NodeProcess
from midstride.runtime.process.reaper import ProcessInfo, process_info

if TYPE_CHECKING:  # it imports rclpy, which this is tested without
    from midstride.backends.ros2.manager.graph import Graph


class PublisherProcesses:
    """The processes of the publishers of one topic, as far as they are known."""

    def __init__(self, graph: Graph) -> None:
        self._graph = graph
        self._known: dict[bytes, ProcessInfo | None] = {}

    def living(self, infos: Iterable[Any]) -> list[Any]:
        """The endpoints of ``infos``, all that the graph shows, whose process is not known to have ended."""
        shown = [(info, self._graph.rmw.node_process(info)) for info in infos]
        processes = {process.key: process for _, process in shown if process is not None and process.pid is not None}
        new = processes.keys() - self._known.keys()
        here = host_of(self._graph) if new else None
        self._known = {
            key: _only_one(process, here) if key in new else self._known[key] for key, process in processes.items()
        }
        return [info for info, process in shown if process is None or not self._has_ended(process.key)]

    def _has_ended(self, key: bytes) -> bool:
        if (known := self._known.get(key)) is None:
            return False
        now = process_info(known.pid)
        return now is None or not now.alive or now.started != known.started


def _only_one(process: NodeProcess, here: bytes | None) -> ProcessInfo | None:
    """The process that has this name, where one alone on this computer may be it."""
    pids = pids_of(process, here)
    return process_info(pids[0]) if len(pids) == 1 else None

"""How long the servers of running nodes with a preloaded library take to answer, for `midstride capture`.

It only reads the page of their system, from a process that is not their manager.
"""

from __future__ import annotations

from pathlib import Path

from midstride.foreign import build
from midstride.foreign.page import PAGE, SEND_GOAL, Page
from midstride.foreign.page_layout import SERVER
from midstride.foreign.record import ForeignRecord
from midstride.node.control.response_watch import latest_responses


class SeenAnswers:
    """Of the nodes whose page and records are in ``folder``. Raises BackendError where the page cannot be used."""

    def __init__(self, folder: Path) -> None:
        self._page = Page(folder / PAGE, build.library())
        self._nodes = {record.index: record.node for record in ForeignRecord.all(folder) if record.index is not None}
        self._processes: dict[int, int] = {}  # by the index of a node: the process in which it was seen first
        self._known: dict[tuple[str, str], int] = {}  # how many it had answered at the last look
        # By the full names of a node and of its service or ROS action: how long each response took (s).
        self.took: dict[tuple[str, str], list[float]] = {}

    def look(self) -> None:
        """See what was answered since the last look; of more responses than the page has, the last ones."""
        for port in self._page.every_port():
            node = self._nodes.get(port.node - 1)
            if port.kind != SERVER or node is None or not self._is_same(port.node - 1):
                continue
            key = node, port.topic.decode().removesuffix(SEND_GOAL)
            self._known[key], found = latest_responses(port, self._known.get(key))
            self.took.setdefault(key, []).extend(found)

    def _is_same(self, index: int) -> bool:
        """Return whether a node of the page is still the one that was seen first: its part may be given to another."""
        process = int(self._page.layout.nodes[index].pid)
        return process != 0 and self._processes.setdefault(index, process) == process and not self._page.is_dead(index)

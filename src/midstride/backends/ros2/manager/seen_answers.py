"""The times that servers of running nodes with a preloaded library take to answer, for `midstride capture`."""

from __future__ import annotations

from midstride.backends.ros2.manager.seen_nodes import SeenNodes
from midstride.foreign.page import SEND_GOAL
from midstride.foreign.page_layout import SERVER
from midstride.node.control.response_watch import latest_responses


class SeenAnswers:
    """The answers of ``nodes``."""

    def __init__(self, nodes: SeenNodes) -> None:
        self._seen = nodes
        self._known: dict[tuple[str, str], int] = {}  # how many it had answered at the last look
        # By the full names of a node and of its service or ROS action: how long each response took (s).
        self.took: dict[tuple[str, str], list[float]] = {}

    def look(self) -> None:
        """See what was answered since the last look; of more responses than the page has, the last ones."""
        for port in self._seen.page.every_port():
            node = self._seen.nodes.get(port.node - 1)
            if port.kind != SERVER or node is None or not self._seen.is_same(port.node - 1):
                continue
            key = node, port.topic.decode().removesuffix(SEND_GOAL)
            self._known[key], found = latest_responses(port, self._known.get(key))
            self.took.setdefault(key, []).extend(found)

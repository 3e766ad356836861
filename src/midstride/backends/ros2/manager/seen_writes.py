"""The moments at which running nodes with a preloaded library publish, for `midstride capture`: without a subscription.

The library counts in their processes, also what goes to subscriptions of the same process by intra-process
communication. A subscription would have such a publisher serialize each message.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

from midstride.backends.ros2.manager.seen_nodes import SeenNodes
from midstride.capture.observed import MAX_TIMES
from midstride.foreign.page_layout import NODE, OUTPUT, WRITES, PagePort, Within

# How often the counts are read, and how often it is looked for new outputs (s).
EVERY: Final = 0.02
OUTPUTS_EVERY: Final = 0.5
# An output without a reader that has written nothing for so long (s) may write only while it has one.
SILENT: Final = 2.0
_WRAP: Final = 2**32


@dataclass(slots=True)
class _Output:
    """The messages on one topic of a node of the page, since ``since``."""

    port: PagePort
    since: float
    count: int
    times: list[float] = field(default_factory=list)
    lost: bool = False  # it is no longer the same, or not the only one

    def look(self, before: float, now: float) -> None:
        """Note when messages were written since the last look, at ``before``, or since it was found.

        Of more than the page has, the last ones: what was noted before says nothing of the gap.
        """
        written, before = int(self.port.written), max(before, self.since)
        if written < self.count:
            self.lost = True
            return
        if written - self.count > WRITES:
            self.times.clear()
        micros = int(now * 1e6)
        for number in range(max(self.count, written - WRITES), written):
            at = now - (micros - self.port.wrote[number % WRITES]) % _WRAP / 1e6
            # A thread that has counted one and not yet noted its time leaves that of another.
            if at > before - EVERY and len(self.times) < MAX_TIMES:
                self.times.append(at)
        self.count = written

    @property
    def counts(self) -> bool:
        """Return whether the library sees each message: rclcpp of Humble does not tell what goes within the process."""
        return not self.lost and (not self.port.within & Within.TAKES_PART or bool(self.port.inside))


class SeenWrites:
    """The messages of ``nodes``; ``now``: the time of CLOCK_MONOTONIC (s)."""

    def __init__(self, nodes: SeenNodes, now: Callable[[], float] = time.monotonic) -> None:
        self._seen, self._now = nodes, now
        self._outputs: dict[tuple[int, str], _Output] = {}  # by the index of the node, and the topic
        self._names: dict[int, set[str]] = {}  # by the index of the node, the full names of its ROS nodes
        self._searched = self._looked = -float("inf")

    def look(self) -> None:
        """See what was written since the last look."""
        if (now := self._now()) - self._looked < EVERY:
            return
        if now - self._searched >= OUTPUTS_EVERY:
            self._search(now)
        for (index, _), output in self._outputs.items():
            output.lost |= output.port.node != index + 1 or not self._seen.is_same(index)
            if not output.lost:
                output.look(self._looked, now)
        self._looked = now

    def _search(self, now: float) -> None:
        self._searched = now
        self._names = {index: {name} for index, name in self._seen.nodes.items()}
        ports = [port for port in self._seen.page.every_port() if port.node]
        for port in ports:
            if port.kind == NODE:
                self._names.setdefault(port.node - 1, set()).add(port.topic.decode())
        for port in ports:
            key = port.node - 1, port.topic.decode()
            if port.kind == OUTPUT and self._seen.is_same(key[0]):
                known = self._outputs.get(key)
                if known is None or known.lost:
                    self._outputs[key] = known = _Output(port, now, int(port.written))
                # Publishers of two ROS nodes have one count.
                known.lost |= port.endpoints > 1 and len(self._names[key[0]]) > 1

    def counts(self, node: str, topic: str) -> bool:
        """Return whether no subscription is needed for what a ROS node, by its full name, publishes on ``topic``.

        For an output without a reader, one may be: it may write only while it has one.
        """
        if self._find(node, topic) is None:  # the graph may show an output before the next look for new ones
            self._search(self._now())
        if (output := self._find(node, topic)) is None:
            return False
        if output.count:
            return output.counts
        return not output.lost and (bool(output.port.matched) or self._now() - output.since < SILENT)

    def times(self, node: str, topic: str) -> list[float] | None:
        """The publication times of a ROS node on ``topic`` (s, of one clock); None where the library sees none."""
        output = self._find(node, topic)
        return output.times if output is not None and output.counts else None

    def has_closed(self, node: str, topic: str) -> bool:
        """Return whether a ROS node that goes on has closed its publisher on ``topic``."""
        output = self._find(node, topic)
        return output is not None and not output.lost and not output.port.endpoints

    def _find(self, node: str, topic: str) -> _Output | None:
        found = [
            output
            for (index, name), output in self._outputs.items()
            if name == topic and node in self._names.get(index, ())
        ]
        return found[0] if len(found) == 1 else None

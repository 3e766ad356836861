"""The search for a program's own node in its process, where the program itself gives the node its name."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Final

# How often the graph is looked at for the node of a process that has just been started (s).
NODE_LOOK: Final = 0.05
# How long the node that is expected may take to show after another one of its process (s).
PATIENCE: Final = 2.0


@dataclass
class OwnNodeSearch:
    """Looks at the nodes of a process for at most ``seconds``; other nodes than the program's may show first.

    ``expected``: the full name that the node was passed, or has had before; empty where none is known.
    """

    expected: str
    seconds: float
    shown: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._deadline = time.monotonic() + self.seconds

    def look(self, nodes: Iterable[str]) -> bool:
        """Take what the graph shows now, by full names; return whether there is nothing more to wait for."""
        before, self.shown = self.shown, [name for name in nodes if "/_" not in name]
        if self.shown and not before:  # a program that names its node otherwise by now shows that soon
            self._deadline = min(self._deadline, time.monotonic() + PATIENCE)
        found = self.expected in self.shown if self.expected else bool(self.shown)
        return found or time.monotonic() >= self._deadline

    @property
    def node(self) -> str:
        """The full name of the program's node; empty where none was shown."""
        if not self.shown or self.expected in self.shown:
            return self.expected if self.shown else ""
        # Of several, a further one is often in a namespace of the first.
        return min(self.shown, key=lambda name: (name.count("/"), len(name), name))

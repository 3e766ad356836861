"""The running nodes of a system that have a preloaded library, as `midstride capture` sees them.

It only reads the page of their system, from a process that is not their manager.
"""

from __future__ import annotations

from pathlib import Path

from midstride.foreign import build
from midstride.foreign.page import PAGE, Page
from midstride.foreign.record import ForeignRecord


class SeenNodes:
    """The nodes whose page and records are in ``folder``. Raises BackendError where the page cannot be used.

    ``nodes``: by index, the full name of its ROS node, as its record has it.
    """

    def __init__(self, folder: Path) -> None:
        self.page = Page(folder / PAGE, build.library())
        self.nodes = {record.index: record.node for record in ForeignRecord.all(folder) if record.index is not None}
        self._processes: dict[int, int] = {}  # by the index of a node: the process in which it was seen first

    def is_same(self, index: int) -> bool:
        """Return whether a node of the page is still the one that was seen first: its part may be given to another."""
        process = int(self.page.layout.nodes[index].pid)
        return process != 0 and self._processes.setdefault(index, process) == process and not self.page.is_dead(index)

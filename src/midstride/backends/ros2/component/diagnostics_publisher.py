"""The publisher of a component's diagnostics, on its hidden control node.

It is none of the data node's endpoints, and user code does not delay it. It is created when there is something to
publish for the first time: that is not before the component answers for its node, so a hand-over is over by then.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from midstride.backends import diagnostic_array
from midstride.backends.naming import DIAGNOSTICS
from midstride.node.diagnostic_status import DiagnosticEntry


class DiagnosticsPublisher:
    """``instance`` and ``node`` are the full names of the instance and of its data node."""

    def __init__(self, control_node: Any, control_executor: Any, node: str, instance: str) -> None:
        self._control_node = control_node
        self._executor = control_executor
        self._names = node.strip("/"), instance.strip("/")
        self._publisher: Any = None
        self._under_way = False

    def publish(self, entries: Callable[[], Iterable[DiagnosticEntry]], now: int) -> None:
        """Have the executor of the control node do it; ``entries`` is called where something listens.

        Not beside another one: a middleware that has deadlocked may never return, and they would add up.
        """
        if diagnostic_array.MESSAGE is not None and not self._under_way:
            self._under_way = True
            self._executor.create_task(self._publish, entries, now)

    def _publish(self, entries: Callable[[], Iterable[DiagnosticEntry]], now: int) -> None:
        try:
            if self._publisher is None:
                self._publisher = self._control_node.create_publisher(diagnostic_array.MESSAGE, DIAGNOSTICS, 1)
            if self._publisher.get_subscription_count():
                self._publisher.publish(diagnostic_array.message(entries(), *self._names, now))
        finally:
            self._under_way = False

"""An executor in a thread of its own."""

from __future__ import annotations

import threading
import traceback
from collections.abc import Callable
from typing import Any

from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor


class ExecutorThread:
    """Spins a SingleThreadedExecutor in a thread until it is stopped; survives what user callbacks raise."""

    def __init__(self, name: str, context: Any, failed: Callable[[str], None]) -> None:
        """``failed`` is called, in the thread, with the traceback of whatever a callback raised."""
        self.executor: Any = SingleThreadedExecutor(context=context)
        self._context = context
        self._failed = failed
        self._stopping = False
        self._thread = threading.Thread(target=self._spin, name=name, daemon=True)

    def start(self) -> None:
        self._thread.start()

    def stop(self, timeout: float) -> bool:
        """Stop and join it; False where a callback does not return in time. Blocks.

        The thread must be out of the middleware before the context is shut down, or that aborts.
        """
        self._stopping = True
        if self._thread.is_alive():
            self.executor.create_task(lambda: None)  # a mere wake-up would let it go back to waiting
            self._thread.join(timeout)
        if self._thread.is_alive():
            return False
        self.executor.shutdown()
        return True

    def _spin(self) -> None:
        while not self._stopping and self._context.ok():
            try:
                self.executor.spin_once()
            except ExternalShutdownException:
                return
            except Exception:
                self._failed(traceback.format_exc())

"""A future as rclpy's are: whatever waits for it is resumed on the data thread of its process."""

from __future__ import annotations

from collections.abc import Callable, Generator
from functools import partial
from typing import Any

from midstride.backends.simulator.simulated_process import SimulatedProcess


class SimulatedFuture:
    """Used on the data thread of ``process``, or on the loop."""

    __slots__ = ("_callbacks", "_done", "_error", "_process", "_result")

    def __init__(self, process: SimulatedProcess) -> None:
        self._process = process
        self._done = False
        self._result: Any = None
        self._error: BaseException | None = None
        self._callbacks: list[Callable[[SimulatedFuture], object]] = []

    def done(self) -> bool:
        return self._done

    def cancelled(self) -> bool:
        return False

    def result(self) -> Any:
        """The value it was set to, None until then. Raises the exception it was set to."""
        if self._error is not None:
            raise self._error
        return self._result

    def exception(self) -> BaseException | None:
        return self._error

    def set_result(self, result: Any) -> None:
        self._result = result
        self._end()

    def set_exception(self, error: BaseException) -> None:
        self._error = error
        self._end()

    def add_done_callback(self, callback: Callable[[SimulatedFuture], object]) -> None:
        if self._done:
            self._process.enqueue(partial(callback, self))
        else:
            self._callbacks.append(callback)

    def _end(self) -> None:
        self._done = True
        callbacks, self._callbacks = self._callbacks, []
        for callback in callbacks:
            self._process.enqueue(partial(callback, self))

    def __await__(self) -> Generator[SimulatedFuture, None, Any]:
        while not self._done:
            yield self
        return self.result()

"""A server of a component's port, on any platform: when it leaves the graph."""

from __future__ import annotations

import inspect
from abc import ABC, abstractmethod
from collections.abc import Awaitable, Callable, Mapping
from typing import Any, Generic, TypeVar

from midstride.node.request_admission import RequestAdmission

A = TypeVar("A")


class RetiringServer(ABC, Generic[A]):
    """Implements :class:`midstride.node.component_host.ServedService`. Used on the data thread.

    ``answer`` is that of the port that it belongs to now. ``later`` has the data thread call a function.
    """

    def __init__(
        self,
        name: str,
        type_: type,
        answer: A,
        admission: RequestAdmission,
        later: Callable[[Callable[[], Any]], object],
    ) -> None:
        self.name = name
        self.type = type_
        self.answer = answer
        self.admission = admission
        self.retired = False
        self._later = later
        self._under_way = 0

    def resume(self, answer: A) -> None:
        """Belong to a port again."""
        self.answer, self.retired = answer, False

    def retire(self) -> None:
        """Answer what has arrived, and leave the graph when what is under way has ended.

        While another instance answers, it stays until the process ends: it passes on what only it receives.
        """
        self.retired = True
        if self.admission.is_open:
            self._answer_waiting()
            self._leave_when_done()

    def _in_time(self, result: Any) -> Any:
        """``result``, which may be an awaitable: the server stays in the graph until that is done."""
        if not inspect.isawaitable(result):
            return result
        self._under_way += 1
        return self._finish(result)

    async def _finish(self, awaitable: Awaitable[Any]) -> Any:
        try:
            return await awaitable
        finally:
            self._under_way -= 1
            if self.retired:
                self._later(self._leave_when_done)  # once the response has been sent

    def _leave_when_done(self) -> None:
        if self.retired and not self._under_way and self.admission.is_open:
            self._leave()

    def _answer_waiting(self) -> None:
        """Answer the requests that have arrived and wait for the data thread, where there are any."""

    @abstractmethod
    def _leave(self) -> None:
        """Leave the graph."""


S = TypeVar("S", bound=RetiringServer[Any])


def taken_up(servers: Mapping[str, S], name: str, type_: type, answer: Any) -> S | None:
    """Take up the server that was given up while another instance answered, if it is still in the graph."""
    server = servers.get(name)
    if server is None or server.type is not type_:
        return None
    server.resume(answer)
    return server

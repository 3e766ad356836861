"""The servers of the program behind a relay: what the relay answers, and how the program does so for it.

The program serves under a private name, and the relay has the server that clients know. So a request is admitted as
any other one to a component (:mod:`midstride.node.request_admission`), and only then passed on to the program.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any, Final

from midstride.errors import Unanswered
from midstride.node.author.server_ports import ServerPort
from midstride.node.component_host import CalledService, Host

# How many requests to a server may be at the program at once: its queue has room for ten, unless it asks for another
# number, and drops the oldest of more.
ROOM: Final = 8
# A request that is not answered after so long (s) does not count among these any more: it may never be.
NEVER: Final = 10.0


class RelayedServer:
    """Passes the requests to ``port`` on, in order, to the server of the program, whose full name is ``private``.

    Used on the data thread.
    """

    def __init__(self, name: str, type_: type, private: str, within: float | None) -> None:
        self.private = private
        self.port = ServerPort(name, type_, self._pass_on, within, None)
        self._client: CalledService | None = None
        self._steady: Callable[[], int] = lambda: 0
        # Requests that the program has no room for yet, each with the future that its response ends; and when those
        # that it has were sent (steady ns), by that future.
        self._waiting: deque[tuple[Any, Any]] = deque()
        self._sent: dict[Any, int] = {}
        self._exited = False

    def connect(self, host: Host) -> None:
        self._steady = host.steady
        self._client = host.create_client(self.private, self.port.type)

    @property
    def matched(self) -> bool:
        """Return whether the program's server has been discovered. On any thread."""
        return self._client is not None and self._client.matched() > 0

    def send_waiting(self) -> None:
        """Send as many as the program has room for."""
        assert self._client is not None
        now = self._steady()
        under_way = sum(now - since < NEVER * 1e9 for since in self._sent.values())
        while self._waiting and under_way < ROOM:
            request, given = self._waiting.popleft()
            self._sent[given] = now
            under_way += 1
            self._client.call(request).add_done_callback(partial(self._answered, given))

    def give_up(self) -> None:
        """The program has exited: none of its requests is answered any more."""
        self._exited = True
        left = [*self._sent, *(given for _, given in self._waiting)]
        self._sent.clear()
        self._waiting.clear()
        for given in left:
            assert self._client is not None
            self._client.abandon(given, self._unanswered())

    def _unanswered(self) -> Unanswered:
        return Unanswered(f"the program that answers for server {self.port.name} has exited")

    def _pass_on(self, request: Any, _: Any) -> Any:
        assert self._client is not None
        if self._exited:
            raise self._unanswered()
        given = self._client.unsent()
        self._waiting.append((request, given))
        self.send_waiting()
        return given

    def _answered(self, given: Any, response: Any) -> None:
        if self._sent.pop(given, None) is None:
            return
        if (error := response.exception()) is not None:
            given.set_exception(error)
        else:
            given.set_result(response.result())
        self.send_waiting()

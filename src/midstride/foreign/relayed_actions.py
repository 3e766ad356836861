"""The ROS actions of the program behind a relay: goals that the relay accepts where the program does, which has them.

As with services (:mod:`.relayed_servers`), the program serves under a private name. Each goal of a client is a goal of
the relay at the program: its feedback and its result are passed on, and so is a request to cancel it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final

from midstride.errors import Unanswered
from midstride.node.author.server_ports import ActionServerPort
from midstride.node.component_host import CalledService, Host

# The states of a goal that has ended, as `action_msgs/msg/GoalStatus` has them.
SUCCEEDED: Final = 4
CANCELED: Final = 5
# How long a goal that the program has cancelled may take until its relay knows that this was asked for (s).
KNOWN: Final = 1.0
_TICK: Final = 0.005


@dataclass(eq=False)
class _Goal:
    """A goal of a client, as the program has it (``handle``); ``passed_on``: where its feedback goes, once accepted."""

    request: Any
    handle: Any = None
    passed_on: Callable[[Any], object] | None = None
    early: list[Any] = field(default_factory=list)

    def hear(self, message: Any) -> None:
        if self.passed_on is None:
            self.early.append(message.feedback)
        else:
            self.passed_on(message.feedback)

    def begin(self, passed_on: Callable[[Any], object]) -> None:
        self.passed_on = passed_on
        for feedback in self.early:
            passed_on(feedback)
        self.early.clear()


class RelayedActionServer:
    """Passes the goals of ``port`` on to the ROS action of the program, whose full name is ``private``.

    Used on the data thread.
    """

    def __init__(self, name: str, type_: type, private: str, within: float | None) -> None:
        self.private = private
        self.port = ActionServerPort(name, type_, self._execute, within, self._accepts, self._cancels)
        self._host: Host | None = None
        self._client: CalledService | None = None
        # By the request of a client, which the relay's goal has as well.
        self._goals: dict[int, _Goal] = {}
        self._waited_for: set[Any] = set()
        self._exited = False

    def connect(self, host: Host) -> None:
        self._host = host
        self._client = host.create_action_client(self.private, self.port.type, lambda _: None)

    @property
    def matched(self) -> bool:
        """Return whether the program's ROS action has been discovered. On any thread."""
        return self._client is not None and self._client.matched() > 0

    def send_waiting(self) -> None:
        """Nothing waits here: a server of a ROS action takes its requests while its goals are executed."""

    def give_up(self) -> None:
        """The program has exited, and its goals with it."""
        self._exited = True
        for future in list(self._waited_for):
            assert self._client is not None
            self._client.abandon(future, self._unanswered())

    def _unanswered(self) -> Unanswered:
        return Unanswered(f"the program that has the goals of {self.port.name} has exited")

    async def _answered(self, future: Any) -> Any:
        """The result of ``future``, unless the program exits before. Raises Unanswered."""
        if self._exited:
            raise self._unanswered()
        self._waited_for.add(future)
        try:
            return await future
        finally:
            self._waited_for.discard(future)

    async def _accepts(self, request: Any) -> bool:
        assert self._client is not None
        if self._exited:
            return False
        goal = _Goal(request)
        try:
            goal.handle = await self._answered(self._client.call(request, goal.hear))
        except Unanswered:
            return False
        if goal.handle.accepted:
            self._goals[id(request)] = goal
        return bool(goal.handle.accepted)

    async def _execute(self, goal: Any) -> Any:
        own = self._goals[id(goal.request)]
        try:
            own.begin(goal.publish_feedback)
            found = await self._answered(own.handle.get_result_async())
        except Unanswered:  # which ends the relay as well
            goal.abort()
            return self.port.type.Result()  # type: ignore[attr-defined]
        finally:
            del self._goals[id(goal.request)]
        if found.status == SUCCEEDED:
            goal.succeed()
        elif found.status == CANCELED and await self._is_cancelled(goal):
            goal.canceled()
        else:
            goal.abort()
        return found.result

    async def _is_cancelled(self, goal: Any) -> bool:
        """Return whether to cancel ``goal`` was asked for. The program may end it before it has answered that."""
        host = self._host
        assert host is not None
        deadline = host.steady() + KNOWN * 1e9
        while not goal.is_cancel_requested and host.steady() < deadline:
            await host.pause(_TICK)
        return bool(goal.is_cancel_requested)

    async def _cancels(self, goal: Any) -> bool:
        if (own := self._goals.get(id(goal.request))) is None:
            return False
        try:
            return bool((await self._answered(own.handle.cancel_goal_async())).goals_canceling)
        except Unanswered:
            return False

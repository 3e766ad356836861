"""The requests to a server of a ROS action, on any platform: which of them are handled here, and what is noted of each.

Whose turn it is, :mod:`midstride.node.request_admission` says; how a server does what it is asked, its platform.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Final, Literal, Protocol, TypeAlias

from midstride.node.request_admission import GoalTurn, RequestAdmission

# What stands for several goals, in a request to cancel them.
MANY: Final = ""

# The three services of a ROS action.
GoalRequestKind: TypeAlias = Literal["goal", "result", "cancel"]


@dataclass(frozen=True)
class GoalRequest:
    """A request for or about ``goal``, its UUID in hexadecimal, or MANY. ``entry`` is what the platform has of it.

    ``identity`` is the same at every server that has received it.
    """

    kind: GoalRequestKind
    identity: str
    goal: str
    entry: Any


class GoalServer(Protocol):
    """A platform's server of a ROS action. All of it runs on the data thread. ``entry`` is that of a request."""

    @property
    def timed_as(self) -> str:
        """The name under which it is measured how long it takes to accept goals; empty where it is not."""

    async def accept(self, entry: Any) -> None:
        """Do what the server does with a request for a goal: accept or reject it, and respond."""

    def knows(self, goal: str) -> bool:
        """Return whether it has ``goal``, or its result."""

    def when_ended(self, goal: str, function: Callable[[Any], object]) -> None:
        """Have ``function`` called with the response that has the result of ``goal``, once that has ended."""

    async def give_result(self, entry: Any) -> None:
        """Respond with the result of a goal once it has ended; or at once that it is not known."""

    def give_kept(self, entry: Any, response: bytes) -> None:
        """Respond with the result that another instance has left, serialized."""

    async def cancel(self, entry: Any, respond: Callable[[Any], object]) -> None:
        """Cancel what ``entry`` asks for, or all goals where it is None, and call ``respond`` with the response."""

    def give_cancelled(self, entry: Any, response: Any, added: bytes | None) -> bool:
        """Send the response to a request to cancel goals, with those of the other instance (``added``).

        Returns False where it says that the goal is not known.
        """

    def is_cancelled(self, response: Any) -> bool:
        """Return whether the response with a result says that the goal was cancelled."""

    def serialized(self, response: Any) -> bytes:
        """A response with a result, or with a list of cancelled goals, as it is sent to another instance."""


@dataclass(frozen=True)
class AdmittedGoals:
    """The requests to ``server``, of which ``admission`` decides. ``later`` has the data thread call a function."""

    server: GoalServer
    admission: RequestAdmission
    later: Callable[[Callable[[], Any]], object]

    async def handle(self, request: GoalRequest) -> None:
        """Handle ``request``, leave it to the other instance, or hold it: then it comes here again."""
        goals, identity, goal = self.admission.goals, request.identity, request.goal
        if request.kind == "goal":
            accept, timed = partial(self._accept, request), self.server.timed_as
            if self.admission.admit(identity, lambda: self.later(accept), asks_for=goal, service=timed):
                await accept()
            return
        match self.admission.goal_turn(identity, goal, lambda: self.later(partial(self.handle, request))):
            case GoalTurn.WAIT:
                return
            case GoalTurn.ADD:
                await self.server.cancel(
                    request.entry, lambda response: goals.add_list(identity, self.server.serialized(response))
                )
            case GoalTurn.ANSWER if request.kind == "result":
                await self._give_result(request)
            case GoalTurn.ANSWER if goal == MANY and self.admission.predecessor_has_goals:
                answer = partial(self._cancel, request)
                goals.await_list(identity, lambda added: self.later(partial(answer, added)))
            case GoalTurn.ANSWER:
                await self._cancel(request, None)

    def left(self) -> None:
        """Note that the server has left the graph."""
        self.admission.goals.server_left(self._cancel_all)

    async def _accept(self, request: GoalRequest) -> None:
        goal, goals = request.goal, self.admission.goals
        try:
            await self.server.accept(request.entry)
            if self.server.knows(goal) and goals.accepted(goal, self._cancel_all):
                self.server.when_ended(goal, partial(self._ended, goal))
        finally:
            self.admission.finished(request.identity)

    def _ended(self, goal: str, response: Any) -> None:
        cancelled = self.server.is_cancelled(response)
        self.admission.goals.ended(goal, lambda: self.server.serialized(response), cancelled=cancelled)

    async def _give_result(self, request: GoalRequest) -> None:
        goal, goals = request.goal, self.admission.goals
        try:
            if self.server.knows(goal):
                goals.fetched(goal)
                await self.server.give_result(request.entry)
            elif (kept := goals.kept(goal)) is not None:
                goals.fetched(goal)
                self.server.give_kept(request.entry, kept)
            else:
                goals.not_known()
                await self.server.give_result(request.entry)
        finally:
            self.admission.finished(request.identity)

    async def _cancel(self, request: GoalRequest, added: bytes | None) -> None:
        """Cancel goals, and respond also with those that the other instance has cancelled (``added``)."""

        def respond(response: Any) -> None:
            if not self.server.give_cancelled(request.entry, response, added):
                self.admission.goals.not_known()

        try:
            await self.server.cancel(request.entry, respond)
        finally:
            self.admission.finished(request.identity)

    def _cancel_all(self) -> None:
        self.later(partial(self.server.cancel, None, lambda response: None))

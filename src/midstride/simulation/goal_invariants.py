"""The invariants of every goal of a ROS action, whatever strikes: what is asked about it is answered where it is.

The instance that has accepted a goal answers what is asked about it until it has ended, and then its successor does:
with the true result, which no client had fetched. A goal ends with its true result, once; one that a client has had
cancelled does not succeed. Each goal is executed once, as any request (:mod:`.request_invariants`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final

from midstride.backends.simulator.service_endpoints import SUCCEEDED, UNKNOWN
from midstride.backends.simulator.service_network import SimulatedRequest
from midstride.simulation.platform import Platform
from midstride.simulation.puppet import text_of
from midstride.simulation.stand_in import StandIn

# How long a request for the result of a goal may wait once that has ended (s): the successor looks every 0.5 s whether
# the old instance has ended, and asks three times at most for what it has left.
GIVEN: Final = 5.0


@dataclass
class _Goal:
    """A goal that ``process`` has accepted. ``cancelled``: a client was told that it is cancelled.

    ``response``: what a request for its result is answered with, once it has ended; ``ended_at``: when (steady s).
    """

    process: StandIn
    name: str
    cancelled: bool = False
    response: tuple[int, str] | None = None
    ended_at: float = 0.0


@dataclass
class GoalInvariants:
    """``violated`` is called with words.

    ``torn()`` says whether a fault may keep an instance from reaching another one: then a result may be lost.
    """

    platform: Platform
    violated: Callable[[str], None] = lambda words: None
    torn: Callable[[], bool] = lambda: False
    _goals: dict[str, _Goal] = field(default_factory=dict)
    # By role, when a process of it has ended last whose results may have ended with it (steady s).
    _lost: dict[str, float] = field(default_factory=dict)
    _exited: set[int] = field(default_factory=set)  # by process id

    def on_sent(self, request: SimulatedRequest) -> None:
        if request.kind == "result" and request.request in self._goals:
            self.platform.time.loop.call_later(GIVEN, self._check_given, request)

    def _check_given(self, request: SimulatedRequest) -> None:
        """Check that the client has the result of a goal that has ended, unless it may be lost."""
        goal, client, now = self._goals[request.request], request.client.owner, self.platform.time.steady()
        if request.identity not in self.platform.network.services.waiting or client.dead or self._may_be_lost(goal):
            return
        since = max(request.since, goal.ended_at, client.reacts_since, goal.process.reacts_since)
        since = max(since, goal.process.exited_at) if goal.process.dead else since
        if goal.response is None or (left := since + GIVEN - now) > 0:
            self.platform.time.loop.call_later(GIVEN if goal.response is None else left, self._check_given, request)
            return
        self.violated(f"{client.instance} waits for the result of a goal of {goal.name}, which has ended")

    def on_executed(self, request: SimulatedRequest, process: StandIn) -> None:
        """Check that an instance about whose goals ``request`` is answers it itself."""
        goal = self._goals.get(request.request) if request.kind in ("result", "cancel") else None
        if goal is None or goal.process is process or goal.process.dead or self.torn():
            return
        if goal.process.has_goal(request.request):
            what = "result" if request.kind == "result" else "cancelling"
            self.violated(
                f"the {what} of a goal of {goal.name}, which {goal.process.instance} has, is answered by "
                f"{process.instance}"
            )

    def on_response(self, request: SimulatedRequest, process: StandIn, response: Any) -> None:
        match request.kind:
            case "goal" if response.accepted:
                self._goals[request.identity] = _Goal(process, request.client.name)
            case "result" if (goal := self._goals.get(request.request)) is not None:
                self._check_result(goal, _told(response))
            case "cancel" if (goal := self._goals.get(request.request)) is not None:
                goal.cancelled = goal.cancelled or bool(response.goals_canceling)

    def _check_result(self, goal: _Goal, told: tuple[int, str]) -> None:
        if told == goal.response:
            return
        if told[0] != UNKNOWN:
            self.violated(f"a client gets {told} as the result of a goal of {goal.name}, and that is {goal.response}")
        elif not self._may_be_lost(goal):
            self.violated(f"the result of a goal of {goal.name}, which {goal.process.instance} had, is not known")

    def may_answer_again(self, request: SimulatedRequest) -> bool:
        """Return whether the successor of an instance that is lost may not know that it has answered ``request``."""
        goal = self._goals.get(request.request) if request.kind in ("result", "cancel") else None
        return goal is not None and self._may_be_lost(goal)

    def _may_be_lost(self, goal: _Goal) -> bool:
        """Return whether a fault, or what no other instance replaces, may have taken the result with it."""
        return self.torn() or self._lost.get(goal.process.role, -1.0) >= goal.ended_at

    def on_ended(self, identity: str, response: Any) -> None:
        goal = self._goals.get(identity)
        if goal is None:
            return
        if goal.response is not None and not self.torn():  # else both instances may execute it
            self.violated(f"a goal of {goal.name} ends twice")
        goal.response, goal.ended_at = _told(response), self.platform.time.steady()
        if goal.cancelled and goal.response[0] == SUCCEEDED:
            self.violated(f"a goal of {goal.name} succeeds, although its client was told that it is cancelled")

    def on_exit(self, process: StandIn) -> None:
        """Note that a process has ended. In order, and replaced by another one, it must have waited for its goals."""
        if process.pid in self._exited:
            return
        self._exited.add(process.pid)
        if process.status != 0 or not process.replaced or self.torn():
            self._lost[process.role] = self.platform.time.steady()
            return
        for goal in self._goals.values():
            if goal.process is process and goal.response is None:
                self.violated(f"{process.instance} has ended, and a goal of {goal.name} has not")


def _told(response: Any) -> tuple[int, str]:
    """The state of a goal, and its result as a text."""
    return response.status, text_of(response.result)
